"""What an estimate is worth: speed by velocity and by position, jumps, and the noise of a hover. Source: X6, X11, R8."""

from __future__ import annotations

import itertools
import math
from dataclasses import fields, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from safety.estimate import (
    ASTRAY,
    AT_FIRST,
    WANDER,
    HoverSample,
    Motion,
    Noise,
    adapted,
    astray,
    disagreement,
    flown,
    is_astray,
    jump,
    moved,
    observed,
    spans_s,
    too_noisy,
    with_hover,
)
from safety.limits import Limits
from safety.vocabulary import Ned, VehicleState
from tests.safety.scene import LIMITS, vehicle

STILL = Ned(0.0, 0.0, 0.0)
NOISE = Noise(Ned(0.1, 0.0, 0.0), 0.1, 0.3, 0.5)


def fly(seconds: float, velocity: Ned, said: Ned | None = None, dt_s: float = 0.02) -> tuple[Motion, VehicleState]:
    """A drone that moves at `velocity` and says `said`."""
    motion, last = AT_FIRST, None
    for i in range(round(seconds / dt_s) + 1):
        t_s = i * dt_s
        at = Ned(*(t_s * v for v in velocity))
        now = replace(vehicle(), at_s=t_s, position=at, velocity=said if said is not None else velocity)
        motion, last = moved(motion, now, last), now
    assert last is not None
    return motion, last


@pytest.mark.parametrize("dt_s", [0.02, 0.1, 0.25])
def test_speed_by_velocity_and_by_position_agree_where_the_estimate_does(dt_s: float) -> None:
    motion, _ = fly(3.0, Ned(0.3, 0.4, 0.0), dt_s=dt_s)
    assert motion.by_velocity_m_s == pytest.approx(0.5)
    assert motion.by_position_m_s == pytest.approx(0.5, abs=0.01)


def test_of_a_noisy_estimate_the_lesser_counts_and_of_another_the_velocity() -> None:
    """What is real shows in both: a velocity that is wrong does not move the position."""
    for real, said in ((0.0, 0.6), (0.6, 0.0)):
        motion, _ = fly(3.0, Ned(real, 0.0, 0.0), Ned(said, 0.0, 0.0))
        assert motion.speed_m_s(NOISE) == pytest.approx(0.0, abs=0.01)
        assert motion.speed_m_s(None) == pytest.approx(said)


@pytest.mark.requirement("X6")
@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_speed_that_is_not_finite_looks_like_none(bad: float) -> None:
    motion, _ = fly(3.0, STILL, Ned(bad, 0.0, 0.0))
    assert not motion.speed_m_s(NOISE) < 1e9
    assert not motion.rests(NOISE, LIMITS) and not motion.rests(None, LIMITS)


@pytest.mark.parametrize(("speed_m_s", "rests"), [(0.0, True), (0.099, True), (0.101, False), (1.0, False)])
def test_rest_is_slower_than_its_limit(speed_m_s: float, rests: bool) -> None:
    motion, _ = fly(3.0, Ned(speed_m_s, 0.0, 0.0))
    assert motion.rests(None, LIMITS) == rests


def test_with_noise_rest_needs_position_and_velocity() -> None:
    wider = adapted(LIMITS, NOISE)  # rests below 0.3 m/s by position, and 0.9 m/s by velocity
    for real, said, rests in ((0.2, 0.8, True), (0.4, 0.8, False), (0.2, 1.0, False)):
        motion, _ = fly(3.0, Ned(real, 0.0, 0.0), Ned(said, 0.0, 0.0))
        assert motion.rests(NOISE, wider) == rests
    assert not Motion(0.0, ()).rests(NOISE, wider), "a track that is too short shows nothing"


def test_a_jump_is_what_the_velocity_does_not_explain() -> None:
    _, last = fly(1.0, Ned(1.0, 0.0, 0.0))
    on = replace(last, at_s=last.at_s + 0.1, position=last.position.plus(Ned(0.1, 0.0, 0.0)))
    assert jump(on, last).norm == pytest.approx(0.0, abs=1e-9)
    off = replace(on, position=on.position.plus(Ned(0.0, 3.0, -4.0)))
    assert jump(off, last) == pytest.approx((0.0, 3.0, -4.0))
    assert disagreement(off, last).norm == pytest.approx(5.0)
    assert disagreement(off, None) == STILL
    later = replace(off, at_s=off.at_s + 2.0, velocity=STILL, disagreement=Ned(0.0, 3.0, 0.0))
    calm = replace(later, at_s=later.at_s + 2.0)
    assert disagreement(calm, later).norm == pytest.approx(3.0 / math.e)


