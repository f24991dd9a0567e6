"""The events of a run in sentences, for a person who follows it in a terminal."""

from __future__ import annotations

import sys
from typing import IO, TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping


class Narrator:
    """Prints what is worth telling, one line each, with the seconds since the start."""

    def __init__(self, out: IO[str] | None = None) -> None:
        self._out = sys.stderr if out is None else out

    def __call__(self, event: Mapping[str, Any]) -> None:
        """Print the event's sentence, if it has one. A terminal that is gone is not worth a flight: ignored."""
        text = sentence(event)
        if text is None:
            return
        try:
            print(f"{event['t']:7.2f} s  {text}", file=self._out, flush=True)
        except (OSError, ValueError):
            return


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
