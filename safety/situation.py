"""Everything a decision depends on, gathered in one frozen value: x, T, D and C of the paper's Safe(pi, x, T, D, C)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from safety.vocabulary import Anchor, Ned, Neighbours, Operator, ReservedVolume, VehicleState

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

    def near(self, centre: Ned, reach_m: float) -> World:
        """The part of it that can matter within reach_m of centre, for many cheap queries."""
        return World(
            self.terrain.near(centre, reach_m) if self.terrain is not None else None,
            self.obstacles.near(centre, reach_m),
            self.geofence.near(centre, reach_m) if self.geofence is not None else None,
        )


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

    def near(self, reach_m: float) -> Situation:
        """The same with the world cut down to reach_m about the vehicle."""
        return replace(self, world=self.world.near(self.vehicle.position, reach_m))
