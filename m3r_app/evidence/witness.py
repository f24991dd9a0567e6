"""The autopilot's own log as a second witness: where it says it was, against where the record says it was told to be.

Two clocks: the log counts from the autopilot's start, the record from the app's. They are set by where the positions fit best.
Source: X6, R9; what is compared is `vehicle_local_position` and, of a simulation, its ground truth.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from m3r_app.evidence.flight import Flight, Floats
from m3r_app.evidence.samples import judge_samples
from m3r_app.evidence.verdict import Line
from safety.vocabulary import Ned

COARSE_S = 0.5
FINE_S = (0.05, 0.005)
OVERLAP = 0.8
"""So much of what the record tells of our drone must lie within the log's time."""
FEW = 10
ENOUGH = 400
"""So many samples set the clocks."""
FAR_M = 0.5


@dataclass(frozen=True, eq=False)
class Track:
    """One witness. times_s: on the log's clock; places: (n, 3) north, east, down in the record's frame."""

    name: str
    times_s: Floats
    places: Floats
    truth: bool
    """What really was, not an estimate: then the bare limits must hold of it, too."""


@dataclass(frozen=True)
class Compared:
    """offset_s: the log's clock is so much ahead of the record's. Differences in space, metres."""

    track: Track
    offset_s: float
    worst_m: float
    rms_m: float
    worst_at_s: float
    """On the record's clock."""
    within_m: float
    """The least that is left of what each sample's stated accuracy allows; negative: it was wronger than it said."""


def compare(flight: Flight, track: Track) -> Compared | None:
    """The record's telemetry against one witness; None where they have too little time in common."""
    told = [(t_s, v) for t_s, v in flight.telemetry if v.position.finite]
    told = [(t_s, v) for t_s, v in told if any(s.from_s <= t_s <= s.until_s for s in flight.ours)]
    if len(told) < FEW or len(track.times_s) < FEW:
        return None
    times = np.array([t_s for t_s, _ in told])
    places = np.array([v.position for _, v in told])
    some = slice(None, None, max(1, len(times) // ENOUGH))
    offset_s = _best_offset_s(times[some], places[some], track)
    if offset_s is None:
        return None
    seen, at = _seen(times + offset_s, track)
    apart = np.linalg.norm(at - places[seen], axis=1)
    worst = int(apart.argmax())
    k = flight.limits.sigma_k
    level = np.hypot(*(at - places[seen])[:, :2].T)
    upright = np.abs(at - places[seen])[:, 2]
    level_m = np.array([k * v.sigma_h_m for _, v in told])[seen] - level
    upright_m = np.array([k * v.sigma_v_m for _, v in told])[seen] - upright
    within_m = float(np.minimum(level_m, upright_m).min())
    rms_m = float(np.sqrt((apart * apart).mean()))
    return Compared(track, offset_s, float(apart[worst]), rms_m, float(times[seen][worst]), within_m)


def _seen(times_s: Floats, track: Track) -> tuple[np.ndarray[tuple[int], np.dtype[np.bool_]], Floats]:
    """Which of these times (on the log's clock) the track covers, and where it was then."""
    seen = (times_s >= track.times_s[0]) & (times_s <= track.times_s[-1])
    at = np.column_stack([np.interp(times_s[seen], track.times_s, track.places[:, i]) for i in range(3)])
    return seen, at


def _best_offset_s(times: Floats, places: Floats, track: Track) -> float | None:
    """Where the shapes of both tracks fit best: a constant difference is no matter of clocks."""
    first_s, last_s = float(track.times_s[0] - times[-1]), float(track.times_s[-1] - times[0])

    def misfit(offset_s: float) -> float:
        seen, at = _seen(times + offset_s, track)
        if seen.sum() < max(FEW, OVERLAP * len(times)):
            return np.inf
        apart = at - places[seen]
        off = apart - np.median(apart, axis=0)
        # What is far off is not what the clocks are set by, and what is not covered is no better.
        squares = np.minimum((off * off).sum(axis=1), FAR_M**2)
        return float((squares.sum() + (len(times) - len(squares)) * FAR_M**2) / len(times))

    tried = np.arange(first_s, last_s + COARSE_S, COARSE_S)
    found = [misfit(float(offset_s)) for offset_s in tried]
    if not np.isfinite(found).any():
        return None
    best_s, reach_s = float(tried[int(np.argmin(found))]), COARSE_S
    for step_s in FINE_S:
        tried = best_s + np.arange(-reach_s, reach_s + step_s, step_s)
        best_s, reach_s = float(min(tried, key=misfit)), step_s
    return best_s


def witnessed(flight: Flight, tracks: tuple[Track, ...]) -> tuple[Line, ...]:
    """What the log says of the flight.

    Its own estimate is what we were told, so it may differ by no more than the tube; the truth, by no more than k of the
    stated accuracies; and where the truth is known, it must keep the bare limits.
    """
    if not tracks:
        return (Line("witness", "position", "", None, "m", passed=False, note="the log tells of no position"),)
    lines: list[Line] = []
    for track in tracks:
        found = compare(flight, track)
        if found is None:
            note = "it and the record have too little time in common"
            lines.append(Line("witness", "position", track.name, None, "m", passed=False, note=note))
            continue
        margin = found.within_m if track.truth else flight.limits.tracking_m - found.worst_m
        note = f"worst {found.worst_m:.2f} m, rms {found.rms_m:.2f} m, its clock {found.offset_s:+.2f} s"
        at_s = found.worst_at_s
        lines.append(Line("witness", "position", track.name, margin, "m", margin >= 0.0, at_s, note))
        if track.truth:
            lines += _limits(flight, found)
    return tuple(lines)


def _limits(flight: Flight, found: Compared) -> list[Line]:
    """The bare limits, of where it truly was at each sample."""
    times = np.array([t_s for t_s, _ in flight.telemetry])
    seen, at = _seen(times + found.offset_s, found.track)
    covered = [sample for sample, inside in zip(flight.telemetry, seen, strict=True) if inside]
    truth = tuple((t_s, replace(v, position=Ned(*place))) for (t_s, v), place in zip(covered, at.tolist(), strict=True))
    lines, _ = judge_samples(replace(flight, telemetry=truth))
    return [replace(line, part="witness", subject=f"{found.track.name} {line.subject}".strip()) for line in lines]
