"""Terrain, height, obstacles, workspace, session, geofence, standoff: dense about each limit."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from safety import spatial
from safety.geofence import Geofence
from safety.obstacles import Obstacles
from safety.situation import Situation
from safety.terrain import Terrain
from safety.vocabulary import Anchor, Finding, Ned, Operator, Path
from tests.safety.scene import (
    EXACT,
    LIMITS,
    NOW_S,
    START,
    hover,
    number,
    situation,
    square_fence,
    straight,
    vehicle,
    wall,
    world,
)

HERE = hover()
OFFSETS = (-1.0, -0.1, -1e-3, -1e-6, 0.0, 1e-6, 1e-3, 0.1, 1.0)
"""Offsets from a limit: negative breaks it."""


def above(height_m: float) -> Path:
    return hover(Ned(0.0, 0.0, -height_m))


def ramp(slope: float, sigma_m: float = 0.0) -> Terrain:
    """Rising to the north, at altitude 0 at the origin."""
    north = np.arange(-100.0, 101.0)[:, None] * np.ones((1, 201))
    return Terrain(slope * north, (-100.0, -100.0), ((1.0, 0.0), (0.0, 1.0)), sigma_m, 0.0)


# Each case: a hover that has exactly `offset` to spare, and the rule that must say so.
CASES: dict[str, Callable[[float], Finding]] = {
    "terrain": lambda d: spatial.terrain_clearance(above(EXACT.clearance_m + d), situation(), EXACT),
    "agl": lambda d: spatial.agl(above(EXACT.min_agl_m + d), situation(), EXACT),
    "obstacle beside": lambda d: spatial.obstacle_clearance(
        HERE, situation(world=world(obstacles=wall(EXACT.obstacle_clearance_m + d))), EXACT
    ),
    "obstacle below": lambda d: spatial.obstacle_clearance(
        HERE, situation(world=world(obstacles=wall(-0.5, top_m=10.0 - EXACT.obstacle_clearance_m - d))), EXACT
    ),
    "obstacle above": lambda d: spatial.obstacle_clearance(
        HERE,
        situation(world=world(obstacles=wall(-0.5, base_m=10.0 + EXACT.obstacle_clearance_m + d, top_m=50.0))),
        EXACT,
    ),
    "workspace": lambda d: spatial.workspace(
        HERE, situation(anchor=Anchor(START.plus(Ned(0.0, 3.0, 0.0)), 0.0, NOW_S)), replace(EXACT, workspace_m=3.0 + d)
    ),
    "workspace upright": lambda d: spatial.workspace(
        HERE, situation(anchor=Anchor(START.plus(Ned(0.0, 0.0, 5.0 - d)), 0.0, NOW_S)), EXACT
    ),
    "session": lambda d: spatial.session(
        HERE, situation(session_centre=START.plus(Ned(50.0 - d, 0.0, 0.0))), EXACT
    ),
    "fence side": lambda d: spatial.geofence(HERE, situation(world=world(geofence=square_fence(half_m=4.0 + d))), replace(EXACT, tracking_m=4.0)),
    "fence floor": lambda d: spatial.geofence(HERE, situation(world=world(geofence=square_fence(floor_m=10.0 - d))), EXACT),
    "fence ceiling": lambda d: spatial.geofence(HERE, situation(world=world(geofence=square_fence(ceiling_m=10.0 + d))), EXACT),
    "no-fly area": lambda d: spatial.geofence(
        HERE,
        situation(world=world(geofence=Geofence.of(shapely.box(-30, -30, 30, 30).difference(shapely.box(4 + d, -5, 9, 5)), 0, 50, 0.0))),
        replace(EXACT, tracking_m=4.0),
    ),
    "standoff": lambda d: spatial.standoff(HERE, situation(operator=Operator(Ned(-3.0 - d, 0.0, -9.0), 0.0)), EXACT),
}  # fmt: skip


@pytest.mark.parametrize("offset", OFFSETS)
@pytest.mark.parametrize("case", CASES)
def test_the_margin_of_a_hover_is_what_is_to_spare(case: str, offset: float) -> None:
    found = CASES[case](offset)
    assert number(found) == pytest.approx(offset, abs=1e-9)
    # Staying where a limit is already broken does not make it worse (X13), but the number and the sentence tell.
    assert found.passed
    assert ("already" in found.text) == (offset < 0.0)
    assert ("to spare" in found.text) == (offset >= 0.0)


def north(length_m: float = 1.0) -> Path:
    return straight(START.plus(Ned(length_m, 0.0, 0.0)))


def down(length_m: float = 1.0) -> Path:
    return straight(START.plus(Ned(0.0, 0.0, length_m)))


def flat(amsl_m: float) -> Situation:
    return situation(world=world(terrain=Terrain.flat(amsl_m, 0.0, 0.0)))


def fenced(fence: Geofence) -> Situation:
    return situation(world=world(geofence=fence))


# Each case: a move of one metre whose end has exactly `offset` to spare, its start one metre more.
MOVES: dict[str, Callable[[float], Finding]] = {
    "terrain": lambda d: spatial.terrain_clearance(down(), flat(9.0 - EXACT.clearance_m - d), EXACT),
    "agl": lambda d: spatial.agl(down(), flat(9.0 - EXACT.min_agl_m - d), EXACT),
    "obstacle": lambda d: spatial.obstacle_clearance(north(), situation(world=world(obstacles=wall(2.5 + d))), EXACT),
    "workspace": lambda d: spatial.workspace(
        north(), situation(anchor=Anchor(START.plus(Ned(d - 4.0, 0.0, 0.0)), 0.0, NOW_S)), EXACT
    ),
    "session": lambda d: spatial.session(
        north(), situation(session_centre=START.plus(Ned(d - 49.0, 0.0, 0.0))), EXACT
    ),
    "fence side": lambda d: spatial.geofence(north(), fenced(Geofence.of(shapely.box(-9.0, -9.0, 1.0 + d, 9.0), 0.0, 40.0, 0.0)), EXACT),
    "fence floor": lambda d: spatial.geofence(down(), fenced(square_fence(floor_m=9.0 - d)), EXACT),
    "standoff": lambda d: spatial.standoff(north(), situation(operator=Operator(Ned(4.0 + d, 0.0, 0.0), 0.0)), EXACT),
}  # fmt: skip


@pytest.mark.requirement("R3", "R4", "R7", "G2", "G4", "G5", "X1", "X2")
@pytest.mark.parametrize("offset", OFFSETS)
@pytest.mark.parametrize("case", MOVES)
def test_a_move_passes_exactly_up_to_the_limit(case: str, offset: float) -> None:
    """R3, R4, G2: terrain and obstacles; G5: height; R7: workspace; X1: session; G4: fence; X2: standoff."""
    found = MOVES[case](offset)
    assert number(found) == pytest.approx(offset, abs=1e-9)
    assert found.passed == (offset >= 0.0)


AWAY: dict[str, Callable[[Path], Finding]] = {
    "obstacle": lambda p: spatial.obstacle_clearance(p, situation(world=world(obstacles=wall(0.5))), EXACT),
    "workspace": lambda p: spatial.workspace(
        p, situation(anchor=Anchor(START.plus(Ned(-9.0, 0.0, 0.0)), 0.0, NOW_S)), EXACT
    ),
    "session": lambda p: spatial.session(p, situation(session_centre=START.plus(Ned(-60.0, 0.0, 0.0))), EXACT),
    "geofence": lambda p: spatial.geofence(
        p, fenced(Geofence.of(shapely.box(-9.0, -9.0, 0.5, 9.0), 0.0, 40.0, 0.0)), replace(EXACT, tracking_m=1.0)
    ),
    "standoff": lambda p: spatial.standoff(p, situation(operator=Operator(Ned(2.0, 0.0, 0.0), 0.0)), EXACT),
}


@pytest.mark.parametrize("case", AWAY)
def test_a_limit_already_broken_admits_only_what_never_worsens_it(case: str) -> None:
    away, towards = north(-0.4), north(0.4)
    assert AWAY[case](away).passed
    assert number(AWAY[case](away)) < 0.0
    assert not AWAY[case](towards).passed
    assert AWAY[case](hover()).passed
    # There and back is worse at some time, wherever it ends.
    there_and_back = Path(np.concatenate((away.points_ned_m, towards.points_ned_m)), np.arange(22.0), 0.0)
    assert not AWAY[case](there_and_back).passed
    # One single point is no motion that could mend anything: the monitor's question.
    assert not AWAY[case](Path(np.array([START]), np.zeros(1))).passed


def test_mending_one_obstacle_does_not_excuse_closing_in_on_another() -> None:
    between_walls = Obstacles.of(
        ["barn", "mill"],
        [shapely.box(-1.5, -9.0, -1.0, 9.0), shapely.box(1.2, -9.0, 2.0, 9.0)],
        [0.0, 0.0],
        [30.0, 30.0],
        0.0,
    )
    here = situation(world=world(obstacles=between_walls))
    found = spatial.obstacle_clearance(north(0.1), here, EXACT)
    assert not found.passed
    assert "mill" in found.text
    assert spatial.obstacle_clearance(hover(), here, EXACT).passed


def test_an_operators_word_for_an_obstacle_is_in_the_sentence() -> None:
    named = wall(2.0, name="the {old} oak")
    found = spatial.obstacle_clearance(north(), situation(world=world(obstacles=named)), EXACT)
    assert found.text == "0.5 m too close to the {old} oak"
    assert not found.passed


def test_the_whole_path_counts_not_its_end() -> None:
    """Across a 0.2 m thin mast between two samples, and over a spike of terrain."""
    mast = Obstacles.of(["mast"], [shapely.box(0.45, -0.1, 0.55, 0.1)], [0.0], [30.0], 0.0)
    jump = straight(START.plus(Ned(1.0, 0.0, 0.0)), n=2)
    tight = replace(EXACT, obstacle_clearance_m=0.0)
    assert not spatial.obstacle_clearance(jump, situation(world=world(obstacles=mast)), tight).passed
    heights = np.zeros((41, 41))
    heights[20, 20] = 20.0
    spike = Terrain(heights, (-20.0 + 0.5, -20.0), ((1.0, 0.0), (0.0, 1.0)), 0.0, 0.0)
    low = replace(EXACT, clearance_m=0.0, min_agl_m=0.0)
    spiked = situation(world=world(terrain=spike))
    high = Ned(-1.5, 0.0, -8.0)
    over = straight(Ned(2.5, 0.0, -8.0), start=high, n=2)
    assert spike.agl_m(over.points_ned_m).min() == pytest.approx(8.0)
    assert not spatial.terrain_clearance(over, spiked, low).passed
    assert not spatial.agl(over, spiked, low).passed


@pytest.mark.parametrize("slope", [0.0, 0.3, 1.0, 3.0])
@pytest.mark.parametrize("sigma_h_m", [0.0, 0.5])
def test_true_height_keeps_the_minimum_wherever_the_drone_may_be(slope: float, sigma_h_m: float) -> None:
    """With the least height that the rule admits, no place within the errors is lower than the minimum."""
    limits = replace(LIMITS, tracking_m=0.3)
    hillside = situation(
        vehicle=vehicle(sigma_h_m=sigma_h_m, sigma_v_m=0.2), world=world(terrain=ramp(slope, sigma_m=0.1))
    )
    low, high = 0.0, 60.0
    while high - low > 1e-6:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if number(spatial.agl(above(middle), hillside, limits)) >= 0.0 else (middle, high)
    wrong_m = limits.sigma_k * 0.2 + limits.sigma_k * 0.1 + limits.sigma_k * sigma_h_m * slope
    truly = high - wrong_m - limits.tracking_m * math.hypot(1.0, slope)
    by_clearance = high / math.hypot(1.0, slope) - limits.sigma_k * (max(sigma_h_m, 0.2) + 0.1) - limits.tracking_m
    assert max(truly, by_clearance) == pytest.approx(limits.min_agl_m, abs=1e-5)


HOW_WRONG = st.floats(0.0, 3.0)


@settings(max_examples=60, deadline=None)
@given(HOW_WRONG, HOW_WRONG, HOW_WRONG, HOW_WRONG, st.integers(0, 3), st.floats(0.0, 2.0))
def test_more_uncertainty_never_gives_a_larger_margin(
    h_m: float, v_m: float, terrain_m: float, operator_m: float, which: int, more_m: float
) -> None:
    def margins(h: float, v: float, t: float, o: float) -> list[float]:
        scene = situation(
            vehicle=vehicle(sigma_h_m=h, sigma_v_m=v),
            operator=Operator(Ned(-10.0, 0.0, 0.0), o),
            world=world(terrain=ramp(0.3, sigma_m=t), obstacles=wall(4.0), geofence=square_fence()),
            anchor=Anchor(START, 0.0, NOW_S - 60.0),
            paired_at_s=NOW_S - 300.0,
        )
        rules = (
            spatial.terrain_clearance, spatial.agl, spatial.obstacle_clearance, spatial.workspace, spatial.session,
            spatial.geofence, spatial.standoff,
        )  # fmt: skip
        return [number(rule(north(), scene, LIMITS)) for rule in rules]

    sigmas = [h_m, v_m, terrain_m, operator_m]
    before = margins(*sigmas)
    sigmas[which] += more_m
    after = margins(*sigmas)
    assert all(b <= a + 1e-12 for a, b in zip(before, after, strict=True))


@settings(max_examples=60, deadline=None)
@given(st.tuples(*[st.floats(-6.0, 6.0)] * 3), st.tuples(*[st.floats(-0.5, 0.5)] * 3))
def test_margins_are_continuous_in_where_the_path_is(
    place: tuple[float, float, float], shift: tuple[float, float, float]
) -> None:
    scene = situation(world=world(terrain=ramp(0.4), obstacles=wall(4.0), geofence=square_fence()))
    here, moved = np.array(place) + START, float(np.linalg.norm(shift))
    a = straight(Ned(*here).plus(Ned(1.0, 0.0, 0.0)), start=Ned(*here))
    b = Path(a.points_ned_m + shift, a.times_s)
    for rule in (
        spatial.terrain_clearance, spatial.obstacle_clearance, spatial.workspace, spatial.session, spatial.geofence,
        spatial.standoff,
    ):  # fmt: skip
        assert abs(number(rule(a, scene, LIMITS)) - number(rule(b, scene, LIMITS))) <= moved + 1e-6
    # Height above ground may change faster than one moves, by the slope.
    stretched = moved * math.hypot(1.0, 0.4)
    assert abs(number(spatial.agl(a, scene, LIMITS)) - number(spatial.agl(b, scene, LIMITS))) <= stretched + 1e-6


def test_only_the_drift_since_then_counts_against_relative_limits() -> None:
    far = Anchor(START.plus(Ned(3.0, 0.0, 0.0)), 0.0, NOW_S)
    unsure = vehicle(sigma_h_m=1.0, sigma_v_m=1.0)
    assert number(spatial.workspace(HERE, situation(vehicle=unsure, anchor=far), EXACT)) == pytest.approx(2.0)
    later = replace(far, at_s=NOW_S - 10.0)
    found = number(spatial.workspace(HERE, situation(vehicle=unsure, anchor=later), EXACT))
    assert found == pytest.approx(2.0 - EXACT.sigma_k * EXACT.drift_m_s * 10.0)
    long_ago = replace(far, at_s=NOW_S - 1e6)
    found = number(spatial.workspace(HERE, situation(vehicle=unsure, anchor=long_ago), EXACT))
    assert found == pytest.approx(2.0 - EXACT.sigma_k * 1.0)


ALL = (
    spatial.terrain_clearance,
    spatial.agl,
    spatial.obstacle_clearance,
    spatial.workspace,
    spatial.session,
    spatial.geofence,
    spatial.standoff,
)


@pytest.mark.parametrize("rule", ALL)
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_path_that_is_no_number_is_refused(rule: Callable[..., Finding], bad: float) -> None:
    scene = situation(world=world(obstacles=wall(40.0), geofence=square_fence()))
    path = north()
    path.points_ned_m[3, 1] = bad
    with np.errstate(invalid="ignore"):
        found = rule(path, scene, LIMITS)
    assert not found.passed
    assert found.margin is None


@pytest.mark.parametrize("rule", ALL)
@pytest.mark.parametrize("bad", [math.nan, -1.0, math.inf])
def test_an_accuracy_that_is_none_is_refused(rule: Callable[..., Finding], bad: float) -> None:
    unsure = vehicle(sigma_h_m=bad, sigma_v_m=bad)
    scene = situation(
        vehicle=unsure,
        world=world(obstacles=wall(40.0), geofence=square_fence()),
        anchor=Anchor(START, 0.0, -math.inf if bad == math.inf else NOW_S - 5.0),
        paired_at_s=-math.inf if bad == math.inf else NOW_S - 5.0,
    )
    found = rule(north(), scene, LIMITS)
    assert not found.passed
    assert found.margin is None


def test_unknown_terrain_is_refused_with_its_reason() -> None:
    nothing = situation(world=world(terrain=None))
    edge = situation(world=world(terrain=Terrain(np.zeros((3, 3)), (-1.0, -1.0), ((1, 0), (0, 1)), 0.0, 0.0)))
    unsure = situation(world=world(terrain=Terrain.flat(0.0, math.nan, 0.0)))
    for rule in (spatial.terrain_clearance, spatial.agl):
        for scene, reason in ((nothing, "no terrain model"), (edge, "no terrain data"), (unsure, "states no accuracy")):
            found = rule(north(3.0), scene, LIMITS)
            assert not found.passed
            assert found.margin is None
            assert reason in found.text


@pytest.mark.parametrize("offset", OFFSETS)
def test_data_must_reach_as_far_as_clearance_is_required(offset: float) -> None:
    half = 2.0
    grid = Terrain(np.zeros((3, 3)), (-half, -half), ((half, 0.0), (0.0, half)), 0.0, 0.0)
    limits = replace(EXACT, clearance_m=half - offset)
    found = spatial.terrain_clearance(hover(), situation(world=world(terrain=grid)), limits)
    assert found.passed == (offset >= 0.0)
    assert found.passed or (found.margin is None and "no terrain data" in found.text)


def test_what_is_not_declared_does_not_exist() -> None:
    for rule in (spatial.obstacle_clearance, spatial.geofence):
        found = rule(north(), situation(), LIMITS)
        assert found.passed
        assert found.margin is None
