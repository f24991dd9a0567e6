"""Other aircraft: closest approach in time, reserved volumes, silence."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from safety.constraints import nearby
from safety.planner import plan_translation, swept
from safety.separation import neighbour_age, reservation, separation
from safety.situation import Situation
from safety.vocabulary import Floats, Ned, Neighbours, Path, Primitive, ReservedVolume
from safety.volumes import swept_volume, volumes_meet
from tests.safety.scene import EXACT, LIMITS, NOW_S, START, hover, number, situation, sky, straight, vehicle

STILL = Ned(0.0, 0.0, 0.0)
OFFSETS = (-1.0, -0.1, -1e-3, -1e-6, 0.0, 1e-6, 1e-3, 0.1, 1.0)


def at(north: float, east: float = 0.0, up: float = 0.0) -> Ned:
    """Metres from START."""
    return START.plus(Ned(north, east, -up))


def north(length_m: float = 1.0, along_track_tolerance_m: float = 0.0) -> Path:
    return straight(at(length_m), along_track_tolerance_m=along_track_tolerance_m)


def random_sky(seed: int, count: int, wide_m: float = 30.0) -> Neighbours:
    rng = np.random.default_rng(seed)
    return Neighbours(
        tuple(f"n{i}" for i in range(count)),
        np.asarray(START) + rng.uniform(-wide_m, wide_m, (count, 3)),
        rng.normal(0.0, 3.0, (count, 3)),
        rng.uniform(0.0, 0.5, count),
        NOW_S - rng.uniform(0.0, 1.5, count),
        NOW_S,
    )


def sampled_margin(path: Path, scene: Situation) -> float:
    """The same by brute force: every neighbour at every one of many times."""
    times = np.linspace(0.0, max(path.times_s[-1], LIMITS.horizon_s), 20_001)
    own = np.stack([np.interp(times, path.times_s, path.points_ned_m[:, i]) for i in range(3)], axis=1)
    neighbours, lowest = scene.neighbours, math.inf
    for i in range(len(neighbours)):
        age_s = NOW_S - neighbours.at_s[i]
        velocity = neighbours.velocities_ned_m_s[i]
        theirs = neighbours.positions_ned_m[i] + (age_s + times)[:, None] * velocity
        speed = float(np.linalg.norm(velocity))
        required = (
            LIMITS.separation_m + LIMITS.tracking_m + path.along_track_tolerance_m
            + LIMITS.sigma_k * (scene.vehicle.sigma_m + neighbours.sigmas_m[i])
            + speed * age_s + 0.5 * LIMITS.neighbour_acceleration_m_s2 * age_s**2
        )  # fmt: skip
        lowest = min(lowest, float(np.linalg.norm(own - theirs, axis=1).min()) - required)
    return lowest


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 100_000), st.integers(1, 5), st.floats(0.0, 0.5))
def test_closest_approach_is_that_of_a_dense_sampling(seed: int, count: int, along_track_tolerance_m: float) -> None:
    scene = situation(neighbours=random_sky(seed, count), vehicle=vehicle(sigma_h_m=0.2, sigma_v_m=0.1))
    path = straight(at(1.0, 0.3), along_track_tolerance_m=along_track_tolerance_m)
    assert number(separation(path, scene, LIMITS)) == pytest.approx(sampled_margin(path, scene), abs=0.01)


@pytest.mark.requirement("R5", "R6", "G3")
@pytest.mark.parametrize("offset", OFFSETS)
def test_the_margin_is_exact_about_the_limit(offset: float) -> None:
    """R5, R6, G3: where both will be, not where they are."""
    ahead = sky(("green", at(1.0 + EXACT.separation_m + offset), STILL, 0.0, NOW_S))
    found = separation(north(), situation(neighbours=ahead), EXACT)
    assert number(found) == pytest.approx(offset, abs=1e-9)
    assert found.passed == (offset >= 0.0)
    assert "green" in found.text
    # One that crosses between two samples, when the drone has arrived.
    crossing = sky(("green", at(1.0 + EXACT.separation_m + offset, -25.0), Ned(0.0, 10.0, 0.0), 0.0, NOW_S))
    found = separation(north(), situation(neighbours=crossing), EXACT)
    assert number(found) == pytest.approx(offset, abs=1e-9)
    assert found.passed == (offset >= 0.0)


@pytest.mark.parametrize("offset", OFFSETS)
def test_what_adds_to_the_required_distance(offset: float) -> None:
    age_s = 0.4
    required = 3.0 + 0.3 + 0.25 + 2.0 * (0.5 + 0.1) + 2.0 * age_s + 0.5 * 2.0 * age_s**2
    # It flies sideways, so by now it is beside where it was; its closest is now.
    green = ("green", at(1.0 + required + offset, -2.0 * age_s - 2.0 * 2.0), Ned(0.0, 2.0, 0.0), 0.1, NOW_S - age_s)
    scene = situation(vehicle=vehicle(sigma_h_m=0.5, sigma_v_m=0.2), neighbours=sky(green))
    found = separation(north(along_track_tolerance_m=0.25), scene, LIMITS)
    assert number(found) == pytest.approx(offset, abs=1e-9)


def test_it_counts_when_the_drone_hovers_after_the_move_until_the_horizon() -> None:
    def passing_at(t_s: float) -> float:
        green = ("green", at(1.0, -5.0 * t_s), Ned(0.0, 5.0, 0.0), 0.0, NOW_S)
        return number(separation(north(), situation(neighbours=sky(green)), EXACT))

    assert passing_at(EXACT.horizon_s - 0.01) == pytest.approx(-3.0)
    assert passing_at(EXACT.horizon_s + 1.0) == pytest.approx(2.0)


def test_the_one_that_fails_is_named_and_the_closest_of_those_that_pass() -> None:
    both = sky(("green", at(20.0), STILL, 0.0, NOW_S), ("blue", at(-15.0), STILL, 0.0, NOW_S))
    assert separation(north(), situation(neighbours=both), EXACT).text == "blue: 12.0 m to spare"
    near = sky(("green", at(3.5), STILL, 0.0, NOW_S), ("blue", at(-15.0), STILL, 0.0, NOW_S))
    assert separation(north(), situation(neighbours=near), EXACT).text == "0.5 m too close to green"


def test_too_close_already_admits_only_flying_away() -> None:
    green = situation(neighbours=sky(("green", at(2.0), STILL, 0.0, NOW_S)))
    away = separation(north(-0.5), green, EXACT)
    assert away.passed
    assert number(away) == pytest.approx(-1.0)
    assert "already" in away.text
    assert separation(hover(), green, EXACT).passed
    assert not separation(north(0.5), green, EXACT).passed
    # One single point is the monitor's question, and the answer is that the limit is broken.
    assert not separation(Path(np.array([START]), np.zeros(1)), green, EXACT).passed
    # Away from one, towards another: the second is not excused.
    pinched = sky(("green", at(2.0), STILL, 0.0, NOW_S), ("blue", at(-3.2), STILL, 0.0, NOW_S))
    found = separation(north(-0.5), situation(neighbours=pinched), EXACT)
    assert not found.passed
    assert "blue" in found.text
    # Faster than we flee, and then nearer than now while we hover.
    chased = sky(("green", at(2.0), Ned(-0.2, 0.0, 0.0), 0.0, NOW_S))
    assert not separation(north(-0.5), situation(neighbours=chased), EXACT).passed


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 100_000), st.floats(0.0, 3.0), st.floats(0.0, 1.0))
def test_an_older_state_or_a_vaguer_one_never_gives_a_larger_margin(seed: int, older_s: float, vaguer_m: float) -> None:
    now = random_sky(seed, 1)
    older = replace(now, at_s=now.at_s - older_s)
    vaguer = replace(now, sigmas_m=now.sigmas_m + vaguer_m)
    path = north()
    for before, after in ((now, older), (now, vaguer)):
        a = number(separation(path, situation(neighbours=before), LIMITS))
        b = number(separation(path, situation(neighbours=after), LIMITS))
        assert b <= a + 1e-9
        rank = [neighbour_age(path, situation(neighbours=n), LIMITS) for n in (before, after)]
        assert (rank[1].passed, number(rank[1])) <= (rank[0].passed, number(rank[0]) + 1e-9)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 100_000), st.tuples(*[st.floats(-0.5, 0.5)] * 3))
def test_separation_is_continuous_in_where_the_path_is(seed: int, shift: tuple[float, float, float]) -> None:
    scene = situation(neighbours=random_sky(seed, 4))
    path = north()
    moved = Path(path.points_ned_m + shift, path.times_s)
    difference = number(separation(path, scene, LIMITS)) - number(separation(moved, scene, LIMITS))
    assert abs(difference) <= float(np.linalg.norm(shift)) + 1e-6


@settings(max_examples=80, deadline=None)
@given(st.integers(0, 100_000), st.integers(0, 60), st.floats(20.0, 400.0))
def test_leaving_out_those_that_cannot_matter_changes_nothing(seed: int, count: int, wide_m: float) -> None:
    scene = situation(neighbours=random_sky(seed, count, wide_m))
    for path in (north(), straight(at(-0.2, 0.5)), hover(), hover(duration_s=18.0)):
        near = nearby(scene, path, LIMITS)
        assert len(near.neighbours) <= count
        for shorter in (
            path,
            Path(path.points_ned_m[: len(path.times_s) // 2], path.times_s[: len(path.times_s) // 2]),
        ):
            whole, cut = separation(shorter, scene, LIMITS), separation(shorter, near, LIMITS)
            assert (cut.passed, cut.text) == (whole.passed, whole.text)
            assert cut.margin == (None if whole.margin is None else pytest.approx(whole.margin, abs=1e-9))
            assert neighbour_age(shorter, near, LIMITS) == neighbour_age(shorter, scene, LIMITS)


def test_far_traffic_is_left_out() -> None:
    scene = situation(neighbours=random_sky(1, 200, 5000.0))
    assert len(nearby(scene, north(), LIMITS).neighbours) < 20


def test_an_empty_sky_has_no_separation() -> None:
    found = separation(north(), situation(), LIMITS)
    assert found.passed
    assert found.margin is None


@pytest.mark.parametrize("bad", [math.nan, math.inf])
@pytest.mark.parametrize("part", ["positions_ned_m", "velocities_ned_m_s", "sigmas_m", "at_s"])
def test_a_neighbour_whose_state_is_no_number_is_refused_by_name(part: str, bad: float) -> None:
    two = sky(("green", at(50.0), Ned(0.0, 1.0, 0.0), 0.1, NOW_S), ("blue", at(-50.0), Ned(0.0, 1.0, 0.0), 0.1, NOW_S))
    getattr(two, part)[1] = bad
    scene = situation(neighbours=two)
    with np.errstate(invalid="ignore"):
        for asked in (scene, nearby(scene, north(), LIMITS)):
            found = separation(north(), asked, LIMITS)
            assert not found.passed
            assert found.margin is None
            assert "blue" in found.text


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_path_or_accuracy_that_is_no_number_is_refused(bad: float) -> None:
    scene = situation(neighbours=sky(("green", at(50.0), STILL, 0.1, NOW_S)))
    broken = north()
    broken.points_ned_m[4, 0] = bad
    with np.errstate(invalid="ignore"):
        assert not separation(broken, scene, LIMITS).passed
    unsure = replace(scene, vehicle=vehicle(sigma_h_m=bad, sigma_v_m=0.1))
    assert not separation(north(), unsure, LIMITS).passed
    negative = replace(scene.neighbours, sigmas_m=np.array([-1.0]))
    assert not separation(north(), replace(scene, neighbours=negative), LIMITS).passed


# --- silence ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("offset_s", [-10.0, -0.1, -1e-6, 0.0, 1e-6, 0.1, 0.9])
def test_a_feed_is_alive_for_tau_max(offset_s: float) -> None:
    quiet = Neighbours.none(NOW_S - LIMITS.neighbour_age_s + offset_s)
    found = neighbour_age(north(), situation(neighbours=quiet), LIMITS)
    assert number(found) == pytest.approx(offset_s)
    assert found.passed == (offset_s >= 0.0)
    assert found.unit == "s"


def test_never_heard_is_refused_and_declared_none_is_not() -> None:
    for feed_at_s in (-math.inf, math.nan):
        never = neighbour_age(north(), situation(neighbours=Neighbours.none(feed_at_s)), LIMITS)
        assert not never.passed
        assert never.margin is None
    declared = neighbour_age(north(), situation(neighbours=Neighbours.none(math.inf)), LIMITS)
    assert declared.passed
    assert declared.margin is None
    assert "declared" in declared.text
    # A feed from the future is no proof of life either.
    assert not neighbour_age(north(), situation(neighbours=Neighbours.none(NOW_S + 60.0)), LIMITS).passed


@pytest.mark.parametrize("age_s", [1.5, 4.0])
@pytest.mark.parametrize("offset", [-0.1, -1e-3, 1e-3, 0.1])
def test_a_silent_neighbour_blocks_only_where_it_could_be(age_s: float, offset: float) -> None:
    could_be = (1.0 + EXACT.silent_speed_m_s) * age_s + 0.5 * EXACT.neighbour_acceleration_m_s2 * age_s**2
    away = 1.0 + 0.05 + EXACT.separation_m + could_be + offset
    green = sky(("green", at(away), Ned(1.0, 0.0, 0.0), 0.0, NOW_S - age_s))
    found = neighbour_age(north(), situation(neighbours=green), EXACT)
    assert found.passed == (offset > 0.0)
    if not found.passed:
        assert number(found) == pytest.approx(EXACT.neighbour_age_s - age_s)
        assert "green" in found.text


def test_a_neighbour_as_old_as_tau_max_is_not_silent() -> None:
    green = sky(("green", at(5.0), STILL, 0.0, NOW_S - LIMITS.neighbour_age_s))
    assert neighbour_age(north(), situation(neighbours=green), LIMITS).passed
    green.at_s[0] -= 1e-6
    assert not neighbour_age(north(), situation(neighbours=green), LIMITS).passed


# --- reserved volumes ------------------------------------------------------------------------------------------------


def volume(start: Ned, end: Ned, radius_m: float = 1.0, from_s: float = 0.0, until_s: float = 60.0) -> ReservedVolume:
    """Held by green, in seconds from now."""
    return ReservedVolume("green", start, end, radius_m, NOW_S + from_s, NOW_S + until_s)


@pytest.mark.parametrize("offset", OFFSETS)
def test_a_reserved_volume_keeps_its_distance(offset: float) -> None:
    required = 1.0 + LIMITS.tracking_m + 2.0 * 0.25 + 0.2 + 0.5 * LIMITS.separation_m
    ahead = volume(at(1.0 + required + offset, -5.0), at(1.0 + required + offset, 5.0))
    scene = situation(vehicle=vehicle(sigma_h_m=0.25, sigma_v_m=0.1), reservations=(ahead,))
    found = reservation(north(along_track_tolerance_m=0.2), scene, LIMITS)
    assert number(found) == pytest.approx(offset, abs=1e-9)
    assert found.passed == (offset >= 0.0)
    assert "green" in found.text


@pytest.mark.parametrize(
    ("from_s", "until_s", "passed"),
    [
        (-10.0, 60.0, False),
        (-10.0, -1e-6, True),  # over
        (-10.0, 0.5, False),  # over before the drone gets there, but the path's own volume is needed from the beginning
        (-10.0, 1.9, False),
        (LIMITS.horizon_s - 1e-3, 60.0, False),  # begins while it hovers there
        (LIMITS.horizon_s + 1e-3, 60.0, True),
        (math.nan, 60.0, False),  # a window that is no window
        (-10.0, math.nan, False),
    ],
)
def test_a_reserved_volume_counts_while_it_is_held(from_s: float, until_s: float, passed: bool) -> None:
    ahead = volume(at(1.8, -5.0), at(1.8, 5.0), from_s=from_s, until_s=until_s)
    assert reservation(north(), situation(reservations=(ahead,)), EXACT).passed == passed


def test_every_reserved_volume_counts() -> None:
    far, near = volume(at(90.0), at(90.0)), volume(at(0.0, 1.5), at(0.0, 1.5))
    assert reservation(north(), situation(reservations=(far,)), EXACT).passed
    assert not reservation(straight(at(0.0, 1.0)), situation(reservations=(far, near)), EXACT).passed


def test_inside_a_reserved_volume_not_even_the_way_out_is_admitted() -> None:
    """Its authority would deny it."""
    scene = situation(reservations=(volume(START, START, radius_m=3.0),))
    inside = reservation(straight(at(1.5), start=at(1.0)), scene, EXACT)
    assert not inside.passed
    assert number(inside) == pytest.approx(-2.0 - 0.5 * EXACT.separation_m, abs=0.1)


def test_a_lease_counts_that_begins_before_the_plan_must_be_over() -> None:
    """The plan's own volume is reserved for its longest duration, not for the nominal one."""
    path = replace(north(), until_s=29.0)
    for from_s, passed in ((28.9, False), (29.1, True)):
        ahead = volume(at(1.0), at(1.0), from_s=from_s, until_s=60.0)
        assert reservation(path, situation(reservations=(ahead,)), EXACT).passed == passed


