"""Intent and state to a bounded candidate plan: pi_cand = Plan(intent, x). Source: R2, R7, R8, paper III-B, III-G."""

from __future__ import annotations

import math

import numpy as np

from safety.frames import bearing_deg, operator_direction, wrap_deg
from safety.limits import Limits
from safety.vocabulary import Ned, Path, Plan, Primitive, Profile

SPACING_M = 0.1
POINTS_MOST = 512
"""A path has no more points than this, however long it is: coarser is judged more strictly, and work stays bounded (X6)."""
FACING_DEG = 15.0
"""A nose further off the operator's bearing than this turns before the drone moves."""
ABOVE_M = 1e-6
STILL = Ned(0.0, 0.0, 0.0)


def full_length_m(primitive: Primitive, limits: Limits) -> float:
    """How far the primitive goes when nothing shortens it (m); 0 for scans. Source: paper table I."""
    if primitive.is_scan:
        return 0.0
    return limits.vertical_step_m if primitive in (Primitive.ASCEND, Primitive.DESCEND) else limits.lateral_step_m


def full_speed_m_s(primitive: Primitive, limits: Limits) -> float:
    """How fast the primitive goes when nothing slows it (m/s). Source: paper table I (down: half)."""
    return limits.descend_speed_m_s if primitive in (Primitive.DESCEND, Primitive.RETURN) else limits.speed_m_s


def stopping_m(speed_m_s: float, limits: Limits) -> float:
    """How far the vehicle coasts when told to hold at this speed: its lag, then braking. Source: X11."""
    return speed_m_s * limits.lag_s + speed_m_s * speed_m_s / (2.0 * limits.stop_deceleration_m_s2)


def length_reaching_m(reach_m: float, speed_m_s: float, limits: Limits) -> float:
    """How long a straight move may be that ends, stopping distance included, reach_m from its start. Source: X11."""
    # A longer one coasts as far as any; a short one never gets to its speed.
    length_m = reach_m - stopping_m(speed_m_s, limits)
    if length_m >= speed_m_s**2 / limits.acceleration_m_s2:
        return length_m
    per_square = 1.0 / limits.acceleration_m_s2 + 0.5 / limits.stop_deceleration_m_s2
    peak_m_s = (math.sqrt(limits.lag_s**2 + 4.0 * per_square * reach_m) - limits.lag_s) / (2.0 * per_square)
    return float(peak_m_s**2 / limits.acceleration_m_s2)


def plan_translation(
    primitive: Primitive,
    start: Ned,
    yaw_deg: float,
    operator: Ned,
    length_m: float,
    limits: Limits,
    slowness: float = 1.0,
) -> Plan:
    """One straight move of length_m along the operator's direction, ending with the nose on the operator.

    slowness: divides the speed (1 = as fast as the envelope allows). Raises ValueError where the operator's frame has no
    direction (the drone straight above the operator).
    """
    direction = operator_direction(primitive, operator, start)
    speed_m_s = full_speed_m_s(primitive, limits) / slowness
    return _straight(primitive, start, yaw_deg, operator, direction, length_m, speed_m_s, limits)


def plan_return(
    start: Ned, yaw_deg: float, operator: Ned, anchor: Ned, limits: Limits, anchor_yaw_deg: float | None = None
) -> Plan:
    """The straight way back to the anchor at the descent speed. Source: paper III (ReturnToAnchor), design 14.

    anchor_yaw_deg: how the nose pointed there, which it does again at the end (psi of the anchor); None: at the operator.

    Raises ValueError where the anchor is so far that this is no way within the workspace.
    """
    way = anchor.minus(start)
    length_m = way.norm
    if not length_m <= 2.0 * limits.workspace_m:
        raise ValueError("the anchor is nowhere near")
    direction = Ned(*(c / length_m for c in way)) if length_m > 1e-6 else STILL
    speed_m_s = limits.descend_speed_m_s
    return _straight(Primitive.RETURN, start, yaw_deg, operator, direction, length_m, speed_m_s, limits, anchor_yaw_deg)


