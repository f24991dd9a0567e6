"""What PX4 does with a multirotor, where it matters to an offboard user: modes, arming, failsafes, faults. Pure.

Positions inside are NED about the scenario's origin. The vehicle's own local frame starts at `origin`; `sim/link.py`
converts. Time comes in by `tick`, 50 times a second. Source: PX4 1.17 commander and failsafe behaviour.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, IntEnum

from m3r_app.sim.dynamics import ZERO, Multirotor, PositionError, Setpoint
from m3r_app.sim.parameters import Parameters
from safety.vocabulary import Ned

TICK_S = 0.02
SUBSTEPS = 5
GPS_JUMP_M = 5.0
"""North, on FAILURE_TYPE_WRONG of the GPS."""
DEAD_RECKONING_S = 5.0
"""This long after the GPS is gone the position counts as lost."""
MOTOR_OUT_THRUST = 0.6
GROUND_LOOKUP_M = 0.05
FORCE = 21196
"""The magic number of MAV_CMD_COMPONENT_ARM_DISARM."""


class FlightMode(Enum):
    """PX4's custom main and sub mode."""

    MANUAL = (1, 0)
    ALTCTL = (2, 0)
    POSCTL = (3, 0)
    READY = (4, 1)
    TAKEOFF = (4, 2)
    LOITER = (4, 3)
    MISSION = (4, 4)
    RTL = (4, 5)
    LAND = (4, 6)
    OFFBOARD = (6, 0)

    @property
    def custom_mode(self) -> int:
        """HEARTBEAT.custom_mode"""
        return self.value[0] << 16 | self.value[1] << 24

    @property
    def title(self) -> str:
        """What PX4 calls it when it speaks to people."""
        return {"LOITER": "Hold", "RTL": "Return", "POSCTL": "Position", "ALTCTL": "Altitude"}.get(
            self.name, self.name.capitalize()
        )


class Answer(IntEnum):
    """MAV_RESULT"""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3


class Severity(IntEnum):
    """MAV_SEVERITY"""

    EMERGENCY = 0
    CRITICAL = 2
    WARNING = 4
    INFO = 6


class Fault(Enum):
    """Failures that MAV_CMD_INJECT_FAILURE makes: (FAILURE_UNIT, FAILURE_TYPE)."""

    GPS_OFF = (4, 1)
    GPS_STUCK = (4, 2)
    GPS_WRONG = (4, 4)
    BATTERY_OFF = (100, 1)
    MOTOR_OFF = (101, 1)
    RC_OFF = (104, 1)
    RC_WRONG = (104, 4)
    """The pilot moves the sticks."""
    LINK_OFF = (105, 1)


_UNITS = {fault.value[0] for fault in Fault}


@dataclass(frozen=True, slots=True)
class Failsafe:
    """What the autopilot does by itself, and why."""

    mode: FlightMode
    reason: str
    blind: bool = False
    """Position is lost: descend level, drifting with the wind."""


