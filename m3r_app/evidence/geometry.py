"""Distances to ground, prisms and fences, by numpy and shapely: written anew, nothing of it is shared with `safety`.

Points are (n, 3) rows of north, east and altitude above mean sea level, metres.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import shapely

from m3r_app.evidence.flight import Fence, Floats, Grid, Prism

PAIRS_MOST = 400_000
"""So many points times triangles are worked on at once."""


def level_m(points: Floats, polygon: object) -> Floats:
    """(n,) signed horizontal distance to a polygon with holes: negative inside."""
    places = shapely.points(points[:, :2])
    inside = shapely.contains(polygon, places)
    away = shapely.distance(shapely.boundary(polygon), places)
    return np.asarray(np.where(inside, -away, away), dtype=np.float64)


def prism_m(points: Floats, prism: Prism) -> Floats:
    """(n,) signed distance to a prism's surface: negative inside."""
    level = level_m(points, prism.polygon)
    upright = np.maximum(prism.base_amsl_m - points[:, 2], points[:, 2] - prism.top_amsl_m)
    outside = np.hypot(np.maximum(level, 0.0), np.maximum(upright, 0.0))
    return np.where((level < 0.0) & (upright < 0.0), np.maximum(level, upright), outside)


def fence_m(points: Floats, fence: Fence) -> tuple[Floats, Floats]:
    """(n,) horizontal and (n,) vertical distance to where flying ends: positive where it is allowed."""
    upright = np.minimum(points[:, 2] - fence.floor_amsl_m, fence.ceiling_amsl_m - points[:, 2])
    return -level_m(points, fence.polygon), upright


def capsule_m(points: Floats, start: Floats, end: Floats, radius_m: float) -> Floats:
    """(n,) signed distance to everything within radius_m of a segment; all of it in one frame."""
    axis = end - start
    square = float(axis @ axis)
    along = np.clip((points - start) @ axis / square, 0.0, 1.0) if square > 0.0 else np.zeros(len(points))
    return np.asarray(np.linalg.norm(points - start - along[:, None] * axis, axis=1) - radius_m)


def approach_m(apart: Floats) -> Floats:
    """(n,) least distance since the moment before, of (n, 3) differences between two that fly straight in between."""
    first, step = apart[:-1], np.diff(apart, axis=0)
    square = (step * step).sum(axis=1)
    when = np.clip(-(first * step).sum(axis=1) / np.where(square > 0.0, square, 1.0), 0.0, 1.0)
    return np.concatenate((np.linalg.norm(apart[:1], axis=1), np.linalg.norm(first + when[:, None] * step, axis=1)))


def height_m(points: Floats, grid: Grid) -> Floats:
    """(n,) height above the ground straight below; NaN where the model has no data.

    Every cell is two triangles, divided from its first node to the one across.
    """
    heights = grid.heights_amsl_m
    if heights.shape == (1, 1):
        return np.asarray(points[:, 2] - heights[0, 0])
    rows, cols = heights.shape
    row, col = np.linalg.solve(grid.steps_ne_m, (points[:, :2] - grid.corner_ne_m).T)
    on = (row >= 0.0) & (row <= rows - 1) & (col >= 0.0) & (col <= cols - 1)
    i = np.clip(np.where(on, row, 0.0).astype(int), 0, rows - 2)
    j = np.clip(np.where(on, col, 0.0).astype(int), 0, cols - 2)
    u, v = row - i, col - j
    near, far, down, right = heights[i, j], heights[i + 1, j + 1], heights[i + 1, j], heights[i, j + 1]
    lower = near + u * (down - near) + v * (far - down)
    upper = near + v * (right - near) + u * (far - right)
    # A cell with one unknown corner is unknown as a whole.
    surface = np.where(u >= v, lower, upper) + 0.0 * (near + far + down + right)
    return np.asarray(points[:, 2] - np.where(on, surface, np.nan))


