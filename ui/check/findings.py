"""What `m3r check` says: findings, their table, and what the looks at a machine have in common."""

from __future__ import annotations

import contextlib
import importlib
import os
import sys
import textwrap
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path
    from types import ModuleType

    from modalities.hands.camera import CameraAddress


class State(StrEnum):
    """WORKS: seen to work. WEAK: works, but not well enough. MISSING: what needs it cannot be used. NOT_BUILT: no part of
    this M3R. NOT_DONE: it takes a person.
    """

    WORKS = "works"
    WEAK = "weak"
    MISSING = "missing"
    NOT_BUILT = "not built"
    NOT_DONE = "not done"


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was looked at. remedy: one sentence, what to do; None where nothing is to be done."""

    part: str
    state: State
    text: str
    remedy: str | None = None


@dataclass(frozen=True, slots=True)
class Wanted:
    """What to look at beyond what every machine has. vehicles: MAVLink address by colour; microphone: as --audio mic:NAME;
    camera: None for those of this machine; mirror: ask the person before the camera to point, although no terminal is here;
    broker, credentials: of the shared air.
    """

    vehicles: Mapping[str, str] = field(default_factory=dict)
    microphone: str | None = None
    camera: CameraAddress | None = None
    mirror: bool = False
    broker: str | None = None
    credentials: Path | None = None


def shown(finding: Finding, width: int = 100) -> str:
    """The finding as lines of a table, its remedy below it."""
    head = f"{finding.state:<10}{finding.part:<16}"
    lines = textwrap.wrap(finding.text, width, initial_indent=head, subsequent_indent=" " * len(head))
    if finding.remedy is not None:
        indent = " " * (len(head) - 2)
        lines += textwrap.wrap(finding.remedy, width, initial_indent=f"{indent}> ", subsequent_indent=f"{indent}  ")
    return "\n".join(lines)


def parts_of(sentence: str) -> Sequence[str]:
    """Our errors say what is wrong, then, after a colon, what to do."""
    wrong, colon, remedy = sentence.rstrip(".").rpartition(": ")
    return (wrong, remedy) if colon else (remedy,)


def module(name: str) -> ModuleType | None:
    """One of our modules; None where this M3R does not have it. A library that it lacks is an error as elsewhere."""
    try:
        found: ModuleType = importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name == name:
            return None
        raise
    return found


@contextlib.contextmanager
def silence() -> Iterator[None]:
    """Native libraries write to standard error on their own; what matters comes back to us. Nothing else runs meanwhile."""
    sys.stderr.flush()
    kept = os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
