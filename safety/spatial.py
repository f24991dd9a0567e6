"""Constraints on where: terrain, height, obstacles, workspace, session, geofence, standoff from the operator.

Every required distance grows by what the position may be wrong: sigma_k standard deviations and the radius of the tube
about the path that the vehicle stays in (X11). Source: paper III-E, III-F; design 2, 8, 9, 11.
"""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from safety.declarations import (
    AGL,
    GEOFENCE,
    OBSTACLE_CLEARANCE,
    SESSION,
    STANDOFF,
    TERRAIN_CLEARANCE,
    WORKSPACE,
    Constraint,
)
from safety.findings import between, gaps_m, judge, mends, once, worst
from safety.limits import Limits
from safety.situation import Situation
from safety.vocabulary import Finding, Floats, Ned, Path

if TYPE_CHECKING:
    from safety.obstacles import Obstacles
    from safety.terrain import Terrain, TerrainPatch

_AROUND = np.array(
    [(0.0, 0.0, 1.0, 0.0)]
    + [
        (level, tube * level, math.cos(a), math.sin(a))
        for level in (0.5, 1.0)
        for tube in (0.0, 1.0)
        for a in np.linspace(0.0, 2.0 * math.pi, 16, endpoint=False)
    ]
)
"""(65, 4) where the drone may be about where it is said to be: how far out, as a share of what the position may be wrong by
sideways and of the tube's radius, and in which direction."""
NO_ACCURACY = "cannot be judged: the drone's position or its accuracy is unknown"


def checked_sigma_m(sigma_m: float) -> float:
    """A stated accuracy, or NaN if it is none: a negative one is no statement."""
    return sigma_m if sigma_m >= 0.0 else math.nan


def error_m(sigma_m: float, limits: Limits) -> float:
    """How far the true position may be from where the path is, for a 1-sigma accuracy (X11); NaN: unknown."""
    return limits.sigma_k * checked_sigma_m(sigma_m) + limits.tracking_m


def terrain_clearance(path: Path, situation: Situation, limits: Limits) -> Finding:
    """3D distance of the swept path to the terrain. Source: R3, R4, G2."""
    terrain = situation.world.terrain
    if terrain is None:
        return TERRAIN_CLEARANCE.refused("m", "no terrain model: clearance cannot be judged")
    _, clearance = profile(path, terrain)
    sigma_m = situation.vehicle.sigma_m
    required_m = limits.clearance_m + error_m(sigma_m, limits) + limits.sigma_k * checked_sigma_m(terrain.sigma_m)
    margins = clearance - required_m
    found = judge(
        TERRAIN_CLEARANCE,
        margins,
        between(margins, _gaps(path)),
        "terrain",
        "{} too close to the terrain",
        _terrain_unknown("terrain clearance", required_m, terrain),
        far=True,
        mending=lambda: mends(path, lambda points: terrain.clearance_m(points) - required_m),
    )
    # Where the model has no data there may be anything, so it keeps the same distance, and there is no way out of it.
    if found.margin is not None and found.margin < 0.0 and _misses(path, terrain, required_m):
        return TERRAIN_CLEARANCE.refused("m", f"no terrain data within {required_m:.1f} m of the path")
    return found


