"""How long a maneuver may be: the largest length that passes, found by its margins in few tries. Source: P3, design 7."""

from __future__ import annotations

import math
from collections.abc import Callable

Tried = tuple[bool, float]
"""Did it pass, and the smallest margin (m; any number if there is none)."""


def longest_passing(
    attempt: Callable[[float], Tried], low_m: float, high_m: float, at_high: Tried, step_m: float
) -> float | None:
    """The end of a bracket no wider than step_m: a length that passes, step_m below one that fails. None: low_m fails.

    As bisection (and never more than twice its tries), but where the margins say the limit is met it looks just below
    and just above: margins fall about evenly with the length, so two or three tries are enough. at_high: what is known of
    high_m, which fails.
    """
    passed, at_low_m = attempt(low_m)
    if not passed:
        return None
    at_high_m = at_high[1]
    halve, width_m = False, high_m - low_m
    while high_m - low_m > step_m:
        middle_m = 0.5 * (low_m + high_m)
        probe_m = middle_m
        if not halve and at_low_m > 0.0 > at_high_m and math.isfinite(at_low_m - at_high_m):
            limit_m = low_m + (high_m - low_m) * at_low_m / (at_low_m - at_high_m)
            # A little below the limit, but far enough from either end that the bracket closes if the guess is right.
            probe_m = min(max(limit_m - 0.3 * step_m, low_m + 0.9 * step_m), high_m - 0.9 * step_m)
            if not low_m < probe_m < high_m:
                probe_m = middle_m
        passed, margin_m = attempt(probe_m)
        if passed:
            low_m, at_low_m = probe_m, margin_m
        else:
            high_m, at_high_m = probe_m, margin_m
        # A guess that did not halve the bracket is followed by a halving.
        halve = not halve and high_m - low_m > 0.5 * width_m
        width_m = high_m - low_m
    return low_m
