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
    """(4, e): start north and east, end north and east"""
    maps: Floats
    """(3, 3, e) linear in (north, east, 1): how far a point is along the edge, beside it, and north of its line (m)"""
    lengths_m: Floats
    """(e,)"""
    firsts: Ints
    """(m,) index of each polygon's first edge; its edges are consecutive and at least one."""
    centre_ne_m: Floats
    """(2,)"""
    reach_m: float
    """Only edges that matter to points within this of the centre are kept."""
    whole: Bools
    """(m,) those of which all edges are kept: of them nothing is cut off."""

    @staticmethod
    def of(polygons: Sequence[shapely.Polygon]) -> Polygons:
        """From shapely polygons; raises ValueError with the reason for one that is empty or crosses itself."""
        starts, ends, firsts, count = [], [], [], 0
        for number, polygon in enumerate(polygons):
            if not isinstance(polygon, shapely.Polygon) or polygon.is_empty:
                raise ValueError(f"polygon {number + 1} is empty or no polygon")
            if not np.isfinite(shapely.get_coordinates(polygon)).all():
                raise ValueError(f"polygon {number + 1} has a corner that is not finite")
            if not polygon.is_valid:
                raise ValueError(f"polygon {number + 1} is not valid: {shapely.is_valid_reason(polygon)}")
            firsts.append(count)
            for ring in (polygon.exterior, *polygon.interiors):
                corners = shapely.get_coordinates(ring)
                real = (corners[1:] != corners[:-1]).any(axis=1)
                starts.append(corners[:-1][real])
                ends.append(corners[1:][real])
                count += int(real.sum())
        edges = np.zeros((4, count))
        if count:
            edges[:2] = np.concatenate(starts).T
            edges[2:] = np.concatenate(ends).T
        north, east = edges[2:] - edges[:2]
        lengths = np.hypot(north, east)
        maps = np.zeros((3, 3, count))
        maps[0, 0], maps[1, 0] = north / lengths, east / lengths
        maps[0, 1], maps[1, 1] = -maps[1, 0], maps[0, 0]
        # An edge that runs north has no line to be north of, and is never asked for one.
        maps[0, 2], maps[1, 2] = 1.0, -np.divide(north, east, out=np.zeros(count), where=east != 0.0)
        maps[2] = -(maps[0] * edges[0] + maps[1] * edges[1])
        whole = np.ones(len(firsts), dtype=np.bool_)
        return Polygons(edges, maps, lengths, np.array(firsts, dtype=np.intp), np.zeros(2), math.inf, whole)

    def __len__(self) -> int:
        return len(self.firsts)

    def near(
        self, centre: Ned, reach_m: float, among: Bools | None = None, *, deep: bool = True
    ) -> tuple[Polygons, Ints]:
        """Those with an edge that can matter to points within reach_m of centre, and their indices.

        among: (m,) which polygons to look at; all of them if None. deep: those that the centre is inside of stay whole, for
        how deep inside is compared along a path (X13) and must not be cut off.
        """
        north, east, end_north, end_east = self.edges
        # The test for "inside" looks north from a point: edges beside that strip, or south of it, cannot count.
        matters = np.minimum(east, end_east) <= centre.east + reach_m
        matters &= np.maximum(east, end_east) >= centre.east - reach_m
        matters &= np.maximum(north, end_north) >= centre.north - reach_m
        per_polygon = np.diff(self.firsts, append=north.size)
        whole = self.contain(centre) & deep
        matters |= np.repeat(whole, per_polygon)
        if among is not None:
            matters &= np.repeat(among, per_polygon)
        kept = np.add.reduceat(matters.astype(np.intp), self.firsts) if len(self) else np.zeros(0, dtype=np.intp)
        which = np.flatnonzero(kept)
        counts = kept[which]
        firsts = np.cumsum(counts) - counts
        edges = np.flatnonzero(matters)
        cut = Polygons(
            self.edges.take(edges, axis=1),
            self.maps.take(edges, axis=2),
            self.lengths_m[edges],
            firsts,
            np.array(centre[:2]),
            reach_m,
            whole[which],
        )
        return cut, which

    def contain(self, place: Ned) -> Bools:
        """(m,) whether a place is inside each polygon."""
        if not len(self):
            return np.zeros(0, dtype=np.bool_)
        point = np.array((place.north, place.east, 1.0))
        return np.asarray(np.logical_xor.reduceat(self._south_of(point[1], point @ self.maps[:, 2]), self.firsts))

    def _south_of(self, east: Floats, beyond: Floats) -> Bools:
        """(..., e) whether an edge runs straight north of a point. It holds its lower end in east but not its upper one."""
        return np.asarray(((east >= self.edges[1]) != (east >= self.edges[3])) & (beyond < 0.0))

    def distance_m(self, points_ne_m: Floats) -> Floats:
        """(n, m) signed distance of (n, 2) points: negative inside, positive outside (a hole is outside).

        After `near`, never more than what it can vouch for, unless the polygon stayed whole: reach_m less the point's
        distance from the centre.
        """
        count = len(self.lengths_m)
        found = points_ne_m @ self.maps[:2].reshape(2, -1) + self.maps[2].reshape(-1)
        along, beside, beyond = found[:, :count], found[:, count : 2 * count], found[:, 2 * count :]
        over = along - np.minimum(np.maximum(along, 0.0), self.lengths_m)
        distance = np.sqrt(np.minimum.reduceat(beside * beside + over * over, self.firsts, axis=1))
        # An odd number of edges straight north of the point means inside.
        inside = np.logical_xor.reduceat(self._south_of(points_ne_m[:, 1, None], beyond), self.firsts, axis=1)
        if self.reach_m < math.inf:
            vouched = np.where(self.whole, math.inf, self.vouched_m(points_ne_m)[:, None])
            distance = np.minimum(distance, vouched)
        return np.where(inside, -distance, distance)

    def vouched_m(self, points_ne_m: Floats) -> Floats:
        """(n,) how far from (n, 2) points there is certainly no edge other than those still here."""
        about = points_ne_m - self.centre_ne_m
        return np.asarray(np.maximum(self.reach_m - np.sqrt((about * about) @ _ONES), 0.0))

    def may_end_within(self, centre: Ned, reach_m: float) -> bool:
        """Can one of the edges be within reach_m of centre? Those farther north are kept for the test of "inside" alone."""
        return not bool((np.minimum(self.edges[0], self.edges[2]) > centre.north + reach_m).all())


_ONES = np.ones(2)
