"""The formulas of the rules, as z3 terms over the reals; `test_lemmas` holds each to the code that it states.

What has a square root is a new real with its defining conditions, which go into `given`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import count

import z3

_names = count()


@dataclass
class Terms:
    """Terms and what must hold of the numbers in them."""

    given: list[z3.BoolRef] = field(default_factory=list)

    def number(self, name: str, low: float | None = None, high: float | None = None) -> z3.ArithRef:
        """A real within bounds, as config/settings.py has them."""
        x = z3.Real(name)
        if low is not None:
            self.given.append(x >= low)
        if high is not None:
            self.given.append(x <= high)
        return x

    def root(self, square: z3.ArithRef) -> z3.ArithRef:
        x = z3.Real(f"root{next(_names)}")
        self.given += [x >= 0, x * x == square]
        return x

    def ratio(self, above: z3.ArithRef, below: z3.ArithRef) -> z3.ArithRef:
        """above / below where below is not 0; said without a division, which the solver is slow with."""
        x = z3.Real(f"ratio{next(_names)}")
        self.given += [x * below == above, below != 0]
        return x


def least(a: z3.ArithRef, b: z3.ArithRef) -> z3.ArithRef:
    return z3.If(a <= b, a, b)


def most(a: z3.ArithRef, b: z3.ArithRef) -> z3.ArithRef:
    return z3.If(a >= b, a, b)


def stopping_m(speed: z3.ArithRef, lag: z3.ArithRef, braking: z3.ArithRef, terms: Terms) -> z3.ArithRef:
    """planner.stopping_m."""
    return speed * lag + terms.ratio(speed * speed, 2 * braking)


def peak(distance: z3.ArithRef, speed: z3.ArithRef, acceleration: z3.ArithRef, terms: Terms) -> z3.ArithRef:
    """vocabulary.Profile.peak."""
    return least(speed, terms.root(distance * acceleration))


def duration_s(distance: z3.ArithRef, speed: z3.ArithRef, acceleration: z3.ArithRef, terms: Terms) -> z3.ArithRef:
    """vocabulary.Profile.duration_s, for a distance above 0."""
    top = peak(distance, speed, acceleration, terms)
    return terms.ratio(distance, top) + terms.ratio(top, acceleration)


def confidence_of(sigma: z3.ArithRef, half: z3.ArithRef, terms: Terms) -> z3.ArithRef:
    """confidence.confidence_of, for a sigma that is known."""
    share = terms.ratio(sigma, half)
    return terms.ratio(z3.RealVal(1), 1 + share * share)


def fused(a: z3.ArithRef, b: z3.ArithRef) -> z3.ArithRef:
    """fusion.fused, lifted, of two confidences in [0, 1]."""
    return 1 - (1 - a) * (1 - b)


def between(first: z3.ArithRef, last: z3.ArithRef, gap: z3.ArithRef) -> z3.ArithRef:
    """findings.between."""
    return (first + last - gap) / 2


def nearest_square(first: z3.ArithRef, last: z3.ArithRef, onward: z3.ArithRef, terms: Terms) -> z3.ArithRef:
    """separation.nearest_m, squared and not yet cut off at 0. first, last: squares at both ends; onward: scalar product."""
    length = last - first - 2 * onward
    dip = z3.Real(f"dip{next(_names)}")
    dips = z3.And(onward < 0, -onward < length)
    terms.given.append(z3.Implies(dips, dip * length == first * length - onward * onward))
    ends = least(first, last)
    return z3.If(dips, least(ends, dip), ends)


def reaching_m(
    reach: z3.ArithRef,
    speed: z3.ArithRef,
    acceleration: z3.ArithRef,
    braking: z3.ArithRef,
    lag: z3.ArithRef,
    terms: Terms,
) -> z3.ArithRef:
    """planner.length_reaching_m."""
    length = reach - stopping_m(speed, lag, braking, terms)
    per_square = terms.ratio(z3.RealVal(1), acceleration) + terms.ratio(z3.RealVal(1), 2 * braking)
    top = terms.ratio(terms.root(lag * lag + 4 * per_square * reach) - lag, 2 * per_square)
    short = terms.ratio(top * top, acceleration)
    return z3.If(length * acceleration >= speed * speed, length, short)


def covered_at(
    distance: z3.ArithRef, speed: z3.ArithRef, acceleration: z3.ArithRef, t: z3.ArithRef, terms: Terms
) -> tuple[z3.ArithRef, z3.ArithRef]:
    """vocabulary.Profile.at and speed_at, for a distance above 0 and 0 < t < duration."""
    top = peak(distance, speed, acceleration, terms)
    ramp = terms.ratio(top, acceleration)
    whole = terms.ratio(distance, top) + ramp
    left = whole - t
    covered = z3.If(
        t < ramp,
        acceleration * t * t / 2,
        z3.If(t <= whole - ramp, top * (t - ramp / 2), distance - acceleration * left * left / 2),
    )
    terms.given += [t > 0, t < whole]
    return covered, least(top, least(acceleration * t, acceleration * left))
