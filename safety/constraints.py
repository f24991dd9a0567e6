"""The registry of constraints: Safe(pi, x, T, D, C) is the conjunction of these rules. Source: paper III-F, III-G.

A rule is one named, pure predicate that returns a finding with a margin. A maneuver runs only if every one passes.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from safety import confidence, spatial
from safety import declarations as d
from safety import separation as others
from safety.declarations import Constraint
from safety.envelope import envelope
from safety.findings import SPARE_M
from safety.limits import Limits
from safety.situation import Situation, near_as_before
from safety.vocabulary import Finding, ManeuverRequest, Ned, Path, Plan


@dataclass(frozen=True, slots=True)
class PathRule:
    """A constraint of the path that is swept; the monitor asks it about the measured state too."""

    constraint: Constraint
    check: Callable[[Path, Situation, Limits], Finding]

    @property
    def name(self) -> str:
        return self.constraint.name


@dataclass(frozen=True, slots=True)
class PlanRule:
    """A constraint of the plan itself."""

    constraint: Constraint
    check: Callable[[Plan, Situation, Limits], Finding]

    @property
    def name(self) -> str:
        return self.constraint.name


@dataclass(frozen=True, slots=True)
class RequestRule:
    """A constraint of what was asked, whatever the situation."""

    constraint: Constraint
    check: Callable[[ManeuverRequest, Limits], Finding]

    @property
    def name(self) -> str:
        return self.constraint.name


Rule = PathRule | PlanRule | RequestRule

RULES: tuple[Rule, ...] = (
    PathRule(d.AUTHORITY, confidence.authority),
    RequestRule(d.INPUT_CONFIDENCE, confidence.input_confidence),
    PathRule(d.LOCALIZATION, confidence.localization),
    PathRule(d.TERRAIN_CONFIDENCE, confidence.terrain_confidence),
    PathRule(d.NEIGHBOUR_AGE, others.neighbour_age),
    PlanRule(d.ENVELOPE, envelope),
    PathRule(d.WORKSPACE, spatial.workspace),
    PathRule(d.SESSION, spatial.session),
    PathRule(d.GEOFENCE, spatial.geofence),
    PathRule(d.STANDOFF, spatial.standoff),
    PathRule(d.TERRAIN_CLEARANCE, spatial.terrain_clearance),
    PathRule(d.AGL, spatial.agl),
    PathRule(d.OBSTACLE_CLEARANCE, spatial.obstacle_clearance),
    PathRule(d.SEPARATION, others.separation),
    PathRule(d.RESERVATION, others.reservation),
)
DECLARED: dict[str, Constraint] = {
    each.name: each for each in (*(rule.constraint for rule in RULES), d.PAIRED, d.PROPERTY, d.CONTRADICTION)
}
"""By name. A finding names one of these."""


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
        match rule:
            case PathRule():
                found.append(rule.check(path, situation, limits))
            case PlanRule() if plan is not None:
                found.append(rule.check(plan, situation, limits))
            case RequestRule() if request is not None:
                found.append(rule.check(request, limits))
    return tuple(found)


def nearby(
    situation: Situation,
    path: Path,
    limits: Limits,
) -> Situation:
    """The situation without what cannot fail a rule on this path or a part of it; for many cheap decisions.

    Margins are the same, but those to what stands still are cut off at SPARE_M or more beyond what is required. It holds for
    paths that start where this one does, stay in the box about it, end no later and have no more slack.
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
        world=near_as_before(world, centre, reach_m, half),
        neighbours=others.neighbours_that_matter(
            situation, path.points_ned_m[0], travel_m, path.along_track_tolerance_m, until_s, limits
        ),
    )
