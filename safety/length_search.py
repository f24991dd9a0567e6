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

    As bisection, and never more than about three times its tries, but where the margins say the limit is met it looks just
    below and then just above: margins fall about evenly with the length, so a few tries are enough. at_high: what is known
    of high_m, which fails.
    """
    at_high_m = at_high[1]
    # The first guess is that the limit is met head-on, every metre costing one of margin; the second knows better.
    passed, at_low_m, per_m = False, math.nan, 1.0
    for _ in range(2):
        guess_m = high_m + at_high_m / per_m - 0.4 * step_m if per_m > 0.0 else low_m
        if passed or not low_m < guess_m < high_m:
            break
        passed, margin_m = attempt(guess_m)
        if passed:
            low_m, at_low_m = guess_m, margin_m
        else:
            per_m = (margin_m - at_high_m) / (high_m - guess_m)
            high_m, at_high_m = guess_m, margin_m
    # Aim a little below the limit while that is not yet passed, then above it; farther every time the aim was too short.
    aim_m, guesses, width_m = 0.4 * step_m if passed else -0.4 * step_m, 0, high_m - low_m
    if not passed:
        passed, at_low_m = attempt(low_m)
        if not passed:
            return None
    while high_m - low_m > step_m:
        probe_m = 0.5 * (low_m + high_m)
        if guesses < 2 and at_low_m > 0.0 > at_high_m and math.isfinite(at_low_m - at_high_m):
            limit_m = low_m + (high_m - low_m) * at_low_m / (at_low_m - at_high_m)
            guess_m = min(max(limit_m + aim_m, low_m + 0.5 * step_m), high_m - 0.5 * step_m)
            probe_m = guess_m if low_m < guess_m < high_m else probe_m
        passed, margin_m = attempt(probe_m)
        if passed:
            aim_m = 0.4 * step_m if aim_m < 0.0 else 2.0 * aim_m
            low_m, at_low_m = probe_m, margin_m
        else:
            aim_m = -0.4 * step_m if aim_m > 0.0 else 2.0 * aim_m
            high_m, at_high_m = probe_m, margin_m
        # Two guesses that did not halve the bracket are followed by a halving.
        guesses = guesses + 1 if guesses < 2 and high_m - low_m > 0.5 * width_m else 0
        width_m = width_m if guesses else high_m - low_m
    return low_m
