"""What the rules' arithmetic rests on, each for all values within the bounds of config/settings.py, not for samples.

A lemma is what is given, what it claims, and a `wrong` twin: the claim turned or an assumption left out, for which the solver
must find a counter-example, so that no lemma holds for want of any numbers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import z3

from safety.findings import EPSILON, FINE_M
from tests.formal import formulas as f
from tests.formal.formulas import Terms

TOLERANCE = 1e-9


@dataclass(frozen=True)
class Lemma:
    """given /\\ not claim has no solution; wrong_given /\\ not wrong_claim has one."""

    name: str
    requirements: tuple[str, ...]
    given: tuple[z3.BoolRef, ...]
    claim: z3.BoolRef
    wrong_given: tuple[z3.BoolRef, ...]
    wrong_claim: z3.BoolRef


def _lemma(
    name: str,
    requirements: tuple[str, ...],
    terms: Terms,
    claim: z3.BoolRef,
    *,
    assuming: tuple[z3.BoolRef, ...] = (),
    wrong: z3.BoolRef | None = None,
) -> Lemma:
    """assuming: what the wrong twin leaves out. wrong: what it claims instead."""
    given = tuple(terms.given)
    return Lemma(
        name,
        requirements,
        (*given, *assuming),
        claim,
        given if wrong is None else (*given, *assuming),
        claim if wrong is None else wrong,
    )


@dataclass(frozen=True)
class Bounds:
    """The limits that the lemmas are about, as symbols."""

    terms: Terms
    speed: z3.ArithRef
    acceleration: z3.ArithRef
    lag: z3.ArithRef
    braking: z3.ArithRef

    def stop(self, speed: z3.ArithRef) -> z3.ArithRef:
        return f.stopping_m(speed, self.lag, self.braking, self.terms)

    def peak(self, distance: z3.ArithRef) -> z3.ArithRef:
        return f.peak(distance, self.speed, self.acceleration, self.terms)


def bounds() -> Bounds:
    terms = Terms()
    return Bounds(
        terms,
        terms.number("speed", 0.05, 2),
        terms.number("acceleration", 0.1, 2),
        terms.number("lag", 0.1, 3),
        terms.number("braking", 0.2, 5),
    )


def stopping_grows_with_speed() -> Lemma:
    b = bounds()
    slow, fast = b.terms.number("slow", 0, 2), b.terms.number("fast", 0, 2)
    claim = b.stop(slow) <= b.stop(fast)
    return _lemma("a slower drone stops sooner", ("X11",), b.terms, claim, assuming=(slow <= fast,))


def stopping_within_the_tube() -> Lemma:
    """Wherever along its move the drone is told to hold, at the profile's speed there, it stops within what was judged."""
    b = bounds()
    distance, t = b.terms.number("distance", 0.01, 10), b.terms.number("t")
    covered, now = f.covered_at(distance, b.speed, b.acceleration, t, b.terms)
    claim = z3.And(covered >= 0, covered + b.stop(now) <= distance + b.stop(b.peak(distance)))
    wrong = covered + b.stop(now) <= distance
    return _lemma("told to hold anywhere, it stops within the swept path", ("X11", "R3"), b.terms, claim, wrong=wrong)


def profile_within_the_envelope() -> Lemma:
    b = bounds()
    distance, t = b.terms.number("distance", 0.01, 10), b.terms.number("t")
    covered, now = f.covered_at(distance, b.speed, b.acceleration, t, b.terms)
    claim = z3.And(covered >= 0, covered <= distance, now >= 0, now <= b.speed)
    return _lemma("a profile stays on its path and below its speed", ("R8", "G6"), b.terms, claim, wrong=now < b.speed)


def shorter_is_slower() -> Lemma:
    b = bounds()
    short, long = b.terms.number("short", 0.001, 10), b.terms.number("long", 0.001, 10)
    claim = b.peak(short) <= b.peak(long)
    return _lemma("a shorter move is no faster", ("P3", "R8"), b.terms, claim, assuming=(short <= long,))


