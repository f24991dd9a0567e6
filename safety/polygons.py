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

    edges: Floats
    """(6, e): start north and east, end north and east, 1 / squared length, north per east (0 where east is constant)"""
    firsts: Ints
    """(m,) index of each polygon's first edge; its edges are consecutive and at least one."""
    centre: tuple[float, float] = (0.0, 0.0)
    reach_m: float = math.inf
    """Only edges that matter to points within this of the centre are kept."""

    @staticmethod
    def of(polygons: Sequence[shapely.Polygon]) -> Polygons:
        """From shapely polygons; raises ValueError with the reason for one that is empty or crosses itself."""
        starts, ends, firsts, count = [], [], [], 0
        for number, polygon in enumerate(polygons):
            if not isinstance(polygon, shapely.Polygon) or polygon.is_empty:
                raise ValueError(f"polygon {number + 1} is empty or no polygon")
            if not np.isfinite(shapely.get_coordinates(polygon)).all():
                raise ValueError(f"polygon {number + 1} has a corner that is no number")
            if not polygon.is_valid:
                raise ValueError(f"polygon {number + 1} is not valid: {shapely.is_valid_reason(polygon)}")
            firsts.append(count)
            for ring in (polygon.exterior, *polygon.interiors):
                corners = shapely.get_coordinates(ring)
                real = (corners[1:] != corners[:-1]).any(axis=1)
                starts.append(corners[:-1][real])
                ends.append(corners[1:][real])
                count += int(real.sum())
        edges = np.zeros((6, count))
        if count:
            edges[:2] = np.concatenate(starts).T
            edges[2:4] = np.concatenate(ends).T
            north, east = edges[2:4] - edges[:2]
            edges[4] = 1.0 / (north * north + east * east)
            np.divide(north, east, out=edges[5], where=east != 0.0)
        return Polygons(edges, np.array(firsts, dtype=np.intp))

    def __len__(self) -> int:
        return len(self.firsts)

    def near(self, centre: Ned, reach_m: float, among: Bools | None = None) -> tuple[Polygons, Ints]:
        """Those with an edge that can matter to points within reach_m of centre, and their indices.

        among: (m,) which polygons to look at; all of them if None.
        """
        north, east, end_north, end_east, _, _ = self.edges
        # The test for "inside" looks north from a point: edges beside that strip, or south of it, cannot count.
        matters = np.minimum(east, end_east) <= centre.east + reach_m
        matters &= np.maximum(east, end_east) >= centre.east - reach_m
        matters &= np.maximum(north, end_north) >= centre.north - reach_m
        if among is not None and len(self):
            matters &= np.repeat(among, np.diff(self.firsts, append=north.size))
        kept = np.add.reduceat(matters.astype(np.intp), self.firsts) if len(self) else np.zeros(0, dtype=np.intp)
        which = np.flatnonzero(kept)
        counts = kept[which]
        firsts = np.cumsum(counts) - counts
        edges = self.edges.take(np.flatnonzero(matters), axis=1)
        return Polygons(edges, firsts, (centre.north, centre.east), reach_m), which

    def distance_m(self, points_ne_m: Floats) -> Floats:
        """(n, m) signed distance of (n, 2) points: negative inside, positive outside (a hole is outside).

        After `near`, never more than what it can vouch for: reach_m less the point's distance from the centre.
        """
        north, east = points_ne_m[:, 0, None], points_ne_m[:, 1, None]
        start_north, start_east, end_north, end_east, per_square, slope = self.edges
        side_north, side_east = end_north - start_north, end_east - start_east
        from_north, from_east = north - start_north, east - start_east
        along = from_north * (side_north * per_square) + from_east * (side_east * per_square)
        along = np.minimum(np.maximum(along, 0.0), 1.0)
        off_north, off_east = from_north - along * side_north, from_east - along * side_east
        distance = np.sqrt(np.minimum.reduceat(off_north * off_north + off_east * off_east, self.firsts, axis=1))
        # Count the edges straight north of the point. An edge holds its lower end in east but not its upper one.
        crossed = ((east >= start_east) != (east >= end_east)) & (from_north < from_east * slope)
        inside = np.logical_xor.reduceat(crossed, self.firsts, axis=1)
        if self.reach_m < math.inf:
            about = points_ne_m - self.centre
            vouched = np.maximum(self.reach_m - np.sqrt((about * about).sum(axis=1)), 0.0)
            distance = np.minimum(distance, vouched[:, None])
        return np.where(inside, -distance, distance)