def agl(path: Path, situation: Situation, limits: Limits) -> Finding:
    """Height above ground along the swept path. Source: R3, G5.

    Being wrong sideways over a slope is being wrong in height. Two bounds hold of the true height, and the better one
    counts: within the 3D clearance nothing is in the way of an error sideways and the height to be kept below it, and the
    true height is at least the height less the error times the slope.
    """
    terrain = situation.world.terrain
    if terrain is None:
        return AGL.refused("m", "no terrain model: height above ground cannot be judged")
    height, clearance = profile(path, terrain)
    vehicle, k = situation.vehicle, limits.sigma_k
    gaps = _gaps(path)
    level_m = error_m(vehicle.sigma_h_m, limits)
    if not terrain.is_complete and _misses(path, terrain, level_m):
        return AGL.refused("m", "no terrain data under the path")
    terrain_m = k * checked_sigma_m(terrain.sigma_m)
    stretch = math.hypot(1.0, terrain.slope)
    tilted_m = limits.tracking_m * stretch + k * (
        checked_sigma_m(vehicle.sigma_v_m) + terrain.slope * checked_sigma_m(vehicle.sigma_h_m)
    )
    # It may be wrong sideways and in height at once; what must be free is as far below as the height that is to be kept.
    down_m = limits.min_agl_m + terrain_m + k * checked_sigma_m(vehicle.sigma_v_m)
    clearance_needed_m = math.hypot(k * checked_sigma_m(vehicle.sigma_h_m), down_m) + limits.tracking_m
    height_needed_m = limits.min_agl_m + terrain_m + tilted_m
    by_clearance, by_height = clearance - clearance_needed_m, height - height_needed_m

    needed_m = limits.min_agl_m + terrain_m + k * checked_sigma_m(vehicle.sigma_v_m)

    def around_m(points: Floats) -> Floats:
        # What mends is the height above the ground everywhere under where the drone may be, not a bound of it: a place that
        # sinks is not made good by a lower one that does not.
        away_m = k * vehicle.sigma_h_m * _AROUND[:, 0] + limits.tracking_m * _AROUND[:, 1]
        around = np.stack((away_m * _AROUND[:, 2], away_m * _AROUND[:, 3], np.zeros(len(_AROUND))), axis=1)
        heights = terrain.agl_m((points[None] + around[:, None]).reshape(-1, 3)).reshape(len(around), -1)
        below_m = limits.tracking_m * np.sqrt(1.0 - _AROUND[:, 1] ** 2)
        return np.asarray((heights - below_m[:, None]).T - needed_m)

    return judge(
        AGL,
        np.maximum(by_clearance, by_height),
        np.maximum(between(by_clearance, gaps), between(by_height, gaps * stretch)),
        "height above ground", "{} too low above the ground",
        _terrain_unknown("height above ground", terrain_m + tilted_m, terrain), far=True,
        mending=lambda: mends(path, around_m),
    )  # fmt: skip


def obstacle_clearance(path: Path, situation: Situation, limits: Limits) -> Finding:
    """3D distance of the swept path to every obstacle. Source: R3, R4, G2."""
    obstacles = situation.world.obstacles
    required_m = limits.obstacle_clearance_m + error_m(situation.vehicle.sigma_m, limits)
    if not obstacles.declared:
        return OBSTACLE_CLEARANCE.finding(None, "m", True, "no obstacles are declared")
    unknown = f"obstacle clearance {NO_ACCURACY}"
    gaps = _gaps(path)
    if not len(obstacles):
        margins = obstacles.vouched_m(path.points_ned_m) - required_m
        return judge(OBSTACLE_CLEARANCE, margins, between(margins, gaps), "nearest obstacle",
                     "{} too close to an obstacle", unknown, far=True)  # fmt: skip
    all_margins = obstacles.distance_m(path.points_ned_m) - required_m
    all_between = between(all_margins, gaps)
    lowest = np.minimum.reduce(all_between if len(all_between) else all_margins)
    # Nearly always all of them pass, and the nearest is the one to tell of; otherwise each is judged by itself.
    which = range(len(obstacles)) if not lowest.min() >= 0.0 else (int(lowest.argmin()),)
    return worst(
        [
            judge(
                OBSTACLE_CLEARANCE,
                all_margins[:, i],
                all_between[:, i],
                obstacles.names[i],
                f"{{}} too close to {_plain(obstacles.names[i])}",
                unknown,
                far=True,
                mending=partial(mends, path, partial(_apart_m, obstacles, i, required_m)),
                of=f"{obstacles.names[i]} ({obstacles.numbers[i]})",
                subject=obstacles.names[i],
            )
            for i in which
        ]
    )


def _apart_m(obstacles: Obstacles, i: int, required_m: float, points: Floats) -> Floats:
    """(m,) distance of (m, 3) points to one obstacle, beyond what is required."""
    return np.asarray(obstacles.distance_m(points)[:, i] - required_m)


def workspace(path: Path, situation: Situation, limits: Limits) -> Finding:
    """The ball about the anchor. Source: R7, paper III-D. Relative, so only drift since the anchor counts (design 2)."""
    radius_m = limits.workspace_m - _drift_m(situation, situation.anchor.at_s, limits)
    return _ball(WORKSPACE, path, situation.anchor.position, radius_m, "workspace",
                 "{} outside the workspace about the anchor")  # fmt: skip


def session(path: Path, situation: Situation, limits: Limits) -> Finding:
    """The ball about the place of pairing, which no sum of moves leaves. Source: X1, design 2."""
    radius_m = limits.session_m - _drift_m(situation, situation.paired_at_s, limits)
    return _ball(SESSION, path, situation.session_centre, radius_m, "session area",
                 "{} too far from where pairing happened")  # fmt: skip


