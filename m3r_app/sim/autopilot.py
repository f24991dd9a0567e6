"""What PX4 does with a multirotor, where it matters to an offboard user: modes, arming, failsafes, faults. Pure.

Positions inside are NED about the scenario's origin. The vehicle's own local frame starts at `origin`; `sim/link.py`
converts. Time comes in by `tick`, 50 times a second. Source: PX4 1.17 commander and failsafe behaviour.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from m3r_app.sim.dynamics import ZERO, EstimateError, Multirotor, Setpoint
from m3r_app.sim.guidance import TICK_S, Guidance
from m3r_app.sim.modes import FAULT_UNITS, Failsafe, Fault, FlightMode, MavResult, Severity
from m3r_app.sim.parameters import Parameters
from safety.vocabulary import Ned

SUBSTEPS = 5
GPS_JUMP_M = 5.0
"""North, on FAILURE_TYPE_WRONG of the GPS."""
DEAD_RECKONING_S = 5.0
"""This long after the GPS is gone the position counts as lost."""
UNKNOWN_AFTER_BOOT_S = 1.0
"""A rebooted autopilot tells no mode so long."""
MOTOR_OUT_THRUST = 0.6
GROUND_LOOKUP_M = 0.05
FORCE = 21196
"""The magic number of MAV_CMD_COMPONENT_ARM_DISARM."""


class Autopilot:
    """One simulated drone with its autopilot."""

    def __init__(
        self,
        drone: Multirotor,
        error: EstimateError,
        ground_down_m: Callable[[float, float], float],
        parameters: Parameters,
        waypoints: tuple[Ned, ...] = (),
        rc: bool = False,
        battery: float = 1.0,
        mission_loops: bool = True,
    ) -> None:
        """ground_down_m: down coordinate of the ground under (north, east). The drone's position decides if it flies.

        mission_loops False: after the last waypoint it holds there.
        """
        self.drone, self.error, self.parameters = drone, error, parameters
        self._ground_down_m = ground_down_m
        self._guidance = Guidance(parameters, drone.position, drone.yaw_deg, waypoints, mission_loops)
        self.rc, self.battery = rc, battery
        below = ground_down_m(drone.position.north, drone.position.east)
        self.origin = Ned(drone.position.north, drone.position.east, below)
        """Where its own local frame starts."""
        self.home = self._below = self.origin
        self.armed = drone.position.down < below - 0.1
        drone.motors_on, drone.landed = self.armed, not self.armed
        self.now_s = 0.0
        self.intended = FlightMode.LOITER
        self.failsafe: Failsafe | None = None
        self.texts: list[tuple[Severity, str]] = []
        """STATUSTEXT to send; the link empties it."""
        self.resets = 0
        """How often the estimate has jumped, as ODOMETRY counts it."""
        self.boots, self.booted_at_s, self._booting = 0, 0.0, False
        self.stick_pilot = False
        """Another ground station has a stick at hand: the manual modes may be flown."""
        self.faults: set[Fault] = set()
        self.link_silent = False
        self.ground_station_at_s = -math.inf
        self._overridden: set[str] = set()
        self._target: Setpoint | None = None
        self._target_at_s = -math.inf
        self._flew = self.armed
        self._armed_at_s = self._landed_at_s = 0.0
        self._gps_lost_at_s = math.inf
        self._frozen = self._bias = ZERO
        self._entered: FlightMode | None = None
        self._battery_warned = 0

    # What it believes

    @property
    def mode(self) -> FlightMode:
        """The mode it flies: what was asked for, or the failsafe's."""
        return self.failsafe.mode if self.failsafe else self.intended

    @property
    def position_error(self) -> Ned:
        """Estimate minus truth."""
        if Fault.GPS_STUCK in self.faults:
            return self._frozen.minus(self.drone.position)
        return self.error.position.plus(self._bias)

    @property
    def position(self) -> Ned:
        """The estimate."""
        return self.drone.position.plus(self.position_error)

    @property
    def velocity(self) -> Ned:
        """The estimate."""
        return self.drone.velocity.plus(self.error.velocity)

    @property
    def gps_fix(self) -> bool:
        return Fault.GPS_OFF not in self.faults

    @property
    def position_valid(self) -> bool:
        return self.now_s - self._gps_lost_at_s < DEAD_RECKONING_S

    @property
    def sigmas_m(self) -> tuple[float, float]:
        """Horizontal and vertical accuracy as the estimator states them."""
        blind_s = max(0.0, self.now_s - self._gps_lost_at_s)
        return self.error.sigmas_m(blind_s)

    @property
    def height_m(self) -> float:
        """Above the ground below it, in truth."""
        return self._ground_here() - self.drone.position.down

    @property
    def goal(self) -> Ned | None:
        """The place that the last setpoint asked for, in the scenario's frame."""
        return self._target.position if self._target else None

    @property
    def waypoint(self) -> int:
        """Where its mission goes next."""
        return self._guidance.waypoint

    @property
    def running(self) -> bool:
        """It has booted: until then it says and hears nothing."""
        return self.now_s >= self.booted_at_s

    @property
    def mode_known(self) -> bool:
        return not self.boots or self.now_s >= self.booted_at_s + UNKNOWN_AFTER_BOOT_S

    @property
    def in_air(self) -> bool:
        return not self.drone.landed

    @property
    def healthy(self) -> bool:
        return self.position_valid and self.battery > self.parameters["BAT_CRIT_THR"]

    # What it is told

    def say(self, severity: Severity, text: str) -> None:
        self.texts.append((severity, text))

    def arm(self, force: bool) -> MavResult:
        if self.armed:
            return MavResult.ACCEPTED
        reason = self._not_armable()
        if reason and not force:
            self.say(Severity.CRITICAL, f"Arming denied: {reason}")
            return MavResult.TEMPORARILY_REJECTED
        self.armed = self.drone.motors_on = True
        self.home = Ned(self.position.north, self.position.east, self._ground_here())
        self._armed_at_s, self._flew = self.now_s, False
        self.say(Severity.INFO, "Armed by external command")
        return MavResult.ACCEPTED

    def _not_armable(self) -> str | None:
        if not self.gps_fix:
            return "GPS fix required"
        if not self.healthy:
            return "low battery"
        if self.intended is FlightMode.OFFBOARD and self._offboard_lost:
            return "no offboard signal"
        if self.parameters.bits("NAV_DLL_ACT") and self._ground_station_lost:
            return "no connection to the ground control station"
        return None

    def disarm(self, force: bool) -> MavResult:
        if self.armed and self.in_air and not force:
            self.say(Severity.CRITICAL, "Disarming denied: not landed")
            return MavResult.TEMPORARILY_REJECTED
        if self.armed:
            self._disarm("Disarmed by external command")
        return MavResult.ACCEPTED

    def _disarm(self, text: str) -> None:
        self.armed = self.drone.motors_on = False
        self.failsafe = None
        self._overridden.clear()
        if self.intended in (FlightMode.LAND, FlightMode.RTL, FlightMode.TAKEOFF):
            self.intended = FlightMode.LOITER
        self.say(Severity.INFO, text)

    def set_mode(self, main: int, sub: int) -> MavResult:
        """DO_SET_MODE with PX4's custom modes; while disarmed any mode may be chosen."""
        try:
            mode = FlightMode((main, sub if main == 4 else 0))
        except ValueError:
            return MavResult.DENIED
        return self.change_mode(mode)

    def change_mode(self, mode: FlightMode) -> MavResult:
        if mode is FlightMode.MISSION and not self._guidance.waypoints:
            self.say(Severity.CRITICAL, "Switching to Mission is currently not available: no valid mission")
            return MavResult.TEMPORARILY_REJECTED
        if self.armed:
            reason = self._not_available(mode)
            if reason:
                self.say(Severity.CRITICAL, f"Switching to {mode.title} is not available: {reason}")
                return MavResult.TEMPORARILY_REJECTED
        if self.failsafe:
            self._overridden.add(self.failsafe.reason)
        self.intended = mode
        self.failsafe = None
        # Asked for again, a mode starts again: Hold brakes where the drone is now.
        self._entered = None
        return MavResult.ACCEPTED

    def _not_available(self, mode: FlightMode) -> str | None:
        if mode is FlightMode.OFFBOARD and self._offboard_lost:
            return "no offboard signal"
        if mode in (FlightMode.MANUAL, FlightMode.ALTCTL, FlightMode.POSCTL) and not (
            self.rc_alive or self.stick_pilot
        ):
            return "no manual control input"
        if mode not in (FlightMode.MANUAL, FlightMode.ALTCTL, FlightMode.LAND) and not self.position_valid:
            return "no valid position estimate"
        return None

    def take_off(self) -> MavResult:
        """NAV_TAKEOFF: accepted while disarmed, as PX4 does; it climbs once armed."""
        if self.armed and self.in_air:
            self.say(Severity.WARNING, "Already in the air")
            return MavResult.TEMPORARILY_REJECTED
        return self.change_mode(FlightMode.TAKEOFF)

    def reposition(self, place: Ned, yaw_deg: float) -> MavResult:
        """DO_REPOSITION: Hold at another place; NaN keeps a coordinate."""
        if not self.in_air:
            return MavResult.DENIED
        answer = self.change_mode(FlightMode.LOITER)
        if answer is MavResult.ACCEPTED:
            self._enter(FlightMode.LOITER)
            self._guidance.hold_at(place, yaw_deg)
        return answer

    def offboard_setpoint(self, setpoint: Setpoint) -> None:
        """A setpoint arrived, in the scenario's frame."""
        self._target, self._target_at_s = setpoint, self.now_s

    def jump(self, by: Ned) -> None:
        """The estimator resets its position. Its own modes fly on from there; an Offboard setpoint knows nothing of it."""
        self._bias = self._bias.plus(by)
        self._guidance.shift(by)
        self.resets += 1

    def disarm_in_the_air(self, text: str) -> None:
        """By somebody else, whatever it flies: it falls."""
        if self.armed:
            self._disarm(text)

    def restart(self, for_s: float) -> None:
        """The flight controller reboots: the motors stop at once, and it is heard again for_s later, from time 0."""
        self.armed = self.drone.motors_on = False
        self.failsafe, self._target, self.intended = None, None, FlightMode.LOITER
        self._target_at_s = self.ground_station_at_s = -math.inf
        self._overridden.clear()
        self.texts.clear()
        self.boots, self.booted_at_s, self._booting = self.boots + 1, self.now_s + for_s, True

    def _boot(self) -> None:
        """A new local frame and home, where it happens to be."""
        self._booting = False
        self.origin = self.home = self.position
        self.resets = 0

    def inject(self, unit: int, kind: int) -> MavResult:
        """INJECT_FAILURE: FAILURE_UNIT, FAILURE_TYPE; type OK mends the unit."""
        if not self.parameters.bits("SYS_FAILURE_EN"):
            self.say(Severity.WARNING, "Failure injection is disabled: SYS_FAILURE_EN is 0")
            return MavResult.DENIED
        if unit not in FAULT_UNITS:
            return MavResult.UNSUPPORTED
        if kind == 0:
            self.mend(unit)
            return MavResult.ACCEPTED
        try:
            fault = Fault((unit, kind))
        except ValueError:
            return MavResult.UNSUPPORTED
        if unit == Fault.RC_OFF.value[0] and not self.rc:
            self.say(Severity.WARNING, "There is no remote control to fail")
            return MavResult.DENIED
        self.break_(fault)
        return MavResult.ACCEPTED

    def break_(self, fault: Fault) -> None:
        """It fails, permitted or not."""
        match fault:
            case Fault.GPS_OFF:
                self._gps_lost_at_s = min(self._gps_lost_at_s, self.now_s)
            case Fault.GPS_STUCK:
                self._frozen = self.position
            case Fault.GPS_WRONG:
                self._bias = Ned(GPS_JUMP_M, 0.0, 0.0)
            case Fault.BATTERY_OFF:
                self.battery = 0.03
            case Fault.MOTOR_OFF:
                self.drone.thrust_fraction = MOTOR_OUT_THRUST
            case Fault.RC_WRONG:
                self._sticks_moved()
                return
            case Fault.LINK_OFF:
                self.link_silent = True
        self.faults.add(fault)

    def mend(self, unit: int) -> None:
        """Whatever has failed of this FAILURE_UNIT works again."""
        self.faults = {fault for fault in self.faults if fault.value[0] != unit}
        if unit == Fault.GPS_OFF.value[0]:
            self.resets += self._bias != ZERO
            self._gps_lost_at_s, self._bias = math.inf, ZERO
        elif unit == Fault.MOTOR_OFF.value[0]:
            self.drone.thrust_fraction = 1.0
        elif unit == Fault.BATTERY_OFF.value[0]:
            self.battery = 1.0
        elif unit == Fault.LINK_OFF.value[0]:
            self.link_silent = False

    def _sticks_moved(self) -> None:
        bit = 2 if self.mode is FlightMode.OFFBOARD else 1
        if self.armed and self.mode is not FlightMode.POSCTL and self.parameters.bits("COM_RC_OVERRIDE") & bit:
            self.say(Severity.INFO, "Pilot took over using sticks")
            self.change_mode(FlightMode.POSCTL)

    # What it does by itself

    @property
    def _offboard_lost(self) -> bool:
        return self.now_s - self._target_at_s > self.parameters["COM_OF_LOSS_T"]

    @property
    def _ground_station_lost(self) -> bool:
        return self.now_s - self.ground_station_at_s > self.parameters["COM_DL_LOSS_T"]

    @property
    def rc_alive(self) -> bool:
        return self.rc and Fault.RC_OFF not in self.faults

    def _wanted_failsafe(self) -> Failsafe | None:
        """The gravest failsafe that applies and that the user has not overridden by a mode of their choice."""
        parameters = self.parameters
        if not self.position_valid:
            return Failsafe(FlightMode.LAND, "position lost", blind=True)
        found: list[Failsafe | None] = []
        act = parameters.bits("COM_LOW_BAT_ACT")
        if self.battery <= parameters["BAT_EMERGEN_THR"] and act in (2, 3):
            found.append(Failsafe(FlightMode.LAND, "battery level at emergency"))
        elif self.battery <= parameters["BAT_CRIT_THR"] and act in (2, 3):
            found.append(Failsafe(FlightMode.LAND if act == 2 else FlightMode.RTL, "battery level critical"))
        if Fault.RC_OFF in self.faults and not self._rc_loss_excepted:
            found.append(_loss_action(parameters.bits("NAV_RCL_ACT"), "manual control lost"))
        if parameters.bits("NAV_DLL_ACT") and self._ground_station_lost:
            found.append(_loss_action(parameters.bits("NAV_DLL_ACT"), "ground control station lost"))
        if self.intended is FlightMode.OFFBOARD and self._offboard_lost:
            found.append(self._offboard_action())
        active = [failsafe for failsafe in found if failsafe is not None]
        # An override holds for as long as what it overrides.
        self._overridden &= {failsafe.reason for failsafe in active}
        return next((failsafe for failsafe in active if failsafe.reason not in self._overridden), None)

    @property
    def _rc_loss_excepted(self) -> bool:
        bit = {FlightMode.MISSION: 1, FlightMode.LOITER: 2, FlightMode.OFFBOARD: 4}.get(self.intended, 0)
        return bool(self.parameters.bits("COM_RCL_EXCEPT") & bit)

    def _offboard_action(self) -> Failsafe:
        """COM_OBL_RC_ACT; the manual modes need a pilot, and fall to Return without one."""
        act = self.parameters.bits("COM_OBL_RC_ACT")
        mode = {3: FlightMode.RTL, 4: FlightMode.LAND, 5: FlightMode.LOITER}.get(act)
        if mode is None:
            manual = {1: FlightMode.ALTCTL, 2: FlightMode.MANUAL}.get(act, FlightMode.POSCTL)
            # No pilot flies this simulated drone by hand: in any manual mode it stays where the sticks were let go.
            mode = manual if self.rc_alive else FlightMode.RTL
        return Failsafe(mode, "offboard control lost")

    def _update_failsafe(self) -> None:
        if not self.armed:
            return
        wanted = self._wanted_failsafe()
        if wanted == self.failsafe:
            return
        if wanted:
            if wanted.reason == "offboard control lost" and self.parameters.bits("COM_OBL_RC_ACT") in (6, 7):
                self._disarm("Failsafe activated: offboard control lost, motors off")
                return
            self.say(Severity.CRITICAL, f"Failsafe activated: {wanted.reason}, entering {wanted.mode.title}")
        else:
            self.say(Severity.INFO, "Failsafe cleared")
        self.failsafe = wanted

    def tick(self, wind: Ned) -> None:
        """TICK_S more, in this wind (NED, m/s)."""
        self.now_s += TICK_S
        self.error.aided = self.gps_fix
        self.error.step(TICK_S)
        if self._booting and self.running:
            self._boot()
        self._update_failsafe()
        if self.mode is not self._entered:
            self._enter(self.mode)
        setpoint = self._setpoint()
        drone, error = self.drone, self.position_error
        ground = self._ground_here()
        for _ in range(SUBSTEPS):
            drone.step(TICK_S / SUBSTEPS, setpoint, wind, error, self.error.velocity, ground)
        self._landing()
        self._drain()

    def _ground_here(self) -> float:
        """The ground below, looked up anew every few centimetres."""
        north, east, _ = self.drone.position
        if abs(north - self._below[0]) + abs(east - self._below[1]) > GROUND_LOOKUP_M:
            self._below = Ned(north, east, self._ground_down_m(north, east))
        return self._below.down

    def _landing(self) -> None:
        if self.in_air:
            self._flew, self._landed_at_s = True, self.now_s
        elif self.armed:
            if self.drone.thrust_fraction < 1.0:
                self._disarm("Crashed: motors off")
            elif self._flew and self.now_s - self._landed_at_s > self.parameters["COM_DISARM_LAND"]:
                self._disarm("Disarmed by landing")
            elif not self._flew and self.now_s - self._armed_at_s > self.parameters["COM_DISARM_PRFLT"]:
                self._disarm("Disarmed by auto preflight disarming")

    def _drain(self) -> None:
        if self.armed:
            self.battery = max(0.0, self.battery - TICK_S / 1800.0)
        levels = ("BAT_LOW_THR", "BAT_CRIT_THR", "BAT_EMERGEN_THR")
        level = sum(self.battery <= self.parameters[name] for name in levels)
        if level > self._battery_warned:
            self.say(
                Severity.WARNING, ("", "Low battery level", "Critical battery level", "Emergency battery level")[level]
            )
        self._battery_warned = level

    # Where it flies

    def _enter(self, mode: FlightMode) -> None:
        ground_down_m = self._ground_here() + self.position_error.down
        self._guidance.enter(mode, self.position, self.velocity, self.drone.yaw_deg, self.home, ground_down_m)
        self._entered = mode

    def _setpoint(self) -> Setpoint:
        if not self.armed:
            return Setpoint()
        if self.failsafe and self.failsafe.blind:
            return Setpoint(velocity=Ned(math.nan, math.nan, self.parameters["MPC_LAND_SPEED"]))
        if self.mode is FlightMode.OFFBOARD and self._target is not None:
            return self._target
        setpoint, done = self._guidance.fly(self.mode, self.position, self.home, self.in_air)
        if done:
            self.intended = self._entered = FlightMode.LOITER
        return setpoint


def _loss_action(act: int, reason: str) -> Failsafe | None:
    """NAV_RCL_ACT and NAV_DLL_ACT"""
    mode = {1: FlightMode.LOITER, 2: FlightMode.RTL, 3: FlightMode.LAND}.get(act)
    return Failsafe(mode, reason) if mode else None
