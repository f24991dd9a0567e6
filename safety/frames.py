"""Frames: geodetic, local NED about a fixed origin, the operator's. All conversion happens here.

Local NED is the plane tangent to the ellipsoid at the origin; altitudes above mean sea level are converted as if
the geoid were flat over the session (it is, to centimetres, within a kilometre). Source: paper III-A, III-D.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pymap3d

from safety.vocabulary import Floats, Geodetic, Ned, Primitive


@dataclass(frozen=True, slots=True)
class LocalFrame:
    """The session's local NED frame."""

    origin: Geodetic

    def ned(self, place: Geodetic) -> Ned:
        """The local position (m) of a geodetic one."""
        north, east, down = pymap3d.geodetic2ned(*place, *self.origin)
        return Ned(float(north), float(east), float(down))

    def geodetic(self, point: Ned) -> Geodetic:
        """The geodetic position of a local one (m)."""
        lat, lon, amsl = pymap3d.ned2geodetic(*point, *self.origin)
        return Geodetic(float(lat), float(lon), float(amsl))

    def ned_array(self, lat_deg: Floats, lon_deg: Floats, amsl_m: Floats) -> Floats:
        """(..., 3) local positions (m) of geodetic arrays."""
        return np.stack(pymap3d.geodetic2ned(lat_deg, lon_deg, amsl_m, *self.origin), axis=-1)

    def amsl_m(self, down_m: float) -> float:
        """Altitude above mean sea level of a local down coordinate."""
        return self.origin.amsl_m - down_m


def enu(point: Ned) -> tuple[float, float, float]:
    """East, north, up of a NED vector."""
    return point.east, point.north, -point.down


def wrap_deg(angle_deg: float) -> float:
    """The same angle in (-180, 180]; NaN of what is no angle."""
    if not math.isfinite(angle_deg):
        return math.nan
    wrapped = math.fmod(angle_deg, 360.0)
    if wrapped > 180.0:
        return wrapped - 360.0
    if wrapped <= -180.0:
        return wrapped + 360.0
    return wrapped


def bearing_deg(start: Ned, end: Ned) -> float:
    """Compass bearing from start to end in (-180, 180], north 0, east 90."""
    return math.degrees(math.atan2(end.east - start.east, end.north - start.north))


def operator_direction(primitive: Primitive, operator: Ned, drone: Ned) -> Ned:
    """Unit NED direction of a translation, seen by the operator who looks at the drone. Source: design 1.

    Forward is away from the operator, right is the operator's right. Raises ValueError where operator and drone stand
    above each other (no bearing) or the primitive is no translation.
    """
    if primitive is Primitive.ASCEND:
        return Ned(0.0, 0.0, -1.0)
    if primitive is Primitive.DESCEND:
        return Ned(0.0, 0.0, 1.0)
    turn_deg = _TURN_DEG.get(primitive)
    if turn_deg is None:
        raise ValueError(f"{primitive} has no direction")
    if drone.minus(operator).horizontal < 1e-6:
        raise ValueError("the drone is straight above the operator, so left and right have no meaning")
    heading = math.radians(bearing_deg(operator, drone) + turn_deg)
    return Ned(math.cos(heading), math.sin(heading), 0.0)


_TURN_DEG = {
    Primitive.MOVE_FORWARD: 0.0,
    Primitive.MOVE_RIGHT: 90.0,
    Primitive.MOVE_BACKWARD: 180.0,
    Primitive.MOVE_LEFT: -90.0,
}
