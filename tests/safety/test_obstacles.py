"""Obstacles and polygons: signed distances against shapely and against hand-made values."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from safety.obstacles import Obstacles
from safety.polygons import Polygons
from safety.vocabulary import Floats, Ned

BOX = shapely.box(0.0, 0.0, 4.0, 2.0)


def stars(seed: int, count: int) -> list[shapely.Polygon]:
    """Star-shaped polygons, concave ones too, the first with a hole, at whole and half coordinates as well."""
    rng = np.random.default_rng(seed)
    found = []
    for i in range(count):
        corners = rng.integers(4, 12)
        angles = np.sort(rng.uniform(0.0, 2.0 * np.pi, corners))
        if np.diff(angles, append=angles[0] + 2.0 * np.pi).max() > 3.0:
            angles = np.linspace(0.0, 2.0 * np.pi, corners, endpoint=False)
        radii = rng.uniform(2.0, 8.0, corners)
        middle = rng.uniform(-15.0, 15.0, 2)
        shell = np.round(2.0 * (middle + radii[:, None] * np.c_[np.cos(angles), np.sin(angles)])) / 2.0
        polygon = shapely.make_valid(shapely.Polygon(shell))
        if polygon.geom_type != "Polygon":
            polygon = shapely.box(*middle, *(middle + 3.0))
        if i == 0:
            holed = polygon.difference(shapely.Point(polygon.representative_point()).buffer(0.7))
            polygon = holed if holed.geom_type == "Polygon" else polygon
        found.append(polygon)
    return found


def by_shapely(polygons: list[shapely.Polygon], points: Floats) -> Floats:
    places = shapely.points(points)[:, None]
    shapes = np.array(polygons, dtype=object)[None, :]
    edge = shapely.distance(places, shapely.boundary(shapes))
    return np.where(shapely.contains(shapes, places), -edge, edge)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 6))
def test_polygon_distance_is_shapelys(seed: int, count: int) -> None:
    polygons = stars(seed, count)
    # Points on whole coordinates lie exactly beside, above and on corners.
    rng = np.random.default_rng(seed)
    points = np.concatenate((rng.uniform(-20, 20, (40, 2)), rng.integers(-20, 20, (40, 2)).astype(float)))
    np.testing.assert_allclose(Polygons.of(polygons).distance_m(points), by_shapely(polygons, points), atol=1e-9)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.5, 15.0))
def test_polygons_near_a_place_answer_as_all_of_them(seed: int, reach_m: float) -> None:
    polygons = stars(seed, 6)
    rng = np.random.default_rng(seed)
    centre = Ned(*rng.uniform(-10.0, 10.0, 2), 0.0)
    points = np.array(centre[:2]) + rng.uniform(-0.5, 0.5, (30, 2))
    whole = Polygons.of(polygons).distance_m(points)
    cut, which = Polygons.of(polygons).near(centre, reach_m)
    vouched = np.maximum(reach_m - np.linalg.norm(points - centre[:2], axis=1), 0.0)[:, None]
    around = (Polygons.of(polygons).distance_m(np.array([centre[:2]])) < 0.0)[0]  # stays whole
    expected = np.where(around, whole, np.sign(whole) * np.minimum(np.abs(whole), vouched))
    if len(cut):
        np.testing.assert_allclose(cut.distance_m(points), expected[:, which], atol=1e-9)
    left_out = np.setdiff1d(np.arange(len(polygons)), which)
    assert (whole[:, left_out] >= vouched - 1e-9).all()


@pytest.mark.parametrize(
    ("point", "distance"),
    [
        ((2.0, 1.0, -5.0), -1.0),  # inside: 1 m to the side, 5 m to top and base
        ((2.0, 1.0, -9.5), -0.5),  # inside: half a metre below the top
        ((2.0, 1.0, -0.25), -0.25),
        ((5.0, 1.0, -5.0), 1.0),  # beside
        ((4.0, 1.0, -5.0), 0.0),  # on the face
        ((2.0, 1.0, -12.0), 2.0),  # above
        ((2.0, 1.0, 3.0), 3.0),  # below
        ((7.0, 6.0, -5.0), 5.0),  # off a corner, level
        ((4.0 + 2.0, 2.0 + 3.0, -10.0 - 6.0), 7.0),  # off a corner, above
    ],
)
def test_prism_distance(point: tuple[float, float, float], distance: float) -> None:
    prism = Obstacles.of(["box"], [BOX], [100.0], [110.0], 100.0)
    assert prism.distance_m(np.array([point]))[0, 0] == pytest.approx(distance)


def test_inside_the_hole_of_a_prism_is_outside_it() -> None:
    ring = shapely.box(-10, -10, 10, 10).difference(shapely.box(-4, -4, 4, 4))
    prism = Obstacles.of(["yard"], [ring], [0.0], [10.0], 0.0)
    assert prism.distance_m(np.array([[0.0, 0.0, -5.0]]))[0, 0] == pytest.approx(4.0)
    assert prism.distance_m(np.array([[5.0, 0.0, -5.0]]))[0, 0] == pytest.approx(-1.0)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10_000))
def test_prism_distance_changes_by_no_more_than_is_moved(seed: int) -> None:
    rng = np.random.default_rng(seed)
    prisms = Obstacles.of(list("abcd"), stars(seed, 4), [0.0, 1.0, -3.0, 2.0], [3.0, 5.0, 4.0, 9.0], 0.0)
    here = rng.uniform((-15, -15, -10), (15, 15, 3), (40, 3))
    there = here + rng.normal(0.0, 0.5, here.shape)
    moved = np.linalg.norm(there - here, axis=1)[:, None]
    assert (np.abs(prisms.distance_m(here) - prisms.distance_m(there)) <= moved + 1e-9).all()


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10_000), st.floats(1.0, 15.0))
def test_obstacles_near_a_place_answer_as_all_of_them(seed: int, reach_m: float) -> None:
    rng = np.random.default_rng(seed)
    names = list("abcdef")
    everything = Obstacles.of(names, stars(seed, 6), rng.uniform(-5, 5, 6), rng.uniform(6, 30, 6), 0.0)
    centre = Ned(*rng.uniform((-12, -12, -25), (12, 12, 3)))
    points = np.asarray(centre) + rng.uniform(-0.5, 0.5, (20, 3))
    near = everything.near(centre, reach_m)
    vouched = near.vouched_m(points)[:, None]
    whole = everything.distance_m(points)
    kept = [names.index(n) for n in near.names]
    assert near.declared == 6
    if kept:
        found = near.distance_m(points)
        # What is nearer than vouched for is exact; the rest is not claimed to be nearer than that.
        close = np.abs(whole[:, kept]) < vouched
        np.testing.assert_allclose(found[close], whole[:, kept][close], atol=1e-9)
        assert (np.abs(found[~close]) <= np.abs(whole[:, kept][~close]) + 1e-9).all()
        assert (found[~close] >= np.broadcast_to(vouched, found.shape)[~close] - 1e-9)[whole[:, kept][~close] > 0].all()
    left_out = [i for i in range(6) if i not in kept]
    assert (whole[:, left_out] >= vouched - 1e-9).all()


def test_no_obstacles() -> None:
    nothing = Obstacles.none()
    assert nothing.declared == 0
    assert len(nothing.near(Ned(0.0, 0.0, 0.0), 10.0)) == 0
    assert nothing.vouched_m(np.zeros((2, 3))).tolist() == [math.inf, math.inf]


@pytest.mark.parametrize(
    ("polygon", "base", "top", "sentence"),
    [
        (shapely.Polygon([(0, 0), (2, 2), (2, 0), (0, 2)]), 0.0, 5.0, "shed.*not valid"),
        (shapely.Polygon(), 0.0, 5.0, "shed.*empty"),
        (shapely.Point(0, 0), 0.0, 5.0, "shed.*no polygon"),
        (shapely.Polygon([(0, 0), (np.nan, 2), (2, 0)]), 0.0, 5.0, "shed.*not finite"),
        (BOX, 5.0, 5.0, "shed.*above its base"),
        (BOX, 5.0, np.nan, "shed.*above its base"),
    ],
)
def test_what_is_no_prism_is_refused_by_name(polygon: shapely.Polygon, base: float, top: float, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        Obstacles.of(["shed"], [polygon], [base], [top], 0.0)


def test_every_obstacle_needs_all_of_its_parts() -> None:
    with pytest.raises(ValueError, match="every obstacle"):
        Obstacles.of(["a", "b"], [BOX], [0.0], [1.0], 0.0)
