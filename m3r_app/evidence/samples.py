"""Every telemetry sample while the drone was ours, against the bare limits: no uncertainty, no excuse.

A limit is broken where the drone said it was. Source: R9, contract (exit status 4), X3.
"""

from __future__ import annotations

import bisect
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from m3r_app.evidence.flight import Flight, Floats, Stretch
from m3r_app.evidence.geometry import Patch, fence_m, height_m, prism_m
from m3r_app.evidence.verdict import Line

ROUNDING_M = 1e-6
SEEN_M = 3.0
"""The ground is looked for so far beyond what is required; a margin is cut off there."""
TOGETHER = 64
"""So many samples are compared with the ground at once."""
SPEED_OVER_S = 0.5
"""Speed is measured by position over this time."""


def judge_samples(flight: Flight) -> tuple[tuple[Line, ...], int]:
    """A line for each limit, with the worst sample, and how many samples there were."""
    samples = [(t_s, v) for t_s, v in flight.telemetry if _stretch(flight, t_s) is not None]
    if not samples:
        return (), 0
    times = np.array([t_s for t_s, _ in samples])
    ned = np.array([v.position for _, v in samples], dtype=np.float64)
    known = np.isfinite(ned).all(axis=1)
    lines = []
    if not known.all():
        first = float(times[int((~known).argmax())])
        note = f"{int((~known).sum())} samples tell no place"
        lines.append(Line("telemetry", "position", "", None, "m", passed=False, at_s=first, note=note))
    times, ned = times[known], ned[known]
    if not len(times):
        return tuple(lines), len(samples)
    up = np.column_stack((ned[:, :2], flight.ground.origin_amsl_m - ned[:, 2]))
    lines += [*_still(flight, times, up), *_about_us(flight, times, ned), *_others(flight, times, ned)]
    lines += _speed(flight, times, ned)
    return tuple(lines), len(samples)


def _stretch(flight: Flight, t_s: float) -> Stretch | None:
    return next((s for s in flight.ours if s.from_s <= t_s <= s.until_s), None)


def _line(limit: str, times: Floats, margins: Floats, subject: str = "", unit: str = "m") -> Line:
    if not np.isfinite(margins).all():
        at_s = float(times[int((~np.isfinite(margins)).argmax())])
        return Line("telemetry", limit, subject, None, unit, passed=False, at_s=at_s, note="cannot be judged")
    worst, broken = int(margins.argmin()), int((margins < -ROUNDING_M).sum())
    note = f"broken in {broken} of {len(margins)} samples" if broken else ""
    return Line("telemetry", limit, subject, float(margins[worst]), unit, not broken, float(times[worst]), note)


def _still(flight: Flight, times: Floats, up: Floats) -> list[Line]:
    """Ground, obstacles and fence."""
    grid, limits = flight.ground.terrain, flight.limits
    lines = []
    if grid is None:
        lines += [
            Line("telemetry", limit, "", None, "m", passed=False, note="the record holds no terrain")
            for limit in ("terrain_clearance", "agl")
        ]
    else:
        height = height_m(up, grid)
        lines.append(_nearest_ground(flight, times, up, height))
        lines.append(_line("agl", times, height - limits.min_agl_m))
    lines += [
        _line("obstacle_clearance", times, prism_m(up, prism) - limits.obstacle_clearance_m, prism.name)
        for prism in flight.ground.prisms
    ]
    if flight.ground.fence is not None:
        level, upright = fence_m(up, flight.ground.fence)
        lines.append(_line("geofence", times, np.minimum(level, upright)))
    return lines


def _nearest_ground(flight: Flight, times: Floats, up: Floats, height: Floats) -> Line:
    """The least distance to the ground of all samples: those that are lowest are looked at first, and many need not be."""
    grid, needed_m = flight.ground.terrain, flight.limits.clearance_m
    assert grid is not None
    if not np.isfinite(height).all():
        return _line("terrain_clearance", times, height)
    order = np.argsort(height)
    away = np.full(len(up), needed_m + SEEN_M)
    for first in range(0, len(order), TOGETHER):
        chosen = order[first : first + TOGETHER]
        # Those that fly together are together: what spreads wide is looked at one by one.
        wide = np.ptp(up[chosen, :2], axis=0).max() > 4.0 * SEEN_M
        for part in np.split(chosen, len(chosen)) if wide else (chosen,):
            away[part] = Patch(grid, up[part], needed_m + SEEN_M).surface_m(up[part])
    found = _line("terrain_clearance", times, away - needed_m)
    return replace(found, note="or more") if found.margin == SEEN_M else found


