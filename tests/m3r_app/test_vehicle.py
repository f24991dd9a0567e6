"""The vehicle over real UDP: the simulated fleet where it flies, a stand-in where it refuses, lies or is silent."""

from __future__ import annotations

import asyncio
import logging
import math
import os
import signal
import socket
import subprocess
import sys
import textwrap
import threading
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from m3r_app.ports import free_udp_block
from m3r_app.vehicle.guard import Guard
from m3r_app.vehicle.interface import VehicleError
from m3r_app.vehicle.mavsdk_vehicle import MavsdkVehicle
from m3r_app.vehicle.px4_failsafe import apply, check
from m3r_app.vehicle.telemetry import Telemetry
from safety.frames import LocalFrame
from safety.vocabulary import FlightMode, Geodetic, Ned
from tests.m3r_app.autopilot_stand_in import HOLD, MISSION, OFFBOARD, POSCTL, StandIn
from tests.m3r_app.sim.fleet_process import FleetProcess

ROOT = Path(__file__).resolve().parents[2]
PLAIN = ROOT / "config" / "scenarios" / "plain.toml"
POSITION_ONLY = 0b100111111000
"""SET_POSITION_TARGET_LOCAL_NED: velocity, acceleration and yaw rate ignored; position and yaw used."""
FAILSAFE: dict[str, float | int] = {"COM_OF_LOSS_T": 1.0, "COM_OBL_RC_ACT": 0, "COM_RC_OVERRIDE": 1}


@pytest.fixture(scope="module")
def fleet() -> Iterator[FleetProcess]:
    with FleetProcess(PLAIN, 3) as running:
        yield running


@asynccontextmanager
async def connected(url: str, colour: str = "red") -> AsyncIterator[MavsdkVehicle]:
    vehicle = await MavsdkVehicle.connect(colour, url, time.monotonic, 5.0)
    try:
        await vehicle.wait_ready()
        yield vehicle
    finally:
        await vehicle.close()


def with_stand_in(test: Callable[[MavsdkVehicle, StandIn], Awaitable[None]], **how: object) -> None:
    """Run a test on a vehicle that does as told."""

    async def run() -> None:
        port = free_udp_block(1)
        with StandIn(port, **how) as autopilot:  # type: ignore[arg-type]
            async with connected(f"udpin://127.0.0.1:{port}") as vehicle:
                await test(vehicle, autopilot)

    asyncio.run(run())


async def until(condition: Callable[[], bool], within_s: float = 5.0) -> None:
    deadline_s = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < deadline_s, "it never came to be"
        await asyncio.sleep(0.01)


# On the simulated fleet


