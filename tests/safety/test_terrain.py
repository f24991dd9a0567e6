"""Terrain: heights and distances against dense sampling, and no data is never a yes."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from safety.terrain import Terrain
from safety.vocabulary import Floats, Ned

STEPS = st.sampled_from(
    [
        ((1.0, 0.0), (0.0, 1.0)),
        ((-2.0, 0.0), (0.0, 2.0)),
        ((0.0, 1.5), (1.5, 0.0)),
        ((0.8, -0.6), (0.6, 0.8)),
        ((3.0, 0.5), (-0.2, 1.0)),
    ]
)


def hills(seed: int, rough_m: float = 2.0, shape: tuple[int, int] = (12, 11)) -> Floats:
    return np.random.default_rng(seed).uniform(-rough_m, rough_m, shape)


def placed(heights: Floats, steps: tuple[tuple[float, float], tuple[float, float]], sigma_m: float = 0.0) -> Terrain:
    """With the middle of the grid at the origin."""
    middle = np.array(steps) @ (np.array(heights.shape) - 1.0) / 2.0
    return Terrain(heights, (-middle[0], -middle[1]), steps, sigma_m, 0.0)


def sampled(terrain: Terrain, pieces: int = 40) -> Floats:
    """Points of every triangle, (k, 3) NED: the corners of its pieces."""
    rows, cols = terrain.heights_amsl_m.shape
    steps = np.array(terrain.steps_ne_m)
    share = [(a / pieces, b / pieces) for a in range(pieces + 1) for b in range(pieces + 1 - a)]
    a, b = np.array(share).T
    found = []
    for i in range(rows - 1):
        for j in range(cols - 1):
            for others in (((1, 0), (1, 1)), ((1, 1), (0, 1))):
                corners = [
                    (
                        *(np.array(terrain.corner_ne_m) + steps @ (i + di, j + dj)),
                        terrain.heights_amsl_m[i + di, j + dj],
                    )
                    for di, dj in ((0, 0), *others)
                ]
                p, q, r = (np.array((n, e, terrain.origin_amsl_m - h)) for n, e, h in corners)
                found.append(p + a[:, None] * (q - p) + b[:, None] * (r - p))
    return np.concatenate(found)


@settings(max_examples=15, deadline=None)
@given(STEPS, st.integers(0, 10_000), st.floats(-1.5, 1.5), st.floats(-1.5, 1.5), st.floats(0.3, 3.0))
def test_clearance_is_the_distance_to_a_dense_sampling(
    steps: tuple[tuple[float, float], tuple[float, float]], seed: int, north: float, east: float, above: float
) -> None:
    terrain = placed(hills(seed), steps)
    ground = -terrain.agl_m(np.array([[north, east, 0.0]]))[0]
    path = np.array([[north + 0.1 * i, east, -(ground + above)] for i in range(6)])
    surface = sampled(terrain)
    nearest = np.sqrt(((path[:, None, :] - surface[None]) ** 2).sum(axis=2).min(axis=1))
    exact = terrain.clearance_m(path, reach_m=nearest.max() + 1.0)
    unknown = terrain.unknown_m(path, reach_m=nearest.max() + 1.0)
    assert unknown.min() > 0.0
    coarse_m = 0.1
    for i in range(6):
        # A sample can only be farther than the surface, and by no more than the sampling is coarse.
        brute = min(nearest[i], unknown[i])
        assert brute - coarse_m <= abs(exact[i]) <= brute + 1e-9
        assert math.copysign(1.0, exact[i]) == math.copysign(1.0, terrain.agl_m(path[i : i + 1])[0])


@settings(max_examples=30, deadline=None)
@given(STEPS, st.integers(0, 10_000))
def test_height_is_linear_between_the_corners_of_each_triangle(
    steps: tuple[tuple[float, float], tuple[float, float]], seed: int
) -> None:
    terrain = placed(hills(seed), steps)
    points = sampled(terrain, pieces=4)
    points = points[terrain.unknown_m(points, reach_m=5.0) > 1e-6]
    assert len(points) > 500
    np.testing.assert_allclose(terrain.agl_m(points), 0.0, atol=1e-9)
    up = np.array((0.0, 0.0, 2.5))
    np.testing.assert_allclose(terrain.agl_m(points - up), 2.5, atol=1e-9)
    np.testing.assert_allclose(terrain.agl_m(points + up), -2.5, atol=1e-9)


@settings(max_examples=30, deadline=None)
@given(
    STEPS, st.integers(0, 10_000), st.floats(-4.0, 4.0), st.floats(-4.0, 4.0), st.floats(-4.0, 8.0),
    st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0),
)  # fmt: skip
def test_clearance_changes_by_no_more_than_is_moved(
    steps: tuple[tuple[float, float], tuple[float, float]],
    seed: int, north: float, east: float, up: float, d_north: float, d_east: float, d_up: float,
) -> None:  # fmt: skip
    terrain = placed(hills(seed, shape=(30, 30)), steps)
    here = np.array([[north, east, -up]])
    there = here + np.array([[d_north, d_east, -d_up]])
    moved = float(np.linalg.norm(there - here))
    a, b = terrain.clearance_m(here)[0], terrain.clearance_m(there)[0]
    assert abs(a - b) <= moved + 1e-9


@settings(max_examples=30, deadline=None)
@given(STEPS, st.integers(0, 10_000), st.floats(2.0, 12.0))
def test_a_patch_answers_as_the_whole_up_to_what_it_vouches_for(
    steps: tuple[tuple[float, float], tuple[float, float]], seed: int, reach_m: float
) -> None:
    terrain = placed(hills(seed, shape=(30, 30)), steps)
    rng = np.random.default_rng(seed)
    centre = Ned(*rng.uniform((-3, -3, -6), (3, 3, -1)))
    patch = terrain.near(centre, reach_m)
    points = np.asarray(centre) + rng.uniform(-1.0, 1.0, (20, 3))
    vouched = reach_m - np.linalg.norm(points - np.asarray(centre), axis=1)
    whole = terrain.clearance_m(points, reach_m=30.0)
    expected = np.sign(whole) * np.minimum(np.abs(whole), vouched)
    np.testing.assert_allclose(patch.clearance_m(points), expected, atol=1e-6)
    np.testing.assert_allclose(patch.agl_m(points), terrain.agl_m(points))


def test_many_points_at_once_answer_as_one_by_one() -> None:
    terrain = placed(hills(3, shape=(40, 40)), ((1.0, 0.0), (0.0, 1.0)))
    points = np.random.default_rng(3).uniform((-8, -8, -8), (8, 8, -2), (50, 3))
    patch = terrain.near(Ned(0.0, 0.0, -5.0), 30.0)
    single = [patch.clearance_m(p[None])[0] for p in points]
    np.testing.assert_allclose(patch.clearance_m(points), single, atol=1e-6)


def test_flat_ground_has_no_end() -> None:
    flat = Terrain.flat(100.0, 0.5, 90.0)
    points = np.array([[0.0, 0.0, -15.0], [9e5, -9e5, -15.0], [0.0, 0.0, -9.0]])
    np.testing.assert_allclose(flat.agl_m(points), [5.0, 5.0, -1.0])
    np.testing.assert_allclose(flat.near(Ned(0.0, 0.0, -15.0), 20.0).clearance_m(points), [5.0, 0.0, -1.0])
    assert flat.is_complete
    assert flat.near(Ned(0.0, 0.0, 0.0), 5.0).is_complete
    assert flat.slope == 0.0


def test_outside_the_grid_nothing_is_known() -> None:
    terrain = placed(np.zeros((11, 11)), ((1.0, 0.0), (0.0, 1.0)))
    points = np.array([[5.001, 0.0, -3.0], [0.0, -5.001, -3.0], [400.0, 0.0, -3.0]])
    assert np.isnan(terrain.agl_m(points)).all()
    assert np.isnan(terrain.clearance_m(points)).all()
    assert (terrain.unknown_m(points) == 0.0).all()
    edge = np.array([[5.0, 0.0, -3.0], [4.0, 0.0, -3.0], [2.0, 0.0, -3.0]])
    np.testing.assert_allclose(terrain.agl_m(edge), 3.0)
    # Beyond the border there may be a cliff.
    np.testing.assert_allclose(terrain.clearance_m(edge), [0.0, 1.0, 3.0], atol=1e-9)


def test_a_cell_with_one_unknown_corner_is_unknown_as_a_whole() -> None:
    heights = np.zeros((21, 21))
    heights[10, 10] = np.nan
    terrain = placed(heights, ((1.0, 0.0), (0.0, 1.0)))
    off = np.linspace(-0.9, 0.9, 7)
    inside = np.array([(n, e, -3.0) for n in off for e in off])
    assert np.isnan(terrain.agl_m(inside)).all()
    assert np.isnan(terrain.clearance_m(inside)).all()
    beside = np.array([[0.0, 1.5, -3.0], [0.0, 5.0, -3.0]])
    np.testing.assert_allclose(terrain.agl_m(beside), 3.0)
    near, far = terrain.clearance_m(beside)
    assert 0.0 <= near <= 0.5  # the cell could hold anything
    assert far == pytest.approx(3.0)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_point_that_is_no_number_has_no_clearance(bad: float) -> None:
    terrain = placed(np.zeros((21, 21)), ((1.0, 0.0), (0.0, 1.0)))
    points = np.array([[0.0, 0.0, -3.0], [bad, 0.0, -3.0]])
    patch = terrain.near(Ned(0.0, 0.0, -3.0), 8.0)
    with np.errstate(invalid="ignore"):
        answers = terrain.agl_m(points), patch.clearance_m(points)
    for found in answers:
        assert found[0] == pytest.approx(3.0)
        assert np.isnan(found[1])


def test_the_slope_is_that_of_the_steepest_triangle() -> None:
    north = np.arange(20.0)[:, None] * np.ones((1, 20))
    assert placed(0.5 * north, ((1.0, 0.0), (0.0, 1.0))).slope == pytest.approx(0.5)
    assert placed(0.5 * north, ((2.0, 0.0), (0.0, 2.0))).slope == pytest.approx(0.25)
    assert placed(0.5 * north, ((0.8, -0.6), (0.6, 0.8))).slope == pytest.approx(0.5)
    holed = 0.5 * north
    holed[3, 3] = np.nan
    assert placed(holed, ((1.0, 0.0), (0.0, 1.0))).slope == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("heights", "corner", "steps", "sentence"),
    [
        (np.zeros(5), (0.0, 0.0), ((1.0, 0.0), (0.0, 1.0)), "2 x 2"),
        (np.zeros((1, 5)), (0.0, 0.0), ((1.0, 0.0), (0.0, 1.0)), "2 x 2"),
        (np.zeros((5, 5)), (0.0, 0.0), ((1.0, 1.0), (1.0, 1.0)), "do not span"),
        (np.zeros((5, 5)), (0.0, 0.0), ((np.nan, 0.0), (0.0, 1.0)), "do not span"),
        (np.zeros((5, 5)), (np.inf, 0.0), ((1.0, 0.0), (0.0, 1.0)), "finite"),
    ],
)
def test_what_is_no_grid_is_refused(heights: Floats, corner: tuple[float, float], steps: object, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        Terrain(heights, corner, steps, 0.1, 0.0)  # type: ignore[arg-type]


# ---------------------------------------------------------------- against plain geometry, cell by cell


class Plain:
    """A terrain's triangles and its unknown cells, worked out the slow way."""

    def __init__(self, terrain: Terrain) -> None:
        heights, steps = terrain.heights_amsl_m, np.array(terrain.steps_ne_m)
        self.triangles: list[Floats] = []
        unknown = []
        for i, j in np.ndindex(heights.shape[0] - 1, heights.shape[1] - 1):
            nodes = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
            ground = [np.array(terrain.corner_ne_m) + steps @ np.array(node, dtype=float) for node in nodes]
            if np.isnan([heights[node] for node in nodes]).any():
                unknown.append(shapely.Polygon(ground))
                continue
            corners = [np.array((*g, terrain.origin_amsl_m - heights[n])) for g, n in zip(ground, nodes, strict=True)]
            self.triangles += [np.array([corners[k] for k in which]) for which in ((0, 1, 2), (0, 2, 3))]
        ends = [
            (0, 0),
            (heights.shape[0] - 1, 0),
            (heights.shape[0] - 1, heights.shape[1] - 1),
            (0, heights.shape[1] - 1),
        ]
        self.grid = shapely.Polygon([np.array(terrain.corner_ne_m) + steps @ np.array(e, dtype=float) for e in ends])
        self.unknown = shapely.unary_union(unknown)

    def unknown_m(self, point: Floats) -> float:
        at = shapely.Point(point[:2])
        border_m = self.grid.exterior.distance(at) if self.grid.contains(at) else 0.0
        return float(min(border_m, math.inf if self.unknown.is_empty else self.unknown.distance(at)))

    def height_m(self, point: Floats) -> float:
        """Straight down to the one triangle that the point is over."""
        for a, b, c in self.triangles:
            share = np.linalg.solve(np.column_stack((b[:2] - a[:2], c[:2] - a[:2])), point[:2] - a[:2])
            if share.min() >= -1e-12 and share.sum() <= 1.0 + 1e-12:
                return float(a[2] + share @ (np.array((b[2], c[2])) - a[2]) - point[2])
        return math.nan

    def surface_m(self, point: Floats) -> float:
        return min(_from_triangle_m(point, triangle) for triangle in self.triangles)

    def slope(self) -> float:
        normals = [np.cross(b - a, c - a) for a, b, c in self.triangles]
        return max(math.hypot(n[0], n[1]) / abs(n[2]) for n in normals)


