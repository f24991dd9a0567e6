"""No hard constraint is ever violated in seeded random flights, and each of them is what prevents it (R3-R11, X1, X2, X11).

`make test` flies a stated sample of 10; `M3R_SOAK=1` the full 2,000.
"""

from __future__ import annotations

import multiprocessing
import os
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np
import pytest
import shapely

import safety.supervisor
from safety.geofence import Geofence
from safety.limits import Limits
from safety.obstacles import Obstacles
from safety.terrain import Terrain
from safety.vocabulary import Command, Ned, ReservedVolume
from tests.flights import DT_S, ORIGIN_AMSL_M, Aircraft, Flight, Outcome, without

pytestmark = pytest.mark.xdist_group("busy")  # it keeps a core busy: one of them at a time

SOAK = os.environ.get("M3R_SOAK") == "1"
FLIGHTS = 2000 if SOAK else 10
GONE = 300.0
T = TypeVar("T")


def flown(one: Callable[[int], T], seeds: range) -> list[T]:
    """All of them; the full counts on every core."""
    if not SOAK:
        return [one(seed) for seed in seeds]
    with multiprocessing.get_context("spawn").Pool() as pool:
        return pool.map(one, seeds, chunksize=5)


def fly(seed: int) -> Outcome:
    outcome = Flight(seed).fly()
    outcome.reports = [r for r in outcome.reports if r[1] in ("decision", "motion", "violation")]
    return outcome


def fly_beyond(seed: int) -> tuple[Outcome, float]:
    """Outside the declared bounds: gusts of 3 m/s sigma, and an aircraft that turns towards the drone."""
    flight = Flight(seed, gust_sigma_m_s=3.0, wind_m_s=8.0)
    late_s = 0.0
    swerved = False
    flight.put(flight.telemetry())
    flight.ask(Command.ACTIVATE, 1.0)
    for tick in range(round(flight.duration_s / DT_S)):
        flight.tick(tick)
        here = flight.pilot.body.position
        if not swerved and flight.state.flight is not None and flight.now_s > 106.0:
            swerved = True
            flight.aircraft = [_swerving(flight.now_s, here)]
        flown = flight.state.flight
        # A plan that is approved only because it mends the separation (X13) may be flown while it does.
        going_on = flown is not None and ("actual", "separation") not in flown.baseline
        flying_in_violation = going_on and _true_margin_m(flight, here) < 0.0
        late_s = late_s + DT_S if flying_in_violation else 0.0
        flight.outcome.worst["late_s"] = max(flight.outcome.worst.get("late_s", 0.0), late_s)
    return flight.outcome, flight.outcome.worst["late_s"]


def _swerving(now_s: float, target: Ned) -> Aircraft:
    start = Ned(target.north, target.east - 25.0, target.down)
    aircraft = Aircraft("swerving", start, Ned(4.0, 0.0, 0.0), now_s, now_s + GONE, swerve_at_s=now_s + 1.0)
    turning = aircraft.at(now_s + 1.0)
    away = target.minus(turning)
    aircraft.turned = (turning, Ned(*(8.0 * c / away.norm for c in away)))
    return aircraft


def _true_margin_m(flight: Flight, here: Ned) -> float:
    live = [a for a in flight.aircraft if a.born_s <= flight.now_s < a.gone_s]
    return min((a.at(flight.now_s).minus(here).norm - flight.limits.separation_m for a in live), default=1.0)


@pytest.mark.requirement("R3", "R4", "R5", "R6", "R7", "R8", "R9", "X1", "X2", "X11")
def test_no_hard_constraint_is_violated() -> None:
    """R3-R9, X1, X2, X11: judged on the true state, inside the declared bounds."""
    outcomes = flown(fly, range(FLIGHTS))
    violated = {o.seed: o.violations for o in outcomes if o.violations}
    assert not violated
    falsified = {o.seed: o.falsified for o in outcomes if o.falsified}
    assert not falsified, "temporal properties"
    # The flights are worth something: things were flown, shortened and refused.
    verdicts = Counter(fields["verdict"] for o in outcomes for _, event, fields in o.reports if event == "decision")
    assert sum(o.flown for o in outcomes) >= 3 * FLIGHTS
    assert verdicts["reduced"] >= FLIGHTS / 4
    assert verdicts["rejected"] >= FLIGHTS / 8


@pytest.mark.requirement("R10")
def test_outside_the_declared_bounds_it_aborts_within_a_tick() -> None:
    """R10: violated or not, nothing goes on being flown into a violation; the rate is reported, whatever it is."""
    outcomes = flown(fly_beyond, range(200 if SOAK else 4))
    assert not [o.falsified for o, _ in outcomes if o.falsified]
    rate = sum(bool(o.violations) for o, _ in outcomes) / len(outcomes)
    print(f"\noutside the declared bounds: {rate:.0%} of {len(outcomes)} flights violated something")
    # Telemetry comes every second step of the simulation and neighbours every fifth: one tick of the slower of the two.
    assert max(late_s for _, late_s in outcomes) <= 5 * DT_S + 1e-9
    assert any(o.count("violation", kind="predicted") for o, _ in outcomes)


# ---------------------------------------------------------------- each constraint switched off in turn

ONLY_RIGHT, ONLY_FORWARD, ONLY_BACK, ONLY_DOWN = (
    (Command.GO_RIGHT,), (Command.GO_FORWARD,), (Command.GO_BACK,), (Command.GO_DOWN,),
)  # fmt: skip


def _open(flight: Flight) -> None:
    """Flat ground and nothing else: what a setting adds is what binds."""
    flight.place = Ned(12.0, 0.0, -6.0)
    flight.terrain = Terrain.flat(ORIGIN_AMSL_M, 0.1, ORIGIN_AMSL_M)
    flight.walls = Obstacles.none(ORIGIN_AMSL_M)
    flight.fence = None
    flight.crossing = False