@dataclass(frozen=True, eq=False)
class Patch:
    """The part of a terrain model within reach_m, horizontally, of every one of some points."""

    grid: Grid
    points: Floats
    reach_m: float
    triangles: Floats = field(init=False)
    """(m, 3, 3)"""
    _unknown: object = field(init=False)
    """Where there is no data, as far as it is in reach."""

    def __post_init__(self) -> None:
        heights, grid = self.grid.heights_amsl_m, self.grid
        if heights.shape == (1, 1):
            object.__setattr__(self, "triangles", np.zeros((0, 3, 3)))
            object.__setattr__(self, "_unknown", None)
            return
        low, high = self.points[:, :2].min(axis=0) - self.reach_m, self.points[:, :2].max(axis=0) + self.reach_m
        corners = np.array([(low[0], low[1]), (low[0], high[1]), (high[0], low[1]), (high[0], high[1])])
        cells = np.linalg.solve(grid.steps_ne_m, (corners - grid.corner_ne_m).T)
        last = np.array(heights.shape) - 1
        i0, j0 = np.clip(np.floor(cells.min(axis=1)).astype(int), 0, last)
        i1, j1 = np.clip(np.ceil(cells.max(axis=1)).astype(int), 0, last)
        rows, cols = np.meshgrid(np.arange(i0, i1 + 1), np.arange(j0, j1 + 1), indexing="ij")
        flat = grid.corner_ne_m + np.stack((rows, cols), axis=-1) @ grid.steps_ne_m.T
        nodes = np.concatenate((flat, heights[i0 : i1 + 1, j0 : j1 + 1, None]), axis=-1)
        near, far, down, right = (
            part.reshape(-1, 3) for part in (nodes[:-1, :-1], nodes[1:, 1:], nodes[1:, :-1], nodes[:-1, 1:])
        )
        known = np.isfinite(near + far + down + right).all(axis=1)
        both = np.concatenate((np.stack((near, down, far), axis=1)[known], np.stack((near, far, right), axis=1)[known]))
        object.__setattr__(self, "triangles", both)
        blank = [shapely.Polygon([c[k, :2] for c in (near, down, far, right)]) for k in np.flatnonzero(~known)]
        whole = grid.corner_ne_m + np.array([(0, 0), (last[0], 0), last, (0, last[1])]) @ grid.steps_ne_m.T
        beyond = shapely.difference(
            shapely.box(low[0] - 1.0, low[1] - 1.0, high[0] + 1.0, high[1] + 1.0), shapely.Polygon(whole)
        )
        object.__setattr__(self, "_unknown", shapely.union_all([beyond, *blank]))

    def surface_m(self, points: Floats) -> Floats:
        """(n,) 3D distance to the ground, negative beneath it, NaN where there is none below; cut off at reach_m."""
        height = height_m(points, self.grid)
        if self.grid.heights_amsl_m.shape == (1, 1):
            return height
        away = np.full(len(points), self.reach_m)
        if len(self.triangles):
            at_once = max(1, PAIRS_MOST // len(self.triangles))
            for first in range(0, len(points), at_once):
                part = points[first : first + at_once]
                away[first : first + at_once] = np.minimum(triangles_m(part, self.triangles).min(axis=1), self.reach_m)
        return np.asarray(np.copysign(away, height) + 0.0 * height)

    def unknown_m(self, points: Floats) -> Floats:
        """(n,) horizontal distance to where the model has no data, cut off at reach_m."""
        if self._unknown is None or shapely.is_empty(self._unknown):
            return np.full(len(points), self.reach_m)
        away = shapely.distance(self._unknown, shapely.points(points[:, :2]))
        return np.asarray(np.minimum(away, self.reach_m), dtype=np.float64)


def triangles_m(points: Floats, triangles: Floats) -> Floats:
    """(n, m) distance of points to triangles: to the foot on its plane where that lies inside, else to the sides."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    normal = np.cross(b - a, c - a)
    square = (normal * normal).sum(axis=1)
    over = np.einsum("nmx,mx->nm", points[:, None] - a, normal)
    foot = points[:, None] - (over / square)[:, :, None] * normal
    inside = np.ones(over.shape, dtype=bool)
    best = np.full(over.shape, np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        side = end - start
        inside &= np.einsum("nmx,mx->nm", np.cross(side, foot - start), normal) >= 0.0
        along = np.clip(np.einsum("nmx,mx->nm", points[:, None] - start, side) / (side * side).sum(axis=1), 0.0, 1.0)
        best = np.minimum(best, np.linalg.norm(points[:, None] - start - along[:, :, None] * side, axis=2))
    return np.where(inside, np.minimum(best, np.abs(over) / np.sqrt(square)), best)
