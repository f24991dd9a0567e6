"""The registry of constraints: Safe(pi, x, T, D, C) is the conjunction of these rules. Source: paper III-F, III-G.

A rule is one named, pure predicate that returns a finding with a margin. A maneuver runs only if every one passes.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from enum import Enum
from typing import NamedTuple

import numpy as np

from safety import confidence, spatial
from safety import separation as others
from safety.envelope import envelope
from safety.findings import SPARE_M
from safety.limits import Limits
from safety.situation import Situation, World
from safety.vocabulary import Finding, ManeuverRequest, Ned, Path, Plan


class Subject(Enum):
    """What a rule looks at beside the limits."""

    PATH = "path"
    """(path, situation, limits)"""
    PLAN = "plan"
    """(plan, situation, limits)"""
    REQUEST = "request"
    """(request, limits)"""


class Rule(NamedTuple):
    """One constraint by its name, the requirements it serves, and the predicate."""

    name: str
    requirements: tuple[str, ...]
    check: Callable[..., Finding]
    subject: Subject = Subject.PATH
    hard: bool = False
    """Violating it in flight is a violation of safety, not only a reason not to start."""


RULES: tuple[Rule, ...] = (
    Rule("authority", ("X3",), confidence.authority),
    Rule("input_confidence", ("R11", "G1", "P2"), confidence.input_confidence, Subject.REQUEST),
    Rule("localization", ("R11", "X6"), confidence.localization),
    Rule("terrain_confidence", ("R11", "X6"), confidence.terrain_confidence),
    Rule("neighbour_age", ("R11", "X6"), others.neighbour_age),
    Rule("envelope", ("R8", "G6"), envelope, Subject.PLAN, hard=True),
    Rule("workspace", ("R7",), spatial.workspace, hard=True),
    Rule("session", ("X1",), spatial.session, hard=True),
    Rule("geofence", ("G4",), spatial.geofence, hard=True),
    Rule("standoff", ("X2",), spatial.standoff, hard=True),
    Rule("terrain_clearance", ("R3", "R4", "G2"), spatial.terrain_clearance, hard=True),
    Rule("agl", ("R3", "G5"), spatial.agl, hard=True),
    Rule("obstacle_clearance", ("R3", "R4", "G2"), spatial.obstacle_clearance, hard=True),
    Rule("separation", ("R5", "R6", "G3"), others.separation, hard=True),
    Rule("reservation", ("R5", "X10"), others.reservation),
)


def findings(
    path: Path,
    situation: Situation,
    limits: Limits,
    plan: Plan | None = None,
    request: ManeuverRequest | None = None,
    rules: tuple[Rule, ...] = RULES,
) -> tuple[Finding, ...]:
    """What every rule says. Rules about a plan or a request are left out where there is none (a monitored path)."""
    found = []
    for rule in rules:
        if rule.subject is Subject.PATH:
            found.append(rule.check(path, situation, limits))
        elif rule.subject is Subject.PLAN:
            if plan is not None:
                found.append(rule.check(plan, situation, limits))
        elif request is not None:
            found.append(rule.check(request, limits))
    return tuple(found)


def nearby(
    situation: Situation,
    path: Path,
    limits: Limits,
    cut: Callable[[World, Ned, float, Ned], World] = World.near,
) -> Situation:
    """The situation without what cannot fail a rule on this path or a part of it; for many cheap decisions.

    Margins are the same, but those to what stands still are cut off at SPARE_M or more beyond what is required. It holds for
    paths that start where this one does, stay in the box about it, end no later and have no more slack. cut: how to cut
    the world down to a reach about a box.
    """
    vehicle, world = situation.vehicle, situation.world
    terrain = world.terrain
    points = path.points_ned_m.tolist()
    box = [(min(along), max(along)) for along in zip(*points, strict=True)]
    centre, half = Ned(*(0.5 * (low + high) for low, high in box)), Ned(*(0.5 * (high - low) for low, high in box))
    # From anywhere on the path it must still be seen as far as required, and the spare beyond.
    reach_m = max(limits.clearance_m, limits.obstacle_clearance_m, limits.min_agl_m) + SPARE_M + 0.1
    sigma_m = math.hypot(spatial.checked_sigma_m(vehicle.sigma_h_m), spatial.checked_sigma_m(vehicle.sigma_v_m))
    reach_m += spatial.error_m(sigma_m, limits)
    reach_m += limits.sigma_k * (spatial.checked_sigma_m(terrain.sigma_m) if terrain is not None else 0.0)
    travel_m = max(math.dist(point, points[0]) for point in points)
    until_s = float(path.times_s[-1])
    if not (math.isfinite(reach_m + until_s) and np.isfinite(path.points_ned_m).all()):
        # Nothing can be left out; the rules will say what is missing.
        return situation
    return replace(
        situation,
        world=cut(world, centre, reach_m, half),
        neighbours=others.neighbours_that_matter(
            situation, path.points_ned_m[0], travel_m, path.slack_m, until_s, limits
        ),
    )