def test_a_hover_reserves_nothing() -> None:
    """Only what it needs itself must be clear: half the separation is in the other's volume."""
    east_m = 1.0 + 0.5 * EXACT.separation_m - 0.01
    beside = volume(at(0.0, east_m), at(0.0, 9.0), radius_m=1.0)
    here = Path(np.array([START]), np.zeros(1))
    assert reservation(here, situation(reservations=(beside,)), EXACT).passed
    assert not reservation(straight(at(0.0, 0.5)), situation(reservations=(beside,)), EXACT).passed


@given(
    st.sampled_from([p for p in Primitive if p not in (Primitive.SCAN_LEFT, Primitive.SCAN_RIGHT, Primitive.RETURN)]),
    st.floats(0.1, 1.0),
    st.builds(at, st.floats(-8, 8), st.floats(-8, 8), st.floats(-3, 3)),
    st.builds(at, st.floats(-8, 8), st.floats(-8, 8), st.floats(-3, 3)),
    st.floats(0.5, 4.0),
    st.floats(-1.0, 20.0),
)
def test_what_passes_is_not_denied_by_the_authority(
    primitive: Primitive, length_m: float, start: Ned, end: Ned, radius_m: float, until_s: float
) -> None:
    """Where a known volume is in the way, it is the supervisor that delays, shortens or rejects."""
    scene = situation(reservations=(volume(start, end, radius_m, from_s=-5.0, until_s=until_s),))
    plan = plan_translation(primitive, START, 180.0, Ned(-10.0, 0.0, 0.0), length_m, LIMITS)
    found = reservation(swept(plan, LIMITS), scene, LIMITS)
    if found.passed and (found.margin is None or found.margin >= 0.0):  # else it leads out of one that it is in already
        own = swept_volume(plan, "red", scene.vehicle.sigma_m, NOW_S, LIMITS)
        assert not volumes_meet(own, scene.reservations[0])


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_volume_that_is_no_number_is_refused(bad: float) -> None:
    broken: Floats = np.array([bad, 0.0, 0.0])
    for held in (volume(Ned(*broken), START), volume(START, Ned(*broken)), volume(at(9.0), at(9.0), radius_m=bad)):
        with np.errstate(invalid="ignore"):
            found = reservation(north(), situation(reservations=(held,)), LIMITS)
        assert not found.passed