def shorter_is_swept_within() -> Lemma:
    """So what stands still and is clear of the long move is clear of the short one."""
    b = bounds()
    short, long = b.terms.number("short", 0.001, 10), b.terms.number("long", 0.001, 10)
    claim = short + b.stop(b.peak(short)) <= long + b.stop(b.peak(long))
    return _lemma(
        "a shorter move, stopping included, lies within the longer",
        ("P3", "X11"),
        b.terms,
        claim,
        assuming=(short <= long,),
    )


def shorter_ends_no_later() -> Lemma:
    b = bounds()
    short, long = b.terms.number("short", 0.001, 10), b.terms.number("long", 0.001, 10)
    claim = f.duration_s(short, b.speed, b.acceleration, b.terms) <= f.duration_s(
        long, b.speed, b.acceleration, b.terms
    )
    return _lemma("a shorter move ends no later", ("P3", "R8"), b.terms, claim, assuming=(short <= long,))


def reaching_reaches_no_further() -> Lemma:
    b = bounds()
    reach = b.terms.number("reach", 0.001, 20)
    length = f.reaching_m(reach, b.speed, b.acceleration, b.braking, b.lag, b.terms)
    claim = z3.And(length >= 0, length + b.stop(b.peak(length)) == reach)
    wrong = length + b.stop(b.peak(length)) < reach
    return _lemma(
        "what may be that long ends, stopped, exactly at its reach", ("X11", "P3"), b.terms, claim, wrong=wrong
    )


def confidence_is_a_share() -> Lemma:
    terms = Terms()
    half = terms.number("half", 0.1, 5)
    small, large = terms.number("small", 0), terms.number("large", 0)
    sure, unsure = f.confidence_of(small, half, terms), f.confidence_of(large, half, terms)
    claim = z3.And(sure > 0, sure <= 1, unsure > 0, unsure <= sure)
    return _lemma(
        "a larger error is no more confidence, within (0, 1]", ("R11",), terms, claim, assuming=(small <= large,)
    )


def confidence_is_half_at_half() -> Lemma:
    terms = Terms()
    half = terms.number("half", 0.1, 5)
    sigma = terms.number("sigma", 0)
    claim = (f.confidence_of(sigma, half, terms) >= 0.5) == (sigma <= half)
    wrong = f.confidence_of(sigma, half, terms) >= 0.5
    return _lemma(
        "confidence is a half or more up to the stated error, not beyond", ("R11",), terms, claim, wrong=wrong
    )


def fusion_is_a_share() -> Lemma:
    terms = Terms()
    a, b = terms.number("a"), terms.number("b")
    together = f.fused(a, b)
    claim = z3.And(together >= a, together >= b, together >= 0, together <= 1)
    known = (a >= 0, a <= 1, b >= 0, b <= 1)
    return _lemma("fused confidence is in [0, 1] and no less than either", ("X5", "G1"), terms, claim, assuming=known)


def fusion_is_monotone() -> Lemma:
    terms = Terms()
    a, b, more = terms.number("a", 0, 1), terms.number("b", 0, 1), terms.number("more", 0, 1)
    claim = z3.And(f.fused(a, b) <= f.fused(more, b), f.fused(a, b) == f.fused(b, a))
    return _lemma("more confidence of one is no less of both", ("X5", "G1"), terms, claim, assuming=(a <= more,))


def nothing_lower_between() -> Lemma:
    """A distance changes by no more than is flown: nowhere between two samples is it less than `between` says."""
    terms = Terms()
    first, last, gap = terms.number("first"), terms.number("last"), terms.number("gap", 0)
    flown, here = terms.number("flown", 0), terms.number("here")
    terms.given += [flown <= gap, here >= first - flown]
    claim = here >= f.between(first, last, gap)
    return _lemma(
        "nowhere between two samples is a margin below what is judged",
        ("R3", "X11"),
        terms,
        claim,
        assuming=(here >= last - (gap - flown),),
    )


