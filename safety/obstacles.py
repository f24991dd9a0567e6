"""Obstacles: prisms with a polygon as base, and the signed 3D distance to them. Source: R3, R4, G2."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from safety.polygons import Polygons
from safety.vocabulary import Floats, Ned


@dataclass(frozen=True, eq=False)
class Obstacles:
    """m prisms in the local frame."""

    names: tuple[str, ...]
    """(m,) what the operator calls them"""
    polygons: Polygons
    bases_amsl_m: Floats
    """(m,)"""
    tops_amsl_m: Floats
    """(m,)"""
    origin_amsl_m: float
    """Altitude of the local frame's origin."""
    declared: int
    """How many there are before `near` leaves any out."""
    centre: Ned
    reach_m: float
    """Prisms farther than this from the centre are left out."""
    numbers: tuple[int, ...]
    """(m,) which of all declared ones each is: names may be shared"""

    @staticmethod
    def of(
        names: Sequence[str],
        polygons_ne_m: Sequence[shapely.Polygon],
        bases_amsl_m: Sequence[float],
        tops_amsl_m: Sequence[float],
        origin_amsl_m: float,
    ) -> Obstacles:
        """From shapely polygons in local (north, east) metres, holes allowed.

        Raises ValueError that names the obstacle whose polygon or heights make no prism.
        """
        bases, tops = np.array(bases_amsl_m, dtype=np.float64), np.array(tops_amsl_m, dtype=np.float64)
        if not len(names) == len(polygons_ne_m) == len(bases) == len(tops):
            raise ValueError("every obstacle needs a name, a polygon, a base and a top")
        for name, polygon, base, top in zip(names, polygons_ne_m, bases, tops, strict=True):
            try:
                Polygons.of([polygon])
            except ValueError as error:
                raise ValueError(f"obstacle {name!r}: {error}") from None
            if not base < top:
                raise ValueError(f"obstacle {name!r}: its top ({top} m) must be above its base ({base} m)")
        polygons = Polygons.of(polygons_ne_m)
        numbers = tuple(range(len(names)))
        here = Ned(0.0, 0.0, 0.0)
        return Obstacles(tuple(names), polygons, bases, tops, origin_amsl_m, len(names), here, math.inf, numbers)

    @staticmethod
    def none(origin_amsl_m: float = 0.0) -> Obstacles:
        """No obstacles, declared so."""
        return Obstacles.of((), (), (), (), origin_amsl_m)

    def __len__(self) -> int:
        return len(self.names)

    def near(self, centre: Ned, reach_m: float) -> Obstacles:
        """Those that can be within reach_m of centre."""
        amsl_m = self.origin_amsl_m - centre.down
        level = (self.bases_amsl_m - amsl_m <= reach_m) & (amsl_m - self.tops_amsl_m <= reach_m)
        polygons, which = self.polygons.near(centre, reach_m, level)
        return Obstacles(
            tuple(self.names[i] for i in which.tolist()),
            polygons,
            self.bases_amsl_m[which],
            self.tops_amsl_m[which],
            self.origin_amsl_m,
            self.declared,
            centre,
            reach_m,
            tuple(self.numbers[i] for i in which.tolist()),
        )

    def distance_m(self, points_ned_m: Floats) -> Floats:
        """(n, m) signed distance of (n, 3) points to each prism's surface: negative inside it, positive outside.

        After `near`, never more than what it can vouch for (`vouched_m`).
        """
        level = self.polygons.distance_m(points_ned_m[:, :2])
        amsl_m = self.origin_amsl_m - points_ned_m[:, 2, None]
        upright = np.maximum(self.bases_amsl_m - amsl_m, amsl_m - self.tops_amsl_m)
        beyond, above = np.maximum(level, 0.0), np.maximum(upright, 0.0)
        return np.asarray(np.sqrt(beyond * beyond + above * above) + np.minimum(np.maximum(level, upright), 0.0))

    def vouched_m(self, points_ned_m: Floats) -> Floats:
        """(n,) how far from (n, 3) points there is certainly no obstacle other than those still here."""
        if self.reach_m == math.inf:
            return np.full(len(points_ned_m), math.inf)
        about = points_ned_m - self.centre
        return np.asarray(np.maximum(self.reach_m - np.sqrt((about * about).sum(axis=1)), 0.0))
