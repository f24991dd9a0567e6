"""How every command ends: the exit statuses of the contract, once. Nothing heavy is imported here."""

from __future__ import annotations

from enum import IntEnum


class ExitStatus(IntEnum):
    """The highest that applies counts."""

    ENDED = 0
    """Normally: everything asked was played, or a person ended it in order."""
    FAULT = 1
    """A fault of ours."""
    BAD_INPUT = 2
    NO_VEHICLE = 3
    """None could be paired with, or it was lost."""
    VIOLATED = 4
    """A hard limit was broken in flight, and it was ours to keep."""
    INTERRUPTED = 130
    """By a signal (128 + SIGINT)."""
