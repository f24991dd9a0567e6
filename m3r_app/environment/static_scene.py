"""What stands still about a flight, as the scene shows it: ground, obstacles, fence, operator. Pure."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from m3r_app.environment.ground import ground_about
from safety.vocabulary import Ned, Operator

if TYPE_CHECKING:
    from safety.obstacles import Obstacles
    from safety.situation import World


def static_scene(world: World, operator: Operator | None) -> dict[str, Any]:
    """The static scene in the session's frame: places north, east, down; levels and heights up; all in metres."""
    centre = operator.position if operator is not None else Ned(0.0, 0.0, 0.0)
    fence = world.geofence
    levels = (
        () if fence is None else (fence.floor_amsl_m - fence.origin_amsl_m, fence.ceiling_amsl_m - fence.origin_amsl_m)
    )
    return {
        "ground": ground_about(world, centre),
        "obstacles": _prisms(world.obstacles),
        "fence_ne_m": [] if fence is None else fence.polygon.edges.T.tolist(),
        "fence_levels_m": [level for level in levels if math.isfinite(level)],
        "operator": operator.position if operator is not None else None,
    }


def _prisms(obstacles: Obstacles) -> list[dict[str, Any]]:
    """Name, corners, base and top of each obstacle; holes in it are drawn as part of its outline."""
    polygons = obstacles.polygons
    firsts = [*polygons.firsts.tolist(), polygons.edges.shape[1]]
    return [
        {
            "name": name,
            "corners_ne_m": polygons.edges[:2, firsts[i] : firsts[i + 1]].T.tolist(),
            "base_m": float(obstacles.bases_amsl_m[i]) - obstacles.origin_amsl_m,
            "top_m": float(obstacles.tops_amsl_m[i]) - obstacles.origin_amsl_m,
        }
        for i, name in enumerate(obstacles.names)
    ]
