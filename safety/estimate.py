"""What the vehicle's estimate of itself is worth: how it moved lately, whether it jumped, and its noise while it hovers.

A single sample says little: a real estimator's velocity may be wrong by half a metre a second while its stated accuracy
says nothing of it, and its position wanders. So speed is judged over time and by position too, and what is observed while
the drone hovers before a session widens the tolerances of that session, the distances to everything with them. Pure.
Source: X6, X11, R8.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from safety.limits import Limits
from safety.vocabulary import Ned, VehicleState

SPEED_FILTER_S = 0.1
SPEED_WINDOW_S = 0.5
"""Speed by position is measured over this time."""
DISAGREEMENT_S = 2.0
"""Over this time position and velocity are compared."""
SAMPLE_S = 0.04
"""Samples of the track are kept this far apart."""
WANDER = 1.4
"""A short hover shows only part of a slow wander: on a real estimator 8 s show about two thirds of what a minute shows."""
HOVER_SAMPLE_S = 0.1
"""... and those of a hover whose noise is learnt."""
FOLLOWED = 0.5
"""A position that shows at least this share of what was flown by velocity is not stuck along that line."""
ASTRAY = 1.5
"""Of the disagreement allowed: less than two maneuvers that a stuck position hid, in one direction, come to."""


class Place(NamedTuple):
    """Where the drone was said to be."""

    at_s: float
    position: Ned


Track = tuple[Place, ...]
"""The last SPEED_WINDOW_S and a little, oldest first."""


class Motion(NamedTuple):
    """How a drone moves, of several reports: by what velocity says, smoothed, and by what position shows."""

    by_velocity_m_s: float
    track: Track

    @property
    def by_position_m_s(self) -> float:
        """NaN where the track is too short to say."""
        track = self.track
        if not track or track[-1].at_s - track[0].at_s < 0.8 * SPEED_WINDOW_S:
            return math.nan
        return track[-1].position.minus(track[0].position).norm / (track[-1].at_s - track[0].at_s)

    def speed_m_s(self, noise: Noise | None) -> float:
        """By velocity; of an estimate known to be noisy the lesser of both, for what is real shows in both."""
        if noise is None or not math.isfinite(self.by_velocity_m_s + self.by_position_m_s):
            return self.by_velocity_m_s
        return min(self.by_velocity_m_s, self.by_position_m_s)

    def rests(self, noise: Noise | None, limits: Limits) -> bool:
        """Whether it stands still. noise: what its session has learnt, which has widened limits; None: nothing unusual."""
        if noise is None:
            return self.by_velocity_m_s < limits.rest_m_s
        said_m_s = max(limits.rest_m_s, limits.noise_k * noise.velocity_m_s)
        return self.by_velocity_m_s < said_m_s and self.by_position_m_s < limits.rest_m_s


AT_FIRST = Motion(math.nan, ())


def moved(before: Motion, vehicle: VehicleState, last: VehicleState | None) -> Motion:
    """With one more report."""
    by_velocity_m_s = vehicle.velocity.norm
    if last is not None and math.isfinite(before.by_velocity_m_s):
        alpha = min(1.0, max(0.0, vehicle.at_s - last.at_s) / SPEED_FILTER_S)
        by_velocity_m_s = before.by_velocity_m_s + alpha * (by_velocity_m_s - before.by_velocity_m_s)
    return Motion(by_velocity_m_s, _with(before.track, Place(vehicle.at_s, vehicle.position)))


def _with(track: Track, place: Place) -> Track:
    recent = tuple(p for p in track if 0.0 <= place.at_s - p.at_s <= SPEED_WINDOW_S + SAMPLE_S)
    if recent and place.at_s - recent[-1].at_s < SAMPLE_S:
        return recent
    return (*recent, place)


def disagreement(vehicle: VehicleState, last: VehicleState | None) -> Ned:
    """How far the position has lately moved otherwise than the velocity says (m): a frozen or jumping estimate. Source: X6."""
    if last is None:
        return Ned(0.0, 0.0, 0.0)
    keep = math.exp(-max(0.0, vehicle.at_s - last.at_s) / DISAGREEMENT_S)
    return Ned(*(keep * d + j for d, j in zip(last.disagreement, jump(vehicle, last), strict=True)))


def jump(vehicle: VehicleState, last: VehicleState) -> Ned:
    """How far the position has moved from one report to the next otherwise than the velocity says (m)."""
    return vehicle.position.minus(last.position).minus(flown(vehicle, last))


def flown(vehicle: VehicleState, last: VehicleState) -> Ned:
    """How far it has moved from one report to the next by what velocity says (m)."""
    dt_s = max(0.0, vehicle.at_s - last.at_s)
    return Ned(*(0.5 * dt_s * (v + w) for v, w in zip(vehicle.velocity, last.velocity, strict=True)))


def astray(before: Ned, by_position: Ned, by_velocity: Ned) -> Ned:
    """What position has missed of all that velocity says was flown (m), with one more maneuver; a stuck estimate adds up.

    by_position, by_velocity: how far the maneuver went by each (m). Where position followed it is right along that line, and
    what was missed along it before is forgotten; across it nothing is known, and it stays. What is not finite adds nothing:
    that is refused elsewhere. Source: X6, X11.
    """
    missed, way_m = by_velocity.minus(by_position), by_velocity.norm
    if not (missed.finite and math.isfinite(way_m)):
        return before
    if not missed.norm < FOLLOWED * way_m:
        return before.plus(missed)
    along = sum(b * v for b, v in zip(before, by_velocity, strict=True)) / (way_m * way_m)
    return Ned(*(b - along * v for b, v in zip(before, by_velocity, strict=True)))


def is_astray(missed: Ned, limits: Limits) -> bool:
    """Whether position has missed more than one maneuver that was aborted for it explains. Source: X6, X11."""
    return not missed.norm <= ASTRAY * limits.disagreement_m


class HoverSample(NamedTuple):
    """One report of a drone that hovers."""

    at_s: float
    position: Ned
    by_position_m_s: float
    by_velocity_m_s: float
    disagreement_m: float


class Noise(NamedTuple):
    """What was observed while the drone hovered, 1 sigma: all of it is noise of the estimate, or wind."""

    position: Ned
    """How far it wandered about its mean, by axis (m)."""
    speed_m_s: float
    """How fast its position moved."""
    velocity_m_s: float
    """How fast it said to fly."""
    disagreement_m: float

    @property
    def position_m(self) -> float:
        return self.position.norm


def with_hover(
    samples: tuple[HoverSample, ...], vehicle: VehicleState, motion: Motion, learn_s: float
) -> tuple[HoverSample, ...]:
    """The samples of the last learn_s with one more, if it is time for one and it is finite."""
    if samples and vehicle.at_s - samples[-1].at_s < HOVER_SAMPLE_S:
        return samples
    by_position_m_s = motion.by_position_m_s
    if math.isnan(by_position_m_s):
        return samples
    sample = HoverSample(
        vehicle.at_s, vehicle.position, by_position_m_s, motion.by_velocity_m_s, vehicle.disagreement.norm
    )
    if not (sample.position.finite and math.isfinite(by_position_m_s + sample.by_velocity_m_s + sample.disagreement_m)):
        return ()
    return (*(s for s in samples if sample.at_s - s.at_s <= learn_s), sample)


def spans_s(samples: Sequence[HoverSample]) -> float:
    """How long has been observed."""
    return samples[-1].at_s - samples[0].at_s if samples else 0.0


def observed(samples: Sequence[HoverSample]) -> Noise:
    """The noise of a hover, of at least two samples."""
    places = np.array([s.position for s in samples])
    spread = places.std(axis=0)

    def rms(values: list[float]) -> float:
        return float(np.sqrt(np.mean(np.square(values))))

    return Noise(
        Ned(*spread.tolist()),
        rms([s.by_position_m_s for s in samples]),
        rms([s.by_velocity_m_s for s in samples]),
        rms([s.disagreement_m for s in samples]),
    )


def adapted(limits: Limits, noise: Noise) -> Limits:
    """The limits of a session with an estimate this noisy: never stricter, and the tube about a path grows with it.

    The tube counts in every required distance (X11): a drone that wanders keeps so much farther from everything. Where
    nothing exceeds what the limits are made for, they stay; else tube and agreement are allowed at least what noise comes to
    in minutes, of which a hover of seconds shows little.
    """
    k = limits.noise_k
    rest_m_s, tracking_m = k * noise.speed_m_s, k * WANDER * noise.position_m
    disagreement_m = k * WANDER * noise.disagreement_m
    if rest_m_s <= limits.rest_m_s and tracking_m <= limits.tracking_m and disagreement_m <= limits.disagreement_m:
        return limits
    return replace(
        limits,
        rest_m_s=max(limits.rest_m_s, rest_m_s),
        tracking_m=max(limits.tracking_m, limits.noisy_tracking_m, tracking_m),
        speed_tolerance_m_s=max(limits.speed_tolerance_m_s, rest_m_s),
        disagreement_m=max(limits.disagreement_m, limits.noisy_disagreement_m, disagreement_m),
    )


def too_noisy(noise: Noise, limits: Limits) -> str | None:
    """Why no session can be flown on such an estimate, in numbers; None: it can."""
    wide_m = limits.noise_k * WANDER * noise.position_m
    if wide_m > limits.tracking_max_m:
        return (
            f"its position wanders by {noise.position_m:.2f} m while it hovers, so it can be held to {wide_m:.1f} m only, "
            f"{limits.tracking_max_m:.1f} m are needed"
        )
    off_m = limits.noise_k * WANDER * noise.disagreement_m
    if off_m > limits.disagreement_max_m:
        return (
            f"its position and its velocity disagree by {noise.disagreement_m:.2f} m while it hovers, "
            f"at most {limits.disagreement_max_m / (limits.noise_k * WANDER):.2f} m can be flown with"
        )
    return None
