"""Do the heights that are known agree? A wrong datum (ellipsoid for sea level, feet, a phone's guess) is tens of metres.

Nothing that is computed from heights that contradict each other can be believed, so a disagreement beyond what is stated
to be uncertain refuses pairing and take-off, with its number. Pure. Source: X6, X8, R3; design 8.
"""

from __future__ import annotations

import math

import numpy as np

from m3r_app.vehicle.telemetry import Telemetry
from safety.confidence import underground_m
from safety.frames import LocalFrame
from safety.limits import Limits
from safety.spatial import checked_sigma_m
from safety.terrain import Terrain, TerrainPatch
from safety.vocabulary import Ned, Operator, VehicleState


def disagreements(
    telemetry: Telemetry, frame: LocalFrame, operator: Operator, terrain: Terrain | TerrainPatch | None, limits: Limits
) -> tuple[str, ...]:
    """Every pair of heights that should agree and does not, each one sentence with how much and what could explain."""
    place = telemetry.geodetic
    if terrain is None or place is None:
        return ()  # said by others
    here, k = frame.ned(place), limits.sigma_k
    drone_m = k * (checked_sigma_m(telemetry.sigma_v_m) + terrain.slope * checked_sigma_m(telemetry.sigma_h_m))
    terrain_m = k * checked_sigma_m(terrain.sigma_m)
    height_m = _above(terrain, here)
    found = [
        _said(
            f"your altitude ({frame.amsl_m(operator.position.down):.0f} m)",
            _above(terrain, operator.position),
            k * checked_sigma_m(operator.sigma_m) * (1.0 + terrain.slope) + terrain_m + limits.operator_height_m,
        )
    ]
    if telemetry.in_air is False:
        found.append(_said("it stands, but its altitude", height_m, drone_m + terrain_m + limits.landed_height_m))
    else:
        vehicle = VehicleState(
            0.0, here, Ned(0, 0, 0), 0.0, sigma_h_m=telemetry.sigma_h_m, sigma_v_m=telemetry.sigma_v_m
        )
        below_m = underground_m(vehicle, terrain.sigma_m, terrain.slope, limits)
        found.append(_said("its altitude", min(height_m, 0.0), below_m))
    if telemetry.home is not None:
        home_m = _above(terrain, frame.ned(telemetry.home))
        found.append(_said("its home", home_m, drone_m + terrain_m + limits.home_height_m))
    if telemetry.ground_distance_m is not None:
        off_m = height_m - telemetry.ground_distance_m
        explained_m = drone_m + terrain_m + limits.rangefinder_tilt * telemetry.ground_distance_m
        if abs(off_m) > explained_m:
            found.append(
                f"its rangefinder measures {telemetry.ground_distance_m:.1f} m to the ground and the terrain model says "
                f"{height_m:.1f} m, where {explained_m:.1f} m can be explained: the model or an altitude is wrong"
            )
    return tuple(sentence for sentence in found if sentence is not None)


def _above(terrain: Terrain | TerrainPatch, place: Ned) -> float:
    return float(terrain.agl_m(np.array([place]))[0]) if place.finite else math.nan


def _said(what: str, above_m: float, explained_m: float) -> str | None:
    """None: it agrees, or it cannot be compared, which others say."""
    if not abs(above_m) > explained_m:
        return None
    side = "above" if above_m > 0.0 else "below"
    return (
        f"{what} is {abs(above_m):.1f} m {side} the terrain model, where {explained_m:.1f} m can be explained: "
        "the model's height reference, your altitude or the drone's is wrong"
    )
