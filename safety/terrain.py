"""The terrain model: heights on a grid, triangulated; vertical height above it and exact 3D distance to it.

Every cell is split along the diagonal from its (row, col) corner to its (row + 1, col + 1) corner, for both
questions alike. Where there is no data nothing is assumed: an unknown cell could be of any height, so what counts is
the horizontal distance to it. Source: paper III-F (terrain constraints), R3, R4, G2, G5, X6.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from safety.vocabulary import POINT, Floats, Ned

FEW = 48
"""Leaving cells out of a question pays only where there are more than so many."""


@dataclass(frozen=True, eq=False)
class Terrain:
    """Heights at the nodes of a grid that an affine map places in local metres. Raises ValueError if it is no grid.

    A grid of one single node is an endless plane (`Terrain.flat`).
    """

    heights_amsl_m: Floats
    """(rows, cols); NaN: no data."""
    corner_ne_m: tuple[float, float]
    """North and east of node (0, 0)."""
    steps_ne_m: tuple[tuple[float, float], tuple[float, float]]
    """((north per row, north per column), (east per row, east per column))"""
    sigma_m: float
    """1-sigma error of the heights, as the model states it."""
    origin_amsl_m: float
    """Altitude of the local frame's origin: down = origin_amsl_m - amsl."""
    slope: float = field(init=False, default=0.0)
    """The steepest that any triangle of it is, rise over run."""
    _cells: Floats = field(init=False, repr=False, default_factory=lambda: np.zeros((2, 2)))
    """(2, 2) rows and columns per metre: the inverse of steps_ne_m."""
    _corner: Floats = field(init=False, repr=False, default_factory=lambda: np.zeros((2, 1)))
    """(2, 1) rows and columns from the local origin to node (0, 0)"""
    _complete: bool = field(init=False, repr=False, default=False)
    """There is no node without data."""

    def __post_init__(self) -> None:
        heights = np.array(self.heights_amsl_m, dtype=np.float64, order="C")
        heights[~np.isfinite(heights)] = np.nan
        if heights.ndim != 2 or (heights.shape != (1, 1) and min(heights.shape) < 2):
            raise ValueError(f"terrain needs a grid of at least 2 x 2 heights, not {heights.shape}")
        steps = np.array(self.steps_ne_m, dtype=np.float64)
        if steps.shape != (2, 2) or not np.isfinite(steps).all() or abs(np.linalg.det(steps)) < 1e-9:
            raise ValueError(f"terrain grid steps {self.steps_ne_m} do not span the ground")
        if not all(map(math.isfinite, (*self.corner_ne_m, self.origin_amsl_m))):
            raise ValueError("terrain needs a finite place and altitude for its grid")
        (a, b), (c, d) = self.steps_ne_m
        cells = np.array(((d, -b), (-c, a))) / (a * d - b * c)
        object.__setattr__(self, "heights_amsl_m", heights)
        object.__setattr__(self, "_cells", cells)
        object.__setattr__(self, "_corner", cells @ np.array(self.corner_ne_m)[:, None])
        object.__setattr__(self, "_complete", bool(np.isfinite(heights).all()))
        object.__setattr__(self, "slope", _steepest(heights, cells))

    @staticmethod
    def flat(amsl_m: float, sigma_m: float, origin_amsl_m: float) -> Terrain:
        """An endless horizontal plane: what an operator who declares `terrain = "flat"` vouches for."""
        heights = np.array([[amsl_m]])
        return Terrain(heights, (0.0, 0.0), ((1.0, 0.0), (0.0, 1.0)), sigma_m, origin_amsl_m)

    @property
    def is_complete(self) -> bool:
        """There is data everywhere: only a plane has no end."""
        return self.is_flat

    @property
    def is_flat(self) -> bool:
        return self.heights_amsl_m.shape == (1, 1)

    def agl_m(self, points_ned_m: Floats) -> Floats:
        """(n,) vertical height of (n, 3) points above the surface; NaN where there is no data."""
        if self.is_flat:
            return np.asarray(self.origin_amsl_m - self.heights_amsl_m[0, 0] - points_ned_m[:, 2])
        place = self._cells @ points_ned_m[:, :2].T - self._corner
        rows, cols = self.heights_amsl_m.shape
        row, col = place
        known: NDArray[np.bool_] | None = None
        (low_row, low_col), (high_row, high_col) = np.minimum.reduce(place, axis=1), np.maximum.reduce(place, axis=1)
        # A point that is not finite is in no cell either.
        if not (low_row >= 0.0 and high_row <= rows - 1 and low_col >= 0.0 and high_col <= cols - 1):
            known = (row >= 0.0) & (row <= rows - 1) & (col >= 0.0) & (col <= cols - 1)
            row, col = np.where(known, place, 0.0)
        i = np.minimum(row.astype(np.intp), rows - 2)
        j = np.minimum(col.astype(np.intp), cols - 2)
        first = i * cols + j
        at = self.heights_amsl_m.reshape(-1)
        h00, h01, h10, h11 = at[first], at[first + 1], at[first + cols], at[first + (cols + 1)]
        # Of the two triangles the one on this side of the diagonal, which holds h00 and h11 and one more.
        row, col = row - i, col - j
        more, less = np.maximum(row, col), np.minimum(row, col)
        third = np.where(row >= col, h10, h01)
        agl = self.origin_amsl_m - points_ned_m[:, 2] - (h00 + more * (third - h00) + less * (h11 - third))
        if not self._complete:
            # A cell with one unknown corner is unknown as a whole.
            agl += 0.0 * (h01 + h10)
        return np.asarray(agl if known is None else np.where(known, agl, np.nan))

    def clearance_m(self, points_ned_m: Floats, reach_m: float = 20.0, agl_m: Floats | None = None) -> Floats:
        """(n,) distance of (n, 3) points to the ground, at most reach_m; see `TerrainPatch.clearance_m`."""
        distance = self._about(points_ned_m, reach_m).clearance_m(points_ned_m, agl_m)
        return np.asarray(np.maximum(np.minimum(distance, reach_m), -reach_m))

    def unknown_m(self, points_ned_m: Floats, reach_m: float = 20.0) -> Floats:
        """(n,) horizontal distance of (n, 3) points to where there is no data, at most reach_m."""
        return np.asarray(np.minimum(self._about(points_ned_m, reach_m).unknown_m(points_ned_m), reach_m))

    def _about(self, points_ned_m: Floats, reach_m: float) -> TerrainPatch:
        """The patch that vouches for reach_m about every one of the points."""
        low, high = points_ned_m.min(axis=0), points_ned_m.max(axis=0)
        return self.near(Ned(*(0.5 * (low + high)).tolist()), reach_m, Ned(*(0.5 * (high - low)).tolist()))

    def near(self, centre: Ned, reach_m: float, half: Ned = POINT) -> TerrainPatch:
        """The part within reach_m of a box about centre, for many cheap queries about points in it. half: its half sides."""
        if self.is_flat:
            return TerrainPatch(self, centre, half, reach_m, _NOTHING, np.zeros((2, 0)), 0.0, border=False)
        rows, cols = self.heights_amsl_m.shape
        north, east = centre.north - self.corner_ne_m[0], centre.east - self.corner_ne_m[1]
        (row_n, row_e), (col_n, col_e) = self._cells.tolist()
        row, col = row_n * north + row_e * east, col_n * north + col_e * east
        per_row, per_col = math.hypot(row_n, row_e), math.hypot(col_n, col_e)
        inside_m = min(row / per_row, (rows - 1 - row) / per_row, col / per_col, (cols - 1 - col) / per_col)
        level_m = reach_m + half.horizontal
        i0, i1 = _window(row, level_m * per_row, rows)
        j0, j1 = _window(col, level_m * per_col, cols)
        (n_row, n_col), (e_row, e_col) = self.steps_ne_m
        up = self.heights_amsl_m[i0:i1, j0:j1] + (centre.down - self.origin_amsl_m)
        i, j = np.arange(i0, i1 - 1)[:, None] + (0.5 - row), np.arange(j0, j1 - 1) + (0.5 - col)
        mid_n, mid_e = n_row * i + n_col * j, e_row * i + e_col * j
        low, high = np.minimum(up[1:], up[:-1]), np.maximum(up[1:], up[:-1])
        low, high = np.minimum(low[:, 1:], low[:, :-1]), np.maximum(high[:, 1:], high[:, :-1])
        mid_u, tall = 0.5 * (low + high), 0.5 * (high - low)
        # A box about every cell: those that begin within reach count. An unknown cell compares false.
        half_n, half_e = 0.5 * (abs(n_row) + abs(n_col)), 0.5 * (abs(e_row) + abs(e_col))
        off_n = np.maximum(np.abs(mid_n) - (half_n + half.north), 0.0)
        off_e = np.maximum(np.abs(mid_e) - (half_e + half.east), 0.0)
        off_u = np.maximum(np.abs(mid_u) - (tall + half.down), 0.0)
        kept = np.flatnonzero(off_n * off_n + off_e * off_e + off_u * off_u <= reach_m * reach_m)
        unknown = np.zeros((2, 0))
        if not self._complete:
            blank = np.isnan(low)
            unknown = np.stack((mid_n[blank], mid_e[blank]))
        middles = np.array((mid_n.ravel()[kept], mid_e.ravel()[kept], mid_u.ravel()[kept]))
        halves = np.empty((3, kept.size))
        halves[0], halves[1], halves[2] = half_n, half_e, tall.ravel()[kept]
        across = up.shape[1]
        first = kept + kept // (across - 1) if across > 1 else kept
        corners = up.ravel()[first + np.array(((0,), (across,), (across + 1,), (1,)))]
        starts = middles[:2] - ((0.5 * (n_row + n_col),), (0.5 * (e_row + e_col),))
        maps = _maps(self.steps_ne_m, starts[0], starts[1], corners)
        # About the middle of an unknown cell there may be anything as far as to its farthest corner.
        radius_m = 0.5 * max(math.hypot(n_row + n_col, e_row + e_col), math.hypot(n_row - n_col, e_row - e_col))
        return TerrainPatch(
            self,
            centre,
            half,
            reach_m,
            _Cells(maps, middles, halves),
            unknown,
            radius_m,
            border=not inside_m >= level_m,
        )


