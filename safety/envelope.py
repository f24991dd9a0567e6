"""The flight envelope: what any plan may ask of the vehicle. Source: R8, G6, paper III-F (flight envelope), table I."""

from __future__ import annotations

import math

from safety.declarations import ENVELOPE
from safety.findings import amount
from safety.limits import Limits
from safety.planner import stopping_m
from safety.situation import Situation
from safety.vocabulary import Finding, Plan, Primitive

ROUNDING = 1e-6
"""Relative: a plan made to be exactly as large as allowed is."""


def envelope(plan: Plan, situation: Situation, limits: Limits) -> Finding:
    """Displacement, speeds, accelerations, yaw rate and duration within the bounds. The worst relative margin is reported.

    The way back to the anchor may be as long as the workspace is wide: it is no step of the operator's. A plan starts at
    rest: what the drone still coasts may not leave the tube about the path, which is what every distance counts with.
    """
    goal, direction = plan.goal, plan.direction
    move = goal.minus(plan.start)
    home = plan.primitive is Primitive.RETURN
    sideways_m = limits.workspace_m if home else limits.lateral_step_m
    upright_m = limits.workspace_m if home else limits.vertical_step_m
    turn_deg_s = limits.yaw_rate_deg_s
    peak_m_s = plan.peak_speed_m_s
    longest_s = plan.duration_s * limits.duration_factor + limits.duration_extra_s
    coasting_m = stopping_m(situation.vehicle.velocity.norm, limits)
    # (what, value, bound, unit)
    asked = (
        ("sideways step", move.horizontal, sideways_m, "m"),
        ("vertical step", abs(move.down), upright_m, "m"),
        ("speed", peak_m_s * direction.norm, limits.speed_m_s, "m/s"),
        ("descent speed", peak_m_s * max(direction.down, 0.0), limits.descend_speed_m_s, "m/s"),
        ("acceleration", plan.move.acceleration if plan.length_m > 0.0 else 0.0, limits.acceleration_m_s2, "m/s\N{SUPERSCRIPT TWO}"),
        ("turn rate", plan.peak_yaw_rate_deg_s, turn_deg_s, "deg/s"),
        ("duration", plan.max_duration_s, longest_s, "s"),
        ("coasting before it starts", coasting_m, limits.tracking_m, "m"),
    )  # fmt: skip
    worst = None
    for what, value, bound, unit in asked:
        margin = bound - value
        if not math.isfinite(margin):
            return ENVELOPE.refused(unit, f"the plan's {what} is not finite")
        if abs(margin) <= ROUNDING * bound:
            margin = 0.0
        relative = margin / bound if bound > 0.0 else math.copysign(math.inf, margin) if margin else 0.0
        if worst is None or relative < worst[0]:
            worst = (relative, margin, unit, f"{what} {amount(value, unit)}, at most {amount(bound, unit)}")
    assert worst is not None
    _, margin, unit, text = worst
    return ENVELOPE.finding(margin, unit, margin >= 0.0, text)
