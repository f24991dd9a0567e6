"""Constraints on what is known and who may command: context and confidence of the paper, and authority.

Source: paper III-F (context and confidence constraints), R11, G1, P2, X3, X6.
"""

from __future__ import annotations

import math

from safety.declarations import AUTHORITY, INPUT_CONFIDENCE, LOCALIZATION, TERRAIN_CONFIDENCE
from safety.estimate import is_astray
from safety.findings import amount
from safety.limits import Limits
from safety.situation import Situation
from safety.spatial import checked_sigma_m, profile
from safety.vocabulary import Finding, ManeuverRequest, Modality, Path, VehicleState


def confidence_of(sigma_m: float, half_m: float) -> float:
    """1 for a perfect sigma, 1/2 at half_m, towards 0 beyond; NaN if there is no accuracy."""
    ratio = checked_sigma_m(sigma_m) / half_m
    return 1.0 / (1.0 + ratio * ratio)  # a power would raise where a product overflows


def input_confidence(request: ManeuverRequest, limits: Limits) -> Finding:
    """InputConfidence(m) >= C_min of the modality. A fused request must satisfy the strictest. Source: R11, G1, P2."""
    required = {
        Modality.VOICE: limits.confidence_voice,
        Modality.GESTURE: limits.confidence_gesture,
        Modality.PANEL: limits.confidence_panel,
    }.get(request.modality, max(limits.confidence_voice, limits.confidence_gesture, limits.confidence_panel))
    if not 0.0 <= request.confidence <= 1.0:
        return INPUT_CONFIDENCE.refused("", f"the {request.modality} request has no confidence")
    margin = request.confidence - required
    text = f"{request.modality} confidence {request.confidence:.2f}, {required:.2f} needed"
    return INPUT_CONFIDENCE.finding(margin, "", margin >= 0.0, text)


def localization(path: Path, situation: Situation, limits: Limits) -> Finding:
    """LocalizationConfidence >= L_min, of a position that is fresh. Source: R11, X6."""
    age_s = abs(situation.now_s - situation.vehicle.at_s)
    if not age_s <= limits.telemetry_age_s:
        age = amount(age_s, "s") if math.isfinite(age_s) else "an unknown time"
        return LOCALIZATION.refused("", f"the drone's position is {age} old")
    if not situation.vehicle.position.finite:
        return LOCALIZATION.refused("", "the drone's position is unknown")
    speed_m_s = situation.vehicle.velocity.norm
    if not speed_m_s <= limits.speed_plausible_m_s:
        said = f"of {amount(speed_m_s, 'm/s')} is not plausible" if math.isfinite(speed_m_s) else "is unknown"
        return LOCALIZATION.refused("", f"the drone's velocity {said}")
    off_m = situation.vehicle.disagreement.norm
    if not off_m <= limits.disagreement_m:
        return LOCALIZATION.refused("", "the drone's position does not move as its velocity says")
    if is_astray(situation.missed, limits):
        missed = amount(situation.missed.norm)
        return LOCALIZATION.refused("", f"the drone's position has missed {missed} that its velocity says it flew")
    sigma_m = situation.vehicle.sigma_m
    confidence = confidence_of(sigma_m, limits.localization_half_m)
    if math.isnan(confidence):
        return LOCALIZATION.refused("", "the drone states no position accuracy")
    margin = confidence - limits.localization_min
    text = f"position known to {amount(sigma_m)}: confidence {confidence:.2f}, {limits.localization_min:.2f} needed"
    return LOCALIZATION.finding(margin, "", margin >= 0.0, text)


def terrain_confidence(path: Path, situation: Situation, limits: Limits) -> Finding:
    """TerrainModelConfidence >= T_min. Source: R11, X6."""
    terrain = situation.world.terrain
    if terrain is None:
        return TERRAIN_CONFIDENCE.refused("", "there is no terrain model")
    confidence = confidence_of(terrain.sigma_m, limits.terrain_half_m)
    if math.isnan(confidence):
        return TERRAIN_CONFIDENCE.refused("", "the terrain model states no accuracy")
    below_m = -float(profile(path, terrain)[0][0])
    explained_m = underground_m(situation.vehicle, terrain.sigma_m, terrain.slope, limits)
    if below_m > explained_m:
        wrong = f"the drone is {amount(below_m)} under the terrain model where {amount(explained_m)} can be explained"
        return TERRAIN_CONFIDENCE.refused("", f"{wrong}: its height or the model's is wrong")
    margin = confidence - limits.terrain_confidence_min
    text = f"terrain known to {amount(terrain.sigma_m)}: confidence {confidence:.2f}, {limits.terrain_confidence_min:.2f} needed"
    return TERRAIN_CONFIDENCE.finding(margin, "", margin >= 0.0, text)


def underground_m(vehicle: VehicleState, terrain_sigma_m: float, slope: float, limits: Limits) -> float:
    """How far under the terrain model a flying drone may seem to be, by what is uncertain of both; NaN: unknown.

    Farther, its height and the model's do not agree: a wrong datum, and nothing that is computed from them holds. Source: X6.
    """
    vertical_m = checked_sigma_m(vehicle.sigma_v_m) + slope * checked_sigma_m(vehicle.sigma_h_m)
    return limits.sigma_k * (vertical_m + checked_sigma_m(terrain_sigma_m))


def authority(path: Path, situation: Situation, limits: Limits) -> Finding:
    """The app may command the drone, and the drone is fit to be commanded. Source: X3, X8, design 4."""
    held = situation.authority is True
    unfit = unfit_to_fly(situation.vehicle, limits)
    if held and unfit is not None:
        return AUTHORITY.finding(None, "", False, unfit)
    text = "this station commands the drone" if held else "this station does not command the drone: pair again"
    return AUTHORITY.finding(None, "", held, text)


def unfit_to_fly(vehicle: VehicleState, limits: Limits) -> str | None:
    """What stands against any maneuver of this vehicle, as a sentence; None: nothing. Source: X8."""
    if not vehicle.healthy:
        return "the drone reports that it is not healthy"
    if vehicle.battery is not None and math.isnan(vehicle.battery):
        return "its battery is unknown"
    if vehicle.battery is not None and not vehicle.battery >= limits.battery_min:
        return f"its battery is at {100.0 * vehicle.battery:.0f} %, {100.0 * limits.battery_min:.0f} % needed"
    return None
