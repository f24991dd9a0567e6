"""Seeded random flights of the pure core with simulated dynamics, judged on the true state.

A flight is a world (hills, walls, a fence with a hole), an operator, one drone in wind with a noisy position, traffic that
crosses, and a random sequence of requests. The arbiter, the motion controller and the multirotor run in virtual time.

Declared bounds, inside which no hard constraint may ever be violated: wind up to 4 m/s with gusts of 0.6 m/s sigma; position
errors within twice the stated sigmas; traffic flies straight, tells where it is ten times a second within twice its stated
sigma, and appears clear of where the drone is and of the volume it has reserved, to be gone before the horizon.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Coroutine
from dataclasses import dataclass, field
from random import Random
from typing import Any

import numpy as np
import shapely

from m3r_app.arbiter.announcements import Announce
from m3r_app.arbiter.effects import FaceOperator, Fly, Hold, Pair, Report, Reserve
from m3r_app.arbiter.events import (
    Event,
    NeighboursHeard,
    PairingAnswered,
    Requested,
    ReservationAnswered,
    TelemetryArrived,
    Tick,
)
from m3r_app.arbiter.signals import SignalReader
from m3r_app.arbiter.state import ArbiterState, Policy
from m3r_app.arbiter.step import step
from m3r_app.sim.dynamics import Multirotor, PositionError, Setpoint, Wind
from m3r_app.vehicle.motion_controller import MotionController
from safety.constraints import RULES, Rule
from safety.frames import bearing_deg
from safety.geofence import Geofence
from safety.limits import Limits
from safety.obstacles import Obstacles
from safety.properties import Watch
from safety.situation import World
from safety.terrain import Terrain
from safety.vocabulary import (
    Command,
    FlightMode,
    ManeuverRequest,
    Modality,
    Ned,
    Neighbours,
    Operator,
    ReservedVolume,
    VehicleState,
)
from safety.volumes import segment_distance_m

DT_S = 0.02
MOVES = (
    Command.GO_LEFT, Command.GO_RIGHT, Command.GO_FORWARD, Command.GO_BACK, Command.GO_UP, Command.GO_DOWN,
)  # fmt: skip
ORIGIN_AMSL_M = 500.0


@dataclass
class Aircraft:
    """One crossing neighbour: straight, from `born_s` until `gone_s`."""

    name: str
    start: Ned
    velocity: Ned
    born_s: float
    gone_s: float
    error: Ned = Ned(0.0, 0.0, 0.0)
    swerve_at_s: float = math.inf
    """Outside the declared bounds: from then on it flies straight at the drone."""
    turned: tuple[Ned, Ned] | None = None

    def at(self, now_s: float) -> Ned:
        """Its true position."""
        if self.turned is not None and now_s >= self.swerve_at_s:
            start, velocity = self.turned
            return _along(start, velocity, now_s - self.swerve_at_s)
        return _along(self.start, self.velocity, now_s - self.born_s)

    def going(self, now_s: float) -> Ned:
        return self.turned[1] if self.turned is not None and now_s >= self.swerve_at_s else self.velocity


def _along(start: Ned, velocity: Ned, t_s: float) -> Ned:
    return Ned(*(p + v * t_s for p, v in zip(start, velocity, strict=True)))


@dataclass
class Outcome:
    """What a flight came to."""

    seed: int
    violations: dict[str, float] = field(default_factory=dict)
    """Constraint -> worst true margin, where negative."""
    reports: list[tuple[float, str, dict[str, Any]]] = field(default_factory=list)
    worst: dict[str, float] = field(default_factory=dict)
    """Constraint -> least true margin, negative or not."""
    falsified: list[tuple[float, str]] = field(default_factory=list)
    """When which temporal property did not hold."""
    flown: int = 0
    true_speed_m_s: float = 0.0

    def count(self, event: str, **fields: object) -> int:
        return sum(1 for _, e, f in self.reports if e == event and all(f.get(k) == v for k, v in fields.items()))


class _Autopilot:
    """A multirotor in offboard, as the motion controller sees it: by its own estimate."""

    def __init__(self, position: Ned, yaw_deg: float, error: PositionError) -> None:
        self.body = Multirotor(position=position, yaw_deg=yaw_deg)
        self.error = error
        self.setpoint = Setpoint(position=position.plus(error.position), yaw_deg=yaw_deg)

    def here(self) -> tuple[Ned, float]:
        return self.body.position.plus(self.error.position), self.body.yaw_deg

    def set_position_ned(self, point: Ned, yaw_deg: float) -> None:
        self.setpoint = Setpoint(position=point, yaw_deg=yaw_deg)

    async def enter_offboard(self) -> None:
        self.set_position_ned(*self.here())

    async def end_setpoints(self) -> None: ...

    async def leave_in_hold(self) -> None: ...

    async def resume_mission(self) -> None: ...

    async def begin_landing(self) -> None: ...

    def step(self, wind: Ned) -> None:
        error = self.error.step(DT_S)
        self.body.step(DT_S, self.setpoint, wind, error, self.error.velocity)


class Flight:
    """One seeded flight. rules: what the supervisor and the monitor know of; the judge knows all."""

    def __init__(
        self,
        seed: int,
        limits: Limits | None = None,
        rules: tuple[Rule, ...] = RULES,
        *,
        commands: tuple[Command, ...] = MOVES,
        duration_s: float = 24.0,
        gust_sigma_m_s: float = 0.6,
        wind_m_s: float = 4.0,
        crossing: bool = True,
        telemetry_every: int = 2,
        setting: Callable[[Flight], None] | None = None,
    ) -> None:
        """setting: may change what the seed has laid out, before it flies."""
        self.rng = Random(seed)
        self.limits = limits or Limits()
        self.rules = rules
        self.commands = commands
        self.favourite = self.rng.choice(commands)
        self.duration_s = duration_s
        self.crossing = crossing
        self.telemetry_every = telemetry_every
        self.now_s = 100.0
        self.outcome = Outcome(seed)
        self.aircraft: list[Aircraft] = []
        self.sigma_h_m, self.sigma_v_m = 0.25, 0.35
        self.neighbour_sigma_m = 0.3
        self.operator = Operator(Ned(0.0, 0.0, 0.0), 0.2)
        self.neighbours_fail = False
        self.confidence = 0.9
        rng = self.rng
        self.place = Ned(rng.uniform(7.0, 12.0), rng.uniform(-3.0, 3.0), -rng.uniform(5.0, 7.0))
        self.volumes: tuple[ReservedVolume, ...] = ()
        self.terrain = _hills(rng)
        self.walls = _walls(rng, self.place)
        self.fence = _fence(rng, self.place)
        self.wind = Wind(rng.uniform(0.0, wind_m_s), rng.uniform(0.0, 360.0), gust_sigma_m_s, 3.0, rng)
        if setting is not None:
            setting(self)
        self.world = World(self.terrain, self.walls, self.fence)
        error = PositionError(self.sigma_h_m, self.sigma_v_m, 60.0, self.limits.drift_m_s, rng)
        yaw_deg = bearing_deg(self.place, self.operator.position)
        self.pilot = _Autopilot(self.place, yaw_deg, error)
        for _ in range(500):  # ten seconds to find the wind before anybody watches
            self.pilot.step(self.wind.step(DT_S))
        self.controller = MotionController(self.pilot, lambda: self.now_s, 30.0, 30.0, lambda: None, lambda _why: None)
        self.state = ArbiterState(self.limits, Policy(), rules)
        self.true_anchor = self.pilot.body.position
        self.true_centre = self.pilot.body.position
        self.next_request_s = self.now_s + 2.0
        self.next_aircraft_s = self.now_s + rng.uniform(1.0, 5.0)
        self.requests = 0
        self.signals, self.watch = SignalReader(self.limits), Watch()
        self._inbox: list[Event] = []

    # ------------------------------------------------------------ running

    def fly(self) -> Outcome:
        """Until the end of the sequence."""
        self.put(self.telemetry())
        self.ask(Command.ACTIVATE, 1.0)
        ticks = round(self.duration_s / DT_S)
        for tick in range(ticks):
            self.tick(tick)
        return self.outcome

    def tick(self, tick: int) -> None:
        self.now_s += DT_S
        self.pilot.step(self.wind.step(DT_S))
        self.controller.send()
        if tick % 5 == 0:
            self.traffic()
            self.put(NeighboursHeard(self.neighbours(), self.volumes))
            self.put(Tick())
        if tick % self.telemetry_every == 0:
            self.put(self.telemetry())
        if self.now_s >= self.next_request_s and self.state.session is not None:
            self.next_request_s = self.now_s + self.rng.uniform(1.5, 6.5)
            # People push on in one direction until it no longer goes.
            command = self.rng.choice(self.commands) if self.rng.random() < 0.5 else self.favourite
            if self.rng.random() < 0.08:
                command = Command.STOP
            elif self.rng.random() < 0.05:
                command = Command.CONTINUE
            self.ask(command, self.confidence)
        if tick % 5 == 0:
            self.judge()

    def ask(self, command: Command, confidence: float = 0.9, modality: Modality = Modality.VOICE) -> None:
        self.requests += 1
        request = ManeuverRequest(
            f"r{self.requests}", command, modality, confidence, self.now_s, self.now_s, command, "red"
        )
        self.put(Requested(request, 0.0))

    def put(self, event: Event) -> None:
        """Take an event and all that follows from it."""
        self._inbox.append(event)
        while self._inbox:
            had_anchor = self.state.session.anchor if self.state.session else None
            event = self._inbox.pop(0)
            self.state, effects = step(self.state, event, self.now_s)
            for broken in self.watch.update(self.now_s, self.signals.read(event, effects)):
                self.outcome.falsified.append((self.now_s, broken.formula))
            anchor = self.state.session.anchor if self.state.session else None
            if anchor is not None and anchor is not had_anchor:
                self.true_anchor = self.pilot.body.position
                if had_anchor is None:
                    self.true_centre = self.pilot.body.position
            for effect in effects:
                self.carry_out(effect)

    def carry_out(self, effect: object) -> None:
        match effect:
            case Report():
                self.outcome.reports.append((self.now_s, effect.event, effect.fields))
                self.outcome.flown += effect.event == "motion" and effect.fields["status"] == "started"
            case Announce():
                self.outcome.reports.append((self.now_s, "announce", {"text": effect.text}))
            case Pair():
                self._inbox.append(PairingAnswered(effect.colour, (), self.operator, self.world))
            case FaceOperator():
                _now(self.controller.face(effect.yaw_deg))
            case Fly():
                self.judge_start()
                _now(self.controller.fly(effect.plan, Ned(0.0, 0.0, 0.0)))
            case Hold():
                self.controller.hold()
            case Reserve():
                self._inbox.append(ReservationAnswered(effect.request_id, "granted"))

    # ------------------------------------------------------------ what is told

    def telemetry(self) -> TelemetryArrived:
        body, error = self.pilot.body, self.pilot.error
        return TelemetryArrived(
            VehicleState(
                self.now_s,
                body.position.plus(error.position),
                body.velocity.plus(error.velocity),
                body.yaw_deg,
                body.yaw_rate_deg_s,
                self.sigma_h_m,
                self.sigma_v_m,
                healthy=True,
                in_air=True,
                flight_mode=FlightMode.OFFBOARD,
            )
        )

    def neighbours(self) -> Neighbours:
        told_s = self.now_s - 0.05
        live = [a for a in self.aircraft if a.born_s <= told_s < a.gone_s]
        return Neighbours(
            tuple(a.name for a in live),
            np.array([a.at(told_s).plus(a.error) for a in live]).reshape(-1, 3),
            np.array([a.going(told_s) for a in live]).reshape(-1, 3),
            np.full(len(live), self.neighbour_sigma_m),
            np.full(len(live), told_s),
            -math.inf if self.neighbours_fail else told_s,
        )

    def traffic(self) -> None:
        """Now and then somebody crosses, clear of where the drone is and of what it has reserved."""
        self.aircraft = [a for a in self.aircraft if self.now_s < a.gone_s + 1.0]
        if not self.crossing or self.now_s < self.next_aircraft_s:
            return
        self.next_aircraft_s = self.now_s + self.rng.uniform(3.0, 8.0)
        for _ in range(20):
            made = self.crossing_one()
            if made is not None:
                self.aircraft.append(made)
                return

    def crossing_one(self) -> Aircraft | None:
        rng, here = self.rng, self.pilot.body.position
        speed = rng.uniform(1.0, 4.0)
        heading = rng.uniform(0.0, 2.0 * math.pi)
        velocity = Ned(speed * math.cos(heading), speed * math.sin(heading), 0.0)
        # Its closest approach is a few metres off where the drone is, four to six seconds from now.
        side, off_m = rng.choice((-1.0, 1.0)), rng.uniform(5.5, 9.0)
        nearest = here.plus(
            Ned(-side * math.sin(heading) * off_m, side * math.cos(heading) * off_m, rng.uniform(-2, 2))
        )
        lead_s = rng.uniform(3.5, 5.5)
        start = _along(nearest, velocity, -lead_s)
        error = Ned(*(rng.uniform(-0.3, 0.3) for _ in range(3)))
        made = Aircraft(f"t{self.now_s:.0f}", start, velocity, self.now_s, self.now_s + lead_s + 3.5, error)
        needed_m = self.limits.separation_m + 2.0 * (0.35 + 0.3) + 0.9 + 0.06 * speed
        flight = self.state.flight
        goals = (
            [here]
            if flight is None
            else [here, flight.plan.goal, _along(flight.plan.goal, flight.plan.direction, flight.plan.stop_m)]
        )
        for i in range(90):
            if min(made.at(self.now_s + 0.1 * i).minus(g).norm for g in goals) < needed_m:
                return None
        return made

    # ------------------------------------------------------------ the judge

    def judge(self) -> None:
        """Bare limits against the true state."""
        session = self.state.session
        if session is None or session.anchor is None:
            return
        here, limits = self.pilot.body.position, self.limits
        point = np.array([here])
        margins = {
            "terrain_clearance": float(self.terrain.near(here, 8.0).clearance_m(point)[0]) - limits.clearance_m,
            "agl": float(self.terrain.agl_m(point)[0]) - limits.min_agl_m,
            "workspace": limits.workspace_m - here.minus(self.true_anchor).norm,
            "session": limits.session_m - here.minus(self.true_centre).norm,
            "standoff": here.minus(self.operator.position).horizontal - limits.standoff_m,
            "envelope": limits.speed_m_s + limits.speed_tolerance_m_s - self.pilot.body.velocity.norm,
        }
        if len(self.walls):
            margins["obstacle_clearance"] = float(self.walls.distance_m(point).min()) - limits.obstacle_clearance_m
        if self.fence is not None:
            margins["geofence"] = float(self.fence.inside_m(point)[0])
        live = [a for a in self.aircraft if a.born_s <= self.now_s < a.gone_s]
        if live:
            margins["separation"] = min(a.at(self.now_s).minus(here).norm for a in live) - limits.separation_m
        for volume in self.volumes:
            inside_m = segment_distance_m(here, here, volume.start, volume.end) - volume.radius_m
            margins["reservation"] = min(margins.get("reservation", math.inf), inside_m)
        worst, outcome = self.outcome.worst, self.outcome
        outcome.true_speed_m_s = max(outcome.true_speed_m_s, self.pilot.body.velocity.norm)
        for name, margin in margins.items():
            worst[name] = min(worst.get(name, math.inf), margin)
            if margin < 0.0:
                outcome.violations[name] = min(outcome.violations.get(name, 0.0), margin)

    def judge_start(self) -> None:
        """What must be known before anything is flown."""
        limits, violations = self.limits, self.outcome.violations
        if self.confidence < limits.confidence_voice:
            violations["input_confidence"] = self.confidence - limits.confidence_voice
        if max(self.sigma_h_m, self.sigma_v_m) > limits.localization_half_m:
            violations["localization"] = -1.0
        if self.terrain.sigma_m > limits.terrain_half_m:
            violations["terrain_confidence"] = -1.0
        if self.neighbours_fail:
            violations["neighbour_age"] = -1.0


def without(name: str) -> tuple[Rule, ...]:
    """The rules with one switched off."""
    return tuple(rule for rule in RULES if rule.name != name)


def _now(work: Coroutine[Any, Any, None]) -> None:
    """Run a coroutine that has nothing to wait for."""
    try:
        work.send(None)
    except StopIteration:
        return
    raise AssertionError("the controller waits for something in virtual time")


def _hills(rng: Random) -> Terrain:
    n = 81
    rows, cols = np.mgrid[0:n, 0:n]
    slope_n, slope_e = rng.uniform(-0.05, 0.35), rng.uniform(-0.2, 0.2)
    heights = (rows - 40) * slope_n + (cols - 40) * slope_e
    for _ in range(4):
        r, c, w = rng.uniform(20, 60), rng.uniform(20, 60), rng.uniform(3, 9)
        heights = heights + rng.uniform(-1.0, 2.0) * np.exp(-((rows - r) ** 2 + (cols - c) ** 2) / (2 * w * w))
    heights = heights - heights[52, 40] + rng.uniform(0.0, 1.0)
    return Terrain(ORIGIN_AMSL_M + heights, (-40.0, -40.0), ((1.0, 0.0), (0.0, 1.0)), 0.1, ORIGIN_AMSL_M)


def _walls(rng: Random, place: Ned) -> Obstacles:
    polygons = []
    for _ in range(rng.randint(1, 3)):
        bearing, away = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(3.2, 6.0)
        n, e = place.north + away * math.cos(bearing), place.east + away * math.sin(bearing)
        half, thick = rng.uniform(1.0, 5.0), 0.3
        a, b = -math.sin(bearing), math.cos(bearing)
        line = shapely.LineString([(n - a * half, e - b * half), (n + a * half, e + b * half)])
        polygons.append(line.buffer(thick, cap_style="flat"))
    k = len(polygons)
    return Obstacles.of([f"wall {i}" for i in range(k)], polygons, [480.0] * k, [515.0] * k, ORIGIN_AMSL_M)


def _fence(rng: Random, place: Ned) -> Geofence:
    corners = []
    for i in range(12):
        angle, away = 2.0 * math.pi * i / 12, rng.uniform(3.5, 10.0)
        corners.append((place.north + away * math.cos(angle), place.east + away * math.sin(angle)))
    return Geofence.of(
        shapely.Polygon(corners).buffer(0), 490.0, ORIGIN_AMSL_M - place.down + rng.uniform(1.5, 4.0), ORIGIN_AMSL_M
    )
