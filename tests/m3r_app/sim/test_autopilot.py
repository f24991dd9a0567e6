"""What PX4 does, the simulated autopilot does: arming, modes, failsafes, injected failures. In virtual time."""

from __future__ import annotations

import math
from collections.abc import Callable
from random import Random

import pytest

from m3r_app.sim.autopilot import FORCE, Autopilot
from m3r_app.sim.dynamics import ZERO, Multirotor, PositionError, Setpoint
from m3r_app.sim.guidance import TICK_S
from m3r_app.sim.modes import Fault, FlightMode, MavResult
from m3r_app.sim.parameters import INT32, REAL32, Parameters
from safety.vocabulary import Ned

UP = Ned(0.0, 0.0, -8.0)


def autopilot(
    place: Ned = UP, waypoints: tuple[Ned, ...] = (), rc: bool = False, loops: bool = True, **params: float
) -> Autopilot:
    """One on flat ground at down = 0, with a perfect position."""
    error = PositionError(1e-6, 1e-6, 300.0, 1e-6, Random(1))
    return Autopilot(Multirotor(position=place), error, lambda n, e: 0.0, Parameters(params), waypoints, rc, 1.0, loops)


def run(pilot: Autopilot, seconds: float, each: Callable[[], None] | None = None) -> None:
    for _ in range(round(seconds / TICK_S)):
        if each:
            each()
        pilot.tick(ZERO)


def until(pilot: Autopilot, condition: Callable[[], bool], within_s: float) -> float:
    start_s = pilot.now_s
    while not condition():
        assert pilot.now_s - start_s < within_s, (pilot.mode, pilot.position, pilot.texts)
        pilot.tick(ZERO)
    return pilot.now_s - start_s


def texts(pilot: Autopilot) -> str:
    return "; ".join(text for _, text in pilot.texts)


def offboard(pilot: Autopilot, goal: Ned = UP) -> None:
    pilot.offboard_setpoint(Setpoint(position=goal, yaw_deg=0.0))
    assert pilot.set_mode(6, 0) is MavResult.ACCEPTED


# Arming, take-off, landing


def test_arms_and_disarms_by_itself_after_10_s_on_the_ground() -> None:
    pilot = autopilot(ZERO)
    assert not pilot.armed and not pilot.in_air
    assert pilot.arm(force=False) is MavResult.ACCEPTED
    assert until(pilot, lambda: not pilot.armed, 12.0) == pytest.approx(10.0, abs=0.1)
    assert "auto preflight disarming" in texts(pilot)


def test_takes_off_to_the_parameters_height_and_holds() -> None:
    pilot = autopilot(ZERO, MIS_TAKEOFF_ALT=4.0)
    assert pilot.take_off() is MavResult.ACCEPTED
    run(pilot, 2.0)
    assert not pilot.in_air and pilot.mode is FlightMode.TAKEOFF
    assert pilot.arm(force=False) is MavResult.ACCEPTED
    until(pilot, lambda: pilot.mode is FlightMode.LOITER, 8.0)
    run(pilot, 5.0)
    assert pilot.position == pytest.approx((0.0, 0.0, -4.0), abs=0.05)
    assert pilot.take_off() is MavResult.TEMPORARILY_REJECTED


def test_is_disarmed_in_the_air_only_by_force() -> None:
    pilot = autopilot()
    assert pilot.disarm(force=False) is MavResult.TEMPORARILY_REJECTED
    assert "not landed" in texts(pilot) and pilot.armed
    assert pilot.disarm(force=True) is MavResult.ACCEPTED
    run(pilot, 3.0)
    assert not pilot.in_air
    assert FORCE == 21196


def test_lands_where_it_is_and_disarms_after_2_s() -> None:
    pilot = autopilot()
    assert pilot.change_mode(FlightMode.LAND) is MavResult.ACCEPTED
    until(pilot, lambda: not pilot.in_air, 20.0)
    assert pilot.armed
    assert until(pilot, lambda: not pilot.armed, 3.0) == pytest.approx(2.0, abs=0.1)
    assert pilot.position.horizontal < 0.1
    assert pilot.mode is FlightMode.LOITER


@pytest.mark.parametrize(
    ("prepare", "reason"),
    [
        (lambda p: p.inject(4, 1), "GPS"),
        (lambda p: p.inject(100, 1), "battery"),
        (lambda p: p.set_mode(6, 0), "no offboard signal"),
        (lambda p: p.parameters.set_wire("NAV_DLL_ACT", Parameters({"NAV_DLL_ACT": 2}).wire("NAV_DLL_ACT"), INT32),
         "ground control station"),
    ],
)  # fmt: skip
def test_arming_is_refused_with_a_reason(prepare: Callable[[Autopilot], object], reason: str) -> None:
    pilot = autopilot(ZERO, SYS_FAILURE_EN=1)
    prepare(pilot)
    assert pilot.arm(force=False) is MavResult.TEMPORARILY_REJECTED
    assert "Arming denied" in texts(pilot) and reason in texts(pilot)
    assert pilot.arm(force=True) is MavResult.ACCEPTED


