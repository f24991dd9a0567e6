"""The ground about the operator as a small grid: for the flight record, the report and the live scene. Pure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety.situation import World
from safety.vocabulary import Ned

Floats = NDArray[np.float64]
REACH_M = 60.0
"""Sessions end at 50 m; beyond is scenery."""
NODES = 61


@dataclass(frozen=True, eq=False)
class Ground:
    """Heights above the local origin, (n, n): rows from south to north, columns from west to east; NaN: no data."""

    norths_m: Floats
    easts_m: Floats
    heights_m: Floats


def ground_about(world: World, centre: Ned, reach_m: float = REACH_M) -> Ground | None:
    """The ground within reach_m north, south, east and west of centre; None where the terrain is unknown."""
    if world.terrain is None:
        return None
    norths = np.linspace(centre.north - reach_m, centre.north + reach_m, NODES)
    easts = np.linspace(centre.east - reach_m, centre.east + reach_m, NODES)
    north, east = np.meshgrid(norths, easts, indexing="ij")
    points = np.stack([north.ravel(), east.ravel(), np.zeros(north.size)], axis=1)
    # At the origin's level, the height above ground is how far the ground lies below.
    heights = np.round(-world.terrain.agl_m(points).reshape(north.shape), 2)
    return Ground(norths, easts, heights)