def mending_never_decreases() -> Lemma:
    """The induction step of `mends`: with every margin no less than the one before, none is below the best so far."""
    terms = Terms()
    best, before, after, n = terms.number("best"), terms.number("before"), terms.number("after"), terms.number("n", 0)
    terms.given.append(before >= best - n * EPSILON)
    claim = after >= f.most(best, after) - (n + 1) * EPSILON
    return _lemma(
        "along a path that mends, no margin falls below the best before it",
        ("X13",),
        terms,
        claim,
        assuming=(after >= before - EPSILON,),
    )


def mending_unseen_dip() -> Lemma:
    """What `findings.FINE_M` says: between two fine points of a mending path a margin dips by half of their gap at most."""
    terms = Terms()
    first, last, gap = terms.number("first"), terms.number("last"), terms.number("gap", 0, FINE_M)
    flown, here = terms.number("flown", 0), terms.number("here")
    terms.given += [flown <= gap, here >= first - flown, here >= last - (gap - flown)]
    claim = here >= first - z3.RealVal(str(FINE_M)) / 2 - EPSILON
    return _lemma(
        "between two fine points of a mending path a margin dips by FINE_M / 2 at most",
        ("X13",),
        terms,
        claim,
        assuming=(last >= first - EPSILON,),
    )


def nearest_is_a_lower_bound() -> Lemma:
    """For any share of a straight stretch of relative flight; onward and the squares as of any two real vectors."""
    terms = Terms()
    first, length, onward = terms.number("first", 0), terms.number("length", 0), terms.number("onward")
    share = terms.number("share", 0, 1)
    last = first + 2 * onward + length
    there = first + 2 * share * onward + share * share * length
    nearest = f.nearest_square(first, last, onward, terms)
    return _lemma(
        "nowhere on a stretch are two aircraft nearer than judged",
        ("R6", "G3"),
        terms,
        nearest <= there,
        wrong=there <= nearest,
    )


def separation_with_errors() -> Lemma:
    """Required is separation and both errors: what passes is apart even where both err towards each other."""
    terms = Terms()
    separation, ours, theirs = terms.number("separation", 0), terms.number("ours", 0), terms.number("theirs", 0)
    believed, true = terms.number("believed", 0), terms.number("true", 0)
    terms.given.append(true >= believed - ours - theirs)
    claim = true >= separation - EPSILON
    return _lemma(
        "what passes is apart whatever both positions are wrong by",
        ("R6", "X11"),
        terms,
        claim,
        assuming=(believed - (separation + ours + theirs) >= -EPSILON,),
    )


LEMMAS: tuple[Callable[[], Lemma], ...] = (
    stopping_grows_with_speed, stopping_within_the_tube, profile_within_the_envelope, shorter_is_slower,
    shorter_is_swept_within, shorter_ends_no_later, reaching_reaches_no_further, confidence_is_a_share,
    confidence_is_half_at_half, fusion_is_a_share, fusion_is_monotone, nothing_lower_between, mending_never_decreases,
    mending_unseen_dip, nearest_is_a_lower_bound, separation_with_errors,
)  # fmt: skip


def counter_example(given: tuple[z3.BoolRef, ...], claim: z3.BoolRef, timeout_ms: int = 20_000) -> z3.ModelRef | None:
    """Numbers for which `claim` fails though all of `given` holds; None: there are none. Raises TimeoutError: not known."""
    solver = z3.SolverFor("QF_NRA")
    solver.set("timeout", timeout_ms)
    solver.add(*given, z3.Not(claim))
    found = solver.check()
    if found == z3.unknown:
        raise TimeoutError(f"the solver does not know within {timeout_ms / 1000:.0f} s: {solver.reason_unknown()}")
    return solver.model() if found == z3.sat else None
