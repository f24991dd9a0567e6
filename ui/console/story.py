"""The log of the console: each event of the output as lines to read, and which of them deserve a toast. Pure."""

from __future__ import annotations

from typing import assert_never

from rich.text import Text

from m3r_app.output import (
    AnnounceEvent,
    DecisionEvent,
    EndEvent,
    FindingTold,
    ModeEvent,
    MotionEvent,
    MotionStatus,
    OutputEvent,
    PairEvent,
    PairStatus,
    RequestEvent,
    Told,
    ViolationEvent,
)
from safety.vocabulary import Verdict
from ui.narrator import sentence

SIGNS = {
    Verdict.APPROVED: ("✓", "green"),
    Verdict.REDUCED: ("◐", "yellow"),
    Verdict.DELAYED: ("…", "yellow"),
    Verdict.REPLACED: ("↻", "yellow"),
    Verdict.REJECTED: ("✗", "bold red"),
}
"""Verdict: sign and style. In ASCII they are told apart by the word that follows."""


def lines(told: Told, before: Told | None = None) -> list[Text]:
    """What the log gains by this event; nothing for what the event before it, a decision, has told with more numbers."""
    at, event = f"{told.t_s:6.1f} ", told.event
    match event:
        case RequestEvent():
            said = f' "{event.evidence}"' if event.evidence else ""
            text = f"{at}> {event.modality}{said}: {words(event.command)}"
            return [Text(text).append(f" ({event.confidence or 0.0:.2f})", style="dim")]
        case DecisionEvent():
            return [Text(at).append_text(verdict(event)), *reasons(event)]
        case MotionEvent():
            if event.status is MotionStatus.STARTED:
                return []
            return [Text(f"{at}  {event.status}: {_moved(event)}", style="dim")]
        case ViolationEvent():
            return [Text(f"{at}! {sentence(event)}", style="bold red")]
        case AnnounceEvent():
            if before is not None and isinstance(before.event, DecisionEvent):
                return []
            return [Text(f"{at}{event.text}", style="bold")]
        case PairEvent():
            why = f": {'; '.join(event.reasons)}" if event.reasons else ""
            return [Text(f"{at}{event.vehicle.capitalize()}: pairing {event.status}{why}", style="bold cyan")]
        case EndEvent():
            return [Text(f"{at}{sentence(event)}", style="bold")]
        case ModeEvent():
            return []
        case _:
            assert_never(event)


def verdict(decision: DecisionEvent) -> Text:
    """The verdict with its metres."""
    sign, style = SIGNS[decision.verdict]
    text = Text(f"{sign} {decision.verdict}", style=style)
    granted_m, requested_m = decision.granted_m, decision.requested_m
    if granted_m is not None and requested_m is not None:
        text.append(f" {granted_m:.2f} m of {requested_m:.2f} m")
    elif requested_m is not None:
        text.append(f", {requested_m:.2f} m asked")
    return text


def reasons(decision: DecisionEvent) -> list[Text]:
    """Every finding that failed, with its margin and requirements."""
    return [
        Text(f"         {f.text} ({', '.join(f.requirements)}{_margin(f)})", style="yellow") for f in decision.failing
    ]


def toast(event: OutputEvent, colour: str) -> str | None:
    """What may not be overlooked: a blocked request, a violation, a refused pairing. Named by the drone's colour."""
    name = colour.capitalize() or "No drone"
    match event:
        case DecisionEvent():
            blocked = event.verdict is Verdict.REJECTED
            return f"{name}: blocked, {'; '.join(f.text for f in event.failing)}" if blocked else None
        case ViolationEvent():
            return f"{name}: {sentence(event)}"
        case PairEvent():
            refused = event.status is PairStatus.REFUSED
            return f"{event.vehicle.capitalize()}: not paired, {'; '.join(event.reasons)}" if refused else None
        case RequestEvent() | ModeEvent() | MotionEvent() | AnnounceEvent() | EndEvent():
            return None
        case _:
            assert_never(event)


def words(command: str) -> str:
    """A command as it is said."""
    return command.replace("_", " ")


def _margin(finding: FindingTold) -> str:
    return "" if finding.margin is None else f", {finding.margin:+.2f} {finding.unit}"


def _moved(event: MotionEvent) -> str:
    east, north, up = event.displacement_enu_m
    parts = [
        f"{name} {value:+.2f} m" for name, value in (("east", east), ("north", north), ("up", up)) if value is not None
    ]
    if event.min_clearance_m is not None:
        parts.append(f"clearance {event.min_clearance_m:.2f} m")
    if event.min_separation_m is not None:
        parts.append(f"separation {event.min_separation_m:.2f} m")
    return ", ".join(parts)
