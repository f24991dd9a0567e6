"""One drone has one commander: what is commanded ends what was commanded before, and STOP ends whatever it is."""

from __future__ import annotations

import ast
import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace
from pathlib import Path

import pytest

from m3r_app.arbiter.events import PairingAsked
from m3r_app.output import PairEvent, PairStatus
from m3r_app.vehicle.commander import MODE_LAG_S, Commander
from m3r_app.vehicle.interface import VehicleError
from safety.frames import Ned
from safety.limits import Limits
from safety.vocabulary import Command, FlightMode, Geodetic, State
from tests.m3r_app.tabletop_app import tabletop
from tests.m3r_app.tabletop_vehicle import TabletopVehicle, flying

ROOT = Path(__file__).resolve().parents[2]
HERE = flying(Geodetic(47.0, 8.0, 500.0), Ned(0.0, 0.0, -10.0))


class Made:
    """A commander and its vehicle, at a time that stands still."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.vehicle = TabletopVehicle("red", HERE, lambda: self.now_s)
        self.commander = Commander(self.vehicle, lambda: self.now_s)
        self.stalls: list[str] = []

    def engage(self) -> None:
        self.commander.engage(Limits(), lambda: None, self.stalls.append, lambda *_: None)

    async def begun(self, command: Callable[[Commander], Awaitable[None]]) -> asyncio.Task[None]:
        """Commanded, and not done yet."""

        async def work() -> None:
            await command(self.commander)

        self.vehicle.obeys.clear()
        task = asyncio.create_task(work())
        while not self.vehicle.commands:
            await asyncio.sleep(0)
        return task


TAKE_OFF: Callable[[Commander], Awaitable[None]] = lambda c: c.take_off(5.0)  # noqa: E731


@pytest.mark.requirement("X4")
@pytest.mark.parametrize("command", [TAKE_OFF, Commander.land, Commander.hold])
@pytest.mark.parametrize("given_up", [False, True])
async def test_stop_ends_what_is_under_way_in_hold(
    command: Callable[[Commander], Awaitable[None]], given_up: bool
) -> None:
    """X4: also where whoever had asked for it was cancelled first."""
    made = Made()
    task = await made.begun(command)
    if given_up:
        task.cancel()
        await asyncio.wait({task})
    made.vehicle.obeys.set()
    assert await made.commander.stop()
    assert made.vehicle.commands[1:] == ["hold"]
    await asyncio.wait({task})
    assert task.cancelled() if given_up else isinstance(task.exception(), VehicleError)
    assert not await made.commander.stop(), "and then nothing is under way any more"


@pytest.mark.requirement("X4")
async def test_stop_commands_nothing_where_nothing_is_under_way() -> None:
    """It may be somebody else's drone: X3. A take-off is ended, whoever told it to."""
    made = Made()
    assert not await made.commander.stop()
    await made.commander.land()
    made.vehicle.refuses = "not now"
    with pytest.raises(VehicleError):
        await made.commander.take_off(5.0)
    assert not await made.commander.stop()
    made.vehicle.refuses = ""
    made.vehicle.told = replace(made.vehicle.told, flight_mode=FlightMode.TAKEOFF)
    assert await made.commander.stop()
    assert made.vehicle.commands == ["land", "take off 5", "hold"]


async def test_what_is_commanded_ends_what_was_commanded_before() -> None:
    made = Made()
    task = await made.begun(TAKE_OFF)
    made.vehicle.obeys.set()
    await made.commander.land()
    with pytest.raises(VehicleError, match="the take-off was ended by what was commanded after it"):
        await task
    assert made.vehicle.commands == ["take off 5", "land"]


@pytest.mark.requirement("X3")
async def test_no_order_reaches_a_drone_that_was_let_go() -> None:
    made = Made()
    made.engage()
    await made.commander.face(90.0)
    freed = made.commander.let_go("hold")
    made.commander.hover()
    await made.commander.face(10.0)
    await freed
    await made.commander.face(20.0)
    assert made.vehicle.commands == ["offboard", "leave in hold"]


@pytest.mark.requirement("X3")
async def test_a_mode_told_before_it_was_changed_is_not_a_takeover() -> None:
    made = Made()
    assert made.commander.flight_mode(replace(HERE, flight_mode=FlightMode.LAND)) is FlightMode.LAND
    made.engage()
    await made.commander.face(90.0)
    old, new = (
        replace(HERE, flight_mode=FlightMode.HOLD, mode_at_s=made.now_s + later_s) for later_s in (0.0, MODE_LAG_S)
    )
    assert made.commander.flight_mode(old) is FlightMode.OFFBOARD and not made.commander.unasked_hold(old)
    assert made.commander.flight_mode(new) is FlightMode.HOLD and made.commander.unasked_hold(new)
    silent = replace(old, flight_mode=FlightMode.UNKNOWN)
    assert made.commander.flight_mode(silent) is FlightMode.UNKNOWN
    made.commander.disengaged()
    assert made.commander.flight_mode(old) is FlightMode.HOLD and not made.commander.unasked_hold(new)
    await made.commander.close()


