"""What `m3r check` says: findings, their table, and what the looks at a machine have in common."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from config.settings import Settings
    from modalities.hands.camera import CameraAddress


class State(StrEnum):
    """WORKS: seen to work. WEAK: works, but not well enough. MISSING: what needs it cannot be used. NOT_DONE: it takes a
    person.
    """

    WORKS = "works"
    WEAK = "weak"
    MISSING = "missing"
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
    broker, credentials: of the shared air; live: by name of a live modality, what its option says; settings: None for the defaults.
    """

    vehicles: Mapping[str, str] = field(default_factory=dict)
    microphone: str | None = None
    camera: CameraAddress | None = None
    mirror: bool = False
    broker: str | None = None
    credentials: Path | None = None
    live: Mapping[str, str] = field(default_factory=dict)
    settings: Settings | None = None


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