# Hold, mission, return


def test_hold_brakes_where_it_is_asked_for() -> None:
    pilot = autopilot()
    offboard(pilot)
    forward = Setpoint(velocity=Ned(0.5, 0.0, 0.0))
    run(pilot, 4.0, lambda: pilot.offboard_setpoint(forward))
    told = pilot.position
    assert pilot.set_mode(4, 3) is MavResult.ACCEPTED
    run(pilot, 4.0)
    assert pilot.velocity.norm < 0.02
    assert 0.1 < pilot.position.minus(told).norm < 0.4
    held = pilot.position
    # Asked for again it stays; the old setpoint means nothing any more.
    assert pilot.set_mode(4, 3) is MavResult.ACCEPTED
    run(pilot, 4.0)
    assert pilot.position.minus(held).norm < 0.05


SQUARE = (Ned(10.0, 0.0, -8.0), Ned(10.0, 10.0, -8.0), Ned(0.0, 0.0, -6.0))


def test_flies_its_mission_straight_round_and_resumes_it() -> None:
    pilot = autopilot(waypoints=SQUARE)
    assert pilot.change_mode(FlightMode.MISSION) is MavResult.ACCEPTED
    until(pilot, lambda: pilot.waypoint == 1, 10.0)
    pilot.change_mode(FlightMode.LOITER)
    run(pilot, 5.0)
    assert pilot.velocity.norm < 0.05 and pilot.waypoint == 1
    pilot.change_mode(FlightMode.MISSION)
    until(pilot, lambda: pilot.waypoint == 2, 10.0)
    until(pilot, lambda: pilot.waypoint == 0, 15.0)
    assert pilot.mode is FlightMode.MISSION


def test_a_mission_flown_once_ends_in_hold_and_keeps_its_line() -> None:
    pilot = autopilot(waypoints=(UP, Ned(0.0, 30.0, -8.0)), loops=False, MPC_XY_CRUISE=2.5, MPC_ACC_HOR=1.0)
    pilot.change_mode(FlightMode.MISSION)
    before = pilot.velocity

    def line() -> None:
        nonlocal before
        assert abs(pilot.position.north) < 0.05 and pilot.velocity.norm < 2.5 * 1.2
        assert pilot.velocity.minus(before).norm / TICK_S < 2.0
        before = pilot.velocity

    run(pilot, 25.0, line)
    assert pilot.mode is FlightMode.LOITER
    assert pilot.position.east == pytest.approx(30.0, abs=0.2)


def test_no_mission_no_mission_mode() -> None:
    pilot = autopilot()
    assert pilot.change_mode(FlightMode.MISSION) is MavResult.TEMPORARILY_REJECTED
    assert "no valid mission" in texts(pilot)
    assert pilot.set_mode(9, 9) is MavResult.DENIED


def test_returns_home_high_enough_and_lands_there() -> None:
    pilot = autopilot()
    assert pilot.reposition(Ned(30.0, 0.0, -8.0), math.nan) is MavResult.ACCEPTED
    run(pilot, 20.0)
    assert pilot.position.north == pytest.approx(30.0, abs=0.2)
    pilot.change_mode(FlightMode.RTL)
    until(pilot, lambda: pilot.position.down < -28.0, 20.0)
    assert pilot.position.north > 28.0
    until(pilot, lambda: not pilot.armed, 90.0)
    assert pilot.position.horizontal < 1.0


def test_manual_modes_need_a_pilot() -> None:
    assert autopilot().set_mode(3, 0) is MavResult.TEMPORARILY_REJECTED
    assert autopilot(rc=True).set_mode(3, 0) is MavResult.ACCEPTED


# Offboard


def test_offboard_needs_a_recent_setpoint() -> None:
    pilot = autopilot()
    assert pilot.set_mode(6, 0) is MavResult.TEMPORARILY_REJECTED
    assert "no offboard signal" in texts(pilot)
    pilot.offboard_setpoint(Setpoint(position=UP))
    run(pilot, 1.1)
    assert pilot.set_mode(6, 0) is MavResult.TEMPORARILY_REJECTED
    assert pilot.mode is FlightMode.LOITER
    offboard(pilot)
    assert pilot.mode is FlightMode.OFFBOARD


