"""The geofence: where the drone may be. A polygon with holes (no-fly areas), a floor and a ceiling. Source: G4."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import shapely

from safety.polygons import Polygons
from safety.vocabulary import Floats, Ned


@dataclass(frozen=True, eq=False)
class Geofence:
    """Inside the polygon, outside its holes, above the floor, below the ceiling."""

    polygon: Polygons
    """One, in the local frame."""
    floor_amsl_m: float
    """-inf: none"""
    ceiling_amsl_m: float
    """inf: none"""
    origin_amsl_m: float
    """Altitude of the local frame's origin."""
    all_inside: bool = False
    """After `near`: everything within its reach is inside."""

    @staticmethod
    def of(polygon_ne_m: shapely.Polygon, floor_amsl_m: float, ceiling_amsl_m: float, origin_amsl_m: float) -> Geofence:
        """From a shapely polygon in local (north, east) metres. Raises ValueError with the reason if it bounds nothing."""
        if not floor_amsl_m < ceiling_amsl_m:
            raise ValueError(f"geofence: its ceiling ({ceiling_amsl_m} m) must be above its floor ({floor_amsl_m} m)")
        try:
            polygon = Polygons.of([polygon_ne_m])
        except ValueError as error:
            raise ValueError(f"geofence: {error}") from None
        return Geofence(polygon, floor_amsl_m, ceiling_amsl_m, origin_amsl_m)

    @property
    def is_open_above_and_below(self) -> bool:
        return self.floor_amsl_m == -math.inf and self.ceiling_amsl_m == math.inf

    def near(self, centre: Ned, reach_m: float) -> Geofence:
        """The same with only the edges that matter to points within reach_m of centre; whole where that is outside.

        How far outside is compared along a path (X13), and must not be cut off.
        """
        if not bool(self.polygon.contain(centre)[0]):
            return self
        polygon, _ = self.polygon.near(centre, reach_m, deep=False)
        return Geofence(
            polygon,
            self.floor_amsl_m,
            self.ceiling_amsl_m,
            self.origin_amsl_m,
            not polygon.may_end_within(centre, reach_m),
        )

    def level_m(self, points_ned_m: Floats) -> Floats:
        """(n,) horizontal distance of (n, 3) points to the boundary: positive where flying is allowed.

        After `near`, never more than what it can vouch for.
        """
        if self.all_inside:
            return self.polygon.vouched_m(points_ned_m[:, :2])
        return -self.polygon.distance_m(points_ned_m[:, :2])[:, 0]

    def upright_m(self, points_ned_m: Floats) -> Floats:
        """(n,) vertical distance of (n, 3) points to floor or ceiling, the nearer: positive between them."""
        amsl_m = self.origin_amsl_m - points_ned_m[:, 2]
        return np.asarray(np.minimum(amsl_m - self.floor_amsl_m, self.ceiling_amsl_m - amsl_m))

    def inside_m(self, points_ned_m: Floats) -> Floats:
        """(n,) signed distance of (n, 3) points to the nearest boundary: the smaller of level and upright."""
        return np.asarray(np.minimum(self.level_m(points_ned_m), self.upright_m(points_ned_m)))
