"""Signed horizontal distance to polygons with holes, for many points at once.

shapely reads and validates the polygons; the distances are plain array arithmetic, because for the handful of edges
and points of one decision shapely's cost per call is the larger part.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from safety.vocabulary import Floats, Ned

Ints = NDArray[np.intp]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Polygons:
    """The edges of m polygons (each maybe with holes) in local (north, east) metres."""

    starts: Floats
    """(2, e)"""
    sides: Floats
    """(2, e) from start to end"""
    firsts: Ints
    """(m,) index of each polygon's first edge; its edges are consecutive and at least one."""
    centre: tuple[float, float] = (0.0, 0.0)
    reach_m: float = math.inf
    """Only edges that matter to points within this of the centre are kept."""

    @staticmethod
    def of(polygons: Sequence[shapely.Polygon]) -> Polygons:
        """From shapely polygons; raises ValueError with the reason for one that is empty or crosses itself."""
        starts, sides, firsts, count = [], [], [], 0
        for number, polygon in enumerate(polygons):
            if not isinstance(polygon, shapely.Polygon) or polygon.is_empty:
                raise ValueError(f"polygon {number + 1} is empty or no polygon")
            if not polygon.is_valid:
                raise ValueError(f"polygon {number + 1} is not valid: {shapely.is_valid_reason(polygon)}")
            firsts.append(count)
            for ring in (polygon.exterior, *polygon.interiors):
                corners = shapely.get_coordinates(ring)
                side = np.diff(corners, axis=0)
                real = (side != 0.0).any(axis=1)
                starts.append(corners[:-1][real])
                sides.append(side[real])
                count += int(real.sum())
        if not count:
            return Polygons(np.zeros((2, 0)), np.zeros((2, 0)), np.zeros(0, dtype=np.intp))
        return Polygons(
            np.ascontiguousarray(np.concatenate(starts).T),
            np.ascontiguousarray(np.concatenate(sides).T),
            np.array(firsts, dtype=np.intp),
        )

    def __len__(self) -> int:
        return len(self.firsts)

    def near(self, centre: Ned, reach_m: float, among: Bools | None = None) -> tuple[Polygons, Ints]:
        """Those with an edge that can matter to points within reach_m of centre, and their indices.

        among: (m,) which polygons to look at; all of them if None.
        """
        north, east = self.starts
        d_north, d_east = self.sides
        # The test for "inside" looks north from a point: edges beside that strip, or south of it, cannot count.
        matters = (np.minimum(east, east + d_east) <= centre.east + reach_m) & (
            np.maximum(east, east + d_east) >= centre.east - reach_m
        )
        matters &= np.maximum(north, north + d_north) >= centre.north - reach_m
        if among is not None and len(self):
            matters &= np.repeat(among, np.diff(self.firsts, append=north.size))
        kept = np.add.reduceat(matters.astype(np.intp), self.firsts) if len(self) else np.zeros(0, dtype=np.intp)
        which = np.flatnonzero(kept)
        counts = kept[which]
        firsts = np.cumsum(counts) - counts
        cut = Polygons(self.starts[:, matters], self.sides[:, matters], firsts, (centre.north, centre.east), reach_m)
        return cut, which

    def distance_m(self, points_ne_m: Floats) -> Floats:
        """(n, m) signed distance of (n, 2) points: negative inside, positive outside (a hole is outside).

        After `near`, never more than what it can vouch for: reach_m less the point's distance from the centre.
        """
        north, east = points_ne_m[:, 0, None], points_ne_m[:, 1, None]
        d_north, d_east = self.sides
        from_north, from_east = north - self.starts[0], east - self.starts[1]
        along = (from_north * d_north + from_east * d_east) / (d_north * d_north + d_east * d_east)
        along = np.minimum(np.maximum(along, 0.0), 1.0)
        off_north, off_east = from_north - along * d_north, from_east - along * d_east
        squares = np.minimum.reduceat(off_north * off_north + off_east * off_east, self.firsts, axis=1)
        # Count the edges straight north of the point. An edge holds its lower end in east but not its upper one.
        spans = (from_east >= 0.0) != (from_east >= d_east)
        slope = np.divide(d_north, d_east, out=np.zeros_like(d_north), where=d_east != 0.0)
        crossed = spans & (from_north < from_east * slope)
        inside = np.logical_xor.reduceat(crossed, self.firsts, axis=1)
        distance = np.sqrt(squares)
        if self.reach_m < math.inf:
            about = points_ne_m - self.centre
            vouched = np.maximum(self.reach_m - np.sqrt((about * about).sum(axis=1)), 0.0)
            distance = np.minimum(distance, vouched[:, None])
        return np.where(inside, -distance, distance)
