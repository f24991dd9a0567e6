"""The rules against arithmetic done by hand: nothing here is judged by the product's own judgement.

Signs, datums, edges and minima that a change could turn round unseen. Source: R3-R8, R11, G2-G6, X6, X8, X11.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from safety.confidence import authority, confidence_of
from safety.geofence import Geofence
from safety.limits import Limits
from safety.monitor import watch
from safety.obstacles import Obstacles
from safety.planner import plan_return, plan_scan, plan_translation, swept
from safety.separation import separation
from safety.situation import Situation, World
from safety.spatial import agl, geofence, obstacle_clearance, standoff, terrain_clearance
from safety.supervisor import decide, interpret
from safety.terrain import Terrain
from safety.vocabulary import (
    Command,
    Decision,
    ManeuverRequest,
    Modality,
    Ned,
    Path,
    Primitive,
    ReservedVolume,
    Verdict,
)
from tests.safety.scene import LIMITS, NOW_S, START, number, situation, sky, vehicle, wall, world

SOUTH = Ned(-10.0, 0.0, 0.0)
AMSL_M = 730.0
"""Of the local origin: a sign that is wrong is wrong by a kilometre and a half."""


def ask(command: Command, about: Situation, limits: Limits = LIMITS, *, may_delay: bool = False) -> Decision:
    request = ManeuverRequest("r", command, Modality.VOICE, 0.95, NOW_S, NOW_S)
    return decide(request, interpret(request, limits), about, limits, may_delay=may_delay)


def seen(**changes: object) -> Situation:
    fit = vehicle(sigma_h_m=0.1, sigma_v_m=0.1, yaw_deg=180.0)
    return situation(**{"vehicle": fit, **changes})


def point(north: float, east: float, up: float) -> Path:
    return Path(np.array([[north, east, -up]]), np.zeros(1))


# ---------------------------------------------------------------- where a plan leads


@pytest.mark.requirement("R2")
@pytest.mark.parametrize(
    ("primitive", "moves"),
    [
        (Primitive.ASCEND, Ned(0.0, 0.0, -0.5)),
        (Primitive.DESCEND, Ned(0.0, 0.0, 0.5)),
        (Primitive.MOVE_FORWARD, Ned(0.5, 0.0, 0.0)),
        (Primitive.MOVE_BACKWARD, Ned(-0.5, 0.0, 0.0)),
        (Primitive.MOVE_RIGHT, Ned(0.0, 0.5, 0.0)),
        (Primitive.MOVE_LEFT, Ned(0.0, -0.5, 0.0)),
    ],
)
def test_every_primitive_leads_where_its_word_says(primitive: Primitive, moves: Ned) -> None:
    """The operator stands south of the drone and looks north."""
    plan = plan_translation(primitive, START, 180.0, SOUTH, 0.5, LIMITS)
    assert plan.goal.minus(START) == pytest.approx(moves)
    path = swept(plan, LIMITS)
    beyond = path.points_ned_m[-1] - np.array(START)
    assert beyond @ np.array(moves) == pytest.approx(0.5 * (0.5 + plan.stop_m))
    assert (np.diff(path.points_ned_m, axis=0) @ np.array(moves) >= 0.0).all()
    assert np.linalg.norm(np.cross(beyond, np.array(moves))) == pytest.approx(0.0, abs=1e-9)


def test_setpoints_lead_along_the_line_and_never_beyond_the_goal() -> None:
    plan = plan_translation(Primitive.ASCEND, START, 180.0, SOUTH, 0.5, LIMITS)
    heights = [START.down - plan.led(0.01 * i, 0.8).down for i in range(500)]
    assert all(b >= a - 1e-9 for a, b in itertools.pairwise(heights)) and max(heights) == pytest.approx(0.5)
    for i in range(0, 300, 10):
        t_s = 0.01 * i
        speed_m_s = (plan.move.at(t_s + 1e-4) - plan.move.at(t_s - 1e-4)) / 2e-4
        expected = min(plan.move.at(t_s) + 0.8 * speed_m_s, 0.5)
        assert heights[i] == pytest.approx(expected, abs=1e-3)


def test_the_way_back_ends_as_the_anchor_was() -> None:
    anchor = Ned(1.0, 2.0, -9.0)
    plan = plan_return(START, 170.0, SOUTH, anchor, LIMITS, anchor_yaw_deg=-150.0)
    assert plan.goal == pytest.approx(anchor)
    assert math.remainder(plan.yaw_deg(plan.duration_s) + 150.0, 360.0) == pytest.approx(0.0, abs=1e-9)


def test_a_scan_goes_round_in_its_own_sense() -> None:
    for primitive, sign in ((Primitive.SCAN_LEFT, 1.0), (Primitive.SCAN_RIGHT, -1.0)):
        plan = plan_scan(primitive, START, 180.0, SOUTH, 360.0, LIMITS)
        assert plan.turn_deg == pytest.approx(sign * 360.0)
        assert sign * (plan.yaw_deg(1.0) - plan.yaw_deg(0.0)) > 0.0


# ---------------------------------------------------------------- heights and their datum


@pytest.mark.parametrize("up_m", [-40.0, 0.0, 3.5, 120.0])
def test_a_height_is_that_above_the_ground_and_no_other(up_m: float) -> None:
    grid = Terrain(np.full((5, 5), AMSL_M - 20.0), (-10.0, -10.0), ((5.0, 0.0), (0.0, 5.0)), 0.0, AMSL_M)
    for terrain in (Terrain.flat(AMSL_M - 20.0, 0.0, AMSL_M), grid):
        assert terrain.agl_m(np.array([[1.0, 2.0, -up_m]]))[0] == pytest.approx(up_m + 20.0)


@pytest.mark.parametrize(
    ("north", "east", "known"),
    [
        (0.0, 0.0, True), (40.0, 30.0, True), (40.0, 0.0, True), (0.0, 30.0, True), (20.0, 30.0, True),
        (40.01, 15.0, False), (-0.01, 15.0, False), (20.0, 30.01, False), (20.0, -0.01, False), (45.0, 35.0, False),
    ],
)  # fmt: skip
def test_the_model_ends_at_its_last_node(north: float, east: float, known: bool) -> None:
    """5 rows and 4 columns of 10 m."""
    grid = Terrain(np.zeros((5, 4)), (0.0, 0.0), ((10.0, 0.0), (0.0, 10.0)), 0.0, 0.0)
    assert bool(np.isfinite(grid.agl_m(np.array([[north, east, -5.0]]))[0])) == known


def test_a_slope_rises_where_its_heights_do() -> None:
    """1 m in 10 to the north: at 25 m north the ground is 2.5 m higher."""
    grid = Terrain(
        AMSL_M + np.arange(5.0)[:, None] + np.zeros((5, 5)), (0.0, 0.0), ((10.0, 0.0), (0.0, 10.0)), 0.0, AMSL_M
    )
    assert grid.agl_m(np.array([[25.0, 20.0, -10.0]]))[0] == pytest.approx(7.5)
    assert grid.clearance_m(np.array([[25.0, 20.0, -10.0]]))[0] == pytest.approx(7.5 / math.hypot(1.0, 0.1))
    assert grid.slope == pytest.approx(0.1)


@pytest.mark.requirement("R3", "G2", "X11")
@pytest.mark.parametrize("up_m", [4.0, 6.0, 9.0])
def test_margins_over_flat_ground_by_hand(up_m: float) -> None:
    """Required: 1.5 m and 2 m, the tube of 0.3 m, twice 0.2 m sideways or 0.1 m upright of the drone, twice 0.4 m of the model."""
    about = seen(
        vehicle=vehicle(position=Ned(0.0, 0.0, -up_m), sigma_h_m=0.2, sigma_v_m=0.1),
        world=world(terrain=Terrain.flat(0.0, 0.4, 0.0)),
    )
    assert number(terrain_clearance(point(0.0, 0.0, up_m), about, LIMITS)) == pytest.approx(
        up_m - 1.5 - 0.3 - 0.4 - 0.8
    )
    assert number(agl(point(0.0, 0.0, up_m), about, LIMITS)) == pytest.approx(up_m - 2.0 - 0.3 - 0.2 - 0.8)


@pytest.mark.requirement("G5", "X6")
@pytest.mark.parametrize(("north", "known"), [(39.69, True), (39.71, False), (0.31, True), (0.29, False)])
def test_a_height_is_known_where_the_ground_is_known_as_far_as_the_error(north: float, known: bool) -> None:
    """The model ends at 0 m and 40 m; the drone may be 0.3 m off."""
    grid = Terrain(np.zeros((5, 4)), (0.0, 0.0), ((10.0, 0.0), (0.0, 10.0)), 0.0, 0.0)
    about = seen(vehicle=vehicle(sigma_h_m=0.0, sigma_v_m=0.0), world=world(terrain=grid))
    found = agl(point(north, 15.0, 30.0), about, LIMITS)
    assert (found.margin is not None) == known
    assert found.passed == known


# ---------------------------------------------------------------- the least of several


@pytest.mark.requirement("R3", "X11")
def test_of_several_obstacles_the_nearest_counts() -> None:
    boxes = [shapely.box(n, -5.0, n + 1.0, 5.0) for n in (30.0, 8.0, 19.0)]
    about = seen(world=world(obstacles=Obstacles.of(["far", "near", "middle"], boxes, [0.0] * 3, [30.0] * 3, 0.0)))
    found = obstacle_clearance(point(0.0, 0.0, 10.0), about, LIMITS)
    assert number(found) == pytest.approx(8.0 - 1.5 - 0.3 - 0.2)
    assert found.text.startswith("near")


@pytest.mark.requirement("G4", "G5")
@pytest.mark.parametrize(("up_m", "margin_m"), [(3.0, 2.5), (38.0, 1.5), (20.0, 5.0)])
def test_of_a_fence_the_nearest_of_side_floor_and_ceiling_counts(up_m: float, margin_m: float) -> None:
    """Sides at 5.5 m, floor at 0 m, ceiling at 40 m; the error is 0.5 m each way."""
    fence = Geofence.of(shapely.box(-5.5, -50.0, 50.0, 50.0), 0.0, 40.0, 0.0)
    about = seen(world=world(geofence=fence))
    assert number(geofence(point(0.0, 0.0, up_m), about, LIMITS)) == pytest.approx(margin_m)


@pytest.mark.parametrize(
    ("floor", "ceiling", "up_m", "passed"),
    [
        (5.0, math.inf, 4.0, False),
        (5.0, math.inf, 90.0, True),
        (-math.inf, 30.0, 31.0, False),
        (-math.inf, 30.0, 1.0, True),
    ],
)
def test_a_fence_with_only_a_floor_or_only_a_ceiling_has_it(
    floor: float, ceiling: float, up_m: float, passed: bool
) -> None:
    fence = Geofence.of(shapely.box(-50.0, -50.0, 50.0, 50.0), floor, ceiling, 0.0)
    assert not fence.is_open_above_and_below
    assert geofence(point(0.0, 0.0, up_m), seen(world=world(geofence=fence)), LIMITS).passed == passed


@pytest.mark.requirement("X2")
@pytest.mark.parametrize(("north", "passed"), [(-6.6, True), (-6.8, False)])
def test_the_standoff_is_horizontal(north: float, passed: bool) -> None:
    """3 m, the tube, twice 0.1 m: 3.5 m from an operator at -10.2 m; height does not help."""
    about = seen(operator=replace(situation().operator, position=Ned(-10.2, 0.0, 0.0)))
    assert standoff(point(north, 0.0, 60.0), about, LIMITS).passed == passed


# ---------------------------------------------------------------- who may fly


@pytest.mark.requirement("X3", "X8")
@pytest.mark.parametrize(
    ("changes", "held", "passed"),
    [
        ({}, True, True), ({}, False, False), ({"healthy": False}, True, False), ({"battery": 0.19}, True, False),
        ({"battery": 0.2}, True, True), ({"battery": math.nan}, True, False), ({"healthy": False}, False, False),
    ],
)  # fmt: skip
def test_an_unfit_drone_is_not_flown(changes: dict[str, object], held: bool, passed: bool) -> None:
    about = replace(
        seen(vehicle=replace(vehicle(sigma_h_m=0.1, sigma_v_m=0.1, yaw_deg=180.0), **changes)), authority=held
    )
    assert authority(point(0.0, 0.0, 10.0), about, LIMITS).passed == passed
    assert (ask(Command.GO_UP, about).plan is not None) == passed


@pytest.mark.parametrize(("sigma_m", "confidence"), [(0.0, 1.0), (1.0, 0.8), (2.0, 0.5), (4.0, 0.2), (6.0, 0.1)])
def test_confidence_falls_with_the_square(sigma_m: float, confidence: float) -> None:
    assert confidence_of(sigma_m, 2.0) == pytest.approx(confidence)


# ---------------------------------------------------------------- what is granted, judged anew


def least_apart_m(decision: Decision, wall_m: float, other: Ned, velocity: Ned) -> tuple[float, float]:
    """Least distance to a wall that faces south at wall_m, coasting included, and to an aircraft, in 10 ms steps for 12 s."""
    plan = decision.plan
    assert plan is not None
    to_wall = wall_m - (plan.goal.north + plan.stop_m * plan.direction.north)
    to_other = min(
        plan.position(0.01 * i).minus(Ned(*(p + 0.01 * i * v for p, v in zip(other, velocity, strict=True)))).norm
        for i in range(1200)
    )
    return to_wall, to_other


@pytest.mark.requirement("R4", "R6")
@settings(max_examples=120, deadline=None)
@given(
    st.floats(2.2, 4.0),
    st.floats(-8.0, 8.0),
    st.floats(-12.0, 12.0),
    st.floats(-4.0, 4.0),
    st.floats(-4.0, 4.0),
    st.sampled_from([180.0, 90.0, -120.0, 20.0]),
)
def test_what_is_shortened_for_one_rule_keeps_every_other(
    wall_m: float, north: float, east: float, v_north: float, v_east: float, yaw_deg: float
) -> None:
    """A wall ahead shortens the move; another aircraft crosses meanwhile; a nose that is away turns first."""
    other, velocity = START.plus(Ned(north, east, 0.0)), Ned(v_north, v_east, 0.0)
    about = seen(
        vehicle=vehicle(sigma_h_m=0.1, sigma_v_m=0.1, yaw_deg=yaw_deg),
        neighbours=sky(("blue", other, velocity, 0.1, NOW_S)),
        world=world(obstacles=wall(wall_m)),
    )
    made = ask(Command.GO_FORWARD, about)
    if made.plan is None or other.minus(START).norm < 3.7:
        return
    to_wall, to_other = least_apart_m(made, wall_m, other, velocity)
    assert to_wall >= 1.5 + 0.3 + 0.2 - 1e-6
    assert to_other >= 3.0 + 0.3 + 0.2 + 0.2 - 0.02


@pytest.mark.requirement("R6", "P2")
def test_a_shortened_plan_that_another_rule_forbids_is_not_granted() -> None:
    """The wall leaves 0.7 m. Another drone hovers beside where that ends: the full move is refused for both."""
    blue = ("blue", START.plus(Ned(1.3, 3.6, 0.0)), Ned(0.0, 0.0, 0.0), 0.1, NOW_S)
    about = seen(world=world(obstacles=wall(3.2)), neighbours=sky(blue))
    assert ask(Command.GO_FORWARD, replace(about, neighbours=sky())).verdict is Verdict.REDUCED
    made = ask(Command.GO_FORWARD, about)
    assert made.plan is None or made.plan.goal.minus(START.plus(Ned(1.3, 3.6, 0.0))).norm >= 3.7


@pytest.mark.requirement("R6")
def test_a_shortened_plan_stays_in_nobodys_way_that_the_full_one_had_left() -> None:
    """A wall to the right leaves half a metre. Somebody will pass to the left: a metre would be far enough, half is not."""
    passes = sky(("blue", START.plus(Ned(24.0, -3.25, 0.0)), Ned(-4.0, 0.0, 0.0), 0.1, NOW_S))
    hedge = Obstacles.of(["hedge"], [shapely.box(-50.0, 2.98, 50.0, 4.0)], [0.0], [30.0], 0.0)
    assert ask(Command.GO_RIGHT, seen(neighbours=passes)).verdict is Verdict.APPROVED
    assert ask(Command.GO_RIGHT, seen(world=world(obstacles=hedge))).verdict is Verdict.REDUCED
    made = ask(Command.GO_RIGHT, seen(neighbours=passes, world=world(obstacles=hedge)))
    assert made.plan is None or made.plan.goal.east + made.plan.stop_m + 3.25 >= 3.7 + made.plan.stop_m


def test_a_delay_is_given_once() -> None:
    passing = sky(("blue", START.plus(Ned(-6.0, 3.5, 0.0)), Ned(5.0, 0.0, 0.0), 0.1, NOW_S))
    about = seen(neighbours=passing)
    assert ask(Command.GO_RIGHT, about, may_delay=True).verdict is Verdict.DELAYED
    assert ask(Command.GO_RIGHT, about).verdict in (Verdict.REJECTED, Verdict.REDUCED)


# ---------------------------------------------------------------- what is measured


@pytest.mark.parametrize(("wall_m", "actual"), [(1.52, False), (1.48, True)])
@pytest.mark.parametrize("sigma_m", [0.0, 0.5, 2.0])
def test_a_bare_limit_is_broken_by_the_best_estimate_alone(wall_m: float, actual: bool, sigma_m: float) -> None:
    about = seen(vehicle=vehicle(sigma_h_m=sigma_m, sigma_v_m=sigma_m), world=world(obstacles=wall(wall_m)))
    found = watch(about, None, 0.0, 0.0, {}, LIMITS)
    assert any(b.kind == "actual" for b in found.breaches) == actual


@pytest.mark.requirement("X6")
def test_nowhere_is_no_place_to_fly() -> None:
    empty = World(None, Obstacles.none(), None)
    for command in (Command.GO_UP, Command.TURN_LEFT):
        assert ask(command, seen(world=empty)).verdict is Verdict.REJECTED


# ---------------------------------------------------------------- what cannot be planned, what is old


@pytest.mark.requirement("X6")
@pytest.mark.parametrize(
    ("command", "asked_m", "primitive"),
    [(Command.GO_LEFT, 1.0, Primitive.MOVE_LEFT), (Command.TURN_LEFT, None, Primitive.SCAN_LEFT)],
)
def test_what_cannot_be_planned_is_refused_as_what_was_asked(
    command: Command, asked_m: float | None, primitive: Primitive
) -> None:
    lost = vehicle(sigma_h_m=0.1, sigma_v_m=0.1, yaw_deg=math.nan)
    made = ask(command, seen(vehicle=lost))
    assert (made.request_id, made.primitive, made.verdict) == ("r", primitive, Verdict.REJECTED)
    assert (made.requested_m, made.granted_m, made.plan) == (asked_m, None, None)
    assert [f.constraint for f in made.findings] == ["localization"]


@pytest.mark.requirement("R6", "X11")
@pytest.mark.parametrize("age_s", [0.5, -0.5, 0.0])
def test_who_was_seen_a_moment_ago_may_be_nearer_by_what_can_be_flown_since(age_s: float) -> None:
    """At rest 7 m away: 3 m, the tube of 0.3 m, and a quarter of a metre in half a second at 2 m/s^2, also of a clock ahead."""
    blue = ("blue", START.plus(Ned(0.0, 7.0, 0.0)), Ned(0.0, 0.0, 0.0), 0.0, NOW_S - age_s)
    about = situation(vehicle=vehicle(sigma_h_m=0.0, sigma_v_m=0.0), neighbours=sky(blue))
    expected_m = 7.0 - 3.3 - (0.25 if age_s else 0.0)
    assert number(separation(point(0.0, 0.0, 10.0), about, LIMITS)) == pytest.approx(expected_m)


@pytest.mark.requirement("R6")
@pytest.mark.parametrize(("after_s", "delayed"), [(1.0, True), (2.9, True), (3.6, False), (30.0, False)])
def test_a_delay_is_for_what_clears_within_its_time(after_s: float, delayed: bool) -> None:
    """Somebody's volume beside the drone ends so many seconds from now; a delay lasts 3 s."""
    left = START.plus(Ned(0.0, -2.0, 0.0))
    lease = ReservedVolume("blue", left, left, 1.5, NOW_S - 1.0, NOW_S + after_s)
    made = ask(Command.GO_LEFT, seen(reservations=(lease,)), may_delay=True)
    assert (made.verdict is Verdict.DELAYED) == delayed


@pytest.mark.requirement("R6", "X6")
@pytest.mark.parametrize(("feed_s", "delayed"), [(1.5, True), (4.0, True), (4.0078125, False)])
def test_a_delay_is_for_a_feed_that_may_come_back(feed_s: float, delayed: bool) -> None:
    """Heard again within 3 s of having been missed for a second."""
    made = ask(Command.GO_LEFT, seen(neighbours=sky(feed_at_s=NOW_S - feed_s)), may_delay=True)
    assert (made.verdict is Verdict.DELAYED) == delayed


@pytest.mark.requirement("P3")
def test_the_shortest_maneuver_is_not_shortened() -> None:
    short = replace(LIMITS, lateral_step_m=0.1)
    about = seen(world=world(obstacles=wall(1.9)))
    assert ask(Command.GO_FORWARD, about, short).verdict is Verdict.REJECTED
