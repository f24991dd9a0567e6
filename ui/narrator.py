"""The events of a run in sentences, for a person who follows it in a terminal."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import assert_never

from m3r_app.output import (
    AnnounceEvent,
    DecisionEvent,
    EndEvent,
    ModeEvent,
    MotionEvent,
    OutputEvent,
    PairEvent,
    RequestEvent,
    Told,
    ViolationEvent,
)


def narrated(told: Told, sentence_of: Callable[[OutputEvent], str | None]) -> str | None:
    """The event's sentence, as `sentence_of` puts it, after the seconds since the start; None: there is nothing to tell."""
    text = sentence_of(told.event)
    return None if text is None else f"{told.t_s:7.2f} s  {text}"


def sentence(event: OutputEvent) -> str | None:
    """What one event means; None where `announce` tells the same."""
    match event:
        case AnnounceEvent():
            return event.text
        case RequestEvent():
            evidence = f' "{event.evidence}"' if event.evidence else ""
            return f"> {event.modality}{evidence}: {event.command} (confidence {_number(event.confidence, 2)})"
        case ViolationEvent():
            return f"! {event.kind} violation of {', '.join(event.requirements)}: {event.action}"
        case EndEvent():
            return (
                f"ended ({event.reason}): {event.requests} requests, {event.approved} approved, "
                f"{event.rejected} rejected, {event.completed} completed, {event.aborted} aborted, "
                f"{event.violations} violations"
            )
        case PairEvent() | DecisionEvent() | ModeEvent() | MotionEvent():
            return None
        case _:
            assert_never(event)


def every_sentence(event: OutputEvent) -> str:
    """What any event means, with its numbers: for screen readers and logs. No signs that are read aloud as noise."""
    match event:
        case RequestEvent():
            evidence = f", {event.evidence}" if event.evidence else ""
            return (
                f"request {event.id} by {event.modality}{evidence}: {event.command}, "
                f"confidence {_number(event.confidence, 2)}, after {_number(event.latency_ms, 0)} ms"
            )
        case DecisionEvent():
            return f"request {event.request} is {event.verdict}{_granted(event)}{_why(event)}"
        case ModeEvent():
            return f"mode {event.mode}, {event.state}, because of {event.cause}; before: {event.previous}"
        case MotionEvent():
            return f"request {event.request} {event.status}: {_measured(event)}"
        case PairEvent():
            reasons = f": {'; '.join(event.reasons)}" if event.reasons else ""
            return f"pairing with {event.vehicle} {event.status}{reasons}"
        case ViolationEvent():
            return f"{event.kind} violation of {', '.join(event.requirements)}: {event.action}"
        case AnnounceEvent() | EndEvent():
            return sentence(event) or event.name
        case _:
            assert_never(event)


def _granted(event: DecisionEvent) -> str:
    if event.granted_m is None:
        return ""
    of = f" of {event.requested_m:.2f} m" if event.requested_m is not None else ""
    return f", {event.granted_m:.2f} m{of}"


def _why(event: DecisionEvent) -> str:
    """Every failing finding with its requirements."""
    return "".join(f"; {f.text} ({f.constraint}, {', '.join(f.requirements)})" for f in event.failing)


def _measured(event: MotionEvent) -> str:
    east, north, up = (_number(metres, 2) for metres in event.displacement_enu_m)
    parts = [f"{east} m east, {north} m north, {up} m up", f"turned {_number(event.yaw_deg, 0)} degrees"]
    for least_m, what in ((event.min_clearance_m, "clearance"), (event.min_separation_m, "separation")):
        if least_m is not None:
            parts.append(f"least {what} {least_m:.2f} m")
    parts.append(f"at most {_number(event.max_speed_m_s, 2)} m/s")
    return ", ".join(parts)


def _number(value: float | None, places: int) -> str:
    """A number that does not exist is null in the output."""
    if value is None or not math.isfinite(value):
        return "unknown"
    return f"{round(value, places) + 0.0:.{places}f}"  # no -0.00