def wall_on_the_right(flight: Flight) -> None:
    _open(flight)
    wall = shapely.box(0.0, 3.2, 30.0, 3.6)
    flight.walls = Obstacles.of(["wall"], [wall], [480.0], [520.0], ORIGIN_AMSL_M)


def slope_ahead(flight: Flight) -> None:
    _open(flight)
    heights = np.full((60, 60), ORIGIN_AMSL_M)
    heights[34:, :] += np.arange(26.0)[:, None]
    flight.terrain = Terrain(heights, (-20.0, -30.0), ((1.0, 0.0), (0.0, 1.0)), 0.1, ORIGIN_AMSL_M)


def low_over_flat_ground(flight: Flight) -> None:
    _open(flight)
    flight.place = Ned(12.0, 0.0, -5.0)


def neighbour_on_the_right(flight: Flight) -> None:
    _open(flight)
    parked = Aircraft("parked", Ned(12.0, 5.6, -6.0), Ned(0.0, 0.0, 0.0), 0.0, GONE)
    flight.aircraft = [parked]


def unseen_neighbours(flight: Flight) -> None:
    _open(flight)
    flight.neighbours_fail = True


def fence_on_the_right(flight: Flight) -> None:
    _open(flight)
    flight.fence = Geofence.of(shapely.box(-50.0, -50.0, 50.0, 2.2), 480.0, 520.0, ORIGIN_AMSL_M)


def leased_volume_on_the_right(flight: Flight) -> None:
    _open(flight)
    leased = ReservedVolume("green", Ned(2.0, 4.5, -6.0), Ned(22.0, 4.5, -6.0), 2.0, 0.0, 1e6)
    flight.volumes = (leased,)


def near_the_operator(flight: Flight) -> None:
    _open(flight)
    flight.place = Ned(5.5, 0.0, -6.0)


def unsure_of_what_was_asked(flight: Flight) -> None:
    _open(flight)
    flight.confidence = 0.4


def lost(flight: Flight) -> None:
    _open(flight)
    flight.place = Ned(40.0, 0.0, -40.0)
    flight.sigma_h_m = flight.sigma_v_m = 2.5


def badly_surveyed(flight: Flight) -> None:
    _open(flight)
    flight.place = Ned(40.0, 0.0, -40.0)
    flight.terrain = Terrain.flat(ORIGIN_AMSL_M, 2.5, ORIGIN_AMSL_M)


Setting = Callable[[Flight], None]
SETTINGS: list[tuple[str, Setting, tuple[Command, ...], Limits]] = [
    ("obstacle_clearance", wall_on_the_right, ONLY_RIGHT, Limits()),
    ("terrain_clearance", slope_ahead, ONLY_FORWARD, Limits(clearance_m=3.0, min_agl_m=0.5)),
    ("agl", low_over_flat_ground, ONLY_DOWN, Limits(min_agl_m=3.0, clearance_m=0.5)),
    ("separation", neighbour_on_the_right, ONLY_RIGHT, Limits()),
    ("reservation", leased_volume_on_the_right, ONLY_RIGHT, Limits()),
    ("workspace", _open, ONLY_RIGHT, Limits(workspace_m=0.8)),
    ("session", _open, ONLY_FORWARD, Limits(session_m=2.5)),
    ("geofence", fence_on_the_right, ONLY_RIGHT, Limits()),
    ("standoff", near_the_operator, ONLY_BACK, Limits()),
    ("input_confidence", unsure_of_what_was_asked, ONLY_RIGHT, Limits()),
    ("localization", lost, ONLY_RIGHT, Limits()),
    ("terrain_confidence", badly_surveyed, ONLY_RIGHT, Limits()),
    ("neighbour_age", unseen_neighbours, ONLY_RIGHT, Limits()),
]


def violated(name: str, setting: Setting, commands: tuple[Command, ...], limits: Limits, *, off: bool) -> bool:
    """Whether any of a few flights in this setting violates the named constraint."""
    rules = without(name) if off else without("")
    flights = (
        Flight(seed, limits, rules, commands=commands, setting=setting, duration_s=45.0 if off else 20.0)
        for seed in range(2)
    )
    return any(name in flight.fly().violations for flight in flights)


@pytest.mark.parametrize(("name", "setting", "commands", "limits"), SETTINGS, ids=[s[0] for s in SETTINGS])
def test_each_constraint_is_what_prevents_its_violation(
    name: str, setting: Setting, commands: tuple[Command, ...], limits: Limits
) -> None:
    """The same flights violate it with the rule switched off, and do not with it on."""
    assert not violated(name, setting, commands, limits, off=False)
    assert violated(name, setting, commands, limits, off=True)


@pytest.mark.requirement("R8", "G6")
def test_the_envelope_rule_stops_a_planner_that_plans_too_fast(monkeypatch: pytest.MonkeyPatch) -> None:
    """R8, G6: the supervisor does not trust the planner."""
    honest = safety.supervisor.plan_translation

    def reckless(primitive, start, yaw_deg, operator, length_m, limits, slowness=1.0):  # type: ignore[no-untyped-def]
        fast = replace(limits, speed_m_s=2.0, acceleration_m_s2=2.0)
        return honest(primitive, start, yaw_deg, operator, 3.0 * length_m, fast, slowness)

    monkeypatch.setattr(safety.supervisor, "plan_translation", reckless)
    assert not violated("envelope", _open, ONLY_RIGHT, Limits(), off=False)
    assert violated("envelope", _open, ONLY_RIGHT, Limits(), off=True)
