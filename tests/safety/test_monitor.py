"""The runtime monitor: actual and predicted violation, measured as they are watched. R9, R10, R8, X6, X11, X13."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from safety.constraints import RULES, findings
from safety.monitor import Watch, watch
from safety.planner import plan_translation, stopping_m
from safety.situation import Situation
from safety.terrain import Terrain
from safety.vocabulary import Ned, Neighbours, Path, Plan, Primitive, ReservedVolume
from tests.safety.scene import LIMITS, NOW_S, START, situation, sky, vehicle, wall, world
from tests.safety.test_constraints import landscape

PLAN = plan_translation(Primitive.MOVE_FORWARD, START, 180.0, Ned(-10.0, 0.0, 0.0), 1.0, LIMITS)
NORTH = Ned(0.5, 0.0, 0.0)
STILL = Ned(0.0, 0.0, 0.0)


def look(
    about: Situation, plan: Plan | None = PLAN, elapsed_s: float = 1.0, speed_m_s: float = 0.0, **how: object
) -> Watch:
    return watch(about, plan, elapsed_s, speed_m_s, how.get("baseline", {}), LIMITS)  # type: ignore[arg-type]


def kinds(seen: Watch) -> set[tuple[str, str]]:
    return {(b.kind, b.constraint) for b in seen.breaches}


def near_wall(wall_m: float, velocity: Ned = STILL, sigma_m: float = 0.0) -> Situation:
    drone = vehicle(velocity=velocity, sigma_h_m=sigma_m, sigma_v_m=sigma_m)
    return situation(world=world(obstacles=wall(wall_m)), vehicle=drone)


def test_all_well() -> None:
    seen = look(situation())
    assert not seen.breaches
    assert seen.clearance_m == pytest.approx(10.0)
    assert seen.separation_m is None


@pytest.mark.requirement("R9")
@pytest.mark.parametrize(("wall_m", "found"), [
    (1.49, {("actual", "obstacle_clearance"), ("predicted", "obstacle_clearance")}), (1.51, set()),
])  # fmt: skip
def test_actual_is_the_bare_limit(wall_m: float, found: set[tuple[str, str]]) -> None:
    assert kinds(look(near_wall(wall_m))) == found


@pytest.mark.requirement("R10", "X11")
def test_predicted_counts_what_it_takes_to_stop_at_the_measured_speed() -> None:
    reach_m = 1.5 + stopping_m(0.5, LIMITS)
    assert kinds(look(near_wall(reach_m + 0.01, NORTH))) == set()
    assert kinds(look(near_wall(reach_m - 0.01, NORTH))) == {("predicted", "obstacle_clearance")}
    assert kinds(look(near_wall(reach_m - 0.01, Ned(-0.5, 0.0, 0.0)))) == set(), "it flies away from it"


@pytest.mark.requirement("R10", "X11")
def test_predicted_counts_uncertainty_and_actual_does_not() -> None:
    assert kinds(look(near_wall(1.7, sigma_m=0.2))) == {("predicted", "obstacle_clearance")}


def test_hovering_predicts_nothing() -> None:
    assert kinds(look(near_wall(1.7, sigma_m=0.2), plan=None)) == set()
    assert kinds(look(near_wall(1.4), plan=None)) == {("actual", "obstacle_clearance")}


@pytest.mark.requirement("X6")
def test_an_unknown_accuracy_is_predicted_not_actual() -> None:
    """X6: it aborts, but nobody claims that a limit was broken."""
    seen = look(near_wall(1.6, sigma_m=math.nan))
    assert ("predicted", "localization") in kinds(seen)
    assert all(b.kind == "predicted" for b in seen.breaches)


@pytest.mark.requirement("R10", "X6")
@pytest.mark.parametrize("about", [
    situation(neighbours=Neighbours.none(NOW_S - 1.5)),
    situation(neighbours=Neighbours.none(-math.inf)),
])  # fmt: skip
def test_a_dead_feed_is_a_predicted_breach(about: Situation) -> None:
    assert kinds(look(about)) == {("predicted", "neighbour_age")}


@pytest.mark.requirement("R10", "X6")
def test_no_terrain_is_a_predicted_breach() -> None:
    assert ("predicted", "terrain_clearance") in kinds(look(situation(world=world(terrain=None))))


@pytest.mark.requirement("R9", "R10")
@pytest.mark.parametrize(("away_m", "velocity_m_s", "found"), [
    (2.9, 0.0, {("actual", "separation"), ("predicted", "separation")}),
    (3.1, 0.0, set()),
    (6.0, -2.0, {("predicted", "separation")}),
    (8.0, -2.0, set()),
    (6.0, 2.0, set()),
])  # fmt: skip
def test_neighbours(away_m: float, velocity_m_s: float, found: set[tuple[str, str]]) -> None:
    other = ("blue", Ned(away_m, 0.0, -10.0), Ned(velocity_m_s, 0.0, 0.0), 0.0, NOW_S)
    seen = look(situation(neighbours=sky(other)))
    assert kinds(seen) == found
    assert seen.separation_m == pytest.approx(away_m)


def test_an_aged_neighbour_is_no_actual_violation_by_where_it_could_have_turned() -> None:
    other = ("blue", Ned(6.0, 0.0, -10.0), Ned(0.0, 5.0, 0.0), 0.0, NOW_S - 0.9)
    assert ("actual", "separation") not in kinds(look(situation(neighbours=sky(other))))


# ---------------------------------------------------------------- broken before it began: X13


@pytest.mark.requirement("X13")
def test_what_was_broken_may_only_mend() -> None:
    first = look(near_wall(1.4))
    assert first.negative[("actual", "obstacle_clearance", "wall (0)")] == pytest.approx(-0.1)
    for wall_m, mending in ((1.4, True), (1.45, True), (1.36, True), (1.3, False)):
        seen = look(near_wall(wall_m), baseline=first.negative)
        actual = [b for b in seen.breaches if b.kind == "actual"]
        assert [b.mending for b in actual] == [mending], wall_m


@pytest.mark.requirement("X13")
def test_a_limit_that_only_uncertainty_broke_must_not_really_break() -> None:
    """The doubtful margin was negative from the start; that does not excuse the bare limit."""
    first = look(near_wall(1.6, sigma_m=0.3))
    assert set(first.negative) == {("predicted", "obstacle_clearance", "wall (0)")}
    seen = look(near_wall(1.45, sigma_m=0.3), baseline=first.negative)
    assert not next(b for b in seen.breaches if b.kind == "actual").mending


# ---------------------------------------------------------------- the envelope: R8


@pytest.mark.requirement("R8")
@pytest.mark.parametrize(("speed_m_s", "elapsed_s", "off", "kind"), [
    (0.8, 1.0, Ned(0.5, 0.0, 0.0), None),
    (0.81, 1.0, Ned(0.5, 0.0, 0.0), "actual"),
    (math.nan, 1.0, Ned(0.5, 0.0, 0.0), "predicted"),
    (0.1, PLAN.max_duration_s, Ned(0.5, 0.0, 0.0), None),
    (0.1, PLAN.max_duration_s + 0.01, Ned(0.5, 0.0, 0.0), "predicted"),
    (0.1, 1.0, Ned(0.5, 0.29, 0.0), None),
    (0.1, 1.0, Ned(0.5, 0.31, 0.0), "predicted"),
    (0.1, 1.0, Ned(1.0 + PLAN.stop_m + 0.29, 0.0, 0.0), None),
    (0.1, 1.0, Ned(1.0 + PLAN.stop_m + 0.31, 0.0, 0.0), "predicted"),
])  # fmt: skip
def test_speed_duration_and_line(speed_m_s: float, elapsed_s: float, off: Ned, kind: str | None) -> None:
    about = situation(vehicle=vehicle(position=START.plus(off)))
    found = [b.kind for b in look(about, elapsed_s=elapsed_s, speed_m_s=speed_m_s).breaches]
    assert found == ([] if kind is None else [kind])


@pytest.mark.requirement("R8")
def test_down_is_bounded_by_its_own_speed() -> None:
    """Paper table I: down at half the speed."""
    plan = plan_translation(Primitive.DESCEND, START, 180.0, Ned(-10.0, 0.0, 0.0), 0.5, LIMITS)
    assert not look(situation(), plan=plan, speed_m_s=0.54).breaches
    assert kinds(look(situation(), plan=plan, speed_m_s=0.56)) == {("actual", "envelope")}


@pytest.mark.requirement("X6")
def test_a_place_that_is_no_number_aborts() -> None:
    seen = look(replace(situation(), vehicle=vehicle(position=Ned(math.nan, 0.0, 0.0))))
    assert ("predicted", "envelope") in kinds(seen)
    assert ("predicted", "terrain_clearance") in kinds(seen)


@pytest.mark.requirement("R9")
@settings(max_examples=80, deadline=None)
@given(st.integers(0, 100_000), st.floats(0.0, 0.6), st.floats(-180.0, 180.0))
def test_where_nothing_is_predicted_nothing_is_broken(seed: int, speed_m_s: float, heading_deg: float) -> None:
    """R9: the bare rules, all of them, find no breach that the look, which leaves out some, does not."""
    about = landscape(seed)
    heading = math.radians(heading_deg)
    velocity = Ned(speed_m_s * math.cos(heading), speed_m_s * math.sin(heading), 0.0)
    about = replace(about, vehicle=replace(about.vehicle, velocity=velocity))
    bare = replace(
        LIMITS, sigma_k=0.0, tracking_m=0.0, horizon_s=0.0, neighbour_acceleration_m_s2=0.0, neighbour_turn=0.0
    )
    here = Path(np.array([about.vehicle.position]), np.zeros(1))
    hard = {rule.name for rule in RULES if rule.constraint.hard}
    broken = {
        f.constraint for f in findings(here, about, bare)
        if f.constraint in hard and f.margin is not None and f.margin < 0.0
    }  # fmt: skip
    assert {b.constraint for b in look(about, plan=None).breaches} == broken
    seen = look(about, speed_m_s=speed_m_s)
    assert {b.constraint for b in seen.breaches if b.kind == "actual"} == broken


@pytest.mark.requirement("R4")
def test_the_recorded_clearance_is_the_same_however_high_it_flies() -> None:
    """R4: near the ground it is what the rules found; higher up than they have to look, it is looked for again."""
    for height_m in (2.5, 4.0, 5.0, 6.0, 8.0, 15.0, 19.0):
        ground = Terrain(np.zeros((80, 80)), (-40.0, -40.0), ((1.0, 0.0), (0.0, 1.0)), 0.0, 0.0)
        about = situation(world=world(terrain=ground), vehicle=vehicle(position=Ned(0.3, 0.4, -height_m)))
        assert look(about).clearance_m == pytest.approx(height_m)


# ---------------------------------------------------------------- leases of others, and what cannot be: X10, X6


@pytest.mark.requirement("R10")
@pytest.mark.parametrize(("east_m", "seen"), [(2.0, True), (9.0, False)])
def test_a_lease_of_somebody_else_in_the_way_is_a_breach_before_it_is_entered(east_m: float, seen: bool) -> None:
    """It was granted while this plan was flown: by an authority that did not know, or knows better."""
    place = START.plus(Ned(0.5, east_m, 0.0))
    lease = ReservedVolume("zoe", place, place, 1.0, NOW_S, NOW_S + 30.0)
    moving = vehicle(position=START.plus(Ned(0.5, 0.0, 0.0)), velocity=Ned(0.5, 0.0, 0.0))
    found = look(situation(vehicle=moving, reservations=(lease,)))
    assert any(b.constraint == "reservation" and not b.mending for b in found.breaches) == seen
