"""Where PX4's own modes fly to: Hold, Mission, Return, Land, Takeoff as setpoints for the position cascade. Pure.

Positions are those of the estimate, NED about the scenario's origin. Source: PX4 1.17 navigator and flight tasks.
"""

from __future__ import annotations

import math

from m3r_app.sim.dynamics import Setpoint
from m3r_app.sim.modes import FlightMode
from m3r_app.sim.parameters import Parameters
from safety.vocabulary import Ned

TICK_S = 0.02
"""How often it is asked for the next setpoint."""


class Guidance:
    """What the modes of one drone remember."""

    def __init__(
        self, parameters: Parameters, here: Ned, yaw_deg: float, waypoints: tuple[Ned, ...], mission_loops: bool
    ) -> None:
        self._parameters = parameters
        self.waypoints, self.waypoint, self._mission_loops = waypoints, 0, mission_loops
        self._hold, self._yaw_deg = here, yaw_deg
        self._return_down_m = 0.0
        self._runner, self._runner_m_s = here, 0.0

    def enter(
        self, mode: FlightMode, here: Ned, velocity: Ned, yaw_deg: float, home: Ned, ground_down_m: float
    ) -> None:
        """What a mode remembers from where it begins: a place to stop at, a height to return at."""
        # Half a second of the present speed is what a smooth stop takes in distance.
        self._hold = here.plus(Ned(*(0.5 * v for v in velocity)))
        self._yaw_deg = yaw_deg
        if mode is FlightMode.RTL:
            away = home.minus(here).horizontal
            self._return_down_m = min(here.down, home.down - min(self._parameters["RTL_RETURN_ALT"], away))
        elif mode is FlightMode.MISSION:
            self._runner, self._runner_m_s = self._hold, 0.0
        elif mode is FlightMode.TAKEOFF:
            self._hold = Ned(here.north, here.east, ground_down_m - self._parameters["MIS_TAKEOFF_ALT"])

    def hold_at(self, place: Ned, yaw_deg: float) -> None:
        """Hold at another place; what is not finite stays."""
        self._hold = Ned(*(new if math.isfinite(new) else old for new, old in zip(place, self._hold, strict=True)))
        if math.isfinite(yaw_deg):
            self._yaw_deg = yaw_deg

    def shift(self, by: Ned) -> None:
        """The estimate has jumped: what is remembered jumps with it."""
        self._hold, self._runner = self._hold.plus(by), self._runner.plus(by)

    def fly(self, mode: FlightMode, here: Ned, home: Ned, in_air: bool) -> tuple[Setpoint, bool]:
        """The setpoint, and whether the mode has done what it was for: Hold follows."""
        match mode:
            case FlightMode.MISSION:
                return self._fly_mission(here)
            case FlightMode.RTL:
                return self._fly_home(here, home), False
            case FlightMode.LAND:
                return self._descend(self._hold), False
            case FlightMode.TAKEOFF:
                climb = self._go(self._hold, up_max_m_s=self._parameters["MPC_TKO_SPEED"])
                return climb, in_air and abs(here.down - self._hold.down) < 0.3
        return self._go(self._hold) if in_air else self._descend(here), False

    def _go(self, place: Ned, up_max_m_s: float = math.inf) -> Setpoint:
        cruise = self._parameters["MPC_XY_CRUISE"]
        return Setpoint(position=place, yaw_deg=self._yaw_deg, speed_max_m_s=cruise, up_max_m_s=up_max_m_s)

    def _descend(self, place: Ned) -> Setpoint:
        return Setpoint(
            position=Ned(place.north, place.east, math.nan),
            velocity=Ned(0.0, 0.0, self._parameters["MPC_LAND_SPEED"]),
            yaw_deg=self._yaw_deg,
        )

    def _fly_home(self, here: Ned, home: Ned) -> Setpoint:
        if home.minus(here).horizontal < 2.0:
            return self._descend(home)
        if here.down > self._return_down_m + 1.0:
            return self._go(Ned(self._hold.north, self._hold.east, self._return_down_m))
        return self._go(Ned(home.north, home.east, self._return_down_m))

    def _fly_mission(self, here: Ned) -> tuple[Setpoint, bool]:
        """Follow a point that runs straight from waypoint to waypoint with bounded acceleration, and rests at each."""
        goal = self.waypoints[self.waypoint]
        if self._runner == goal and goal.minus(here).norm < self._parameters["NAV_ACC_RAD"]:
            if self.waypoint == len(self.waypoints) - 1 and not self._mission_loops:
                self._hold = goal
                return self._go(goal), True
            self.waypoint = (self.waypoint + 1) % len(self.waypoints)
            goal = self.waypoints[self.waypoint]
        away = goal.minus(self._runner)
        left_m = away.norm
        acceleration = self._parameters["MPC_ACC_HOR"]
        self._runner_m_s = min(
            self._runner_m_s + acceleration * TICK_S,
            self._parameters["MPC_XY_CRUISE"],
            math.sqrt(2.0 * acceleration * left_m),
        )
        run_m = self._runner_m_s * TICK_S
        if run_m >= left_m - 1e-3:
            self._runner, self._runner_m_s = goal, 0.0
            return Setpoint(position=goal, yaw_deg=self._yaw_deg), False
        if away.horizontal > 1.5:
            self._yaw_deg = math.degrees(math.atan2(away.east, away.north))
        self._runner = self._runner.plus(Ned(*(run_m / left_m * x for x in away)))
        velocity = Ned(*(self._runner_m_s / left_m * x for x in away))
        return Setpoint(position=self._runner, velocity=velocity, yaw_deg=self._yaw_deg), False
