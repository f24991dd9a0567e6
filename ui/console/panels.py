"""What stands beside the views: margins as bars, the mode machine, the modalities. Text from a snapshot; pure."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rich.text import Text

from safety.vocabulary import Mode

if TYPE_CHECKING:
    from m3r_app.snapshot import Margin, Snapshot

GOOD, NEAR, BROKEN, DIM, LIT = "green", "yellow", "bold red", "dim", "bold reverse"
NEAR_SHARE = 0.2
"""A bar shorter than this is near its limit."""
SHORT = {
    Mode.NORMAL_AUTONOMY: "Normal",
    Mode.ARMED: "Armed",
    Mode.ACTIVE: "Active",
    Mode.BLOCKED: "Blocked",
    Mode.EMERGENCY_HOLD: "Hold",
    Mode.RETURN_TO_ANCHOR: "Return",
}
QUIET_DBFS = -60.0
"""The left end of the level bar."""
NOISY_DB = 15.0
"""A voice that stands less far than this above the noise is misheard one time in ten."""
RECENT_S = 2.0
"""What was heard or seen longer ago is told with its age."""


def margins(found: tuple[Margin, ...], width: int) -> Text:
    """One line per limit: name, how far away, bar. Signs say what the colours say."""
    if not found:
        return Text("No drone is paired: press its number.", style=DIM)
    lines = []
    for margin in found:
        value = "unknown" if not margin.known else "none near" if margin.value is None else _number(margin)
        broken = not margin.known or (margin.value is not None and margin.value < 0.0)
        near = not broken and margin.fullness < NEAR_SHARE
        sign, style = ("!", BROKEN) if broken else ("~", NEAR) if near else (" ", GOOD)
        bar = max(4, width - 22)
        filled = min(bar, max(0, round(margin.fullness * bar)))
        line = Text(f"{sign}{margin.name:<10}{value:>9} ", style=style if sign != " " else "")
        line.append("█" * filled, style=style)
        line.append("░" * (bar - filled), style=DIM)
        lines.append(line)
    return Text("\n").join(lines)


def modes(snapshot: Snapshot | None) -> Text:
    """The modes, the present one lit, and its fine state."""
    if snapshot is None:
        return Text("starting", style=DIM)
    text, was_lit = Text(), False
    for mode, name in SHORT.items():
        lit = snapshot.state.mode is mode
        text.append("[" if lit else "]" if was_lit else " ", style=DIM)
        text.append(name, style=LIT if lit else DIM)
        was_lit = lit
    text.append("]" if was_lit else " ", style=DIM)
    state = snapshot.state
    text.append(f"\n{state.state.value}", style="bold")
    if state.return_at_s is not None:
        text.append(f", returning in {max(0.0, state.return_at_s - snapshot.at_s):.0f} s", style=NEAR)
    return text


def senses(snapshot: Snapshot | None, last: dict[str, tuple[float, float]], width: int) -> Text:
    """What each modality takes in. last: by modality, when the last request was made and its confidence."""
    if snapshot is None:
        return Text("")
    taken, now_s = snapshot.taken, snapshot.at_s
    lines = []
    if math.isfinite(taken.level_at_s):
        share = min(1.0, max(0.0, 1.0 - taken.level_dbfs / QUIET_DBFS))
        bar = max(4, min(20, width - 30))
        line = Text("voice ")
        line.append("█" * round(share * bar), style=GOOD)
        line.append("░" * (bar - round(share * bar)), style=DIM)
        if taken.snr_db is not None:
            near = taken.snr_db < NOISY_DB
            line.append(f" {'~' if near else ''}{taken.snr_db:.0f} dB", style=NEAR if near else DIM)
        line.append(f" {taken.words}" if taken.words else " -", style="italic")
        lines.append(line.append(_ago(last.get("voice"), now_s)))
    else:
        lines.append(Text("voice off", style=DIM))
    if math.isfinite(taken.hands_at_s):
        count = len(taken.hands)
        seen = taken.shown or ("a hand" if count == 1 else f"{count} hands" if count else "no hand")
        old = f", {now_s - taken.hands_at_s:.0f} s ago" if now_s - taken.hands_at_s > RECENT_S else ""
        lines.append(Text(f"hands {seen}{old}").append(_ago(last.get("gesture"), now_s)))
    else:
        lines.append(Text("hands off", style=DIM))
    lines.append(Text("panel keys and mouse").append(_ago(last.get("panel"), now_s)))
    for line in lines:
        line.truncate(max(1, width), overflow="ellipsis")
    return Text("\n").join(lines)


def title(snapshot: Snapshot | None, *, dry_run: bool, looking: bool) -> Text:
    """Who is paired, in which mode, and how to stop."""
    text = Text("M3R ", style="bold")
    if snapshot is None:
        return text.append("starting: models, fleet ...")
    drone = snapshot.paired
    if drone is None:
        text.append("no drone paired", style="bold")
    else:
        text.append(f" {drone.name.capitalize()} ", style=f"bold reverse {ink(drone.name)}")
        text.append(f" {snapshot.state.mode.value}")
        if drone.position is not None and snapshot.air_trouble is None:
            mode = drone.flight_mode.lower() if drone.flight_mode is not None else ""
            text.append(f"  {-drone.position.down:.1f} m up, {mode}", style=DIM)
    if snapshot.air_trouble is not None:
        text.append(f"  {snapshot.air_trouble}", style=BROKEN)
    if dry_run:
        text.append("  dry run: nothing is flown", style=NEAR)
    elif looking:
        text.append("  looking first", style=NEAR)
    return text


def ink(name: str) -> str:
    """A drone's colour as a style, where its name is one that every theme shows; else none, which all do."""
    return name if name in ("red", "green", "blue", "yellow", "magenta", "cyan") else ""


def _ago(last: tuple[float, float] | None, now_s: float) -> str:
    return "" if last is None else f"  {last[1]:.2f}, {max(0.0, now_s - last[0]):.0f} s ago"


def _number(margin: Margin) -> str:
    assert margin.value is not None
    if margin.shown:
        return margin.shown
    places = 0 if margin.unit == "%" else 2
    return f"{margin.value:+.{places}f} {margin.unit}"
