"""Take-off and landing outside sessions: only with a drone that nobody else holds. P1."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace

from m3r_app.modes import State
from m3r_app.takeoff_landing import GroundWork
from safety.vocabulary import Geodetic


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

    async def land(self) -> None:
        self.landed += 1


async def test_a_drone_that_somebody_else_holds_is_not_landed() -> None:
    red, green, airspace, said = Drone("red"), Drone("green"), Held(), list[str]()
    done = asyncio.Event()

    def say(text: str) -> None:
        said.append(text)
        if "not landing" in text or "done landing" in text:
            done.set()

    shell = SimpleNamespace(
        fleet=SimpleNamespace(vehicles={"red": red, "green": green}),
        state=SimpleNamespace(state=State.IDLE),
        frame=SimpleNamespace(origin=Geodetic(47.0, 8.0, 500.0)),
        airspace=airspace,
    )
    work = GroundWork(shell, say)  # type: ignore[arg-type]
    work.land("green")
    await asyncio.wait_for(done.wait(), 5.0)
    assert green.landed == 0 and said == ["Green: landing", "Green: not landing, bob holds it"]
    done.clear()
    work.land("red")
    await asyncio.wait_for(done.wait(), 5.0)
    assert red.landed == 1
    await asyncio.sleep(0)
    assert airspace.claimed == ["green"], "red is given up again"
