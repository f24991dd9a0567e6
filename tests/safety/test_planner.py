"""Plans are bounded, in the operator's frame, and swept whole. R2, R8, X9, X11, paper table I."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from safety.frames import bearing_deg, operator_direction, wrap_deg
from safety.planner import (
    FACING_DEG,
    full_length_m,
    length_reaching_m,
    plan_return,
    plan_scan,
    plan_translation,
    stopping_m,
    swept,
)
from safety.vocabulary import Ned, Plan, Primitive
from tests.safety.scene import LIMITS

OPERATOR = Ned(0.0, 0.0, 0.0)
DRONE = Ned(12.0, 5.0, -9.0)
FACING = bearing_deg(DRONE, OPERATOR)
MOVES = [p for p in Primitive if not p.is_scan and p is not Primitive.RETURN]
SCANS = [Primitive.SCAN_LEFT, Primitive.SCAN_RIGHT]
yaws = st.floats(-180.0, 180.0)


def translation(
    primitive: Primitive, yaw_deg: float = FACING, length_m: float | None = None, slowness: float = 1.0
) -> Plan:
    length_m = full_length_m(primitive, LIMITS) if length_m is None else length_m
    return plan_translation(primitive, DRONE, yaw_deg, OPERATOR, length_m, LIMITS, slowness)


def sampled(plan: Plan) -> tuple[np.ndarray, np.ndarray]:
    times = np.arange(0.0, plan.duration_s + 0.1, 0.02)
    return np.array([plan.position(t) for t in times]), np.array([plan.yaw_deg(t) for t in times])


def assert_bounded(plan: Plan, speed_m_s: float) -> None:
    points, yaws_deg = sampled(plan)
    velocity = np.diff(points, axis=0) / 0.02
    acceleration = np.diff(velocity, axis=0) / 0.02
    rate = np.diff(yaws_deg) / 0.02
    assert np.linalg.norm(velocity, axis=1).max() <= speed_m_s + 1e-6
    assert np.linalg.norm(acceleration, axis=1).max(initial=0.0) <= LIMITS.acceleration_m_s2 + 1e-6
    assert np.abs(rate).max() <= LIMITS.yaw_rate_deg_s + 1e-6
    assert np.abs(np.diff(rate) / 0.02).max(initial=0.0) <= LIMITS.yaw_acceleration_deg_s2 + 1e-4
    assert plan.duration_s <= plan.max_duration_s < math.inf
    # At rest at both ends.
    assert np.linalg.norm(velocity[[0, -1]], axis=1).max(initial=0.0) <= LIMITS.acceleration_m_s2 * 0.02


@pytest.mark.requirement("R8", "G6")
@settings(max_examples=40)
@given(st.sampled_from(MOVES), yaws, st.floats(0.001, 5.0), st.sampled_from([1.0, 2.0, 4.0]))
def test_a_move_never_exceeds_its_bounds(
    primitive: Primitive, yaw_deg: float, length_m: float, slowness: float
) -> None:
    """R8, G6: sampled at 50 Hz as it is flown."""
    plan = translation(primitive, yaw_deg, length_m, slowness)
    full = LIMITS.descend_speed_m_s if primitive is Primitive.DESCEND else LIMITS.speed_m_s
    assert_bounded(plan, full / slowness)
    assert plan.goal.minus(plan.start).norm == pytest.approx(length_m)


@pytest.mark.requirement("R8")
@settings(max_examples=30)
@given(st.sampled_from(SCANS), yaws, st.floats(1.0, 360.0))
def test_a_scan_never_exceeds_its_bounds(primitive: Primitive, yaw_deg: float, left_deg: float) -> None:
    plan = plan_scan(primitive, DRONE, yaw_deg, OPERATOR, left_deg, LIMITS)
    assert_bounded(plan, 0.0)
    assert plan.length_m == 0.0


@pytest.mark.requirement("X9")
@given(st.sampled_from(SCANS), yaws)
def test_a_scan_is_one_full_rotation_that_ends_facing_the_operator(primitive: Primitive, yaw_deg: float) -> None:
    """X9: psi_final is the operator's bearing, and a nose that was away does not shorten the turn."""
    plan = plan_scan(primitive, DRONE, yaw_deg, OPERATOR, 360.0, LIMITS)
    assert wrap_deg(plan.yaw_deg(plan.duration_s) - FACING) == pytest.approx(0.0, abs=1e-6)
    assert 360.0 - FACING_DEG - 1e-6 <= abs(plan.turn_deg) <= 720.0
    assert (plan.turn_deg > 0.0) == (primitive is Primitive.SCAN_LEFT), "the nose swings to the operator's left"