def geofence(path: Path, situation: Situation, limits: Limits) -> Finding:
    """Inside the fence, outside its no-fly areas, between floor and ceiling, all along. Source: G4."""
    fence = situation.world.geofence
    if fence is None:
        return GEOFENCE.finding(None, "m", True, "no geofence is declared")
    level_error_m = error_m(situation.vehicle.sigma_h_m, limits)
    upright_error_m = error_m(situation.vehicle.sigma_v_m, limits)
    level = fence.level_m(path.points_ned_m) - level_error_m
    upright = fence.upright_m(path.points_ned_m) - upright_error_m
    unknown = f"geofence {NO_ACCURACY}"
    side = judge(GEOFENCE, level, between(level, _gaps(path)), "geofence",
                 "{} too close to the geofence or beyond it", unknown, far=True, of="sides",
                 mending=lambda: mends(path, lambda points: fence.level_m(points) - level_error_m))  # fmt: skip
    if fence.is_open_above_and_below:
        return side
    # Floor and ceiling are planes, so heights between two samples lie between theirs.
    return worst([side, judge(GEOFENCE, upright, None, "geofence floor and ceiling",
                              "{} beyond the geofence's floor or ceiling", unknown, of="floor and ceiling",
                              mending=lambda: mends(path, lambda points: fence.upright_m(points) - upright_error_m))])  # fmt: skip


def standoff(path: Path, situation: Situation, limits: Limits) -> Finding:
    """Horizontal distance to the operator, who is a person. Source: X2, design 11."""
    operator = situation.operator
    north, east, _ = operator.position
    required_m = limits.standoff_m + error_m(situation.vehicle.sigma_h_m, limits)
    required_m += limits.sigma_k * checked_sigma_m(operator.sigma_m)
    margins = np.array([math.hypot(n - north, e - east) - required_m for n, e, _ in _points(path)])

    def along(points: Floats) -> Floats:
        return np.asarray(np.hypot(points[:, 0] - north, points[:, 1] - east) - required_m)

    return judge(STANDOFF, margins, between(margins, _gaps(path)), "distance to you", "{} too close to you",
                 "distance to you cannot be judged: your position, the drone's or their accuracy is unknown",
                 mending=lambda: mends(path, along))  # fmt: skip


@once
def profile(path: Path, terrain: Terrain | TerrainPatch) -> tuple[Floats, Floats]:
    """(n,) height above ground and distance to the ground."""
    if not np.isfinite(path.points_ned_m).all():
        nowhere = np.full(len(path.points_ned_m), np.nan)
        return nowhere, nowhere
    height = terrain.agl_m(path.points_ned_m)
    return height, terrain.clearance_m(path.points_ned_m, agl_m=height)


_gaps = once(gaps_m)


def _misses(path: Path, terrain: Terrain | TerrainPatch, apart_m: float) -> bool:
    """Does the path come within apart_m, horizontally, of where there is no data?"""
    unknown = terrain.unknown_m(path.points_ned_m)
    lowest = min(float(unknown.min()), float(between(unknown, _gaps(path)).min(initial=math.inf)))
    return lowest < apart_m


def _terrain_unknown(what: str, required_m: float, terrain: Terrain | TerrainPatch) -> str:
    if math.isfinite(required_m):
        return f"{what} cannot be judged: no terrain data there"
    if not math.isfinite(checked_sigma_m(terrain.sigma_m)):
        return f"{what} cannot be judged: the terrain model states no accuracy"
    return f"{what} {NO_ACCURACY}"


@once
def _points(path: Path) -> list[list[float]]:
    """The path's points as plain numbers: of so few, plain arithmetic is faster."""
    return path.points_ned_m.tolist()  # type: ignore[no-any-return]


def _ball(constraint: Constraint, path: Path, centre: Ned, radius_m: float, what: str, lack: str) -> Finding:
    """Inside a ball about a place all along. A ball is convex: what holds at two points holds between them."""
    margins = [radius_m - math.dist(point, centre) for point in _points(path)]

    def along(points: Floats) -> Floats:
        return np.asarray(radius_m - np.sqrt(((points - np.array(centre)) ** 2).sum(axis=1)))

    return judge(constraint, margins, None, what, lack, f"{what} {NO_ACCURACY}",
                 mending=lambda: mends(path, along))  # fmt: skip


def _drift_m(situation: Situation, since_s: float, limits: Limits) -> float:
    """What counts against a limit relative to a place the drone itself recorded at since_s."""
    drifted_m = limits.drift_m_s * abs(situation.now_s - since_s)
    sigma_m = checked_sigma_m(situation.vehicle.sigma_m)
    return error_m(math.nan if math.isnan(sigma_m) else min(drifted_m, sigma_m), limits)


def _plain(label: str) -> str:
    """A name inside a format string."""
    return label.replace("{", "{{").replace("}", "}}")
