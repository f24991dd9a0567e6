"""The events of a run in sentences, for a person who follows it in a terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping


def narrated(event: Mapping[str, Any], told: Callable[[Mapping[str, Any]], str | None]) -> str | None:
    """The event's sentence, as `told` puts it, after the seconds since the start; None where there is nothing to tell."""
    text = told(event)
    return None if text is None else f"{event['t']:7.2f} s  {text}"


def sentence(event: Mapping[str, Any]) -> str | None:
    """What one event means; None where `announce` tells the same."""
    match event["event"]:
        case "announce":
            return str(event["text"])
        case "request":
            evidence = f' "{event["evidence"]}"' if event.get("evidence") else ""
            return f"> {event['modality']}{evidence}: {event['command']} (confidence {_number(event['confidence'], 2)})"
        case "violation":
            return f"! {event['kind']} violation of {', '.join(event['requirements'])}: {event['action']}"
        case "end":
            return (
                f"ended ({event['reason']}): {event['requests']} requests, {event['approved']} approved, "
                f"{event['rejected']} rejected, {event['completed']} completed, {event['aborted']} aborted, "
                f"{event['violations']} violations"
            )
    return None


def every_sentence(event: Mapping[str, Any]) -> str:
    """What any event means, with its numbers: for screen readers and logs. No signs that are read aloud as noise."""
    match event["event"]:
        case "request":
            evidence = f", {event['evidence']}" if event.get("evidence") else ""
            return (
                f"request {event['id']} by {event['modality']}{evidence}: {event['command']}, "
                f"confidence {_number(event['confidence'], 2)}, after {_number(event['latency_ms'], 0)} ms"
            )
        case "decision":
            return f"request {event['request']} is {event['verdict']}{_granted(event)}{_why(event)}"
        case "mode":
            return f"mode {event['mode']}, {event['state']}, because of {event['cause']}; before: {event['previous']}"
        case "motion":
            return f"request {event['request']} {event['status']}: {_measured(event)}"
        case "pair":
            reasons = f": {'; '.join(event['reasons'])}" if event.get("reasons") else ""
            return f"pairing with {event['vehicle']} {event['status']}{reasons}"
        case "violation":
            return f"{event['kind']} violation of {', '.join(event['requirements'])}: {event['action']}"
    return sentence(event) or f"{event['event']}"


def _granted(event: Mapping[str, Any]) -> str:
    granted_m, requested_m = event.get("granted_m"), event.get("requested_m")
    if granted_m is None:
        return ""
    return f", {granted_m:.2f} m of {requested_m:.2f} m" if requested_m is not None else f", {granted_m:.2f} m"


def _why(event: Mapping[str, Any]) -> str:
    """Every failing finding with its requirements."""
    failing = [f for f in event.get("findings", ()) if not f["passed"]]
    return "".join(f"; {f['text']} ({f['constraint']}, {', '.join(f['requirements'])})" for f in failing)


def _measured(event: Mapping[str, Any]) -> str:
    east, north, up = (_number(metres, 2) for metres in event["displacement_enu_m"])
    parts = [f"{east} m east, {north} m north, {up} m up", f"turned {_number(event['yaw_deg'], 0)} degrees"]
    for key, what in (("min_clearance_m", "clearance"), ("min_separation_m", "separation")):
        if event.get(key) is not None:
            parts.append(f"least {what} {event[key]:.2f} m")
    parts.append(f"at most {_number(event['max_speed_m_s'], 2)} m/s")
    return ", ".join(parts)


def _number(value: float | None, places: int) -> str:
    """A number that does not exist is null in the output."""
    return "unknown" if value is None else f"{round(value, places) + 0.0:.{places}f}"  # no -0.00
