"""`m3r requirements`: every requirement in a form that another tool reads: FRETish, StrictDoc's own, or Markdown."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safety.constraints import RULES
from safety.fretish import FRETISH
from safety.requirements import REQUIREMENTS

if TYPE_CHECKING:
    from collections.abc import Callable


def served_by(requirement: str) -> list[str]:
    """The names of the constraints that serve it."""
    return [rule.name for rule in RULES if requirement in rule.constraint.requirements]


def fretish() -> str:
    """One sentence a line, its id before it, as FRET's import by CSV takes it."""
    return "\n".join(["Requirement ID,FRETish", *(f'{name},"{FRETISH[name]}"' for name in REQUIREMENTS)])


def strictdoc() -> str:
    """A document of StrictDoc; what it says in FRETish is its rationale."""
    blocks = ["[DOCUMENT]\nTITLE: M3R requirements"]
    blocks += [
        f"[REQUIREMENT]\nUID: {name}\nTITLE: {name}\nSTATEMENT: >>>\n{text}\n<<<\nRATIONALE: >>>\n{FRETISH[name]}\n<<<"
        for name, text in REQUIREMENTS.items()
    ]
    return "\n\n".join(blocks)


def markdown() -> str:
    """A table for people."""
    lines = ["| id | requirement | FRETish | constraints |", "|---|---|---|---|"]
    lines += [
        f"| {name} | {text} | {_cell(FRETISH[name])} | {', '.join(served_by(name))} |"
        for name, text in REQUIREMENTS.items()
    ]
    return "\n".join(lines)


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


FORMATS: dict[str, Callable[[], str]] = {"fretish": fretish, "strictdoc": strictdoc, "markdown": markdown}