@pytest.mark.requirement("X9")
def test_a_scan_from_the_operators_bearing_is_exactly_360() -> None:
    assert plan_scan(Primitive.SCAN_RIGHT, DRONE, FACING, OPERATOR, 360.0, LIMITS).turn_deg == pytest.approx(-360.0)


@pytest.mark.requirement("R2")
@pytest.mark.parametrize(("primitive", "length_m", "speed_m_s"), [
    (Primitive.MOVE_LEFT, 1.0, 0.5), (Primitive.MOVE_RIGHT, 1.0, 0.5), (Primitive.MOVE_FORWARD, 1.0, 0.5),
    (Primitive.MOVE_BACKWARD, 1.0, 0.5), (Primitive.ASCEND, 0.5, 0.5), (Primitive.DESCEND, 0.5, 0.25),
])  # fmt: skip
def test_table_one(primitive: Primitive, length_m: float, speed_m_s: float) -> None:
    plan = translation(primitive)
    assert plan.length_m == length_m
    assert plan.move.speed == speed_m_s
    assert plan.peak_speed_m_s <= speed_m_s


def test_right_is_the_operators_right_and_the_drones_own_left() -> None:
    """Paper III-A: the drone faces the operator and moves to its left."""
    drone = Ned(10.0, 0.0, -5.0)  # north of the operator, who looks north
    right = operator_direction(Primitive.MOVE_RIGHT, OPERATOR, drone)
    assert right == pytest.approx(Ned(0.0, 1.0, 0.0))  # east
    nose = math.radians(bearing_deg(drone, OPERATOR))
    own_left = Ned(math.cos(nose - math.pi / 2), math.sin(nose - math.pi / 2), 0.0)
    assert right == pytest.approx(own_left)
    assert operator_direction(Primitive.MOVE_FORWARD, OPERATOR, drone) == pytest.approx(Ned(1.0, 0.0, 0.0))  # away
    assert operator_direction(Primitive.MOVE_BACKWARD, OPERATOR, drone) == pytest.approx(Ned(-1.0, 0.0, 0.0))
    assert operator_direction(Primitive.MOVE_LEFT, OPERATOR, drone) == pytest.approx(Ned(0.0, -1.0, 0.0))


@pytest.mark.parametrize("primitive", MOVES)
def test_straight_above_the_operator(primitive: Primitive) -> None:
    above = Ned(0.0, 0.0, -9.0)
    if primitive in (Primitive.ASCEND, Primitive.DESCEND):
        plan = plan_translation(primitive, above, 40.0, OPERATOR, 0.5, LIMITS)
        assert plan.turn_deg == 0.0
        assert not plan.face_first
    else:
        with pytest.raises(ValueError, match="straight above the operator"):
            plan_translation(primitive, above, 40.0, OPERATOR, 1.0, LIMITS)


@pytest.mark.parametrize("primitive", [*SCANS, Primitive.RETURN])
def test_what_is_no_translation_has_no_direction(primitive: Primitive) -> None:
    with pytest.raises(ValueError, match="no direction"):
        operator_direction(primitive, OPERATOR, DRONE)


@pytest.mark.parametrize("off_deg", [0.0, FACING_DEG - 0.01, FACING_DEG + 0.01, 90.0, 180.0, -90.0])
def test_a_nose_that_is_away_faces_the_operator_first(off_deg: float) -> None:
    plan = translation(Primitive.MOVE_LEFT, wrap_deg(FACING + off_deg))
    assert plan.face_first == (abs(off_deg) > FACING_DEG)
    if plan.face_first:
        assert plan.position(plan.turn.duration_s) == pytest.approx(plan.start)
        assert plan.duration_s == pytest.approx(plan.turn.duration_s + plan.move.duration_s)
    assert wrap_deg(plan.yaw_deg(plan.duration_s) - bearing_deg(plan.goal, OPERATOR)) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.requirement("X11")
