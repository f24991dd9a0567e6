"""docs/soak.md from the figures that `make soak` has left in tests/soak/figures.jsonl. Run: python scripts/soak_page.py

The last figure of each family and case counts. A case of the list below that was not run is named as not run.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
FIGURES = ROOT / "tests/soak/figures.jsonl"
PAGE = ROOT / "docs/soak.md"
FAMILIES = {
    "kill -9 of the app": "tests/soak/test_killed.py",
    "event-loop and interpreter stalls": "tests/soak/test_killed.py",
    "link loss, delay and cuts": "tests/soak/test_link.py",
    "neighbours silent, frozen, skewed, teleporting": "tests/soak/test_neighbours.py",
    "air messages forged, fuzzed, replayed": "tests/soak/test_air_messages.py",
    "GPS off, stuck, wrong, jumping while hovering": "tests/soak/test_gps.py",
    "gusts and walls": "tests/soak/test_gusts.py",
    "state x event x delay, takeover in each": "tests/soak/test_takeover.py",
}
"""Family -> the file that passes it."""
FOUND = """\
## What it found

* **A stuck GPS walked the drone away** (2026-11-27): with the position frozen and the velocity right, each move was aborted, and the next one
  granted from the same place; six moves ended 6.3 m from where it hovered, out of its workspace. The first mend added up only what
  aborts for disagreement had missed: small steps, and steps down, end by their time or are called done, and six of them went 3.0 m down.
  Mended: what every maneuver missed is added up, however it ends, until the position follows along that line; then moves are refused and
  the session ends in Hold, at most 1.7 m away in 120 walks on a table-top
  (`test_nobody_walks_a_drone_away_from_a_stuck_position`).
* **With a stuck interpreter setpoints end by themselves**: in the one flight without the guard's process they stopped after 0.86 s, and the
  autopilot's own failsafe held (why is not known; MAVSDK may wait for Python's lock). That the process stops it sooner is not shown;
  that such an app does not go on afterwards is.
"""
ELSEWHERE = """\
## Families held by other tests

These pass or fail without a figure.

* **Broker restarted ×50 in flight**, every second time by kill: `tests/m3r_app/airspace/test_air_run.py`.
* **Stolen client ids, forged and replayed messages over a real broker, two who ask at once**:
  `tests/m3r_app/airspace/test_over_broker.py`.
* **Microphone unplugged in flight**: `tests/m3r_app/test_microphone_run.py`; **camera**: `tests/m3r_app/test_camera_run.py`.
* **10 h of negatives**: needs the recordings of `m3r evaluate`, which are not part of the project.
"""
HEAD = """\
# What `make soak` has seen

Made by `python scripts/soak_page.py` from the figures that the fault families of `tests/soak` write; not edited by hand.
*Unsafe* counts what ended outside of what its family allows; the last column says what happened with the guard taken away.
How to reproduce: `M3R_SOAK=1 python -m pytest tests/soak --timeout 3600`, then the script.
"""


def figures() -> dict[tuple[str, str], dict[str, Any]]:
    """The last line of each family and case. Raises SystemExit with a sentence where there is none."""
    if not FIGURES.exists():
        sys.exit(f"{FIGURES.relative_to(ROOT)} is missing: run M3R_SOAK=1 python -m pytest tests/soak first.")
    found = [json.loads(line) for line in FIGURES.read_text(encoding="utf-8").splitlines()]
    return {(one["family"], one["case"]): one for one in found}


def page(found: dict[tuple[str, str], dict[str, Any]]) -> str:
    """Markdown."""
    parts = [HEAD]
    for family, file in FAMILIES.items():
        rows = [one for (name, _), one in found.items() if name == family]
        if not (ROOT / file).exists():
            parts.append(f"## {family.capitalize()}\n\nNo test of this family exists yet.\n")
            continue
        parts.append(f"## {family[0].upper()}{family[1:]}\n\n`{file}`\n")
        if not rows:
            parts.append("Not run in full yet.\n")
            continue
        parts.append("| case | tried | unsafe | seen | without the guard | run |\n|---|---|---|---|---|---|")
        parts.append("\n".join(_row(one) for one in rows) + "\n")
    return "\n".join([*parts, FOUND, ELSEWHERE])


def _row(one: dict[str, Any]) -> str:
    seen = ", ".join(f"{name} {value}" for name, value in one["seen"].items()) or "-"
    without = one["without_guard"] or "-"
    return (
        f"| {one['case']} | {one['count']:,} | {one['unsafe']} | {seen} | {without} | {one['date']}, {one['commit']} |"
    )


if __name__ == "__main__":
    PAGE.write_text(page(figures()), encoding="utf-8")
