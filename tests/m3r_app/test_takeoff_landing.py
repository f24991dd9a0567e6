"""Take-off and landing outside sessions: only with a drone that nobody else holds, and ended by STOP as everything is."""

from __future__ import annotations

from dataclasses import replace

import pytest

from m3r_app.airspace.local import LocalAirspace
from m3r_app.arbiter.events import LandingAsked, PairingAsked, TakeOffAsked
from safety.vocabulary import Command, FlightMode, Geodetic, State
from tests.m3r_app.tabletop_app import TabletopApp, tabletop


class Held(LocalAirspace):
    """An airspace in which bob holds green."""

    def __init__(self) -> None:
        super().__init__()
        self.claimed: list[str] = []

    async def claim(self, drone: str, operator: Geodetic) -> str | None:
        if drone == "green":
            return "bob holds it"
        self.claimed.append(drone)
        return await super().claim(drone, operator)

    def give_up(self, drone: str) -> None:
        if drone in self.claimed:
            self.claimed.remove(drone)
        super().give_up(drone)


def stands(app: TabletopApp, colour: str) -> None:
    vehicle = app.vehicles[colour]
    place, local = vehicle.told.geodetic, vehicle.told.local
    assert place is not None and local is not None
    on_ground = {"geodetic": place._replace(amsl_m=place.amsl_m - 10.0), "local": local._replace(down=0.0)}
    vehicle.told = replace(vehicle.told, in_air=False, armed=False, **on_ground)  # type: ignore[arg-type]


@pytest.mark.requirement("P1")
async def test_a_drone_that_somebody_else_holds_is_not_landed() -> None:
    airspace = Held()
    async with tabletop(airspace) as app:
        app.put(LandingAsked("green"))
        await app.until(lambda: "Green: not landing, bob holds it" in app.said())
        assert app.said() == ["Green: landing", "Green: not landing, bob holds it"]
        await app.until(lambda: app.shell.state.ground_work is None)
        app.put(LandingAsked("red"))
        await app.until(lambda: "Red: done landing" in app.said())
        await app.until(lambda: airspace.claimed == [])  # red is given up again
        assert (app.vehicles["green"].commands, app.vehicles["red"].commands) == ([], ["land"])


@pytest.mark.requirement("P1")
async def test_a_take_off_that_would_only_be_refused_in_the_air_is_not_begun() -> None:
    async with tabletop() as app:
        stands(app, "red")
        app.vehicles["red"].told = replace(app.vehicles["red"].told, healthy=False, unhealthy=("gyroscope",))
        app.put(TakeOffAsked("red", 5.0))
        await app.until(lambda: any("not taking off" in text for text in app.said()))
        assert app.vehicles["red"].commands == []
        assert app.said()[-1] == "Red: not taking off, it is not healthy: gyroscope"


@pytest.mark.requirement("X4")
@pytest.mark.parametrize("asked", [TakeOffAsked("red", 5.0), LandingAsked("red")])
async def test_stop_ends_it_in_hold(asked: TakeOffAsked | LandingAsked) -> None:
    """X4: whatever mode the drone reports by then."""
    async with tabletop() as app:
        red = app.vehicles["red"]
        if isinstance(asked, TakeOffAsked):
            stands(app, "red")
        red.obeys.clear()
        app.put(asked)
        await app.until(lambda: bool(red.commands))
        assert red.told.flight_mode is FlightMode.HOLD, "what it reports is not yet what it was told"
        app.ask(Command.STOP)
        await app.until(lambda: red.commands[-1] == "hold")
        red.obeys.set()
        await app.until(lambda: app.said()[-1] == "Red: holding")
        await app.until(lambda: app.shell.state.ground_work is None)
        assert red.commands == ["take off 5" if isinstance(asked, TakeOffAsked) else "land", "hold"]
        assert [text for text in app.said() if "called off" not in text][1:] == ["Red: holding"]


@pytest.mark.requirement("X4")
async def test_a_drone_that_does_not_answer_to_stop_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("m3r_app.vehicle.commander.HOLD_S", 0.02)
    async with tabletop() as app:
        app.vehicles["red"].obeys.clear()
        app.put(LandingAsked("red"))
        await app.until(lambda: app.vehicles["red"].commands == ["land"])
        app.ask(Command.STOP)
        await app.until(lambda: app.said()[-1] == "Red: did not answer to Hold")


async def test_one_at_a_time_and_only_in_normal_autonomy() -> None:
    async with tabletop() as app:
        red, green = app.vehicles["red"], app.vehicles["green"]
        red.obeys.clear()
        app.put(LandingAsked("red"))
        app.put(LandingAsked("green"))
        await app.until(lambda: "Green: not landing, the last take-off or landing is not over" in app.said())
        red.obeys.set()
        await app.until(lambda: "Red: done landing" in app.said())
        app.put(PairingAsked("green"))
        await app.until(lambda: app.shell.state.state is State.PAIRING)
        app.put(TakeOffAsked("red", 5.0))
        refused = "Red: taking off to 5 m is only for a drone in normal autonomy, disconnect first"
        await app.until(lambda: refused in app.said())
        assert red.commands == ["land"] and "land" not in green.commands


async def test_a_drone_that_is_not_there_is_said() -> None:
    async with tabletop() as app:
        app.put(LandingAsked("purple"))
        await app.until(lambda: app.said() == ["Purple: there is no such drone"])
        await app.until(lambda: app.shell.state.ground_work is None)