# ---------------------------------------------------------------- who is silent, by hand


def beside(name: str, east_m: float, ago_s: float, velocity: Ned = STILL) -> tuple[str, Ned, Ned, float, float]:
    return name, START.plus(Ned(0.0, east_m, 0.0)), velocity, 0.0, NOW_S - ago_s


@pytest.mark.requirement("R11", "X6")
@pytest.mark.parametrize(
    ("aircraft", "says", "margin"),
    [
        ([beside("a", 6.0, 2.0), beside("b", 7.0, 4.0)], "b", -3.0),  # the one unheard for longest
        ([beside("a", 6.0, 4.0), beside("b", 7.0, 2.0)], "a", -3.0),
        ([beside("a", 90.0, 2.0), beside("b", 8.0, 0.5)], "", 1.0),  # too far to matter; fresh
        ([beside("a", 8.0, 0.5), beside("b", 9.0, 2.0)], "b", -1.0),
        ([beside("a", 9.0, -2.0)], "a", -1.0),  # a clock ahead tells as little
        ([beside("a", 6.0, 1.0)], "", 1.0),  # exactly as old as may be
        # At rest for 2 s: 3 m, the tube of 0.3 m, 4 m at 2 m/s^2, and a ball of 2 m/s; nearer than 11.3 m it could be too close.
        ([beside("a", 11.35, 2.0)], "", 1.0),
        ([beside("a", 11.25, 2.0)], "a", -1.0),
    ],
)
def test_who_is_silent_and_could_be_near_is_named(aircraft: list[Any], says: str, margin: float) -> None:
    about = situation(vehicle=vehicle(sigma_h_m=0.0, sigma_v_m=0.0), neighbours=sky(*aircraft))
    found = neighbour_age(hover(), about, LIMITS)
    assert (found.subject, found.passed) == (says, not says)
    assert number(found) == pytest.approx(margin)