@pytest.mark.parametrize(("loss_s", "expected_s"), [(1.0, 1.0), (0.5, 0.5)])
def test_lost_setpoints_are_noticed_after_the_parameters_time(loss_s: float, expected_s: float) -> None:
    pilot = autopilot(COM_OF_LOSS_T=loss_s, COM_OBL_RC_ACT=5)
    offboard(pilot, Ned(20.0, 0.0, -8.0))
    assert until(pilot, lambda: pilot.failsafe is not None, 3.0) == pytest.approx(expected_s, abs=0.05)
    assert "offboard control lost" in texts(pilot)
    assert pilot.mode is FlightMode.LOITER
    run(pilot, 8.0)
    assert pilot.velocity.norm < 0.05 and pilot.position.north < 15.0


@pytest.mark.parametrize(
    ("act", "rc", "mode"),
    [
        (0, False, FlightMode.RTL),
        (0, True, FlightMode.POSCTL),
        (1, False, FlightMode.RTL),
        (2, True, FlightMode.MANUAL),
        (3, True, FlightMode.RTL),
        (4, False, FlightMode.LAND),
        (5, True, FlightMode.LOITER),
    ],
)
def test_what_is_done_without_setpoints(act: int, rc: bool, mode: FlightMode) -> None:
    pilot = autopilot(rc=rc, COM_OBL_RC_ACT=act)
    offboard(pilot)
    run(pilot, 1.5)
    assert pilot.mode is mode


def test_terminating_without_setpoints() -> None:
    pilot = autopilot(COM_OBL_RC_ACT=7)
    offboard(pilot)
    run(pilot, 5.0)
    assert not pilot.armed and not pilot.in_air


def test_setpoints_that_come_back_take_it_back_to_offboard_by_itself() -> None:
    """PX4's behaviour, and why a stalled client is dangerous."""
    pilot = autopilot(COM_OBL_RC_ACT=5)
    offboard(pilot)
    run(pilot, 3.0)
    assert pilot.mode is FlightMode.LOITER
    goal = Setpoint(position=Ned(2.0, 0.0, -8.0), yaw_deg=0.0)
    run(pilot, 6.0, lambda: pilot.offboard_setpoint(goal))
    assert pilot.mode is FlightMode.OFFBOARD
    assert pilot.position.north == pytest.approx(2.0, abs=0.1)


def test_after_a_failsafe_landing_it_reads_offboard_disarmed() -> None:
    pilot = autopilot(COM_OBL_RC_ACT=4)
    offboard(pilot)
    until(pilot, lambda: not pilot.armed, 30.0)
    assert pilot.mode is FlightMode.OFFBOARD


def test_a_mode_asked_for_ends_the_offboard_failsafe_for_good() -> None:
    pilot = autopilot(COM_OBL_RC_ACT=3)
    offboard(pilot)
    run(pilot, 2.0)
    assert pilot.mode is FlightMode.RTL
    assert pilot.change_mode(FlightMode.LOITER) is MavResult.ACCEPTED
    run(pilot, 3.0, lambda: pilot.offboard_setpoint(Setpoint(position=UP)))
    assert pilot.mode is FlightMode.LOITER
    offboard(pilot)
    run(pilot, 2.0)
    assert pilot.mode is FlightMode.RTL


# Loss of others


def test_the_ground_station_matters_only_if_the_parameter_says_so() -> None:
    silent = autopilot()
    run(silent, 12.0)
    assert silent.mode is FlightMode.LOITER and silent.failsafe is None
    minded = autopilot(NAV_DLL_ACT=2)
    minded.ground_station_at_s = 0.0
    run(minded, 9.9)
    assert minded.failsafe is None
    run(minded, 0.3)
    assert minded.mode is FlightMode.RTL


@pytest.mark.parametrize(("override", "taken"), [(0, False), (1, False), (2, True), (3, True)])
def test_sticks_take_over_from_offboard_if_their_override_is_on(override: int, taken: bool) -> None:
    pilot = autopilot(rc=True, SYS_FAILURE_EN=1, COM_RC_OVERRIDE=override)
    offboard(pilot)
    assert pilot.inject(*Fault.RC_WRONG.value) is MavResult.ACCEPTED
    assert (pilot.mode is FlightMode.POSCTL) is taken


def test_lost_rc_returns_unless_excepted() -> None:
    for excepted, mode in ((0, FlightMode.RTL), (2, FlightMode.LOITER)):
        pilot = autopilot(rc=True, SYS_FAILURE_EN=1, COM_RCL_EXCEPT=excepted)
        assert pilot.inject(*Fault.RC_OFF.value) is MavResult.ACCEPTED
        run(pilot, 0.1)
        assert pilot.mode is mode
    pilot = autopilot(SYS_FAILURE_EN=1)
    assert pilot.inject(*Fault.RC_OFF.value) is MavResult.DENIED


# Injected failures


def test_failures_need_permission_and_a_unit_that_can_fail() -> None:
    assert autopilot().inject(*Fault.GPS_OFF.value) is MavResult.DENIED
    pilot = autopilot(SYS_FAILURE_EN=1)
    assert pilot.inject(0, 1) is MavResult.UNSUPPORTED
    assert pilot.inject(4, 7) is MavResult.UNSUPPORTED
    assert not pilot.faults


