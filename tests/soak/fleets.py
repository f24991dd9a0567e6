"""What the families that fly share: one drone on flat ground as a process, its true states as they come, and many flights at a time."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from tests.whole import PLAIN, App, Simulated, simulated

T = TypeVar("T")
AT_ONCE = 4
"""Flights in real time wait more than they work."""
REST_M_S = 0.1
PATIENCE_S = 40.0


def scenario(folder: Path, events: str = "", params: str = "COM_OF_LOSS_T = 0.5, COM_OBL_RC_ACT = 5") -> Path:
    """The plain scenario with red alone. events: TOML tables of what happens to it."""
    text = PLAIN.read_text(encoding="utf-8")
    start, rest = text.index("[vehicles.red]"), text.index("[vehicles.green]")
    red = text[start:rest].replace("COM_OF_LOSS_T = 0.5, COM_OBL_RC_ACT = 5", params)
    path = folder / "red.toml"
    path.write_text(text[:start] + red + events, encoding="utf-8")
    return path


class Truth:
    """The true states of red, read once each."""

    def __init__(self, sim: Simulated) -> None:
        self._file = sim.truth.open(encoding="utf-8")
        self._torn = ""
        self.states: list[dict[str, Any]] = []

    def read(self) -> list[dict[str, Any]]:
        lines = (self._torn + self._file.read()).split("\n")
        self._torn = lines.pop()
        self.states += [json.loads(line) for line in lines]
        return self.states

    def last(self) -> dict[str, Any]:
        while not self.read():
            time.sleep(0.02)
        return self.states[-1]

    def until(self, met: Callable[..., bool], what: str, within_s: float = PATIENCE_S) -> dict[str, Any]:
        deadline_s = time.monotonic() + within_s
        while time.monotonic() < deadline_s:
            if met(self.last()):
                return self.states[-1]
            time.sleep(0.03)
        raise AssertionError(f"red is not {what} within {within_s:.0f} s: {self.states[-1]}")

    def since(self, at_s: float) -> list[dict[str, Any]]:
        """From a moment of this machine's monotonic clock on."""
        return [state for state in self.read() if state["monotonic_s"] >= at_s]

    def close(self) -> None:
        self._file.close()


def resting(state: dict[str, Any]) -> bool:
    return state["mode"] == "LOITER" and math.hypot(*state["velocity_m_s"]) < REST_M_S


def furthest_m(states: list[dict[str, Any]], place: list[float]) -> float:
    return max((math.dist(state["ned_m"], place) for state in states), default=0.0)


@contextmanager
def flying(place: Path, tmp_path: Path) -> Iterator[tuple[Simulated, Truth]]:
    """The fleet of a scenario in a folder of its own."""
    tmp_path.mkdir(exist_ok=True)
    with simulated(place, tmp_path) as sim:
        truth = Truth(sim)
        try:
            yield sim, truth
        finally:
            truth.close()


def app(sim: Simulated, script: str, guard: str = "none", *more: str, url: str | None = None) -> App:
    """The app that flies red by a script, with one guard taken away."""
    link = url or sim.urls["red"]
    words = [
        "run",
        "--headless",
        "--pair",
        "red",
        "--script",
        "-",
        "--vehicle",
        f"red={link}",
        "--scenario",
        str(PLAIN),
    ]
    words += ["--set", "neighbours=none"]
    return App([guard, *words, *more], stdin=script, program="tests.soak.weakened")


def all_at_once(one: Callable[[int], T], count: int) -> list[T]:
    """one(0) to one(count - 1), a few at a time; the first failure is raised."""
    with ThreadPoolExecutor(AT_ONCE) as pool:
        return list(pool.map(one, range(count)))
