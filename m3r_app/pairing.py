"""The checks before pairing: a pure list of everything that stands against it. Source: X8, P1, design 1, 12; paper III-A."""

from __future__ import annotations

import math
from dataclasses import dataclass

from m3r_app.vehicle.telemetry import Telemetry
from safety.confidence import confidence_of
from safety.frames import LocalFrame
from safety.limits import Limits
from safety.situation import World
from safety.vocabulary import Geodetic, Operator

FIT_TO_HOLD = frozenset({"HOLD", "MISSION", "OFFBOARD", "READY", "TAKEOFF"})
"""Flight modes that pairing may end; in any other a person or a failsafe is flying it."""


@dataclass(frozen=True, slots=True)
class PairingLimits:
    """range_m: how far from the operator; operator_sigma_max_m: how well the operator must be located."""

    range_m: float
    operator_sigma_max_m: float


def objections(
    telemetry: Telemetry,
    frame: LocalFrame,
    operator: Operator,
    world: World,
    limits: Limits,
    pairing: PairingLimits,
    now_s: float,
) -> tuple[str, ...]:
    """Everything that forbids pairing, each one sentence; empty: it may be paired (failsafe parameters aside)."""
    found: list[str] = []
    if not telemetry.age_s(now_s) <= limits.telemetry_age_s:
        found.append("its telemetry is missing or stale")
    if not telemetry.healthy:
        found.append(f"it is not healthy: {', '.join(telemetry.unhealthy) or 'no reason given'}")
    if telemetry.in_air is not True:
        found.append("it is not in the air; take off first")
    if telemetry.flight_mode not in FIT_TO_HOLD:
        found.append(f"it flies in {telemetry.flight_mode}, which pairing does not interrupt")
    if not (math.isfinite(operator.sigma_m) and operator.sigma_m <= pairing.operator_sigma_max_m):
        found.append(f"the operator's position is not known to {pairing.operator_sigma_max_m:.0f} m")
    found += _distance(telemetry.geodetic, frame, operator, limits, pairing)
    # Adding NaN keeps it, max() may not.
    sigma_m = max(telemetry.sigma_h_m, telemetry.sigma_v_m) + 0.0 * (telemetry.sigma_h_m + telemetry.sigma_v_m)
    localization = confidence_of(sigma_m, limits.localization_half_m)
    if not localization >= limits.localization_min:
        found.append(f"its localisation confidence is {_shown(localization)}, {limits.localization_min:.2f} is needed")
    if world.terrain is None:
        found.append('there is no terrain model here; give a scenario or declare terrain = "flat"')
    else:
        terrain = confidence_of(world.terrain.sigma_m, limits.terrain_half_m)
        if not terrain >= limits.terrain_confidence_min:
            found.append(
                f"the terrain model's confidence is {_shown(terrain)}, {limits.terrain_confidence_min:.2f} is needed"
            )
    return tuple(found)


def _distance(
    place: Geodetic | None, frame: LocalFrame, operator: Operator, limits: Limits, pairing: PairingLimits
) -> list[str]:
    if place is None:
        return ["its position is unknown"]
    away = frame.ned(place).minus(operator.position)
    found = []
    if not away.norm <= pairing.range_m:
        found.append(f"it is {away.norm:.0f} m away, more than {pairing.range_m:.0f} m")
    needed_m = limits.standoff_m + limits.sigma_k * operator.sigma_m
    if not away.horizontal >= needed_m:
        found.append(f"it is {away.horizontal:.1f} m from the operator, nearer than {needed_m:.1f} m")
    return found


def _shown(confidence: float) -> str:
    return f"{confidence:.2f}" if math.isfinite(confidence) else "unknown"