@pytest.mark.requirement("X7")
async def test_what_breaks_the_sending_is_told_and_sent_on_after() -> None:
    made = Made()
    made.engage()
    await made.commander.face(90.0)

    def broken(_point: Ned, _yaw_deg: float) -> None:
        raise VehicleError("red: the link is closed")

    sending = made.vehicle.set_position_ned
    made.vehicle.set_position_ned = broken  # type: ignore[method-assign]
    while not made.stalls:
        made.now_s += 0.02
        await asyncio.sleep(0.01)
    assert made.stalls == ["setpoints could not be sent (red: the link is closed)"]
    made.vehicle.set_position_ned = sending  # type: ignore[method-assign]
    await made.commander.face(90.0)
    assert made.vehicle.commands == ["offboard", "offboard"]
    await made.commander.close()


# ---------------------------------------------------------------- in the app


@pytest.mark.requirement("X4", "X8")
@pytest.mark.parametrize("command", [Command.STOP, Command.DISCONNECT])
async def test_a_take_off_for_pairing_is_called_off_in_hold(command: Command) -> None:
    """X4: as soon as it was commanded, before the drone reports that it takes off."""
    async with tabletop(takeoff_m=5.0) as app:
        red = app.vehicles["red"]
        assert red.told.geodetic is not None and red.told.local is not None
        ground = red.told.geodetic._replace(amsl_m=red.told.geodetic.amsl_m - 10.0)
        red.told = replace(red.told, in_air=False, geodetic=ground, local=red.told.local._replace(down=0.0))
        app.put(PairingAsked("red"))
        red.obeys.clear()
        await app.until(lambda: red.commands == ["take off 5"])
        app.ask(command)
        await app.until(lambda: red.commands == ["take off 5", "hold"])
        assert app.shell.state.state is State.PAIRING, "it is not over before it holds"
        red.obeys.set()
        await app.until(lambda: app.shell.state.state is State.IDLE)
        assert [e.status for e in app.output if isinstance(e, PairEvent)] == [PairStatus.REQUESTED, PairStatus.REFUSED]
        assert "offboard" not in red.commands


@pytest.mark.requirement("P1", "X4")
async def test_a_session_from_pairing_to_release() -> None:
    """The tune, the anchor and the end are effects of the arbiter; STOP hovers, and the drone is left in Hold."""
    async with tabletop() as app:
        red = app.vehicles["red"]
        app.put(PairingAsked("red"))
        await app.until(lambda: bool(red.setpoints))
        assert red.commands == ["hold", "offboard"]
        app.ask(Command.STOP)  # before it faces the operator
        await app.until(lambda: app.shell.state.state is State.IDLE)
        await app.until(lambda: red.commands == ["hold", "offboard", "leave in hold"])
        red.told = replace(red.told, yaw_deg=180.0)
        app.put(PairingAsked("red"))
        await app.until(lambda: app.shell.state.state is State.ARMED, 20.0)
        await app.until(lambda: red.commands[3:] == ["hold", "offboard", "tune"])
        app.ask(Command.STOP)
        await app.until(lambda: app.said()[-1] == "Red: holding")
        app.ask(Command.DISCONNECT)
        await app.until(lambda: red.commands[-1] == "leave in hold")
        anchors = [data["position"] for topic, data in app.recorded if topic == "anchor"]
        assert anchors[0] is not None and anchors[-1] is None


@pytest.mark.requirement("X3")
async def test_a_drone_is_paired_again_only_when_it_is_free() -> None:
    async with tabletop() as app:
        red = app.vehicles["red"]
        app.put(PairingAsked("red"))
        await app.until(lambda: app.shell.state.state is State.FACING and bool(red.setpoints))
        red.obeys.clear()
        app.ask(Command.STOP)
        await app.until(lambda: red.commands[-1] == "leave in hold")
        app.put(PairingAsked("red"))
        await app.until(lambda: app.shell.state.state is State.PAIRING)
        for _ in range(50):
            await asyncio.sleep(0)
        assert red.commands[-1] == "leave in hold"
        red.obeys.set()
        await app.until(lambda: red.commands[-2:] == ["hold", "offboard"])


@pytest.mark.requirement("X6", "X8")
async def test_a_drone_that_is_not_heard_once_it_is_taken_is_let_go(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("m3r_app.runtime.FRESH_S", 0.1)
    async with tabletop() as app:
        red = app.vehicles["red"]
        red.told = replace(red.told, velocity=None)
        app.put(PairingAsked("red"))
        await app.until(lambda: app.said()[-1:] == ["Red: not paired, red: nothing was heard from it for 0.1 s."])
        await app.until(lambda: red.commands == ["hold", "leave in hold"])
        assert app.shell.commander is None


COMMANDS = {
    "takeoff", "leave_in_hold", "enter_offboard", "end_setpoints", "set_position_ned", "resume_mission", "begin_landing",
    "hold_blocking",
}  # fmt: skip


def test_nothing_else_commands_a_drone() -> None:
    """What every Vehicle is commanded by is called in the vehicles' wing alone; mypy holds the others to ObservedVehicle."""
    wing, found = ROOT / "m3r_app" / "vehicle", []
    for path in (ROOT / "m3r_app").rglob("*.py"):
        if path.is_relative_to(wing) or path.is_relative_to(ROOT / "m3r_app" / "sim"):
            continue
        tree = ast.parse(path.read_text())
        found += [
            f"{path.name}: {n.attr}" for n in ast.walk(tree) if isinstance(n, ast.Attribute) and n.attr in COMMANDS
        ]
    assert found == []