def test_without_gps_the_accuracy_worsens_and_it_comes_down_blind() -> None:
    pilot = autopilot(SYS_FAILURE_EN=1)
    pilot.inject(*Fault.GPS_OFF.value)
    run(pilot, 2.0)
    assert pilot.sigmas_m[0] == pytest.approx(1.0, abs=0.05)
    assert pilot.mode is FlightMode.LOITER and not pilot.gps_fix
    until(pilot, lambda: pilot.mode is FlightMode.LAND, 4.0)
    assert not pilot.healthy
    assert pilot.change_mode(FlightMode.LOITER) is MavResult.TEMPORARILY_REJECTED
    until(pilot, lambda: not pilot.armed, 30.0)


def test_a_wrong_gps_jumps_and_the_drone_follows_it_away() -> None:
    pilot = autopilot(SYS_FAILURE_EN=1)
    run(pilot, 0.1)
    pilot.inject(*Fault.GPS_WRONG.value)
    assert pilot.position.north == pytest.approx(5.0, abs=0.01)
    assert pilot.sigmas_m[0] < 0.01
    run(pilot, 12.0)
    assert pilot.drone.position.north == pytest.approx(-5.0, abs=0.2)
    pilot.inject(4, 0)
    assert pilot.position.north == pytest.approx(-5.0, abs=0.2)


def test_a_stuck_gps_hides_motion() -> None:
    pilot = autopilot(SYS_FAILURE_EN=1)
    offboard(pilot)
    pilot.inject(*Fault.GPS_STUCK.value)
    frozen = pilot.position
    run(pilot, 3.0, lambda: pilot.offboard_setpoint(Setpoint(position=Ned(1.0, 0.0, -8.0))))
    assert pilot.position.minus(frozen).norm < 1e-9
    assert pilot.drone.position.north > 0.5


def test_a_lost_motor_brings_it_down() -> None:
    pilot = autopilot(SYS_FAILURE_EN=1)
    pilot.inject(*Fault.MOTOR_OFF.value)
    until(pilot, lambda: not pilot.in_air, 6.0)
    run(pilot, 0.1)
    assert not pilot.armed and "Crashed" in texts(pilot)


@pytest.mark.parametrize(("act", "mode"), [(0, FlightMode.LOITER), (2, FlightMode.LAND), (3, FlightMode.LAND)])
def test_an_empty_battery(act: int, mode: FlightMode) -> None:
    pilot = autopilot(SYS_FAILURE_EN=1, COM_LOW_BAT_ACT=act)
    pilot.inject(*Fault.BATTERY_OFF.value)
    run(pilot, 0.1)
    assert pilot.mode is mode and not pilot.healthy
    assert "Emergency battery level" in texts(pilot)


def test_a_battery_failsafe_can_be_overridden_by_the_user() -> None:
    pilot = autopilot(SYS_FAILURE_EN=1, COM_LOW_BAT_ACT=2)
    pilot.inject(*Fault.BATTERY_OFF.value)
    run(pilot, 0.1)
    assert pilot.change_mode(FlightMode.LOITER) is MavResult.ACCEPTED
    run(pilot, 1.0)
    assert pilot.mode is FlightMode.LOITER


# Parameters


def test_parameters_know_their_names_and_types() -> None:
    parameters = Parameters({"COM_OBL_RC_ACT": 5})
    assert parameters["COM_OBL_RC_ACT"] == 5.0 and parameters.bits("COM_OBL_RC_ACT") == 5
    assert parameters["COM_OF_LOSS_T"] == 1.0
    with pytest.raises(ValueError, match="no parameter NOPE"):
        Parameters({"NOPE": 1})
    with pytest.raises(ValueError, match="COM_OBL_RC_ACT is an integer"):
        Parameters({"COM_OBL_RC_ACT": 0.5})


@pytest.mark.parametrize("value", [0, 1, -1, 5, 2**31 - 1, -(2**31)])
def test_integers_travel_bytewise(value: int) -> None:
    sender, receiver = Parameters({"COM_OBL_RC_ACT": value}), Parameters({})
    assert receiver.set_wire("COM_OBL_RC_ACT", sender.wire("COM_OBL_RC_ACT"), INT32)
    assert receiver.bits("COM_OBL_RC_ACT") == value


def test_a_parameter_of_the_wrong_type_is_not_set() -> None:
    parameters = Parameters({})
    assert not parameters.set_wire("COM_OBL_RC_ACT", 5.0, REAL32)
    assert not parameters.set_wire("NOPE", 5.0, REAL32)
    assert parameters.set_wire("COM_OF_LOSS_T", 0.5, REAL32)
    assert parameters["COM_OF_LOSS_T"] == 0.5
