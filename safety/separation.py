"""Constraints on who else: separation in time, reserved volumes, the age of what is known of neighbours.

Source: paper III-F (inter-UAV separation), R5, R6, R11, G3, X10; design 10.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from safety.declarations import NEIGHBOUR_AGE, RESERVATION, SEPARATION
from safety.findings import EPSILON, amount, between, gaps_m, judge, once, worst
from safety.limits import Limits
from safety.situation import Situation
from safety.spatial import NO_ACCURACY, error_m
from safety.vocabulary import Finding, Floats, Neighbours, Path, ReservedVolume

_ONES = np.ones(3)
DIP_M = 0.05
"""A neighbour that is too close already may come this much nearer before it counts: what velocities are wrong by (X13)."""


def separation(path: Path, situation: Situation, limits: Limits) -> Finding:
    """Closest approach of the timed path, and of the hover after it, to every neighbour that flies straight on.

    Required is separation_m and all that either position may be wrong by: accuracies, tracking, how far the vehicle may
    be along its path from where it should be, and the neighbour's possible travel in the age of its state. Source: R5, R6, G3.
    """
    neighbours = situation.neighbours
    if not len(neighbours):
        return SEPARATION.finding(None, "m", True, "no other aircraft")
    now, velocities, required = _sky(situation, limits)
    required = required + path.along_track_tolerance_m
    known = np.isfinite(now.sum(axis=0) + velocities.sum(axis=0) + required + path.points_ned_m.sum())
    if not known.all():
        text = (
            f"separation from {neighbours.names[int(known.argmin())]} cannot be judged: its state or ours is incomplete"
        )
        return SEPARATION.refused("m", text)
    times = np.append(path.times_s, max(float(path.times_s[-1]), limits.horizon_s))
    own = np.concatenate((path.points_ned_m, path.points_ned_m[-1:])).T
    # (3, n + 1, k): where the drone is as its neighbours see it; straight lines between the times.
    apart = own[:, :, None] - (now[:, None, :] + times[:, None] * velocities[:, None, :])
    lowest = nearest_m(apart).min(axis=0) - required
    k = int(lowest.argmin())
    if lowest[k] >= -EPSILON:
        margin = max(float(lowest[k]), 0.0)
        return SEPARATION.finding(
            margin,
            "m",
            True,
            f"{neighbours.names[k]}: {amount(margin)} to spare",
            subject=neighbours.names[k],
        )
    broken = lowest < -EPSILON
    failing = broken
    if len(path.times_s) > 1:
        already = np.sqrt((apart[:, 0] ** 2).sum(axis=0)) < required
        failing = broken & ~(already & _never_closer(path, now, velocities, limits))
    passed = not failing.any()
    # The margin is the smallest of all, the sentence is about the worst that fails.
    told = k if passed else int(np.where(failing, lowest, np.inf).argmin())
    text = f"{amount(float(lowest[told]))} too close to {neighbours.names[told]}"
    if passed:
        text += " already, and this does not make it worse"
    below = tuple((neighbours.names[i], float(lowest[i])) for i in np.flatnonzero(broken).tolist())
    return SEPARATION.finding(float(lowest[k]), "m", passed, text, below, neighbours.names[told])


def _never_closer(path: Path, now: Floats, velocities: Floats, limits: Limits) -> NDArray[np.bool_]:
    """(k,) whether each neighbour, continuously in time, never gets nearer than it has been, but for DIP_M. Source: X13.

    It must hold wherever the drone may be along its path: where the time says, later by the vehicle's lag, or as far ahead
    as along_track_tolerance_m. now, velocities: (3, k) of the neighbours.
    """
    points, times = path.points_ned_m, path.times_s
    end_s = max(float(times[-1]), limits.horizon_s)
    covered = np.concatenate(([0.0], np.cumsum(gaps_m(path))))
    total_m = float(covered[-1])
    way = (points[-1] - points[0]) / total_m if total_m > 0.0 else np.zeros(3)
    ahead = points[0] + np.minimum(covered + path.along_track_tolerance_m, total_m)[:, None] * way
    tracks = (
        (points, times),
        (np.concatenate((points[:1], points)), np.concatenate(([0.0], times + limits.lag_s))),
        (ahead, times),
    )
    kept = np.ones(now.shape[1], dtype=np.bool_)
    for own, when in tracks:
        # The hover where the path ends goes on until others cannot matter any more.
        places = np.concatenate((own, own[-1:])).T
        moments = np.append(when, max(end_s, float(when[-1])))
        apart = places[:, :, None] - (now[:, None, :] + moments[:, None] * velocities[:, None, :])
        distance = np.sqrt(np.einsum("xnk,xnk->nk", apart, apart))
        farthest = np.maximum.accumulate(distance[:-1], axis=0)
        kept &= (nearest_m(apart) >= farthest - DIP_M).all(axis=0)
    return kept


def nearest_m(apart: Floats) -> Floats:
    """(n - 1, k) least distance between two things on each stretch of straight flight. apart: (3, n, k) one from the other."""
    squares = np.einsum("xnk,xnk->nk", apart, apart)
    first, last = squares[:-1], squares[1:]
    onward = np.einsum("xnk,xnk->nk", apart[:, :-1], apart[:, 1:]) - first
    length = last - first - 2.0 * onward
    nearest = np.minimum(first, last)
    dips = (onward < 0.0) & (-onward < length)
    if dips.any():
        dip = first - onward * onward / np.where(dips, length, 1.0)
        nearest = np.where(dips, np.minimum(nearest, dip), nearest)
    return np.asarray(np.sqrt(np.maximum(nearest, 0.0)))


def reservation(path: Path, situation: Situation, limits: Limits) -> Finding:
    """No volume that somebody else holds meanwhile meets the one that the path would need. Source: R5, X10.

    It needs what `volumes.swept_volume` reserves for it, half the separation included, and all of it from its beginning:
    what passes here is not denied by the authority for a volume that is known here, so there is no mending either. A hover
    reserves nothing.
    """
    start_s = situation.now_s + float(path.times_s[0])
    end_s = situation.now_s + max(float(path.times_s[-1]), limits.horizon_s, path.until_s)
    if not math.isfinite(end_s):
        return RESERVATION.refused("m", "reserved volumes cannot be judged: the path has no times")
    found = [
        _one_reservation(f"{volume.holder} ({i})", volume, path, situation, limits)
        for i, volume in enumerate(situation.reservations)
        # A window that is no window (NaN) is not passed over.
        if not (volume.until_s < start_s or volume.from_s > end_s)
    ]
    return worst(found) if found else RESERVATION.finding(None, "m", True, "no reserved volume in the way")


def neighbour_age(path: Path, situation: Situation, limits: Limits) -> Finding:
    """Is the feed of neighbours alive, and is nobody who has fallen silent within reach of the path? Source: R11, X6."""
    neighbours, limit_s = situation.neighbours, limits.neighbour_age_s
    margin = None
    if neighbours.feed_at_s != math.inf:
        if not math.isfinite(neighbours.feed_at_s):
            return NEIGHBOUR_AGE.refused("s", "nothing was ever heard of other aircraft")
        feed_s = abs(situation.now_s - neighbours.feed_at_s)
        margin = limit_s - feed_s
        if not margin >= 0.0:
            return NEIGHBOUR_AGE.finding(margin, "s", False, f"other aircraft: last heard {amount(feed_s, 's')} ago")
    if len(neighbours):
        ages = np.abs(situation.now_s - neighbours.at_s)
        silent = ~(ages <= limit_s)
        if silent.any():
            near = silent & ~(
                _could_be_m(path.points_ned_m, neighbours, ages, situation, limits) > path.along_track_tolerance_m
            )
            if near.any():
                k = int(np.flatnonzero(near)[np.argmax(ages[near])])
                age_s, who = float(ages[k]), neighbours.names[k]
                if not math.isfinite(age_s):
                    return NEIGHBOUR_AGE.refused("s", f"{who}: the time of its state is unknown")
                text = f"{who}: last heard {amount(age_s, 's')} ago, so it could be too close"
                return NEIGHBOUR_AGE.finding(limit_s - age_s, "s", False, text, subject=who)
    if margin is None:
        return NEIGHBOUR_AGE.finding(None, "s", True, "flying without neighbour data, as declared")
    return NEIGHBOUR_AGE.finding(margin, "s", True, f"other aircraft: heard {amount(limit_s - margin, 's')} ago")


def neighbours_that_matter(
    situation: Situation, start: Floats, travel_m: float, along_track_tolerance_m: float, until_s: float, limits: Limits
) -> Neighbours:
    """Without those that cannot change any finding on a path that stays within travel_m of start and ends by until_s.

    Kept are all that could come too close, and all that could be the closest. A state that is not finite is kept.
    """
    neighbours = situation.neighbours
    if len(neighbours) < 2:
        return neighbours
    ages = situation.now_s - neighbours.at_s
    velocities = neighbours.velocities_ned_m_s
    required = _required_m(neighbours, ages, situation, limits) + along_track_tolerance_m
    if not np.isfinite(neighbours.positions_ned_m.sum() + velocities.sum() + required.sum()):
        # Nobody can be left out: the rules will say what is missing.
        return neighbours
    apart = start - neighbours.positions_ned_m - velocities * ages[:, None]
    squares = (velocities * velocities) @ _ONES
    along = (apart * velocities) @ _ONES / np.where(squares > 0.0, squares, 1.0)
    apart_then = apart - velocities * np.minimum(np.maximum(along, 0.0), max(until_s, limits.horizon_s))[:, None]
    at_least = np.sqrt((apart_then * apart_then) @ _ONES) - travel_m - required
    at_most = float(np.fmin.reduce(np.sqrt((apart * apart) @ _ONES) - required))
    keep = ~(at_least > max(at_most, 0.0))
    silent = ~(np.abs(ages) <= limits.neighbour_age_s)
    if silent.any():
        could_be = _could_be_m(start[None, :], neighbours, np.abs(ages), situation, limits)
        keep |= silent & ~(could_be > travel_m + along_track_tolerance_m)
    which = np.flatnonzero(keep)
    return Neighbours(
        tuple(neighbours.names[i] for i in which.tolist()),
        neighbours.positions_ned_m[which],
        velocities[which],
        neighbours.sigmas_m[which],
        neighbours.at_s[which],
        neighbours.feed_at_s,
    )


@once
def _sky(situation: Situation, limits: Limits) -> tuple[Floats, Floats, Floats]:
    """(3, k) where the neighbours are now, (3, k) their velocities, (k,) what each must stay away."""
    neighbours = situation.neighbours
    ages = situation.now_s - neighbours.at_s
    velocities = neighbours.velocities_ned_m_s.T
    return (
        neighbours.positions_ned_m.T + velocities * ages,
        velocities,
        _required_m(neighbours, ages, situation, limits),
    )


def _required_m(neighbours: Neighbours, ages: Floats, situation: Situation, limits: Limits) -> Floats:
    """(k,) what each neighbour must stay away."""
    speeds = np.sqrt((neighbours.velocities_ned_m_s**2) @ _ONES)
    ages = np.abs(ages)
    travel = (limits.neighbour_turn * speeds + 0.5 * limits.neighbour_acceleration_m_s2 * ages) * ages
    sigmas = np.where(neighbours.sigmas_m >= 0.0, neighbours.sigmas_m, np.nan)
    own_m = limits.separation_m + error_m(situation.vehicle.sigma_m, limits)
    return np.asarray(own_m + limits.sigma_k * sigmas + travel)


def _could_be_m(points: Floats, neighbours: Neighbours, ages: Floats, situation: Situation, limits: Limits) -> Floats:
    """(k,) least distance of (n, 3) points to where each neighbour could be by now, less what it must stay away."""
    apart = points[:, None, :] - neighbours.positions_ned_m[None, :, :]
    nearest = np.sqrt((apart * apart).sum(axis=2).min(axis=0))
    if len(points) > 1:
        steps = points[1:] - points[:-1]
        nearest = nearest - 0.5 * math.sqrt(float((steps * steps).sum(axis=1).max()))
    return np.asarray(nearest - _required_m(neighbours, ages, situation, limits) - limits.silent_speed_m_s * ages)


def _one_reservation(
    of: str,
    volume: ReservedVolume,
    path: Path,
    situation: Situation,
    limits: Limits,
) -> Finding:
    half_m = 0.5 * limits.separation_m if len(path.times_s) > 1 else 0.0
    own_m = error_m(situation.vehicle.sigma_m, limits) + path.along_track_tolerance_m + half_m
    margins = _from_capsule(path.points_ned_m, volume) - own_m
    stretches = between(margins, gaps_m(path))
    who = volume.holder.replace("{", "{{").replace("}", "}}")
    return judge(RESERVATION, margins, stretches, f"volume held by {volume.holder}",
                 f"{{}} too close to the volume that {who} holds", f"reserved volumes {NO_ACCURACY}", of=of, subject=volume.holder)  # fmt: skip


def _from_capsule(points: Floats, volume: ReservedVolume) -> Floats:
    """(n,) signed distance of (n, 3) points to the capsule."""
    start = np.array(volume.start)
    axis = np.array(volume.end) - start
    length = float(axis @ axis)
    about = points - start
    along: NDArray[np.float64] = about @ axis / length if length > 0.0 else np.zeros(len(points))
    off = about - np.minimum(np.maximum(along, 0.0), 1.0)[:, None] * axis
    return np.asarray(np.sqrt((off * off).sum(axis=1)) - volume.radius_m)