def hover(
    spread_m: float, speed_m_s: float = 0.0, said_m_s: float = 0.0, off_m: float = 0.0
) -> tuple[HoverSample, ...]:
    return tuple(
        HoverSample(0.1 * i, Ned(spread_m * (-1.0) ** i, 0.0, 0.0), speed_m_s, said_m_s, off_m) for i in range(80)
    )


def test_noise_is_the_spread_and_the_root_mean_squares_of_a_hover() -> None:
    seen = observed(hover(0.2, 0.1, 0.3, 0.5))
    assert seen.position == pytest.approx((0.2, 0.0, 0.0))
    assert (seen.speed_m_s, seen.velocity_m_s, seen.disagreement_m) == pytest.approx((0.1, 0.3, 0.5))
    assert spans_s(hover(0.2)) == pytest.approx(7.9) and spans_s(()) == 0.0


@pytest.mark.requirement("X11")
@given(st.floats(0.0, 2.0), st.floats(0.0, 2.0), st.floats(0.0, 2.0), st.floats(0.0, 5.0))
def test_noise_only_ever_widens_and_only_what_it_concerns(place: float, speed: float, said: float, off: float) -> None:
    wider = adapted(LIMITS, Noise(Ned(place, 0.0, 0.0), speed, said, off))
    changed = {f.name for f in fields(Limits) if getattr(wider, f.name) != getattr(LIMITS, f.name)}
    assert changed <= {"rest_m_s", "tracking_m", "speed_tolerance_m_s", "disagreement_m"}
    assert all(getattr(wider, name) > getattr(LIMITS, name) for name in changed)
    noisy = 3.0 * speed > 0.1 or 3.0 * WANDER * place > 0.3 or 3.0 * WANDER * off > 0.5
    assert wider.tracking_m == (max(1.0, 3.0 * WANDER * place) if noisy else 0.3)
    assert wider.disagreement_m == (max(2.0, 3.0 * WANDER * off) if noisy else 0.5)


@pytest.mark.parametrize(
    ("place_m", "off_m", "says"),
    [
        (0.3, 0.5, None),
        (0.47, 0.5, None),
        (0.48, 0.5, "wanders by 0.48 m"),
        (0.1, 0.95, None),
        (0.1, 0.96, "disagree by 0.96 m"),
    ],
)
def test_what_is_too_noisy_is_said_in_numbers(place_m: float, off_m: float, says: str | None) -> None:
    why = too_noisy(Noise(Ned(place_m, 0.0, 0.0), 0.1, 0.1, off_m), LIMITS)
    assert (why is None) if says is None else (why is not None and says in why)


def test_samples_of_a_hover_are_few_recent_and_finite() -> None:
    motion, last = fly(3.0, STILL)
    samples: tuple[HoverSample, ...] = ()
    for i in range(1000):
        samples = with_hover(samples, replace(last, at_s=0.02 * i), motion, 8.0)
    assert len(samples) <= 82 and 7.8 < spans_s(samples) <= 8.0 + 0.1
    assert with_hover(samples, replace(last, at_s=99.0, position=Ned(math.nan, 0.0, 0.0)), motion, 8.0) == ()


def test_speed_by_velocity_follows_in_a_tenth_of_a_second() -> None:
    """Of a step from 0 to 1 m/s, a report 0.04 s later shows four tenths, one 0.1 s later all; before any, what is said."""
    still, quick = vehicle(at_s=10.0), {"velocity": Ned(1.0, 0.0, 0.0)}
    motion = moved(AT_FIRST, still, None)
    assert motion.by_velocity_m_s == 0.0
    for dt_s, expected in ((0.04, 0.4), (0.1, 1.0), (0.5, 1.0), (0.0, 0.0), (-1.0, 0.0)):
        assert moved(motion, vehicle(at_s=10.0 + dt_s, **quick), still).by_velocity_m_s == pytest.approx(expected)
    assert moved(motion, vehicle(at_s=10.04, **quick), None).by_velocity_m_s == 1.0
    lost = Motion(math.nan, ())
    assert moved(lost, vehicle(at_s=10.04, **quick), still).by_velocity_m_s == 1.0, "what was no number is not followed"