def test_the_swept_path_is_whole() -> None:
    """X11: from the start, and beyond the end as far as it takes to stop."""
    plan = translation(Primitive.MOVE_FORWARD)
    path = swept(plan, LIMITS)
    assert path.points_ned_m[0] == pytest.approx(plan.start)
    reach_m = np.linalg.norm(path.points_ned_m[-1] - np.array(plan.start))
    assert reach_m == pytest.approx(plan.length_m + stopping_m(plan.move.peak, LIMITS))
    assert np.linalg.norm(np.diff(path.points_ned_m, axis=0), axis=1).max() <= 0.1 + 1e-9
    assert (np.diff(path.times_s) >= 0.0).all()
    assert path.along_track_tolerance_m == plan.stop_m


def test_the_hover_while_the_nose_turns_is_part_of_the_path() -> None:
    """Others fly on meanwhile: separation at the start counts from the first moment."""
    plan = translation(Primitive.MOVE_FORWARD, wrap_deg(FACING + 120.0))
    path = swept(plan, LIMITS)
    assert path.times_s[0] == 0.0
    assert path.points_ned_m[0] == pytest.approx(path.points_ned_m[1])
    assert path.times_s[1] == pytest.approx(plan.move_from_s)


@pytest.mark.requirement("X11")
@given(st.floats(0.0, 2.0), st.floats(0.0, 2.0))
def test_stopping_grows_with_speed(slow: float, fast: float) -> None:
    slow, fast = sorted((slow, fast))
    assert stopping_m(slow, LIMITS) <= stopping_m(fast, LIMITS)


@given(st.tuples(*[st.floats(-4.0, 4.0)] * 3), yaws)
def test_the_way_back_ends_at_the_anchor(off: tuple[float, float, float], yaw_deg: float) -> None:
    anchor = DRONE.plus(Ned(*off))
    plan = plan_return(DRONE, yaw_deg, OPERATOR, anchor, LIMITS)
    assert plan.goal.minus(anchor).norm < 1e-6
    assert_bounded(plan, LIMITS.descend_speed_m_s)


@pytest.mark.requirement("X6")
@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_what_is_no_heading_is_no_plan(bad: float) -> None:
    """X6: the autopilot would take a setpoint that is not finite."""
    for plan in (
        lambda: plan_translation(Primitive.MOVE_LEFT, DRONE, bad, OPERATOR, 1.0, LIMITS),
        lambda: plan_scan(Primitive.SCAN_LEFT, DRONE, bad, OPERATOR, 360.0, LIMITS),
        lambda: plan_return(DRONE, bad, OPERATOR, DRONE, LIMITS),
    ):
        with pytest.raises(ValueError, match="heading"):
            plan()


@pytest.mark.requirement("X6")
@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_an_unknown_place_is_no_plan_either(bad: float) -> None:
    with pytest.raises(ValueError, match="heading"):
        plan_translation(Primitive.MOVE_LEFT, DRONE._replace(north=bad), FACING, OPERATOR, 1.0, LIMITS)


def test_slower_is_slower() -> None:
    assert translation(Primitive.MOVE_LEFT, slowness=2.0).peak_speed_m_s == pytest.approx(0.25)


@settings(max_examples=60)
@given(st.sampled_from(MOVES), st.floats(0.05, 3.0), st.sampled_from([1.0, 2.0, 4.0]))
def test_the_length_that_reaches_as_far_is_the_plans(primitive: Primitive, length_m: float, slowness: float) -> None:
    """Its own length and its stopping distance, below and above the length at which it gets to its speed."""
    plan = translation(primitive, FACING, length_m, slowness)
    assert length_reaching_m(plan.length_m + plan.stop_m, plan.move.speed, LIMITS) == pytest.approx(length_m)