@dataclass(frozen=True, eq=False, slots=True)
class _Cells:
    """c cells of a patch, everything about its centre, as linear maps of (north, east, up, 1)."""

    maps: Floats
    """(4, 13, c): the signed distances from the planes of the two triangles (2), their first and their second barycentric
    coordinates (2, 2); how far along each of the three sides from the first corner (3); the part of the squared distance
    to that corner that is linear (1); and in the row of the ones the squared lengths of the three sides (3)."""
    middles: Floats
    """(3, c)"""
    halves_m: Floats
    """(3, c) half the sides of the boxes about the middles that hold the cells"""


_NOTHING = _Cells(np.zeros((4, 13, 0)), np.zeros((3, 0)), np.zeros((3, 0)))


@dataclass(frozen=True, eq=False)
class TerrainPatch:
    """The part of a `Terrain` within reach_m of a box."""

    terrain: Terrain
    centre: Ned
    half: Ned
    """The half sides of the box about the centre."""
    reach_m: float
    _cells: _Cells
    _unknown_ne_m: Floats
    """(2, u) middles of the cells without data, about the centre."""
    _unknown_radius_m: float
    border: bool
    """The end of the grid is within reach."""
    _centre: Floats = field(init=False, repr=False, default_factory=lambda: np.zeros(3))
    """The centre as an array."""
    _half: Floats = field(init=False, repr=False, default_factory=lambda: np.zeros(3))
    """The half sides as an array."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "_centre", np.array(self.centre))
        object.__setattr__(self, "_half", np.array(self.half))

    @property
    def sigma_m(self) -> float:
        return self.terrain.sigma_m

    @property
    def slope(self) -> float:
        return self.terrain.slope

    @property
    def is_complete(self) -> bool:
        """Everything within reach is known."""
        return not self.border and not self._unknown_ne_m.size

    def near(self, centre: Ned, reach_m: float, half: Ned = POINT) -> TerrainPatch:
        """Another patch of the same terrain."""
        return self.terrain.near(centre, reach_m, half)

    def agl_m(self, points_ned_m: Floats) -> Floats:
        """(n,) vertical height of (n, 3) points above the surface; NaN where there is no data."""
        return self.terrain.agl_m(points_ned_m)

    def clearance_m(self, points_ned_m: Floats, agl_m: Floats | None = None) -> Floats:
        """(n,) distance of (n, 3) points to what is or may be ground: the surface, or where there is no data, if nearer.

        Negative beneath the surface; NaN over cells without data. Never more than what the patch can vouch for: reach_m
        less the point's distance from the box. agl_m: these points' heights, if the caller has them already.
        """
        height = self.agl_m(points_ned_m) if agl_m is None else agl_m
        about = points_ned_m - self._centre
        distance = self._vouched_m(about)
        if self.terrain.is_flat:
            distance = np.minimum(distance, np.abs(height))
        elif self._cells.middles.size:
            distance = np.minimum(distance, self._surface_m(about, height))
        if not self.is_complete:
            distance = np.minimum(distance, self.unknown_m(points_ned_m))
        # NaN of the height stays: copysign alone would lose it.
        return np.asarray(np.copysign(distance, height) + 0.0 * height)

    def unknown_m(self, points_ned_m: Floats) -> Floats:
        """(n,) horizontal distance of (n, 3) points to where there is no data; at most what the patch can vouch for."""
        about = points_ned_m - self._centre
        distance = self._vouched_m(about)
        if self.border:
            cells = self.terrain._cells
            place = (points_ned_m[:, :2] - self.terrain.corner_ne_m) @ cells.T
            last = np.array(self.terrain.heights_amsl_m.shape) - 1.0
            inside = np.minimum(place, last - place) / np.hypot(cells[:, 0], cells[:, 1])
            distance = np.minimum(distance, np.maximum(inside.min(axis=1), 0.0))
        if self._unknown_ne_m.size:
            north = about[:, 0, None] - self._unknown_ne_m[0]
            east = about[:, 1, None] - self._unknown_ne_m[1]
            far = np.sqrt(north * north + east * east)
            # Only those can be nearest whose outermost corner may be nearer than the middle of the nearest.
            near = (far - self._unknown_radius_m <= far.min(axis=1, keepdims=True)).any(axis=0)
            distance = np.minimum(distance, self._from_cells_m(north[:, near], east[:, near]).min(axis=1))
        return np.asarray(distance)

    def _from_cells_m(self, north: Floats, east: Floats) -> Floats:
        """(n, u) distance of points to cells, 0 inside; given from the middle of each cell."""
        (n_row, n_col), (e_row, e_col) = self.terrain.steps_ne_m
        cells = self.terrain._cells
        row = cells[0, 0] * north + cells[0, 1] * east
        col = cells[1, 0] * north + cells[1, 1] * east
        inside = (np.abs(row) <= 0.5) & (np.abs(col) <= 0.5)
        squares = np.full(north.shape, np.inf)
        for side in (-0.5, 0.5):
            for (edge_n, edge_e), (from_n, from_e) in (
                ((n_row, e_row), (side * n_col, side * e_col)),
                ((n_col, e_col), (side * n_row, side * e_row)),
            ):
                off_n, off_e = north - from_n, east - from_e
                t = (off_n * edge_n + off_e * edge_e) / (edge_n * edge_n + edge_e * edge_e)
                t = np.minimum(np.maximum(t, -0.5), 0.5)
                off_n, off_e = off_n - t * edge_n, off_e - t * edge_e
                squares = np.minimum(squares, off_n * off_n + off_e * off_e)
        return np.where(inside, 0.0, np.sqrt(squares))

    def _vouched_m(self, about: Floats) -> Floats:
        """(n,) how far from points, (n, 3) about the centre, everything is here."""
        off = np.maximum(np.abs(about) - self._half, 0.0)
        return np.asarray(np.maximum(self.reach_m - np.sqrt((off * off) @ _ONES), 0.0))

    def _surface_m(self, about: Floats, height: Floats) -> Floats:
        """(n,) distance to the nearest known triangle; about: (n, 3) north, east, down from the centre."""
        maps = self._cells.maps
        if maps.shape[2] > FEW:
            maps = maps.take(self._nearest(about, height), axis=2)
        if not maps.shape[2]:  # pragma: no cover - the nearest cell is always among them, but for rounding
            return np.full(len(about), np.inf)
        points = np.ones((len(about), 4))
        points[:, :3] = about
        points[:, 2] *= -1.0
        found = (points @ maps[:, :10].reshape(4, -1)).reshape(len(about), 10, -1)
        plane, u, v = found[:, 0:2], found[:, 2:4], found[:, 4:6]
        # The foot of the perpendicular lies in the triangle, or the nearest point is on one of its sides.
        over = np.minimum(np.minimum(u, v), 1.0 - u - v) >= 0.0
        foot = np.minimum.reduce(np.where(over, plane * plane, np.inf), axis=(1, 2))
        along = found[:, 6:9]
        t = np.minimum(np.maximum(along, 0.0), 1.0)
        side = np.minimum.reduce(maps[3, 10:] * t * (t - (along + along)), axis=1) + found[:, 9]
        nearest = np.minimum(foot, np.minimum.reduce(side, axis=1) + (about * about) @ _ONES)
        return np.asarray(np.sqrt(np.maximum(nearest, 0.0)))

    def _nearest(self, about: Floats, height: Floats) -> NDArray[np.intp]:
        """Indices of the cells that can be nearest to one of the points.

        No point is farther from the surface than it is above it: cells farther than that from the points' box are not
        nearest to any. Written so that an unknown height (NaN) leaves nothing out.
        """
        cells = self._cells
        low, high = np.minimum.reduce(about), np.maximum.reduce(about)
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        middle[2] *= -1.0
        apart = np.maximum(np.abs(cells.middles - middle[:, None]) - (cells.halves_m + half[:, None]), 0.0)
        farthest_m = float(np.maximum.reduce(np.abs(height)))
        return np.flatnonzero(~(_ONES @ (apart * apart) > farthest_m * farthest_m * (1.0 + 1e-9)))


_ONES = np.ones(3)


def _maps(
    steps: tuple[tuple[float, float], tuple[float, float]], north: Floats, east: Floats, corners: Floats
) -> Floats:
    """The maps of `_Cells` from the place of c cells' first corners and (4, c) heights of 00, 10, 11, 01, about the centre."""
    (n_row, n_col), (e_row, e_col) = steps
    first = corners[0]
    # Sides from the first corner to 10, 11, 01: constant over the ground, each cell's own upwards.
    sides_n, sides_e = (
        np.array(((n_row,), (n_row + n_col,), (n_col,))),
        np.array(((e_row,), (e_row + e_col,), (e_col,))),
    )
    sides_u = corners[1:] - first
    maps = np.empty((4, 13, first.size))
    # Triangles (00, 10, 11) and (00, 11, 01): sides p and q. The normal is p x q.
    p_n, p_e, p_u, q_n, q_e, q_u = sides_n[:2], sides_e[:2], sides_u[:2], sides_n[1:], sides_e[1:], sides_u[1:]
    normal_n, normal_e, normal_u = p_e * q_u - q_e * p_u, q_n * p_u - p_n * q_u, p_n * q_e - p_e * q_n
    shrink = 1.0 / (normal_n * normal_n + normal_e * normal_e + normal_u * normal_u)
    unit = np.sqrt(shrink)
    maps[0, 0:2], maps[1, 0:2], maps[2, 0:2] = normal_n * unit, normal_e * unit, normal_u * unit
    # Dual to p and q in the plane: q x normal and normal x p over the normal's square.
    normal_n, normal_e, normal_u = normal_n * shrink, normal_e * shrink, normal_u * shrink
    maps[0, 2:4] = q_e * normal_u - q_u * normal_e
    maps[1, 2:4] = q_u * normal_n - q_n * normal_u
    maps[2, 2:4] = q_n * normal_e - q_e * normal_n
    maps[0, 4:6] = normal_e * p_u - normal_u * p_e
    maps[1, 4:6] = normal_u * p_n - normal_n * p_u
    maps[2, 4:6] = normal_n * p_e - normal_e * p_n
    squares = sides_u * sides_u + (sides_n * sides_n + sides_e * sides_e)
    maps[0, 6:9], maps[1, 6:9], maps[2, 6:9] = sides_n / squares, sides_e / squares, sides_u / squares
    maps[3, 10:] = squares
    # All of these are measured from the first corner.
    maps[3, :9] = -(maps[0, :9] * north + maps[1, :9] * east + maps[2, :9] * first)
    maps[0, 9], maps[1, 9], maps[2, 9] = -2.0 * north, -2.0 * east, -2.0 * first
    maps[3, 9] = north * north + east * east + first * first
    return maps


def _window(middle: float, half: float, count: int) -> tuple[int, int]:
    """First and one past the last of the nodes whose cells lie within half (in nodes) of middle; one node for none."""
    if not math.isfinite(middle) or math.isnan(half):
        return 0, 1
    first = max(0, math.floor(max(middle - half, 0.0)))
    last = min(count, math.ceil(min(middle + half, float(count))) + 1)
    return (first, last) if first < last - 1 else (0, 1)


def _steepest(heights: Floats, cells: Floats) -> float:
    """The largest slope of any triangle that is known; 0 for a plane."""
    if heights.size == 1:
        return 0.0
    by_row, by_col = np.diff(heights, axis=0), np.diff(heights, axis=1)
    steepest = 0.0
    for rise_row, rise_col in ((by_row[:, :-1], by_col[1:, :]), (by_row[:, 1:], by_col[:-1, :])):
        north = rise_row * cells[0, 0] + rise_col * cells[1, 0]
        east = rise_row * cells[0, 1] + rise_col * cells[1, 1]
        square = north * north + east * east
        steepest = max(steepest, float(np.fmax.reduce(square, axis=None, initial=0.0)))
    return math.sqrt(steepest)