def test_the_track_is_half_a_second_of_samples() -> None:
    motion, last = fly(3.0, Ned(1.0, 0.0, 0.0), dt_s=0.01)
    times = [place.at_s for place in motion.track]
    assert len(times) in (13, 14, 15) and times[-1] - times[0] <= 0.54 + 1e-9
    assert all(b - a >= 0.04 - 1e-9 for a, b in itertools.pairwise(times))
    again = moved(motion, replace(last, at_s=last.at_s - 1.0), last)
    assert [place.at_s for place in again.track] == [last.at_s - 1.0], "a clock that goes back begins anew"


@pytest.mark.parametrize(("seconds", "known"), [(0.36, False), (0.44, True)])
def test_speed_by_position_needs_most_of_its_window(seconds: float, known: bool) -> None:
    motion, _ = fly(seconds, Ned(1.0, 0.0, 0.0), dt_s=0.04)
    assert math.isfinite(motion.by_position_m_s) == known


def test_a_hover_without_a_speed_by_position_is_not_sampled() -> None:
    assert with_hover((), vehicle(at_s=5.0), Motion(0.0, ()), 8.0) == ()
    before = hover(0.1)[:3]
    assert with_hover(before, vehicle(at_s=5.0), Motion(0.0, ()), 8.0) is before


@pytest.mark.requirement("X6", "X11")
def test_what_was_flown_is_the_mean_of_both_velocities_over_the_time_between() -> None:
    first = replace(vehicle(), at_s=1.0, velocity=Ned(1.0, 0.0, -2.0))
    then = replace(vehicle(), at_s=1.5, velocity=Ned(3.0, 0.0, 0.0))
    assert flown(then, first) == pytest.approx((1.0, 0.0, -0.5))
    assert flown(first, then) == (0.0, 0.0, 0.0)


@pytest.mark.requirement("X6", "X11")
@pytest.mark.parametrize(
    ("before", "by_position", "by_velocity", "after"),
    [
        (STILL, STILL, Ned(0.0, -0.5, 0.0), Ned(0.0, -0.5, 0.0)),  # stuck
        (Ned(0.0, -0.5, 0.0), STILL, Ned(0.0, -0.5, 0.0), Ned(0.0, -1.0, 0.0)),  # again: it adds up
        (Ned(0.0, -0.5, 0.0), STILL, Ned(0.0, 0.5, 0.0), STILL),  # and back
        (Ned(0.0, -0.5, 0.4), Ned(0.0, -0.9, 0.0), Ned(0.0, -1.0, 0.0), Ned(0.0, 0.0, 0.4)),  # followed along its line
        (STILL, Ned(0.0, -0.5, 0.0), Ned(0.0, -1.0, 0.0), Ned(0.0, -0.5, 0.0)),  # half is not followed
        (STILL, Ned(0.0, -0.51, 0.0), Ned(0.0, -1.0, 0.0), STILL),
        (Ned(0.0, 0.0, 0.4), STILL, STILL, Ned(0.0, 0.0, 0.4)),  # nothing was flown
        (Ned(0.0, 0.0, 0.4), Ned(math.nan, 0.0, 0.0), Ned(1.0, 0.0, 0.0), Ned(0.0, 0.0, 0.4)),
        (Ned(0.0, 0.0, 0.4), STILL, Ned(0.0, math.inf, 0.0), Ned(0.0, 0.0, 0.4)),
    ],
)
def test_what_position_missed_adds_up_until_it_follows(
    before: Ned, by_position: Ned, by_velocity: Ned, after: Ned
) -> None:
    assert astray(before, by_position, by_velocity) == pytest.approx(after)


@pytest.mark.requirement("X6", "X11")
def test_astray_begins_where_more_is_missed_than_one_aborted_maneuver_explains() -> None:
    most_m = ASTRAY * LIMITS.disagreement_m
    assert not is_astray(Ned(0.0, most_m, 0.0), LIMITS)
    assert is_astray(Ned(0.0, 0.0, most_m + 1e-6), LIMITS)
    assert is_astray(Ned(math.nan, 0.0, 0.0), LIMITS)
