"""Take-off and landing outside sessions: only with a drone that nobody else holds. P1."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest

from m3r_app.output import Notice
from m3r_app.takeoff_landing import GroundWork
from safety.vocabulary import Geodetic, State

pytestmark = pytest.mark.requirement("P1")


class Held:
    """An airspace in which bob holds green."""

    def __init__(self) -> None:
        self.claimed: list[str] = []

    async def claim(self, drone: str, _operator: Geodetic) -> str | None:
        self.claimed.append(drone)
        return "bob holds it" if drone == "green" else None

    def give_up(self, drone: str) -> None:
        self.claimed.remove(drone)


class Drone:
    def __init__(self, colour: str) -> None:
        self.colour = colour
        self.landed = 0
        self.taken_off: list[float] = []

    async def takeoff(self, metres: float) -> None:
        self.taken_off.append(metres)

    async def land(self) -> None:
        self.landed += 1


async def nothing_against(_vehicle: Any, _metres: float) -> tuple[str, ...]:
    return ()


async def test_a_drone_that_somebody_else_holds_is_not_landed() -> None:
    red, green, airspace, said = Drone("red"), Drone("green"), Held(), list[str]()
    done = asyncio.Event()

    def say(text: str, _notice: Notice = Notice.INFORMATION, /) -> None:
        said.append(text)
        if "not landing" in text or "done landing" in text:
            done.set()

    shell = SimpleNamespace(
        fleet=SimpleNamespace(vehicles={"red": red, "green": green}),
        state=SimpleNamespace(state=State.IDLE),
        frame=SimpleNamespace(origin=Geodetic(47.0, 8.0, 500.0)),
        airspace=airspace,
    )
    work = GroundWork(shell, say, nothing_against)  # type: ignore[arg-type]
    work.land("green")
    await asyncio.wait_for(done.wait(), 5.0)
    assert green.landed == 0 and said == ["Green: landing", "Green: not landing, bob holds it"]
    done.clear()
    work.land("red")
    await asyncio.wait_for(done.wait(), 5.0)
    assert red.landed == 1
    await asyncio.sleep(0)
    assert airspace.claimed == ["green"], "red is given up again"


async def test_a_take_off_that_would_only_be_refused_in_the_air_is_not_begun() -> None:
    red, said, done = Drone("red"), list[str](), asyncio.Event()

    def say(text: str, _notice: Notice = Notice.INFORMATION, /) -> None:
        said.append(text)
        if "not taking off" in text:
            done.set()

    async def too_near(_vehicle: Any, metres: float) -> tuple[str, ...]:
        return (f"a take-off to {metres:g} m brings it 1.0 m too close to you", "no terrain")

    shell = SimpleNamespace(
        fleet=SimpleNamespace(vehicles={"red": red}),
        state=SimpleNamespace(state=State.IDLE),
        frame=SimpleNamespace(origin=Geodetic(47.0, 8.0, 500.0)),
        airspace=Held(),
    )
    GroundWork(shell, say, too_near).take_off("red", 5.0)  # type: ignore[arg-type]
    await asyncio.wait_for(done.wait(), 5.0)
    assert red.taken_off == []
    assert said[-1] == "Red: not taking off, a take-off to 5 m brings it 1.0 m too close to you; no terrain"