def _about_us(flight: Flight, times: Floats, ned: Floats) -> list[Line]:
    """Operator, anchor and the place of pairing."""
    limits, lines = flight.limits, []
    operator = flight.operator
    if operator is None:
        note = "the record does not tell where the operator stood"
        lines.append(Line("telemetry", "standoff", "", None, "m", passed=False, note=note))
    else:
        away = np.hypot(ned[:, 0] - operator.position.north, ned[:, 1] - operator.position.east)
        lines.append(_line("standoff", times, away - limits.standoff_m))
    anchored = [t_s for t_s, _ in flight.anchors]
    anchors = np.array([_at(flight.anchors, anchored, t_s) for t_s in times], dtype=np.float64)
    lines.append(_line("workspace", times, limits.workspace_m - np.linalg.norm(ned - anchors, axis=1)))
    stretches = [_stretch(flight, float(t_s)) for t_s in times]
    centres = np.array([s.centre if s is not None and s.centre is not None else (math.nan,) * 3 for s in stretches])
    lines.append(_line("session", times, limits.session_m - np.linalg.norm(ned - centres, axis=1)))
    return lines


def _at(places: Sequence[tuple[float, tuple[float, ...]]], starts: list[float], t_s: float) -> tuple[float, ...]:
    """The last place told by t_s; nowhere if none was."""
    i = bisect.bisect_right(starts, t_s) - 1
    return places[i][1] if i >= 0 else (math.nan,) * 3


def _others(flight: Flight, times: Floats, ned: Floats) -> list[Line]:
    """Everybody else, as last told, flown straight on; who has been silent for too long is not known to be anywhere."""
    limits = flight.limits
    least: dict[str, list[tuple[float, float]]] = {}
    for i, (from_s, sky) in enumerate(flight.neighbours):
        until_s = flight.neighbours[i + 1][0] if i + 1 < len(flight.neighbours) else math.inf
        first, last = np.searchsorted(times, (from_s, until_s))
        if first == last:
            continue
        for k, name in enumerate(sky.names):
            ages = times[first:last] - float(sky.at_s[k])
            place = sky.positions_ned_m[k] + ages[:, None] * sky.velocities_ned_m_s[k]
            away = np.linalg.norm(ned[first:last] - place, axis=1) - limits.separation_m
            heard = np.abs(ages) <= limits.neighbour_age_s
            told = least.setdefault(name, [])
            told += zip(times[first:last][heard].tolist(), away[heard].tolist(), strict=True)
    return [
        _line("separation", np.array([t for t, _ in told]), np.array([m for _, m in told]), name)
        for name, told in least.items()
        if told
    ]


def _speed(flight: Flight, times: Floats, ned: Floats) -> list[Line]:
    """How fast it really moved while a plan was flown, by where it was half a second before."""
    found = []
    for (_, plan), started in flight.flown():
        if plan is None or started is None:
            continue
        ended_s = next((m.t_s for m in flight.motions if m.t_s > started.t_s and m.status != "started"), math.inf)
        first, last = np.searchsorted(times, (started.t_s, ended_s))
        if last - first < 2:
            continue
        before = np.searchsorted(times, times[first:last] - SPEED_OVER_S)
        spans_s = times[first:last] - times[before]
        judged = spans_s >= 0.8 * SPEED_OVER_S
        moved = np.linalg.norm(ned[first:last] - ned[before], axis=1)[judged] / spans_s[judged]
        stretch = _stretch(flight, started.t_s)
        # Of an estimate that wanders no speed is known better than this.
        noise_m_s = flight.limits.noise_k * stretch.noise_m / SPEED_OVER_S if stretch is not None else 0.0
        bound = plan.move.speed + flight.limits.speed_tolerance_m_s + noise_m_s
        if len(moved):
            found.append(_line("speed", times[first:last][judged], bound - moved, started.request, "m/s"))
    return found
