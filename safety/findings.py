"""From margins along a path to a finding: the one place where a number becomes passed or not, and a sentence."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from operator import is_
from typing import TypeVar

import numpy as np

from safety.declarations import Constraint
from safety.vocabulary import Finding, Floats, Path

EPSILON = 1e-9
"""Rounding: a margin this far below zero is zero, and one that falls by this much has not fallen."""
FINE_M = 0.005
"""How finely a path is looked at where a limit is broken at its start: no distance falls by more than half of it unseen."""
FINE_MOST = 4096
"""So many points at most, however long the path is."""
SPARE_M = 3.0
"""What stands still is looked for this far beyond what is required; farther, a sentence says "at least"."""

T = TypeVar("T")
Margins = Sequence[float] | Floats


def amount(size: float, unit: str = "m") -> str:
    """A distance, speed, angle or time as a person reads it."""
    size = abs(size)
    text = f"{size:.1f}" if size >= 0.095 else f"{size:.2f}" if size >= 0.005 else "less than 0.01"
    return f"{text} {unit}"


def gaps_m(path: Path) -> Floats:
    """(n - 1,) distances between the points of a path."""
    points = path.points_ned_m.tolist()
    return np.array([math.dist(a, b) for a, b in pairwise(points)])


def between(margins: Floats, gaps: Floats) -> Floats:
    """(n - 1, ...) least that a distance can be on the way from one sample to the next: it changes by no more than is flown."""
    if margins.ndim == 2:
        gaps = gaps[:, None]
    return np.asarray((margins[:-1] + margins[1:] - gaps) * 0.5)


def mends(path: Path, margins_m: Callable[[Floats], Floats]) -> bool:
    """Is a limit broken at the start of a path, and nowhere along it more so than before? Source: X13, design 8.

    margins_m: (m,) margins of one object at (m, 3) points, never cut off where they are negative; or (m, a) at each of a
    places where the drone may be about every point: the least may not fall, and no place may that is too near. A single
    point mends nothing.
    """
    if len(path.points_ned_m) < 2:
        return False
    margins = margins_m(fine_points(path))
    if margins.ndim == 2:
        least = margins.min(axis=1, keepdims=True)
        margins = np.concatenate((least, np.minimum(margins, 0.0)), axis=1)
    return bool(margins[0].min() < 0.0 and (margins[1:] >= margins[:-1] - EPSILON).all())


def judge(
    constraint: Constraint,
    margins_m: Margins,
    between_m: Margins | None,
    spare: str,
    lack: str,
    unknown: str,
    far: bool = False,
    mending: Callable[[], bool] = lambda: False,
    of: str = "",
    subject: str = "",
) -> Finding:
    """The finding for (n,) margins in metres at the points of a path and (n - 1,) least margins between them.

    spare: what it is ("terrain"); lack: the sentence for a failure, with {} for the number; unknown: the sentence where a
    margin is not finite. far: margins from SPARE_M on are only known to be at least that. mending: whether the path only
    mends the limit, asked where it is broken (`mends`). of: the object, where the limit holds for each of several; subject: its name.
    """
    # Of so few numbers a list is faster than an array.
    margins = _listed(margins_m)
    # Between two samples it can only be less than at either.
    lowest = min((_listed(between_m) if between_m is not None else ()) or margins)
    # One sample that is not finite spoils the whole, even if it would be far away.
    if not math.isfinite(lowest + sum(margins)):
        return constraint.refused("m", unknown, subject)
    if lowest >= -EPSILON:
        lowest = max(lowest, 0.0)
        size = f"at least {SPARE_M:.0f} m" if far and lowest >= SPARE_M else amount(lowest)
        return constraint.finding(lowest, "m", True, f"{spare}: {size} to spare", subject=subject)
    text, below = lack.format(amount(lowest)), ((of, lowest),)
    if margins[0] < 0.0 and mending():
        text += " already, and this does not make it worse"
        return constraint.finding(lowest, "m", True, text, below, subject)
    return constraint.finding(lowest, "m", False, text, below, subject)


def _listed(margins: Margins) -> list[float]:
    return margins.tolist() if isinstance(margins, np.ndarray) else list(margins)


def worst(findings: Sequence[Finding]) -> Finding:
    """Of several findings of one constraint the sentence of the worst failure, or of the smallest margin if none fails.

    The margin is the smallest of all, so that it is continuous even where one of them mends and another fails (X13).
    """
    told = min(findings, key=lambda f: (f.passed, f.margin is not None, f.margin if f.margin is not None else 0.0))
    if told.margin is None or len(findings) == 1:
        return told
    below = tuple(entry for f in findings for entry in f.below)
    return replace(told, margin=min(f.margin for f in findings if f.margin is not None), below=below)


def once(function: Callable[..., T]) -> Callable[..., T]:
    """Answers again without computing again while it is asked about the very same (frozen) objects.

    Two rules ask the same of one path; the objects are held, so their identity cannot be reused.
    """
    last: tuple[tuple[object, ...], T] | None = None

    def asked(*about: object) -> T:
        nonlocal last
        if last is not None and all(map(is_, last[0], about)):
            return last[1]
        answer = function(*about)
        last = (about, answer)
        return answer

    return asked


@once
def fine_points(path: Path) -> Floats:
    """(m, 3) points of a path, FINE_M apart or as close as FINE_MOST of them allow; all points of the path are among them."""
    gaps = gaps_m(path)
    spacing_m = max(FINE_M, float(gaps.sum()) / FINE_MOST)
    pieces = [path.points_ned_m[:1]]
    for start, end, gap_m in zip(path.points_ned_m[:-1], path.points_ned_m[1:], gaps.tolist(), strict=True):
        n = max(1, math.ceil(gap_m / spacing_m))
        pieces.append(start + (np.arange(1, n + 1) / n)[:, None] * (end - start))
    return np.concatenate(pieces)
