"""Whole flights in virtual time, kept in tests/golden/ as text: what was asked for, decided by which margins, and the modes.

    .venv/bin/python -m tests.golden_flights     renew the files; `git diff` then shows what changed

One JSON object a line: requests, decisions with the margin of every rule (six places; null: there is none), modes, motions and
violations, at seconds since the flight began. They notice a change of behaviour that nobody meant; what is right other tests say.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from safety.vocabulary import Command
from tests.flights import MOVES, Flight

FOLDER = Path(__file__).with_name("golden")
PLACES = 6
BEGAN_S = 100.0
TURNS = (*MOVES, Command.TURN_LEFT, Command.TURN_RIGHT)
TOLD = {
    "request": ("id", "command", "modality", "confidence"),
    "decision": ("request", "verdict", "requested_m", "granted_m"),
    "mode": ("state", "cause"),
    "motion": ("request", "status", "min_clearance_m", "min_separation_m", "max_speed_m_s"),
    "violation": ("kind", "constraint", "margin", "action", "subject"),
}
FLIGHTS: dict[str, dict[str, Any]] = {
    "crossing": {"seed": 3},
    "gusts": {"seed": 8, "gust_sigma_m_s": 3.0, "wind_m_s": 8.0},
    "turns": {"seed": 11, "commands": TURNS},
}
"""Traffic that crosses; beyond the declared bounds, so that limits are broken; turns among the moves."""


def path(name: str) -> Path:
    return FOLDER / f"flight-{name}.jsonl"


def lines(name: str) -> list[str]:
    """What the flight comes to now."""
    outcome = Flight(**FLIGHTS[name]).fly()
    return [_line(t_s, event, fields) for t_s, event, fields in outcome.reports if event in TOLD]


def _line(t_s: float, event: str, fields: dict[str, Any]) -> str:
    told = {"t": round(t_s - BEGAN_S, 3), "event": event, **{name: _rounded(fields[name]) for name in TOLD[event]}}
    for found in ("findings", "granted_findings"):
        if fields.get(found):
            told[found] = {one["constraint"]: _rounded(one["margin"]) for one in fields[found]}
            told[f"failed_{found}"] = [one["constraint"] for one in fields[found] if not one["passed"]]
    return json.dumps(told)


def _rounded(value: object) -> object:
    return round(value, PLACES) + 0.0 if isinstance(value, float) else value


def main() -> None:
    for name in FLIGHTS:
        path(name).write_text("\n".join(lines(name)) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
