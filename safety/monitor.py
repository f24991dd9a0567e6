"""The runtime monitor: actual and predicted violation on every telemetry tick. Pure. Source: R9, R10, paper III-C (Monitor).

Actual: the best estimate breaks the bare limit. Predicted: with uncertainty, and the distance it takes to stop from the
measured velocity, it would.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import numpy as np

from safety.constraints import RULES, PathRule, Rule, nearby
from safety.declarations import ENVELOPE, SEPARATION, Constraint
from safety.limits import Limits
from safety.planner import spaced, stopping_m
from safety.situation import Situation, near_as_before
from safety.spatial import profile
from safety.terrain import TerrainPatch
from safety.vocabulary import POINT, Finding, Ned, Path, Plan

EASE = 0.05
"""A limit broken from the start may dip by this (m) under its first margin before it counts: estimator noise (X13).

A predicted margin may dip by the tube about the path, which was counted against the plan when it was approved.
"""
RECORDED_M = 20.0
"""How far from the drone the terrain is looked for, for the record."""
MONITORED = ("R9", "R10")
"""Why a limit is watched in flight, whichever it is."""


Kind = Literal["predicted", "actual"]
Baseline = dict[tuple[Kind, str, str], float]
"""By kind, constraint and object: the margins that were negative when a maneuver began, and the best that each has been since,
measured as they are watched (X13). What is in here is mended; what comes new is a breach."""


@dataclass(frozen=True, slots=True)
class Breach:
    """A hard constraint that is broken, or will be unless the maneuver is aborted."""

    kind: Kind
    constraint: str
    requirements: tuple[str, ...]
    margin: float | None
    unit: str
    text: str
    mending: bool = False
    """It was broken when the plan was approved, and the plan has not made it worse (X13)."""
    subject: str = ""
    """The aircraft, obstacle or holder that it is about; empty: none."""


@dataclass(frozen=True, slots=True)
class Watch:
    """What one look says. separation_m: to the nearest aircraft, None if there is none.

    clearance_m: while a plan is flown, to terrain and obstacles; the terrain is looked for within 20 m.

    negative: the baseline of the next look at the same maneuver, which may find no margin lower.
    """

    breaches: tuple[Breach, ...]
    clearance_m: float | None
    separation_m: float | None
    negative: Baseline


def watch(
    situation: Situation,
    plan: Plan | None,
    elapsed_s: float,
    speed_m_s: float,
    baseline: Baseline,
    limits: Limits,
    rules: tuple[Rule, ...] = RULES,
) -> Watch:
    """Check every hard constraint on the measured state, and that what they need is known.

    speed_m_s: filtered; elapsed_s: since the plan's start; baseline: what the last look said, empty at the first: margins
    that were negative when it began may only rise (design 8). plan None: hovering, where nothing is predicted. What cannot
    be judged is a predicted breach.
    """
    ahead = stopping_path(situation, limits)
    scene = nearby(situation, ahead, limits)
    hard, watched = _watched(rules)
    vehicle = situation.vehicle
    here = Path(np.array([vehicle.position]), np.zeros(1))
    estimate = replace(scene, vehicle=replace(vehicle, sigma_h_m=0.0, sigma_v_m=0.0))
    predicted = {rule.name: rule.check(ahead, scene, _wary(limits)) for rule in watched}
    # With all of the uncertainty a margin is no larger than without: where nothing is predicted, nothing is broken.
    now = [
        rule.check(here, estimate, _bare(limits))
        for rule in hard
        if rule.constraint is SEPARATION or _negative(predicted[rule.name])
    ]
    found: list[tuple[Kind, Finding]] = [("actual", f) for f in now if f.margin is not None and f.margin < 0.0]
    if plan is not None:
        found += [("predicted", f) for f in predicted.values() if _negative(f)]
    breaches = [_breach(kind, f, baseline, EASE if kind == "actual" else limits.tracking_m) for kind, f in found]
    if plan is not None:
        breaches += _envelope(plan, elapsed_s, speed_m_s, situation, limits)
    return Watch(
        tuple(breaches),
        _clearance_m(situation, scene, ahead, here) if plan is not None else None,
        _distance(now, SEPARATION, limits.separation_m),
        ratcheted(found, baseline),
    )


def ratcheted(found: list[tuple[Kind, Finding]], baseline: Baseline) -> Baseline:
    """The best that each margin of the baseline has been, up to zero; at the first look, what is below zero. Source: X13."""
    below = {(kind, f.constraint, of): margin for kind, f in found for of, margin in f.below if margin < 0.0}
    return {key: max(best, below.get(key, 0.0)) for key, best in baseline.items()} if baseline else below


@lru_cache(maxsize=8)
def _watched(rules: tuple[Rule, ...]) -> tuple[tuple[PathRule, ...], tuple[PathRule, ...]]:
    """The rules about a path that are hard, and all that are watched."""
    on_path = tuple(rule for rule in rules if isinstance(rule, PathRule))
    hard = tuple(r for r in on_path if r.constraint.hard)
    return hard, tuple(r for r in on_path if r.constraint.hard or r.constraint.watched)


@lru_cache(maxsize=8)
def _bare(limits: Limits) -> Limits:
    """The limits themselves: no uncertainty, no tube, nothing ahead, neighbours flying straight on."""
    return replace(
        limits, sigma_k=0.0, tracking_m=0.0, horizon_s=0.0, neighbour_acceleration_m_s2=0.0, neighbour_turn=0.0
    )


@lru_cache(maxsize=8)
def _wary(limits: Limits) -> Limits:
    """Where the drone is measured to be there is no tracking error, but all of the uncertainty."""
    return replace(limits, tracking_m=0.0, horizon_s=limits.look_ahead_s)


def stopping_path(situation: Situation, limits: Limits) -> Path:
    """From here on along the measured velocity, as far as it takes to stop."""
    vehicle = situation.vehicle
    speed_m_s = vehicle.velocity.norm
    length_m = stopping_m(speed_m_s, limits)
    if not length_m > 1e-3 or not speed_m_s <= limits.speed_plausible_m_s:
        # A speed that is not believed leads nowhere that could be judged; `localization` refuses it.
        return Path(np.array([vehicle.position]), np.zeros(1))
    fractions = np.linspace(0.0, 1.0, spaced(length_m))
    direction = np.asarray(vehicle.velocity) / speed_m_s
    points = np.asarray(vehicle.position) + np.outer(fractions * length_m, direction)
    return Path(points, fractions * (limits.lag_s + speed_m_s / limits.stop_deceleration_m_s2))


def _envelope(plan: Plan, elapsed_s: float, speed_m_s: float, situation: Situation, limits: Limits) -> list[Breach]:
    """Speed, duration and distance from the planned line. Source: R8, paper III-B (maximum duration, abort conditions)."""
    bound_m_s = plan.move.speed + limits.speed_tolerance_m_s
    moved = situation.vehicle.position.minus(plan.start)
    d = plan.direction
    along_m = moved.north * d.north + moved.east * d.east + moved.down * d.down
    across_m = moved.minus(Ned(*(c * along_m for c in d))).norm
    beyond_m = along_m - plan.length_m - plan.stop_m
    # Too fast is too fast now; the others only say that the maneuver must end, with every other limit kept.
    checks: tuple[tuple[Kind, float, str, str], ...] = (
        ("actual", bound_m_s - speed_m_s, "m/s", f"it flies {speed_m_s:.2f} m/s, more than {bound_m_s:.2f} m/s"),
        (
            "predicted",
            plan.max_duration_s - elapsed_s,
            "s",
            f"the maneuver took longer than {plan.max_duration_s:.1f} s",
        ),
        ("predicted", limits.tracking_m - across_m, "m", f"it is {across_m:.2f} m off the planned line"),
        ("predicted", limits.tracking_m - beyond_m, "m", f"it has flown {beyond_m:.2f} m too far"),
    )
    return [
        Breach(
            kind if margin < 0.0 else "predicted",
            ENVELOPE.name,
            (*ENVELOPE.requirements, *MONITORED),
            margin,
            unit,
            text,
        )
        for kind, margin, unit, text in checks
        if not margin >= 0.0
    ]


def _negative(finding: Finding) -> bool:
    # A path that mends a limit passes with a negative margin; here it is still broken.
    return not finding.passed or (finding.margin is not None and finding.margin < 0.0)


def _breach(kind: Kind, f: Finding, baseline: Baseline, ease: float) -> Breach:
    best = [baseline.get((kind, f.constraint, of), math.inf) for of, _ in f.below]
    mending = bool(f.below) and all(margin >= b - ease for b, (_, margin) in zip(best, f.below, strict=True))
    return Breach(kind, f.constraint, (*f.requirements, *MONITORED), f.margin, f.unit, f.text, mending, f.subject)


def _clearance_m(situation: Situation, scene: Situation, ahead: Path, here: Path) -> float | None:
    """The distance to terrain and obstacles, for the record; None where neither is declared or known.

    scene: the situation cut down to what is near the path ahead, which starts here.
    """
    world, place = situation.world, situation.vehicle.position
    distances: list[float] = []
    ground = scene.world.terrain
    if ground is not None and place.finite:
        # As the rules found it just before, unless it is farther than they had to look.
        clearance_m = float(profile(ahead, ground)[1][0])
        if isinstance(ground, TerrainPatch) and abs(clearance_m) >= ground.reach_m:
            wide = near_as_before(world, place, RECORDED_M, POINT).terrain
            clearance_m = float(wide.clearance_m(here.points_ned_m)[0]) if wide is not None else math.nan
        distances.append(clearance_m)
    if len(world.obstacles):
        distances += world.obstacles.distance_m(here.points_ned_m).ravel().tolist()
    least_m = min((d for d in distances if math.isfinite(d)), default=math.nan)
    return least_m if math.isfinite(least_m) else None


def _distance(findings: list[Finding], constraint: Constraint, required_m: float) -> float | None:
    """The distance behind a bare finding; None where nothing is there."""
    for f in findings:
        if f.constraint == constraint.name and f.margin is not None:
            return f.margin + required_m
    return None
