"""Everything a decision depends on, gathered in one frozen value: x, T, D and C of the paper's Safe(pi, x, T, D, C)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

from safety.vocabulary import POINT, Anchor, Ned, Neighbours, Operator, ReservedVolume, VehicleState

if TYPE_CHECKING:
    from safety.geofence import Geofence
    from safety.obstacles import Obstacles
    from safety.terrain import Terrain, TerrainPatch


@dataclass(frozen=True)
class World:
    """What stands still. terrain None: unknown, which refuses moves (X6); geofence None: none declared."""

    terrain: Terrain | TerrainPatch | None
    obstacles: Obstacles
    geofence: Geofence | None

    def near(self, centre: Ned, reach_m: float, half: Ned = POINT) -> World:
        """The part that can matter within reach_m of a box about centre with these half sides, for many cheap queries."""
        around_m = reach_m + half.norm
        return World(
            self.terrain.near(centre, reach_m, half) if self.terrain is not None else None,
            self.obstacles.near(centre, around_m),
            self.geofence.near(centre, around_m) if self.geofence is not None else None,
        )


def near_as_before(world: World, centre: Ned, reach_m: float, half: Ned) -> World:
    """As `World.near`, but of a larger box whose sides lie on a grid of GRID_M: one cut serves many looks.

    A function of its arguments alone, so that what is seen does not depend on what was looked at before.
    """
    bounds = [
        (GRID_M * math.floor((c - h) / GRID_M), GRID_M * math.ceil((c + h) / GRID_M))
        for c, h in zip(centre, half, strict=True)
    ]
    middle, sides = (Ned(*(0.5 * (high + sign * low) for low, high in bounds)) for sign in (1, -1))
    return _cut(world, middle, float(math.ceil(reach_m)), sides)


GRID_M = 4.0
"""Wider, and every look sees more of what does not matter; narrower, and more of them need a cut of their own."""
_cut = lru_cache(maxsize=32)(World.near)


@dataclass(frozen=True)
class Situation:
    """What is known at `now_s`, in the session's local frame."""

    now_s: float
    vehicle: VehicleState
    operator: Operator
    anchor: Anchor
    session_centre: Ned
    """Where pairing happened."""
    paired_at_s: float
    neighbours: Neighbours
    """Flying without neighbour data is said by an empty sky whose feed_at_s is +inf."""
    reservations: tuple[ReservedVolume, ...]
    """Volumes held by others."""
    world: World
    authority: bool
    missed: Ned = POINT
    """What position has missed of all that velocity says was flown in this session (m)."""