@pytest.mark.requirement("R11", "X6")
@pytest.mark.parametrize(
    ("shares", "passed"), [((0.0, 1.0), False), ((0.0, 0.1, 1.0), False), ((0.0, 0.25, 0.5, 0.75, 1.0), True)]
)
def test_between_two_points_of_a_path_a_silent_one_could_be_nearer(shares: tuple[float, ...], passed: bool) -> None:
    """20 m along; at 2 s silent somebody 14 m beside the middle could be too close from 11.3 m on."""
    about = situation(vehicle=vehicle(sigma_h_m=0.0, sigma_v_m=0.0), neighbours=sky(beside("a", 14.0, 2.0)))
    points = np.array([START.plus(Ned(20.0 * share - 10.0, 0.0, 0.0)) for share in shares])
    assert neighbour_age(Path(points, np.array(shares)), about, LIMITS).passed == passed


@pytest.mark.requirement("R6", "X13")
@pytest.mark.parametrize(
    ("goes", "speed", "passed"),
    [
        (Ned(-1.0, 0.0, 0.0), 0.0, True),  # away from who is too near
        (Ned(1.0, 0.0, 0.0), 0.0, False),
        (Ned(0.04, 0.0, 0.0), 0.0, True),  # within what velocities are wrong by
        (Ned(0.06, 0.0, 0.0), 0.0, False),
        (Ned(-1.0, 0.0, 0.0), -0.2, False),  # who follows catches up where the path ends
        (Ned(0.0, 0.0, 0.0), -0.004, True),  # 4 cm in the 10 s that the hover is looked at
        (Ned(0.0, 0.0, 0.0), -0.006, False),
    ],
)
def test_who_is_too_near_may_not_come_nearer_by_hand(goes: Ned, speed: float, passed: bool) -> None:
    """Somebody hovers 3 m ahead, or flies southwards at so many m/s."""
    ahead = ("a", START.plus(Ned(3.0, 0.0, 0.0)), Ned(speed, 0.0, 0.0), 0.0, NOW_S)
    about = situation(vehicle=vehicle(sigma_h_m=0.0, sigma_v_m=0.0), neighbours=sky(ahead))
    path = straight(START.plus(goes), n=5)
    found = separation(path, about, LIMITS)
    assert found.passed == passed and number(found) < 0.0 and found.subject == "a"
