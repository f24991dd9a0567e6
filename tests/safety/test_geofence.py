"""The geofence: where flying is allowed, with no-fly areas, floor and ceiling."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from safety.geofence import Geofence
from safety.vocabulary import Ned
from tests.safety.scene import square_fence

HOLED = shapely.box(-50, -50, 50, 50).difference(shapely.box(10, -5, 20, 5))


@pytest.mark.parametrize(
    ("point", "inside_m"),
    [
        ((0.0, 0.0, -20.0), 10.0),  # the no-fly area is nearest
        ((10.0, 0.0, -20.0), 0.0),  # on its edge
        ((12.0, 0.0, -20.0), -2.0),  # in it
        ((-45.0, 0.0, -20.0), 5.0),  # the outer edge
        ((-53.0, 0.0, -20.0), -3.0),
        ((0.0, 0.0, -6.0), 1.0),  # the floor, at 105 m
        ((0.0, 0.0, -4.0), -1.0),
        ((0.0, 0.0, -39.0), 1.0),  # the ceiling, at 140 m
        ((0.0, 0.0, -42.0), -2.0),
    ],
)
def test_distance_to_the_nearest_bound(point: tuple[float, float, float], inside_m: float) -> None:
    fence = Geofence.of(HOLED, 105.0, 140.0, 100.0)
    assert fence.inside_m(np.array([point]))[0] == pytest.approx(inside_m)
    near = fence.near(Ned(*point), 8.0)
    assert near.inside_m(np.array([point]))[0] == pytest.approx(min(inside_m, 8.0))


@pytest.mark.requirement("X13")
def test_how_far_outside_is_never_cut_off() -> None:
    """It is compared along the way back (X13)."""
    fence = square_fence()
    for centre in (Ned(500.0, 0.0, -10.0), Ned(-500.0, 0.0, -10.0), Ned(0.0, 500.0, -10.0), Ned(0.0, -500.0, -10.0)):
        assert fence.near(centre, 5.0).level_m(np.array([centre]))[0] == pytest.approx(-480.0)


def test_open_above_and_below() -> None:
    fence = Geofence.of(HOLED, -math.inf, math.inf, 0.0)
    assert fence.is_open_above_and_below
    assert fence.inside_m(np.array([[0.0, 0.0, -1e5]]))[0] == pytest.approx(10.0)
    assert not square_fence().is_open_above_and_below


@pytest.mark.parametrize(
    ("polygon", "floor", "ceiling", "sentence"),
    [
        (HOLED, 10.0, 10.0, "ceiling"),
        (HOLED, math.nan, 10.0, "ceiling"),
        (shapely.Polygon([(0, 0), (2, 2), (2, 0), (0, 2)]), 0.0, 10.0, "geofence.*not valid"),
        (shapely.Polygon(), 0.0, 10.0, "geofence.*empty"),
    ],
)
def test_what_bounds_nothing_is_refused(polygon: shapely.Polygon, floor: float, ceiling: float, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        Geofence.of(polygon, floor, ceiling, 0.0)


@settings(max_examples=200, deadline=None)
@given(st.floats(-40.0, 40.0), st.floats(-40.0, 40.0), st.floats(0.1, 12.0))
def test_a_fence_cut_down_answers_as_the_whole_up_to_what_it_vouches_for(
    north: float, east: float, reach_m: float
) -> None:
    """Also where no edge is within reach: inside, outside, and in the middle of a large no-fly area."""
    shape = shapely.Point(0.0, 0.0).buffer(30.0).difference(shapely.box(-12.0, -10.0, 9.0, 14.0))
    fence = Geofence.of(shape, 0.0, 50.0, 0.0)
    near = fence.near(Ned(north, east, -10.0), reach_m)
    about = np.random.default_rng(1).uniform(-0.5, 0.5, (20, 3)) * reach_m
    points = np.array((north, east, -10.0)) + about
    vouched = reach_m - np.hypot(about[:, 0], about[:, 1])
    whole, cut = fence.level_m(points), near.level_m(points)
    outside = fence.level_m(np.array([[north, east, -10.0]]))[0] < 0.0  # nothing is cut off there
    expected = whole if outside else np.copysign(np.minimum(np.abs(whole), vouched), whole)
    np.testing.assert_allclose(cut, expected, atol=1e-9)