def _from_triangle_m(point: Floats, triangle: Floats) -> float:
    a, b, c = triangle
    normal = np.cross(b - a, c - a)
    foot = point - normal * ((point - a) @ normal) / (normal @ normal)
    sides = ((a, b), (b, c), (c, a))
    if all(np.cross(q - p, foot - p) @ normal >= 0.0 for p, q in sides):
        return float(np.linalg.norm(point - foot))
    ends = [p + min(1.0, max(0.0, (point - p) @ (q - p) / ((q - p) @ (q - p)))) * (q - p) for p, q in sides]
    return float(min(np.linalg.norm(point - end) for end in ends))


@pytest.mark.requirement("R3", "R4", "G2", "X6")
@pytest.mark.parametrize("seed", range(6))
def test_heights_and_distances_are_those_of_plain_geometry(seed: int) -> None:
    """Turned, stretched and skewed grids, some with holes, high above the origin; points over, under, beside and outside."""
    rng = np.random.default_rng(seed)
    steps = [
        ((1.0, 0.0), (0.0, 1.0)), ((0.8, -0.6), (0.6, 0.8)), ((3.0, 0.5), (-0.2, 1.0)),
        ((0.0, 1.5), (1.5, 0.0)), ((-2.0, 0.3), (0.4, 1.2)), ((1.2, 0.9), (-1.5, 2.0)),
    ][seed]  # fmt: skip
    heights = rng.uniform(-1.5, 1.5, (6, 5) if seed < 5 else (8, 8)) + 300.0
    if seed % 2:
        heights[rng.integers(1, 5), rng.integers(1, 4)] = np.nan
    corner = rng.uniform(-4.0, 1.0, 2).tolist()
    terrain = Terrain(heights, (corner[0], corner[1]), steps, 0.1, 305.0)
    plain = Plain(terrain)
    assert terrain.slope == pytest.approx(plain.slope())
    west, south, east, north = plain.grid.bounds
    low, high = (west - 0.6, south - 0.6, 1.0), (east + 0.6, north + 0.6, 8.5)
    points = rng.uniform(low, high, (24, 3))
    middle = np.array(((west + east) / 2.0, (south + north) / 2.0, 4.0))
    height = np.array([plain.height_m(p) for p in points])
    unknown = np.array([plain.unknown_m(p) for p in points])
    surface = np.array([plain.surface_m(p) for p in points])
    np.testing.assert_allclose(terrain.agl_m(points), height, atol=1e-9)
    np.testing.assert_allclose(terrain.unknown_m(points, reach_m=30.0), unknown, atol=1e-9)
    for reach_m, half in ((30.0, Ned(9.0, 9.0, 9.0)), (3.0, Ned(1.0, 0.5, 2.0)), (1.2, Ned(0.0, 0.0, 0.0))):
        patch = terrain.near(Ned(*middle.tolist()), reach_m, half)
        outside = np.maximum(np.abs(points - middle) - np.array(half), 0.0)
        vouched = np.maximum(reach_m - np.linalg.norm(outside, axis=1), 0.0)
        expected = np.minimum(np.minimum(surface, unknown), vouched)
        np.testing.assert_allclose(patch.clearance_m(points), np.copysign(expected, height) + 0.0 * height, atol=1e-7)
        np.testing.assert_allclose(patch.unknown_m(points), np.minimum(unknown, vouched), atol=1e-9)
        around = shapely.box(*(middle[:2] - half[:2]), *(middle[:2] + half[:2])).buffer(reach_m)
        if plain.grid.contains(around) and not around.intersects(plain.unknown):
            assert patch.is_complete