def test_telemetry_arrives_complete_true_and_fresh_fifty_times_a_second(fleet: FleetProcess) -> None:
    async def run() -> None:
        async with connected(fleet.vehicles["red"]) as vehicle:
            heard: list[tuple[float, Telemetry]] = []
            vehicle.on_telemetry(lambda telemetry: heard.append((time.monotonic(), telemetry)))
            began_s = time.monotonic()
            await until(lambda: len(heard) >= 100)
            assert 1.6 < time.monotonic() - began_s < 3.0, "50 Hz"
            ages_s = sorted(telemetry.age_s(now_s) for now_s, telemetry in heard)
            assert ages_s[len(ages_s) // 2] < 0.03
            assert ages_s[len(ages_s) * 9 // 10] < 0.3

            latest = heard[-1][1]
            start = LocalFrame(Geodetic(46.9480, 7.4474, 540.0)).geodetic(Ned(14.0, 0.0, -6.0))
            assert latest.geodetic is not None and latest.local is not None and latest.velocity is not None
            assert LocalFrame(start).ned(latest.geodetic).norm < 2.0
            assert latest.local.down == pytest.approx(-6.0, abs=1.5)
            assert latest.velocity.norm < 0.5
            assert abs(abs(latest.yaw_deg) - 180.0) < 5.0
            assert abs(latest.yaw_rate_deg_s) < 20.0
            assert 0.1 < latest.sigma_h_m < 1.0 and 0.1 < latest.sigma_v_m < 1.5
            assert (latest.flight_mode, latest.armed, latest.in_air) == (FlightMode.HOLD, True, True)
            assert latest.healthy and latest.unhealthy == ()
            assert latest.battery is not None and 0.5 < latest.battery <= 1.0
            assert latest.rc_present is False

    asyncio.run(run())


def test_an_offboard_step_moves_the_drone_and_hold_stops_it(fleet: FleetProcess) -> None:
    async def run() -> None:
        async with connected(fleet.vehicles["red"]) as vehicle:
            await vehicle.enter_offboard()
            start = vehicle.telemetry()
            assert start.flight_mode == FlightMode.OFFBOARD and start.local is not None
            goal = start.local.plus(Ned(0.0, 1.0, 0.0))
            vehicle.set_position_ned(goal, start.yaw_deg)
            await vehicle.wait_for(
                lambda t: t.local is not None and t.local.minus(goal).norm < 0.6, 10.0, "a step of 1 m"
            )
            await vehicle.hold()
            await vehicle.wait_for(lambda t: t.flight_mode == FlightMode.HOLD, 3.0, "Hold")

    asyncio.run(run())


def test_a_blocked_event_loop_is_put_in_hold_by_the_guard_over_mavlink(fleet: FleetProcess) -> None:
    async def run() -> None:
        async with connected(fleet.vehicles["red"]) as vehicle:
            reports: list[str] = []
            guard = Guard(reports.append)
            guard.start()
            try:
                await vehicle.enter_offboard()
                guard.arm(vehicle.hold_unless_taken_over)
                time.sleep(1.5)  # noqa: ASYNC251 - the stall itself
                assert not guard.beat()
                await vehicle.wait_for(lambda t: t.flight_mode == FlightMode.HOLD, 2.0, "the guard's Hold")
                assert len(reports) == 1 and "commanded Hold" in reports[0]
            finally:
                guard.close()

    asyncio.run(run())


STUCK = """
    import asyncio, ctypes, sys, time
    from m3r_app.vehicle.guard import Guard
    from m3r_app.vehicle.mavsdk_vehicle import MavsdkVehicle
    from safety.vocabulary import Ned

    async def main():
        guard = Guard(lambda text: None)
        guard.start()
        vehicle = await MavsdkVehicle.connect("red", sys.argv[1], time.monotonic, 5.0)
        await vehicle.wait_ready()
        await vehicle.enter_offboard()
        guard.arm(vehicle.hold_unless_taken_over)
        here, yaw_deg = vehicle.here()
        vehicle.set_position_ned(here.plus(Ned(0.0, -1.0, 0.0)), yaw_deg)
        print(here.north, here.east, here.down, flush=True)
        ctypes.PyDLL(None).usleep(20_000_000)

    asyncio.run(main())
"""


def test_an_app_stuck_in_mid_maneuver_ends_and_the_drones_own_failsafe_holds_it_within_the_step(
    fleet: FleetProcess,
) -> None:
    url = fleet.vehicles["red"]
    with subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(STUCK), url], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as stuck:  # fmt: skip
        assert stuck.stdout is not None
        start = Ned(*map(float, stuck.stdout.readline().split()))
        assert stuck.wait(3.0) == -signal.SIGKILL

    async def run() -> None:
        async with connected(url) as vehicle:
            held = await vehicle.wait_for(
                lambda t: t.flight_mode == FlightMode.HOLD and t.velocity is not None and t.velocity.norm < 0.3,
                5.0,
                "rest",
            )
            assert held.local is not None
            assert held.local.minus(start).norm < 1.0 + 2 * held.sigma_h_m

    asyncio.run(run())


def test_takeoff_climbs_and_ends_in_hold_and_is_refused_in_the_air(fleet: FleetProcess) -> None:
    async def run() -> None:
        async with connected(fleet.vehicles["green"], "green") as vehicle:
            assert vehicle.telemetry().in_air is False
            with pytest.raises(VehicleError, match="green: a take-off to nan m is none"):
                await vehicle.takeoff(math.nan)
            await vehicle.takeoff(3.0)
            flying = vehicle.telemetry()
            assert flying.in_air and flying.flight_mode == FlightMode.HOLD
            assert flying.local is not None and flying.local.down == pytest.approx(-3.0, abs=1.0)
            with pytest.raises(VehicleError, match="stand on the ground"):
                await vehicle.takeoff(3.0)

    asyncio.run(run())


def test_a_mission_is_held_and_resumed_and_where_there_is_none_the_reason_is_told(fleet: FleetProcess) -> None:
    async def run() -> None:
        async with connected(fleet.vehicles["blue"], "blue") as vehicle:
            assert vehicle.telemetry().flight_mode == "MISSION"
            await vehicle.hold()
            await vehicle.wait_for(lambda t: t.flight_mode == FlightMode.HOLD, 3.0, "Hold")
            await vehicle.resume_mission()
            await vehicle.wait_for(lambda t: t.flight_mode == "MISSION", 3.0, "the mission")
        async with connected(fleet.vehicles["red"]) as vehicle:
            with pytest.raises(
                VehicleError, match=r"red: the mission was refused .*: the vehicle says Switching to Mission"
            ):
                await vehicle.resume_mission()

    asyncio.run(run())


def test_px4s_failsafe_defaults_are_found_on_the_vehicle_and_mended(fleet: FleetProcess) -> None:
    async def run() -> None:
        async with connected(fleet.vehicles["green"], "green") as vehicle:
            assert [m.name for m in await check(vehicle, False)] == ["COM_OBL_RC_ACT"]
            assert [m.name for m in await check(vehicle, None)] == ["COM_OBL_RC_ACT", "COM_RC_OVERRIDE"]
            assert await apply(vehicle, None) == ()
            assert await vehicle.parameters(["COM_OBL_RC_ACT", "COM_RC_OVERRIDE"]) == {
                "COM_OBL_RC_ACT": 5,
                "COM_RC_OVERRIDE": 3,
            }

    asyncio.run(run())


# On a vehicle that does as told


def test_setpoints_are_position_and_yaw_only_and_reach_the_vehicle_at_once() -> None:
    async def test(vehicle: MavsdkVehicle, autopilot: StandIn) -> None:
        costs_s = []
        for step in range(100):
            began_s = time.perf_counter()
            vehicle.set_position_ned(Ned(1.0 + step / 100, 2.0, -10.0), -30.0)
            costs_s.append(time.perf_counter() - began_s)
            await asyncio.sleep(0.005)
        assert sorted(costs_s)[90] < 0.005, "cheap enough for the event loop at 50 Hz"
        await until(lambda: autopilot.setpoints[-1][0] == pytest.approx(1.99))
        north, east, down, yaw_deg, mask = autopilot.setpoints[-1]
        assert (north, east, down) == pytest.approx((1.99, 2.0, -10.0))
        assert yaw_deg == pytest.approx(-30.0, abs=0.01)
        assert mask == POSITION_ONLY

    with_stand_in(test)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("axis", range(4))
def test_a_setpoint_that_is_not_finite_is_never_sent(bad: float, axis: int, monkeypatch: pytest.MonkeyPatch) -> None:
    sent: list[object] = []
    vehicle = MavsdkVehicle.__new__(MavsdkVehicle)
    vehicle.colour = "red"
    vehicle._offboard = type("Offboard", (), {"set_position_ned": lambda _, setpoint: sent.append(setpoint)})()
    values = [1.0, 2.0, -3.0, 90.0]
    vehicle.set_position_ned(Ned(*values[:3]), values[3])
    assert len(sent) == 1
    values[axis] = bad
    with pytest.raises(VehicleError, match=r"red: .* is no position"):
        vehicle.set_position_ned(Ned(*values[:3]), values[3])
    assert len(sent) == 1


def test_offboard_starts_at_the_present_position_not_at_a_remembered_one() -> None:
    async def test(vehicle: MavsdkVehicle, autopilot: StandIn) -> None:
        await vehicle.enter_offboard()
        vehicle.set_position_ned(Ned(3.0, 2.0, -10.0), 30.0)
        await vehicle.hold()
        await until(lambda: autopilot.mode == HOLD)
        autopilot.north_m, autopilot.east_m = -4.0, 7.0  # carried elsewhere meanwhile
        await vehicle.wait_for(lambda t: t.local is not None and t.local.north == -4.0, 3.0, "elsewhere")
        await vehicle.enter_offboard()
        assert autopilot.mode == OFFBOARD
        assert (autopilot.north_m, autopilot.east_m) == pytest.approx((-4.0, 7.0)), "it must not have been moved"

    with_stand_in(test)


def test_offboard_denied_at_first_for_want_of_setpoints_is_asked_for_again() -> None:
    async def test(vehicle: MavsdkVehicle, autopilot: StandIn) -> None:
        await vehicle.enter_offboard()
        assert autopilot.mode_commands.count(OFFBOARD) == 3

    with_stand_in(test, deny_first_offboards=2)


def test_a_refusal_carries_the_reason_that_the_autopilot_gave_in_words() -> None:
    async def test(vehicle: MavsdkVehicle, autopilot: StandIn) -> None:
        with pytest.raises(VehicleError) as refusal:
            await vehicle.hold()
        text = str(refusal.value)
        assert text == "red: Hold was refused (COMMAND_DENIED): the vehicle says Preflight Fail: no mode for you."
        with pytest.raises(VehicleError, match="COMMAND_DENIED"):
            await asyncio.get_running_loop().run_in_executor(None, vehicle.hold_blocking, 2.0)
        with pytest.raises(VehicleError, match="the vehicle says Preflight Fail"):
            await vehicle.enter_offboard()

    with_stand_in(test, refuse={176: "Preflight Fail: no mode for you"})


def test_somebody_elses_takeover_is_seen_and_not_fought_by_the_guards_hold() -> None:
    async def test(vehicle: MavsdkVehicle, autopilot: StandIn) -> None:
        await vehicle.enter_offboard()
        autopilot.mode = POSCTL
        await vehicle.wait_for(lambda t: t.flight_mode == FlightMode.POSITION, 2.0, "the takeover")
        commands = len(autopilot.mode_commands)
        vehicle.hold_unless_taken_over(1.0)
        assert (autopilot.mode, len(autopilot.mode_commands)) == (POSCTL, commands)
        await asyncio.get_running_loop().run_in_executor(None, vehicle.hold_blocking, 2.0)
        assert autopilot.mode == HOLD, "asked for expressly it is commanded"

    with_stand_in(test)


def test_a_silent_link_is_seen_by_its_age_and_what_was_known_becomes_unknown() -> None:
    async def test(vehicle: MavsdkVehicle, autopilot: StandIn) -> None:
        autopilot.silent = True
        await until(lambda: vehicle.telemetry().link_age_s(time.monotonic()) > 0.5)
        assert vehicle.here() is None
        with pytest.raises(VehicleError, match="Offboard needs a fresh position"):
            await vehicle.enter_offboard()
        assert not autopilot.mode_commands
        began_s = time.monotonic()
        with pytest.raises(VehicleError, match=r"Hold was sent and not acknowledged within 0.3 s"):
            vehicle.hold_blocking(0.3)
        assert time.monotonic() - began_s < 1.0
        with pytest.raises(VehicleError, match="no answer to Hold"):
            await vehicle.hold()
        await until(lambda: vehicle.telemetry().flight_mode == FlightMode.UNKNOWN)
        lost = vehicle.telemetry()
        assert (lost.armed, lost.in_air, lost.healthy, lost.unhealthy) == (None, None, False, ("no health report",))
        assert math.isnan(lost.sigma_h_m) and math.isnan(lost.sigma_v_m)
        autopilot.silent = False
        await vehicle.wait_for(lambda t: t.healthy and t.age_s(time.monotonic()) < 0.1, 5.0, "the link's return")

    with_stand_in(test)


def test_a_blocked_loop_finds_the_latest_telemetry_not_a_backlog() -> None:
    async def test(vehicle: MavsdkVehicle, autopilot: StandIn) -> None:
        heard: list[Telemetry] = []
        vehicle.on_telemetry(heard.append)
        await until(lambda: bool(heard))
        time.sleep(1.0)  # noqa: ASYNC251 - fifty reports arrive meanwhile
        heard.clear()
        autopilot.north_m = 5.0
        await until(lambda: len(heard) >= 2)
        assert heard[0].age_s(time.monotonic()) < 0.3
        vehicle.off_telemetry(heard.append)

    with_stand_in(test)


def test_the_estimator_is_believed_then_the_receiver_and_neither_is_unknown() -> None:
    async def test(vehicle: MavsdkVehicle, autopilot: StandIn) -> None:
        telemetry = vehicle.telemetry()
        assert (telemetry.sigma_h_m, telemetry.sigma_v_m) == pytest.approx((0.4, 0.6), abs=1e-6)
        autopilot.estimator_m = (math.nan, 2.0)
        await vehicle.wait_for(lambda t: t.sigma_v_m == 2.0, 3.0, "the estimator's doubt")
        assert vehicle.telemetry().sigma_h_m == pytest.approx(0.3, abs=1e-6)
        autopilot.estimator_m, autopilot.gps_m = (math.nan, math.nan), (0.0, 0.0)
        await vehicle.wait_for(lambda t: math.isnan(t.sigma_h_m) and math.isnan(t.sigma_v_m), 3.0, "no accuracy at all")

    with_stand_in(test)


def test_what_is_not_healthy_is_named_and_prevents_a_takeoff(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("m3r_app.vehicle.waiting.HEALTH_WAIT_S", 0.5)

    async def test(vehicle: MavsdkVehicle, autopilot: StandIn) -> None:
        telemetry = vehicle.telemetry()
        assert not telemetry.healthy and telemetry.unhealthy == ("magnetometer",)
        with pytest.raises(VehicleError, match="red: not fit to take off: magnetometer"):
            await vehicle.takeoff(3.0)
        assert not autopilot.armed

    with_stand_in(test, healthy=False, armed=False, landed=True)


def test_a_remote_control_is_noticed() -> None:
    async def test(vehicle: MavsdkVehicle, _: StandIn) -> None:
        await vehicle.wait_for(lambda t: t.rc_present is True, 3.0, "the remote control")

    with_stand_in(test, rc_present=True)


def test_parameters_keep_their_types_and_a_missing_one_is_told_soon() -> None:
    async def test(vehicle: MavsdkVehicle, autopilot: StandIn) -> None:
        began_s = time.monotonic()
        names = ["COM_OF_LOSS_T", "NOT_THERE", "COM_OBL_RC_ACT", "NOR_THIS", "MINUS"]
        assert await vehicle.parameters(names) == {
            "COM_OF_LOSS_T": 1.0,
            "NOT_THERE": None,
            "COM_OBL_RC_ACT": 0,
            "NOR_THIS": None,
            "MINUS": -1,
        }
        assert time.monotonic() - began_s < 2.5, "MAVSDK alone would wait three seconds for each"
        await vehicle.set_parameter("COM_OBL_RC_ACT", 5.0)
        await vehicle.set_parameter("COM_OF_LOSS_T", 0.5)
        assert autopilot.parameters == {
            "SYS_AUTOSTART": 4001,
            **FAILSAFE,
            "MINUS": -1,
            "COM_OBL_RC_ACT": 5,
            "COM_OF_LOSS_T": 0.5,
        }
        with pytest.raises(VehicleError, match="red: the vehicle has no parameter NOT_THERE"):
            await vehicle.set_parameter("NOT_THERE", 1.0)
        with pytest.raises(VehicleError, match="COM_OBL_RC_ACT is an integer"):
            await vehicle.set_parameter("COM_OBL_RC_ACT", 4.5)

    with_stand_in(test, parameters={**FAILSAFE, "MINUS": -1})


def test_we_are_a_ground_station() -> None:
    async def test(_: MavsdkVehicle, autopilot: StandIn) -> None:
        await until(lambda: bool(autopilot.hellos))
        assert autopilot.hellos == {(245, 190, 6)}, "MAV_COMP_ID_MISSIONPLANNER, MAV_TYPE_GCS"

    with_stand_in(test)


def test_mavsdk_writes_nothing_to_standard_output_even_of_what_it_cannot_read(
    capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    async def test(vehicle: MavsdkVehicle, autopilot: StandIn) -> None:
        autopilot.say(b"no \xff UTF-8")
        autopilot.say(b"plain words")
        await until(lambda: [status.text for status in vehicle.status_texts] == ["plain words"])

    caplog.set_level(logging.DEBUG, "m3r.mavsdk")
    with_stand_in(test)
    assert capfd.readouterr().out == ""
    messages = [record.getMessage() for record in caplog.records]
    assert any("plain words" in message for message in messages), "its messages go to logging instead"
    assert any("Error in status_text callback" in message for message in messages)


def test_mission_resumes_by_command() -> None:
    async def test(vehicle: MavsdkVehicle, autopilot: StandIn) -> None:
        await vehicle.resume_mission()
        assert autopilot.mode == MISSION

    with_stand_in(test)


# Links that are none


def test_a_vehicle_that_never_answers_is_one_sentence_and_leaves_the_port_free() -> None:
    async def run() -> None:
        url = f"udpin://127.0.0.1:{free_udp_block(1)}"
        for _ in range(2):
            with pytest.raises(VehicleError, match=f"red: no autopilot answered on {url} within 0.3 s"):
                await MavsdkVehicle.connect("red", url, time.monotonic, 0.3)

    asyncio.run(run())


def test_a_port_in_use_is_refused_before_the_other_program_loses_its_telemetry() -> None:
    async def run() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            other.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            other.bind(("127.0.0.1", 0))
            port = other.getsockname()[1]
            with pytest.raises(VehicleError, match=f"red: UDP port {port} is held by another program"):
                await MavsdkVehicle.connect("red", f"udpin://127.0.0.1:{port}", time.monotonic, 5.0)

    asyncio.run(run())


def test_two_vehicles_of_ours_cannot_share_a_port() -> None:
    async def test(vehicle: MavsdkVehicle, _: StandIn) -> None:
        with pytest.raises(VehicleError, match=r"green: UDP port .* is held"):
            await MavsdkVehicle.connect("green", vehicle.url, time.monotonic, 1.0)

    with_stand_in(test)


def test_two_vehicles_on_one_link_are_refused_for_one_might_be_taken_for_the_other() -> None:
    async def run() -> None:
        port = free_udp_block(1)
        with StandIn(port, system_id=1), StandIn(port, system_id=2):
            vehicle = await MavsdkVehicle.connect("red", f"udpin://127.0.0.1:{port}", time.monotonic, 5.0)
            try:
                with pytest.raises(VehicleError, match="red: more than one vehicle answers"):
                    await vehicle.wait_ready()
            finally:
                await vehicle.close()

    asyncio.run(run())


@pytest.mark.parametrize("url", ["nonsense", "udp://:14540", "serial:///dev/does-not-exist:57600"])
def test_a_bad_link_is_one_sentence(url: str) -> None:
    with pytest.raises(VehicleError) as refusal:
        asyncio.run(MavsdkVehicle.connect("red", url, time.monotonic, 1.0))
    assert str(refusal.value).startswith("red: ") and url in str(refusal.value) and "\n" not in str(refusal.value)


def test_a_cancelled_connect_lets_go_of_the_port() -> None:
    async def run() -> None:
        url = f"udpin://127.0.0.1:{free_udp_block(1)}"
        connecting = asyncio.create_task(MavsdkVehicle.connect("red", url, time.monotonic, 30.0))
        await asyncio.sleep(0.2)
        connecting.cancel()
        with pytest.raises(asyncio.CancelledError):
            await connecting
        with pytest.raises(VehicleError, match="no autopilot answered"):
            await MavsdkVehicle.connect("red", url, time.monotonic, 0.2)

    asyncio.run(run())


def test_after_closing_commands_are_refused_and_late_callbacks_do_no_harm() -> None:
    async def test(vehicle: MavsdkVehicle, _: StandIn) -> None:
        await vehicle.close()
        await vehicle.close()
        with pytest.raises(VehicleError, match="after the link was closed"):
            await vehicle.hold()
        with pytest.raises(VehicleError, match="Hold could not be sent"):
            vehicle.hold_blocking(0.2)
        with pytest.raises(VehicleError, match="a setpoint could not be sent"):
            vehicle.set_position_ned(Ned(0.0, 0.0, -3.0), 0.0)

    with_stand_in(test)
    assert all("guard" not in thread.name for thread in threading.enumerate())


# ---------------------------------------------------------------- letting go ends the setpoints: X3


async def quiet(autopilot: StandIn) -> None:
    """A second in which no setpoint arrives, after what was still on its way."""
    await asyncio.sleep(0.1)
    before = len(autopilot.setpoints)
    await asyncio.sleep(1.0)
    assert len(autopilot.setpoints) == before


def test_a_remembered_setpoint_is_sent_again_until_it_is_let_go() -> None:
    """MAVSDK repeats it at 20 Hz: the test would not notice silence that was there before."""

    async def test(vehicle: MavsdkVehicle, autopilot: StandIn) -> None:
        await vehicle.enter_offboard()
        await asyncio.sleep(0.2)
        before = len(autopilot.setpoints)
        await until(lambda: len(autopilot.setpoints) >= before + 5)
        await vehicle.end_setpoints()
        await quiet(autopilot)
        assert autopilot.mode == OFFBOARD, "it commands nothing: somebody else may have taken over"

    with_stand_in(test)


def test_let_go_in_hold_is_seen_and_silent() -> None:
    async def test(vehicle: MavsdkVehicle, autopilot: StandIn) -> None:
        await vehicle.enter_offboard()
        await vehicle.leave_in_hold()
        assert vehicle.telemetry().flight_mode == FlightMode.HOLD
        await quiet(autopilot)
        await vehicle.enter_offboard()
        assert vehicle.telemetry().flight_mode == FlightMode.OFFBOARD, "and it can be taken again"

    with_stand_in(test)


def test_let_go_while_the_link_is_cut_is_silent_and_holds_when_it_returns() -> None:
    """PX4 goes back to Offboard by itself as long as setpoints come: after a cut too, none may."""

    async def test(vehicle: MavsdkVehicle, autopilot: StandIn) -> None:
        await vehicle.enter_offboard()
        autopilot.silent = True
        letting_go = asyncio.create_task(vehicle.leave_in_hold())
        await asyncio.sleep(1.0)
        assert not letting_go.done()
        autopilot.setpoints.clear()
        autopilot.silent = False
        await letting_go
        assert autopilot.mode == HOLD
        await quiet(autopilot)

    with_stand_in(test)


def test_whoever_took_over_is_not_fought_by_letting_go() -> None:
    async def test(vehicle: MavsdkVehicle, autopilot: StandIn) -> None:
        await vehicle.enter_offboard()
        autopilot.mode = POSCTL
        await vehicle.wait_for(lambda t: t.flight_mode == FlightMode.POSITION, 3.0, "the takeover")
        autopilot.mode_commands.clear()
        await vehicle.leave_in_hold()
        assert autopilot.mode_commands == []
        await quiet(autopilot)

    with_stand_in(test)


# ---------------------------------------------------------------- MAVLink as it is out there: X6


@pytest.mark.parametrize("claimed", [3, 12, 0])
def test_a_gimbal_that_claims_to_be_an_autopilot_is_not_believed(claimed: int) -> None:
    async def test(vehicle: MavsdkVehicle, autopilot: StandIn) -> None:
        modes: set[str] = set()
        vehicle.on_telemetry(lambda t: modes.add(t.flight_mode))
        await vehicle.enter_offboard()
        await vehicle.hold()
        await vehicle.enter_offboard()
        await asyncio.sleep(1.0)
        await vehicle.hold()
        assert modes <= {FlightMode.HOLD, FlightMode.OFFBOARD}
        assert vehicle.telemetry().armed is True

    with_stand_in(test, gimbal=claimed)


def test_what_it_does_not_say_is_unknown() -> None:
    """Whether it stands, above all: a link that was cut is no landing."""

    async def test(vehicle: MavsdkVehicle, autopilot: StandIn) -> None:
        assert vehicle.telemetry().in_air is True
        autopilot.landed_unknown = True
        await vehicle.wait_for(lambda t: t.in_air is None, 5.0, "not knowing")
        autopilot.landed_unknown, autopilot.landed = False, True
        await vehicle.wait_for(lambda t: t.in_air is False, 2.0, "the ground")

    with_stand_in(test)


def test_an_autopilot_that_starts_anew_is_noticed() -> None:
    async def test(vehicle: MavsdkVehicle, autopilot: StandIn) -> None:
        await asyncio.sleep(0.5)
        assert vehicle.telemetry().restarts == 0
        autopilot.boots += 1
        await vehicle.wait_for(lambda t: t.restarts == 1, 3.0, "the restart")

    with_stand_in(test)


@pytest.mark.parametrize(("every", "low_hz", "high_hz"), [(1, 40.0, 55.0), (12, 3.5, 4.8)])
def test_the_rate_of_positions_is_measured(every: int, low_hz: float, high_hz: float) -> None:
    async def test(vehicle: MavsdkVehicle, autopilot: StandIn) -> None:
        await vehicle.wait_for(lambda t: low_hz < t.rate_hz < high_hz, 5.0, f"{low_hz} to {high_hz} Hz")

    with_stand_in(test, every=every)


def test_home_and_rangefinder_are_heard() -> None:
    async def test(vehicle: MavsdkVehicle, autopilot: StandIn) -> None:
        await vehicle.wait_for(lambda t: t.home == Geodetic(47.0, 8.0, 500.0), 3.0, "home")
        await vehicle.wait_for(lambda t: t.ground_distance_m == pytest.approx(7.25), 3.0, "the rangefinder")
        autopilot.rangefinder_m = None
        await vehicle.wait_for(lambda t: t.ground_distance_m is None, 3.0, "its silence")

    with_stand_in(test, rangefinder_m=7.25)


def test_a_lost_answer_is_no_missing_parameter() -> None:
    """Half of all messages are lost each way. What exists answers in the end; what does not is still told."""
    there: dict[str, float | int] = {"SYS_AUTOSTART": 4001, **FAILSAFE}

    async def test(vehicle: MavsdkVehicle, autopilot: StandIn) -> None:
        autopilot.loss = 0.5
        values = await vehicle.parameters(list(FAILSAFE))
        autopilot.loss = 0.0
        for name, value in FAILSAFE.items():
            assert values[name] == value or math.isnan(values[name] or math.nan), (name, values[name])
        assert sum(values[name] == value for name, value in FAILSAFE.items()) >= 2

    with_stand_in(test, parameters=there)


def test_a_parameter_that_does_not_answer_is_told_from_one_that_does_not_exist() -> None:
    async def test(vehicle: MavsdkVehicle, autopilot: StandIn) -> None:
        assert (await vehicle.parameters(["NOT_THERE"]))["NOT_THERE"] is None
        autopilot.silent = True
        assert math.isnan((await vehicle.parameters(["COM_OF_LOSS_T"]))["COM_OF_LOSS_T"] or 0.0)

    with_stand_in(test, parameters={"SYS_AUTOSTART": 4001, **FAILSAFE})


def test_what_a_drone_says_moves_no_cursor() -> None:
    async def test(vehicle: MavsdkVehicle, autopilot: StandIn) -> None:
        autopilot.say(b"\x1b[2J\x1b]0;owned\x07low \xe2\x80\xae battery\r\n")
        await until(lambda: bool(vehicle.status_texts))
        said = vehicle.status_texts[-1].text
        assert "low" in said
        assert all(c.isprintable() for c in said)

    with_stand_in(test)


async def ready_until(deadline_s: float, vehicle: MavsdkVehicle) -> None:
    """Ask again and again: both must have been heard."""
    while time.monotonic() < deadline_s:
        await vehicle.wait_ready()


def test_two_autopilots_on_one_link_are_both_named() -> None:
    async def run() -> None:
        port = free_udp_block(1)
        with StandIn(port, 7), StandIn(port, 9):
            vehicle = await MavsdkVehicle.connect("red", f"udpin://127.0.0.1:{port}", time.monotonic, 5.0)
            try:
                with pytest.raises(VehicleError, match="system ids 7 and 9"):
                    await ready_until(time.monotonic() + 10.0, vehicle)
            finally:
                await vehicle.close()

    asyncio.run(run())


def test_nothing_is_left_in_the_temporary_directory(tmp_path: Path) -> None:
    with FleetProcess(PLAIN, 1) as running:
        script = textwrap.dedent("""
            import asyncio, sys, time
            from m3r_app.vehicle.mavsdk_vehicle import MavsdkVehicle
            async def main():
                vehicle = await MavsdkVehicle.connect("red", sys.argv[1], time.monotonic)
                await vehicle.wait_ready()
                await vehicle.close()
            asyncio.run(main())
        """)
        env = {**os.environ, "TMPDIR": str(tmp_path)}
        subprocess.run(
            [sys.executable, "-c", script, running.vehicles["red"]], cwd=ROOT, env=env, check=True, timeout=60
        )
    assert list(tmp_path.iterdir()) == []
