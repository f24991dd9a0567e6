"""From margins along a path to a finding: the one place where a number becomes passed or not, and a sentence."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TypeVar

import numpy as np

from safety.vocabulary import Finding, Floats, Path

EPSILON = 1e-9
"""Rounding: a margin this far below zero is zero, and one that falls by this much has not fallen."""
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


def mends(margins: list[float]) -> bool:
    """Is the limit broken at the start of n > 1 margins, and never more so later? Source: X13, design 8."""
    return len(margins) > 1 and margins[0] < 0.0 and all(b >= a - EPSILON for a, b in pairwise(margins))


def judge(
    constraint: str,
    requirements: tuple[str, ...],
    margins_m: Margins,
    between_m: Margins | None,
    spare: str,
    lack: str,
    unknown: str,
    far: bool = False,
) -> Finding:
    """The finding for (n,) margins in metres at the points of a path and (n - 1,) least margins between them.

    spare: what it is ("terrain"); lack: the sentence for a failure, with {} for the number; unknown: the sentence where a
    margin is no number. far: margins from SPARE_M on are only known to be at least that.
    """
    # Of so few numbers a list is faster than an array.
    margins = _listed(margins_m)
    # Between two samples it can only be less than at either.
    lowest = min((_listed(between_m) if between_m is not None else ()) or margins)
    # One sample that is no number spoils the whole, even if it would be far away.
    if not math.isfinite(lowest + sum(margins)):
        return Finding(constraint, requirements, None, "m", False, unknown)
    if lowest >= -EPSILON:
        lowest = max(lowest, 0.0)
        size = f"at least {SPARE_M:.0f} m" if far and lowest >= SPARE_M else amount(lowest)
        return Finding(constraint, requirements, lowest, "m", True, f"{spare}: {size} to spare")
    text = lack.format(amount(lowest))
    if mends(margins):
        return Finding(constraint, requirements, lowest, "m", True, f"{text} already, and this does not make it worse")
    return Finding(constraint, requirements, lowest, "m", False, text)


def _listed(margins: Margins) -> list[float]:
    return margins.tolist() if isinstance(margins, np.ndarray) else list(margins)


def worst(findings: Sequence[Finding]) -> Finding:
    """Of several findings of one constraint the sentence of the worst failure, or of the smallest margin if none fails.

    The margin is the smallest of all, so that it is continuous even where one of them mends and another fails (X13).
    """
    told = min(findings, key=lambda f: (f.passed, f.margin is not None, f.margin if f.margin is not None else 0.0))
    if told.margin is None:
        return told
    return replace(told, margin=min(f.margin for f in findings if f.margin is not None))


def refused(constraint: str, requirements: tuple[str, ...], unit: str, text: str) -> Finding:
    """A failure without a number: something is unknown (X6)."""
    return Finding(constraint, requirements, None, unit, False, text)


def once(function: Callable[..., T]) -> Callable[..., T]:
    """Answers again without computing again while it is asked about the very same (frozen) objects.

    Two rules ask the same of one path; the objects are held, so their identity cannot be reused.
    """
    last: tuple[tuple[object, ...], T] | None = None

    def asked(*about: object) -> T:
        nonlocal last
        known = last
        if (
            known is not None
            and len(known[0]) == len(about)
            and all(a is b for a, b in zip(known[0], about, strict=True))
        ):
            return known[1]
        answer = function(*about)
        last = (about, answer)
        return answer

    return asked
