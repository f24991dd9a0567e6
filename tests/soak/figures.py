"""Where the fault families write what they have seen: one line of JSON each, from which scripts/soak_page.py makes docs/soak.md."""

from __future__ import annotations

import json
import os
import subprocess
import time
from pathlib import Path
from typing import Any

SOAK = os.environ.get("M3R_SOAK") == "1"
FIGURES = Path(__file__).with_name("figures.jsonl")
ROOT = Path(__file__).resolve().parents[2]


def record(family: str, case: str, *, count: int, unsafe: int, without_guard: str = "", **seen: Any) -> None:
    """Write the full count's figure; a sample's is no figure.

    count: what was tried; unsafe: how many of them ended outside what the family allows; without_guard: what happened with
    the guard taken away, in a few words; seen: any other figure, its unit in its name.
    """
    if not SOAK:
        return
    line = {
        "family": family,
        "case": case,
        "count": count,
        "unsafe": unsafe,
        "without_guard": without_guard,
        "seen": seen,
        "date": time.strftime("%Y-%m-%d"),
        "commit": _commit(),
    }
    with FIGURES.open("a", encoding="utf-8") as file:
        file.write(json.dumps(line) + "\n")


def _commit() -> str:
    found = subprocess.run(
        ["git", "-C", str(ROOT), "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False
    )
    return found.stdout.strip() or "unknown"
