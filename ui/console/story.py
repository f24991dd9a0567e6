"""The log of the console: each event of the output as lines to read, and which of them deserve a toast. Pure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rich.text import Text

from ui.narrator import sentence

if TYPE_CHECKING:
    from collections.abc import Mapping

SIGNS = {
    "approved": ("✓", "green"),
    "reduced": ("◐", "yellow"),
    "delayed": ("…", "yellow"),
    "replaced": ("↻", "yellow"),
    "rejected": ("✗", "bold red"),
}
"""Verdict: sign and style. In ASCII they are told apart by the word that follows."""


def lines(event: Mapping[str, Any], before: Mapping[str, Any] | None = None) -> list[Text]:
    """What the log gains by this event; nothing for what the event before it, a decision, has told with more numbers."""
    at = f"{event['t']:6.1f} "
    match event["event"]:
        case "request":
            said = f' "{event["evidence"]}"' if event.get("evidence") else ""
            text = f"{at}> {event['modality']}{said}: {words(event['command'])}"
            return [Text(text).append(f" ({event['confidence'] or 0.0:.2f})", style="dim")]
        case "decision":
            return [Text(at).append_text(verdict(event)), *reasons(event)]
        case "motion" if event["status"] != "started":
            return [Text(f"{at}  {event['status']}: {_moved(event)}", style="dim")]
        case "violation":
            return [Text(f"{at}! {sentence(event)}", style="bold red")]
        case "announce" if before is None or before["event"] != "decision":
            return [Text(f"{at}{event['text']}", style="bold")]
        case "pair":
            why = f": {'; '.join(event['reasons'])}" if event.get("reasons") else ""
            return [Text(f"{at}{event['vehicle'].capitalize()}: pairing {event['status']}{why}", style="bold cyan")]
        case "end":
            return [Text(f"{at}{sentence(event)}", style="bold")]
    return []


def verdict(decision: Mapping[str, Any]) -> Text:
    """The verdict with its metres."""
    sign, style = SIGNS[decision["verdict"]]
    text = Text(f"{sign} {decision['verdict']}", style=style)
    granted_m, requested_m = decision.get("granted_m"), decision.get("requested_m")
    if granted_m is not None and requested_m is not None:
        text.append(f" {granted_m:.2f} m of {requested_m:.2f} m")
    elif requested_m is not None:
        text.append(f", {requested_m:.2f} m asked")
    return text


def reasons(decision: Mapping[str, Any]) -> list[Text]:
    """Every finding that failed, with its margin and requirements."""
    return [
        Text(f"         {f['text']} ({', '.join(f['requirements'])}{_margin(f)})", style="yellow")
        for f in decision.get("findings", ())
        if not f["passed"]
    ]


def toast(event: Mapping[str, Any], colour: str) -> str | None:
    """What may not be overlooked: a blocked request, a violation, a refused pairing. Named by the drone's colour."""
    name = colour.capitalize() or "No drone"
    match event["event"]:
        case "decision" if event["verdict"] == "rejected":
            why = "; ".join(f["text"] for f in event.get("findings", ()) if not f["passed"])
            return f"{name}: blocked, {why}"
        case "violation":
            return f"{name}: {sentence(event)}"
        case "pair" if event["status"] == "refused":
            return f"{event['vehicle'].capitalize()}: not paired, {'; '.join(event['reasons'])}"
    return None


def words(command: str) -> str:
    """A command as it is said."""
    return command.replace("_", " ")


def _margin(finding: Mapping[str, Any]) -> str:
    margin = finding.get("margin")
    return "" if margin is None else f", {margin:+.2f} {finding['unit']}"


def _moved(event: Mapping[str, Any]) -> str:
    east, north, up = event["displacement_enu_m"]
    parts = [
        f"{name} {value:+.2f} m" for name, value in (("east", east), ("north", north), ("up", up)) if value is not None
    ]
    if event.get("min_clearance_m") is not None:
        parts.append(f"clearance {event['min_clearance_m']:.2f} m")
    if event.get("min_separation_m") is not None:
        parts.append(f"separation {event['min_separation_m']:.2f} m")
    return ", ".join(parts)
