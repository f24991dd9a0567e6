"""What becomes of the senses, for whoever acts on it: the sentence beside it is for people alone."""

from __future__ import annotations

from enum import StrEnum
from typing import Protocol


class SenseChange(StrEnum):
    """A change that the operator must hear of at once."""

    VOICE_GONE = "voice_gone"
    VOICE_BACK = "voice_back"
    VOICE_OFF = "voice_off"
    HANDS_NOT_SEEN = "hands_not_seen"
    HANDS_SEEN_AGAIN = "hands_seen_again"
    HANDS_OFF = "hands_off"


class Say(Protocol):
    """Tell the operator one sentence, from any thread. change: what it is about, where that matters to a program."""

    def __call__(self, sentence: str, change: SenseChange | None = None, /) -> None: ...


def nothing_said(_sentence: str, _change: SenseChange | None = None, /) -> None:
    """For who wants to hear nothing."""
