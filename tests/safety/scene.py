"""One situation in which everything passes, to be changed one thing at a time."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import shapely

from safety.geofence import Geofence
from safety.limits import Limits
from safety.obstacles import Obstacles
from safety.situation import Situation, World
from safety.terrain import Terrain
from safety.vocabulary import Anchor, Finding, Ned, Neighbours, Operator, Path, VehicleState

LIMITS = Limits()
EXACT = replace(LIMITS, tracking_m=0.0)
"""With no tube about the path, so that numbers are round."""
NOW_S = 100.0
START = Ned(0.0, 0.0, -10.0)


def vehicle(**changes: Any) -> VehicleState:
    return replace(
        VehicleState(NOW_S, START, Ned(0.0, 0.0, 0.0), 0.0, sigma_h_m=0.0, sigma_v_m=0.0, healthy=True, in_air=True),
        **changes,
    )


def world(**changes: Any) -> World:
    return replace(World(Terrain.flat(0.0, 0.0, 0.0), Obstacles.none(), None), **changes)


def square_fence(half_m: float = 20.0, floor_m: float = 1.0, ceiling_m: float = 40.0) -> Geofence:
    return Geofence.of(shapely.box(-half_m, -half_m, half_m, half_m), floor_m, ceiling_m, 0.0)


def wall(north_m: float, name: str = "wall", top_m: float = 30.0, base_m: float = 0.0) -> Obstacles:
    """A slab whose southern face is at north_m."""
    return Obstacles.of([name], [shapely.box(north_m, -50.0, north_m + 1.0, 50.0)], [base_m], [top_m], 0.0)


def sky(*aircraft: tuple[str, Ned, Ned, float, float], feed_at_s: float = NOW_S) -> Neighbours:
    """Aircraft as (name, position, velocity, sigma, at_s)."""
    return Neighbours(
        tuple(a[0] for a in aircraft),
        np.array([a[1] for a in aircraft], dtype=float).reshape(-1, 3),
        np.array([a[2] for a in aircraft], dtype=float).reshape(-1, 3),
        np.array([a[3] for a in aircraft], dtype=float),
        np.array([a[4] for a in aircraft], dtype=float),
        feed_at_s,
    )


def situation(**changes: Any) -> Situation:
    start = Situation(
        now_s=NOW_S,
        vehicle=vehicle(),
        operator=Operator(Ned(-10.0, 0.0, 0.0), 0.0),
        anchor=Anchor(START, 180.0, NOW_S),
        session_centre=START,
        paired_at_s=NOW_S,
        neighbours=Neighbours.none(NOW_S),
        reservations=(),
        world=world(),
        authority=True,
    )
    return replace(start, **changes)


def straight(
    end: Ned, start: Ned = START, duration_s: float = 2.0, n: int = 11, along_track_tolerance_m: float = 0.0
) -> Path:
    """At constant speed from start to end."""
    share = np.linspace(0.0, 1.0, n)
    return Path(
        np.asarray(start) + share[:, None] * (np.asarray(end) - np.asarray(start)),
        share * duration_s,
        along_track_tolerance_m,
    )


def hover(at: Ned = START, duration_s: float = 2.0) -> Path:
    return Path(np.array([at, at]), np.array([0.0, duration_s]))


def number(finding: Finding) -> float:
    assert finding.margin is not None, finding.text
    return finding.margin
