"""The geofence: where flying is allowed, with no-fly areas, floor and ceiling."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely

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
    assert near.inside_m(np.array([point]))[0] == pytest.approx(max(min(inside_m, 8.0), -8.0))


def test_far_outside_stays_outside_when_cut_down() -> None:
    fence = square_fence()
    for centre in (Ned(500.0, 0.0, -10.0), Ned(-500.0, 0.0, -10.0), Ned(0.0, 500.0, -10.0), Ned(0.0, -500.0, -10.0)):
        assert fence.near(centre, 5.0).level_m(np.array([centre]))[0] == pytest.approx(-5.0)


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