def plan_scan(primitive: Primitive, start: Ned, yaw_deg: float, operator: Ned, left_deg: float, limits: Limits) -> Plan:
    """One slow rotation of left_deg (360 unless continued), ended on the operator's bearing. Source: X9, design 13.

    Left is the operator's left: the nose, which points at the operator, swings to the operator's left (clockwise from
    above). A nose that is away from the operator turns further in the same sense, so that a full rotation stays one.
    """
    sign = 1.0 if primitive is Primitive.SCAN_LEFT else -1.0
    # What must be added, in the sense of the turn, to end on the bearing.
    further_deg = wrap_deg(sign * (_facing_deg(start, operator, yaw_deg) - yaw_deg) - left_deg)
    if further_deg < -FACING_DEG:
        further_deg += 360.0
    turn_deg = sign * (left_deg + further_deg)
    turn = Profile(abs(turn_deg), limits.yaw_rate_deg_s, limits.yaw_acceleration_deg_s2)
    move = Profile(0.0, limits.speed_m_s, limits.acceleration_m_s2)
    return Plan(
        primitive, start, STILL, move, yaw_deg, turn_deg, turn, False, _max_duration_s(turn.duration_s, limits), 0.0
    )


def swept(plan: Plan, limits: Limits) -> Path:
    """The polyline that the rules check: the turn before the move, the whole move, the stopping distance. Source: X11."""
    length_m, until_s = plan.length_m, plan.max_duration_s
    if length_m <= 0.0:
        return Path(np.array([plan.start, plan.start]), np.array([0.0, plan.duration_s]), until_s=until_s)
    n = spaced(length_m)
    covered_m = [length_m * i / (n - 1) for i in range(n)]
    times_s = [plan.move_from_s + plan.move.time_at(s) for s in covered_m]
    if plan.move_from_s > 0.0:
        # While the nose turns to the operator the drone hovers at the start, and others fly on.
        covered_m, times_s = [0.0, *covered_m], [0.0, *times_s]
    if plan.stop_m > 0.0:
        pieces = spaced(plan.stop_m) - 1
        covered_m += [length_m + plan.stop_m * (i + 1) / pieces for i in range(pieces)]
        end_s = times_s[-1]
        times_s += [end_s + limits.lag_s * (i + 1) / pieces for i in range(pieces)]
    (north, east, down), (d_north, d_east, d_down) = plan.start, plan.direction
    points = np.array([(north + d_north * s, east + d_east * s, down + d_down * s) for s in covered_m])
    return Path(points, np.array(times_s), plan.stop_m, until_s)


def spaced(length_m: float) -> int:
    """How many points a straight piece of path has."""
    return min(max(2, math.ceil(length_m / SPACING_M) + 1), POINTS_MOST)


def _straight(
    primitive: Primitive,
    start: Ned,
    yaw_deg: float,
    operator: Ned,
    direction: Ned,
    length_m: float,
    speed_m_s: float,
    limits: Limits,
    goal_yaw_deg: float | None = None,
) -> Plan:
    """goal_yaw_deg: where the nose points at the end; None: at the operator."""
    move = Profile(length_m, speed_m_s, limits.acceleration_m_s2)
    goal = start.plus(Ned(*(c * length_m for c in direction)))
    facing_deg = _facing_deg(goal, operator, yaw_deg)
    turn_deg = wrap_deg((goal_yaw_deg if goal_yaw_deg is not None else facing_deg) - yaw_deg)
    turn = Profile(abs(turn_deg), limits.yaw_rate_deg_s, limits.yaw_acceleration_deg_s2)
    face_first = abs(wrap_deg(_facing_deg(start, operator, yaw_deg) - yaw_deg)) > FACING_DEG
    nominal_s = max(move.duration_s + (turn.duration_s if face_first else 0.0), turn.duration_s)
    return Plan(
        primitive,
        start,
        direction,
        move,
        yaw_deg,
        turn_deg,
        turn,
        face_first,
        _max_duration_s(nominal_s, limits),
        stopping_m(move.peak, limits),
    )


def _facing_deg(place: Ned, operator: Ned, yaw_deg: float) -> float:
    """The bearing of the operator; straight above the operator there is none: the nose stays where it is.

    Raises ValueError where it cannot be known: a setpoint that is not finite would be flown (X6).
    """
    facing_deg = yaw_deg if place.minus(operator).horizontal <= ABOVE_M else bearing_deg(place, operator)
    if not (math.isfinite(facing_deg) and math.isfinite(yaw_deg) and place.finite):
        raise ValueError("the drone's heading, its place or yours is unknown")
    return facing_deg


def _max_duration_s(nominal_s: float, limits: Limits) -> float:
    return nominal_s * limits.duration_factor + limits.duration_extra_s
