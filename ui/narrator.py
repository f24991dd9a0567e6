"""The events of a run in sentences, for a person who follows it in a terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping


def narrated(event: Mapping[str, Any]) -> str | None:
    """The event's sentence after the seconds since the start; None where there is nothing to tell."""
    text = sentence(event)
    return None if text is None else f"{event['t']:7.2f} s  {text}"


def sentence(event: Mapping[str, Any]) -> str | None:
    """What one event means; None where `announce` tells the same."""
    match event["event"]:
        case "announce":
            return str(event["text"])
        case "request":
            evidence = f' "{event["evidence"]}"' if event.get("evidence") else ""
            return f"> {event['modality']}{evidence}: {event['command']} (confidence {event['confidence']:.2f})"
        case "violation":
            return f"! {event['kind']} violation of {', '.join(event['requirements'])}: {event['action']}"
        case "end":
            return (
                f"ended ({event['reason']}): {event['requests']} requests, {event['approved']} approved, "
                f"{event['rejected']} rejected, {event['completed']} completed, {event['aborted']} aborted, "
                f"{event['violations']} violations"
            )
    return None