class Autopilot:
    """One simulated drone with its autopilot."""

    def __init__(
        self,
        drone: Multirotor,
        error: PositionError,
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
        self.waypoints, self.waypoint, self._mission_loops = waypoints, 0, mission_loops
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
        self._hold, self._hold_yaw_deg = drone.position, drone.yaw_deg
        self._return_down_m = 0.0
        self._runner, self._runner_m_s = drone.position, 0.0
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
        return self.error.sigma_h_m + 0.5 * blind_s, self.error.sigma_v_m + 0.1 * blind_s

    @property
    def in_air(self) -> bool:
        return not self.drone.landed

    @property
    def healthy(self) -> bool:
        return self.position_valid and self.battery > self.parameters["BAT_CRIT_THR"]

    # What it is told

    def say(self, severity: Severity, text: str) -> None:
        self.texts.append((severity, text))

    def arm(self, force: bool) -> Answer:
        if self.armed:
            return Answer.ACCEPTED
        reason = self._not_armable()
        if reason and not force:
            self.say(Severity.CRITICAL, f"Arming denied: {reason}")
            return Answer.TEMPORARILY_REJECTED
        self.armed = self.drone.motors_on = True
        self.home = Ned(self.position.north, self.position.east, self._ground_here())
        self._armed_at_s, self._flew = self.now_s, False
        self.say(Severity.INFO, "Armed by external command")
        return Answer.ACCEPTED

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

    def disarm(self, force: bool) -> Answer:
        if self.armed and self.in_air and not force:
            self.say(Severity.CRITICAL, "Disarming denied: not landed")
            return Answer.TEMPORARILY_REJECTED
        if self.armed:
            self._disarm("Disarmed by external command")
        return Answer.ACCEPTED

    def _disarm(self, text: str) -> None:
        self.armed = self.drone.motors_on = False
        self.failsafe = None
        self._overridden.clear()
        if self.intended in (FlightMode.LAND, FlightMode.RTL, FlightMode.TAKEOFF):
            self.intended = FlightMode.LOITER
        self.say(Severity.INFO, text)

    def set_mode(self, main: int, sub: int) -> Answer:
        """DO_SET_MODE with PX4's custom modes; while disarmed any mode may be chosen."""
        try:
            mode = FlightMode((main, sub if main == 4 else 0))
        except ValueError:
            return Answer.DENIED
        return self.change_mode(mode)

    def change_mode(self, mode: FlightMode) -> Answer:
        if mode is FlightMode.MISSION and not self.waypoints:
            self.say(Severity.CRITICAL, "Switching to Mission is currently not available: no valid mission")
            return Answer.TEMPORARILY_REJECTED
        if self.armed:
            reason = self._not_available(mode)
            if reason:
                self.say(Severity.CRITICAL, f"Switching to {mode.title} is not available: {reason}")
                return Answer.TEMPORARILY_REJECTED
        if self.failsafe:
            self._overridden.add(self.failsafe.reason)
        self.intended = mode
        self.failsafe = None
        # Asked for again, a mode starts again: Hold brakes where the drone is now.
        self._entered = None
        return Answer.ACCEPTED

    def _not_available(self, mode: FlightMode) -> str | None:
        if mode is FlightMode.OFFBOARD and self._offboard_lost:
            return "no offboard signal"
        if mode in (FlightMode.MANUAL, FlightMode.ALTCTL, FlightMode.POSCTL) and not self.rc_alive:
            return "no manual control input"
        if mode not in (FlightMode.MANUAL, FlightMode.ALTCTL, FlightMode.LAND) and not self.position_valid:
            return "no valid position estimate"
        return None

    def take_off(self) -> Answer:
        """NAV_TAKEOFF: accepted while disarmed, as PX4 does; it climbs once armed."""
        if self.armed and self.in_air:
            self.say(Severity.WARNING, "Already in the air")
            return Answer.TEMPORARILY_REJECTED
        return self.change_mode(FlightMode.TAKEOFF)

    def reposition(self, place: Ned, yaw_deg: float) -> Answer:
        """DO_REPOSITION: Hold at another place; NaN keeps a coordinate."""
        if not self.in_air:
            return Answer.DENIED
        answer = self.change_mode(FlightMode.LOITER)
        if answer is Answer.ACCEPTED:
            self._enter(FlightMode.LOITER)
            self._hold = Ned(*(new if math.isfinite(new) else old for new, old in zip(place, self._hold, strict=True)))
            if math.isfinite(yaw_deg):
                self._hold_yaw_deg = yaw_deg
        return answer

    def offboard_setpoint(self, setpoint: Setpoint) -> None:
        """A setpoint arrived, in the scenario's frame."""
        self._target, self._target_at_s = setpoint, self.now_s

    def inject(self, unit: int, kind: int) -> Answer:
        """INJECT_FAILURE: FAILURE_UNIT, FAILURE_TYPE; type OK mends the unit."""
        if not self.parameters.bits("SYS_FAILURE_EN"):
            self.say(Severity.WARNING, "Failure injection is disabled: SYS_FAILURE_EN is 0")
            return Answer.DENIED
        if unit not in _UNITS:
            return Answer.UNSUPPORTED
        if kind == 0:
            self._mend(unit)
            return Answer.ACCEPTED
        try:
            fault = Fault((unit, kind))
        except ValueError:
            return Answer.UNSUPPORTED
        if unit == Fault.RC_OFF.value[0] and not self.rc:
            self.say(Severity.WARNING, "There is no remote control to fail")
            return Answer.DENIED
        self._break(fault)
        return Answer.ACCEPTED

    def _break(self, fault: Fault) -> None:
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

    def _mend(self, unit: int) -> None:
        self.faults = {fault for fault in self.faults if fault.value[0] != unit}
        if unit == Fault.GPS_OFF.value[0]:
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
        self.error.step(TICK_S)
        if not self.gps_fix:
            # Dead reckoning drifts with what the filter takes for standing still.
            self._bias = self._bias.plus(Ned(0.1 * TICK_S, 0.1 * TICK_S, 0.0))
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
        """What a mode remembers from where it begins: a place to stop at, a height to return at."""
        here, velocity = self.position, self.velocity
        # Half a second of the present speed is what a smooth stop takes in distance.
        self._hold = here.plus(Ned(*(0.5 * v for v in velocity)))
        self._hold_yaw_deg = self.drone.yaw_deg
        self._entered = mode
        if mode is FlightMode.RTL:
            away = self.home.minus(here).horizontal
            self._return_down_m = min(here.down, self.home.down - min(self.parameters["RTL_RETURN_ALT"], away))
        elif mode is FlightMode.MISSION:
            self._runner, self._runner_m_s = self._hold, 0.0
        elif mode is FlightMode.TAKEOFF:
            up = self.parameters["MIS_TAKEOFF_ALT"]
            self._hold = Ned(here.north, here.east, self._ground_here() + self.position_error.down - up)

    def _setpoint(self) -> Setpoint:
        if not self.armed:
            return Setpoint()
        if self.failsafe and self.failsafe.blind:
            return Setpoint(velocity=Ned(math.nan, math.nan, self.parameters["MPC_LAND_SPEED"]))
        match self.mode:
            case FlightMode.OFFBOARD if self._target is not None:
                return self._target
            case FlightMode.MISSION:
                return self._fly_mission()
            case FlightMode.RTL:
                return self._fly_home()
            case FlightMode.LAND:
                return self._descend(self._hold)
            case FlightMode.TAKEOFF:
                if self.in_air and abs(self.position.down - self._hold.down) < 0.3:
                    self.intended, self._entered = FlightMode.LOITER, FlightMode.LOITER
                return self._go(self._hold, self._hold_yaw_deg, up_max_m_s=self.parameters["MPC_TKO_SPEED"])
        if not self.in_air:
            return self._descend(self.position)
        return self._go(self._hold, self._hold_yaw_deg)

    def _go(self, place: Ned, yaw_deg: float, up_max_m_s: float = math.inf) -> Setpoint:
        cruise = self.parameters["MPC_XY_CRUISE"]
        return Setpoint(position=place, yaw_deg=yaw_deg, speed_max_m_s=cruise, up_max_m_s=up_max_m_s)

    def _descend(self, place: Ned) -> Setpoint:
        return Setpoint(
            position=Ned(place.north, place.east, math.nan),
            velocity=Ned(0.0, 0.0, self.parameters["MPC_LAND_SPEED"]),
            yaw_deg=self._hold_yaw_deg,
        )

    def _fly_home(self) -> Setpoint:
        here, home = self.position, self.home
        if home.minus(here).horizontal < 2.0:
            return self._descend(home)
        if here.down > self._return_down_m + 1.0:
            return self._go(Ned(self._hold.north, self._hold.east, self._return_down_m), self._hold_yaw_deg)
        return self._go(Ned(home.north, home.east, self._return_down_m), self._hold_yaw_deg)

    def _fly_mission(self) -> Setpoint:
        """Follow a point that runs straight from waypoint to waypoint with bounded acceleration, and rests at each."""
        goal = self.waypoints[self.waypoint]
        if self._runner == goal and goal.minus(self.position).norm < self.parameters["NAV_ACC_RAD"]:
            if self.waypoint == len(self.waypoints) - 1 and not self._mission_loops:
                self.intended, self._entered, self._hold = FlightMode.LOITER, FlightMode.LOITER, goal
                return self._go(goal, self._hold_yaw_deg)
            self.waypoint = (self.waypoint + 1) % len(self.waypoints)
            goal = self.waypoints[self.waypoint]
        away = goal.minus(self._runner)
        left_m = away.norm
        acceleration = self.parameters["MPC_ACC_HOR"]
        self._runner_m_s = min(
            self._runner_m_s + acceleration * TICK_S,
            self.parameters["MPC_XY_CRUISE"],
            math.sqrt(2.0 * acceleration * left_m),
        )
        run_m = self._runner_m_s * TICK_S
        if run_m >= left_m - 1e-3:
            self._runner, self._runner_m_s = goal, 0.0
            return Setpoint(position=goal, yaw_deg=self._hold_yaw_deg)
        if away.horizontal > 1.5:
            self._hold_yaw_deg = math.degrees(math.atan2(away.east, away.north))
        self._runner = self._runner.plus(Ned(*(run_m / left_m * x for x in away)))
        velocity = Ned(*(self._runner_m_s / left_m * x for x in away))
        return Setpoint(position=self._runner, velocity=velocity, yaw_deg=self._hold_yaw_deg)


def _loss_action(act: int, reason: str) -> Failsafe | None:
    """NAV_RCL_ACT and NAV_DLL_ACT"""
    mode = {1: FlightMode.LOITER, 2: FlightMode.RTL, 3: FlightMode.LAND}.get(act)
    return Failsafe(mode, reason) if mode else None
