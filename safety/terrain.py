"""The terrain model: heights on a grid, triangulated; vertical height above it and exact 3D distance to it.

Every cell is split along the diagonal from its (row, col) corner to its (row + 1, col + 1) corner, for both
questions alike. Where there is no data nothing is assumed: an unknown cell could be of any height, so what counts is
the horizontal distance to it. Source: paper III-F (terrain constraints), R3, R4, G2, G5, X6.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from safety.vocabulary import Floats, Ned


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
        object.__setattr__(self, "slope", _steepest(heights, cells))

    @staticmethod
    def flat(amsl_m: float, sigma_m: float, origin_amsl_m: float) -> Terrain:
        """An endless horizontal plane: what an operator who declares `terrain = "flat"` vouches for."""
        heights = np.array([[amsl_m]])
        return Terrain(heights, (0.0, 0.0), ((1.0, 0.0), (0.0, 1.0)), sigma_m, origin_amsl_m)

    @property
    def is_flat(self) -> bool:
        return self.heights_amsl_m.shape == (1, 1)

    def agl_m(self, points_ned_m: Floats) -> Floats:
        """(n,) vertical height of (n, 3) points above the surface; NaN where there is no data."""
        up = self.origin_amsl_m - points_ned_m[:, 2]
        if self.is_flat:
            return np.asarray(up - self.heights_amsl_m[0, 0])
        place = (points_ned_m[:, :2] - self.corner_ne_m) @ self._cells.T
        rows, cols = self.heights_amsl_m.shape
        row, col = place[:, 0], place[:, 1]
        known = (row >= 0.0) & (row <= rows - 1) & (col >= 0.0) & (col <= cols - 1)
        if not known.all():
            row, col = np.where(known, row, 0.0), np.where(known, col, 0.0)
        i = np.minimum(row.astype(np.intp), rows - 2)
        j = np.minimum(col.astype(np.intp), cols - 2)
        first = i * cols + j
        at = self.heights_amsl_m.reshape(-1)
        h00, h01, h10, h11 = at[first], at[first + 1], at[first + cols], at[first + cols + 1]
        along_row, along_col = row - i, col - j
        ground = np.where(
            along_row >= along_col,
            h00 + along_row * (h10 - h00) + along_col * (h11 - h10),
            h00 + along_col * (h01 - h00) + along_row * (h11 - h01),
        )
        # All four corners must be known: a cell with one unknown corner is unknown as a whole.
        agl = up - ground + 0.0 * (h01 + h10)
        return np.asarray(agl if known.all() else np.where(known, agl, np.nan))

    def clearance_m(self, points_ned_m: Floats, reach_m: float = 20.0, agl_m: Floats | None = None) -> Floats:
        """(n,) distance of (n, 3) points to the surface, at most reach_m; see `TerrainPatch.clearance_m`."""
        distance = self._about(points_ned_m, reach_m).clearance_m(points_ned_m, agl_m)
        return np.asarray(np.maximum(np.minimum(distance, reach_m), -reach_m))

    def unknown_m(self, points_ned_m: Floats, reach_m: float = 20.0) -> Floats:
        """(n,) horizontal distance of (n, 3) points to where there is no data, at most reach_m."""
        return np.asarray(np.minimum(self._about(points_ned_m, reach_m).unknown_m(points_ned_m), reach_m))

    def _about(self, points_ned_m: Floats, reach_m: float) -> TerrainPatch:
        """The patch that vouches for reach_m about every one of the points."""
        middle = (points_ned_m.min(axis=0) + points_ned_m.max(axis=0)) / 2.0
        radius_m = float(np.sqrt(((points_ned_m - middle) ** 2).sum(axis=1).max()))
        return self.near(Ned(*map(float, middle)), radius_m + reach_m)

    def near(self, centre: Ned, reach_m: float) -> TerrainPatch:
        """The triangles within reach_m of centre, for many cheap queries about points near it."""
        if self.is_flat:
            up_m = float(self.heights_amsl_m[0, 0]) - self.origin_amsl_m + centre.down
            return TerrainPatch(self, centre, reach_m, *_plane(up_m), np.zeros((0, 2)), 0.0, False)
        rows, cols = self.heights_amsl_m.shape
        offset = np.array([centre.north - self.corner_ne_m[0], centre.east - self.corner_ne_m[1]])
        row, col = self._cells @ offset
        per_m = np.hypot(self._cells[:, 0], self._cells[:, 1])
        borders = min(row / per_m[0], (rows - 1 - row) / per_m[0], col / per_m[1], (cols - 1 - col) / per_m[1])
        i0, i1 = _window(row, reach_m * per_m[0], rows)
        j0, j1 = _window(col, reach_m * per_m[1], cols)
        steps = np.array(self.steps_ne_m)
        nodes = np.empty((i1 - i0, j1 - j0, 3))
        i = np.arange(i0, i1)[:, None] - row
        j = np.arange(j0, j1)[None, :] - col
        nodes[..., 0] = steps[0, 0] * i + steps[0, 1] * j
        nodes[..., 1] = steps[1, 0] * i + steps[1, 1] * j
        nodes[..., 2] = self.heights_amsl_m[i0:i1, j0:j1] + (centre.down - self.origin_amsl_m)
        faces, edges = _elements(nodes, reach_m)
        unknown = np.isnan(nodes[:-1, :-1, 2] + nodes[1:, :-1, 2] + nodes[:-1, 1:, 2] + nodes[1:, 1:, 2])
        middles = (nodes[:-1, :-1, :2] + nodes[1:, 1:, :2])[unknown] / 2.0
        half_m = max(math.hypot(*(steps[:, 0] + steps[:, 1])), math.hypot(*(steps[:, 0] - steps[:, 1]))) / 2.0
        return TerrainPatch(self, centre, reach_m, faces, edges, middles, half_m, bool(borders < reach_m))


@dataclass(frozen=True, eq=False)
class _Faces:
    """Triangles as linear maps of (north, east, up, 1) about the patch's centre."""

    maps: Floats
    """(4, 3, f): signed distance from the plane, and the two barycentric coordinates along its sides."""
    centres: Floats
    """(3, f)"""
    radii_m: Floats
    """(f,)"""


@dataclass(frozen=True, eq=False)
class _Edges:
    """Sides of triangles about the patch's centre."""

    maps: Floats
    """(5, 2, e), of (north, east, up, 1, squared distance from the centre): how far along, squared distance to start."""
    squares_m2: Floats
    """(e,) squared lengths"""
    centres: Floats
    """(3, e)"""
    radii_m: Floats
    """(e,)"""


@dataclass(frozen=True, eq=False)
class TerrainPatch:
    """The part of a `Terrain` within reach_m of a centre."""

    terrain: Terrain
    centre: Ned
    reach_m: float
    _faces: _Faces
    _edges: _Edges
    _unknown_ne_m: Floats
    """(u, 2) middles of the cells without data, about the centre."""
    _unknown_radius_m: float
    _border: bool
    """The end of the grid is within reach."""

    @property
    def sigma_m(self) -> float:
        return self.terrain.sigma_m

    @property
    def slope(self) -> float:
        return self.terrain.slope

    def near(self, centre: Ned, reach_m: float) -> TerrainPatch:
        """Another patch of the same terrain."""
        return self.terrain.near(centre, reach_m)

    def agl_m(self, points_ned_m: Floats) -> Floats:
        """(n,) vertical height of (n, 3) points above the surface; NaN where there is no data."""
        return self.terrain.agl_m(points_ned_m)

    def clearance_m(self, points_ned_m: Floats, agl_m: Floats | None = None) -> Floats:
        """(n,) distance of (n, 3) points to the known surface; negative beneath it, NaN over cells without data.

        Never more than what the patch can vouch for: reach_m less the point's distance from the centre.
        agl_m: these points' heights, if the caller has them already.
        """
        agl_m = self.agl_m(points_ned_m) if agl_m is None else agl_m
        about = points_ned_m - self.centre
        about[:, 2] *= -1.0
        squares = (about * about).sum(axis=1)
        distance = np.maximum(self.reach_m - np.sqrt(squares), 0.0)
        if self._faces.radii_m.size and np.isfinite(squares).all():
            distance = np.minimum(distance, self._surface_m(about, squares))
        return np.asarray(np.copysign(distance, agl_m) + 0.0 * agl_m)

    def unknown_m(self, points_ned_m: Floats) -> Floats:
        """(n,) horizontal distance of (n, 3) points to where the model has no data; at most what the patch vouches for."""
        about = points_ned_m[:, :2] - self.centre[:2]
        distance = np.maximum(self.reach_m - np.sqrt((about * about).sum(axis=1)), 0.0)
        if self._border:
            cells = self.terrain._cells
            place = (points_ned_m[:, :2] - self.terrain.corner_ne_m) @ cells.T
            last = np.array(self.terrain.heights_amsl_m.shape) - 1.0
            inside = np.minimum(place, last - place) / np.hypot(cells[:, 0], cells[:, 1])
            distance = np.minimum(distance, np.maximum(inside.min(axis=1), 0.0))
        if len(self._unknown_ne_m):
            apart = about[:, None, :] - self._unknown_ne_m[None, :, :]
            nearest = np.sqrt((apart * apart).sum(axis=2).min(axis=1)) - self._unknown_radius_m
            distance = np.minimum(distance, np.maximum(nearest, 0.0))
        return np.asarray(distance)

    def _surface_m(self, about: Floats, squares: Floats) -> Floats:
        """(n,) distance to the nearest triangle; about: (n, 3) north, east, up from the centre."""
        faces, edges = self._faces, self._edges
        # What can be nearest to any of these points: bounding balls against the nearest centre of a triangle.
        middle = (about.min(axis=0) + about.max(axis=0)) / 2.0
        offset = about - middle
        twice_m = 2.0 * math.sqrt(float((offset * offset).sum(axis=1).max()))
        to_faces = _from(middle, faces.centres)
        at_most_m = float(to_faces.min()) + twice_m
        face = np.flatnonzero(to_faces - faces.radii_m <= at_most_m)
        plane_u_v = np.empty((len(about), 5))
        plane_u_v[:, :3] = about
        plane_u_v[:, 3] = 1.0
        plane_u_v[:, 4] = squares
        found = (plane_u_v[:, :4] @ faces.maps[:, :, face].reshape(4, -1)).reshape(len(about), 3, -1)
        u, v = found[:, 1], found[:, 2]
        over = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0)
        nearest = np.where(over, np.abs(found[:, 0]), np.inf).min(axis=1)
        if edges.radii_m.size:
            edge = np.flatnonzero(_from(middle, edges.centres) - edges.radii_m <= at_most_m)
            along = (plane_u_v @ edges.maps[:, :, edge].reshape(5, -1)).reshape(len(about), 2, -1)
            s = along[:, 0]
            t = np.minimum(np.maximum(s, 0.0), 1.0)
            square = (along[:, 1] + edges.squares_m2[edge] * (t * (t - 2.0 * s))).min(axis=1)
            nearest = np.minimum(nearest, np.sqrt(np.maximum(square, 0.0)))
        return np.asarray(nearest)


def _from(point: Floats, centres: Floats) -> Floats:
    """(k,) distances from a (3,) point to (3, k) centres."""
    apart = centres - point[:, None]
    return np.asarray(np.sqrt((apart * apart).sum(axis=0)))


def _window(middle: float, half: float, count: int) -> tuple[int, int]:
    """First and one past the last of the nodes whose cells lie within half (in nodes) of middle; maybe none."""
    if not math.isfinite(middle + half):
        return 0, 0 if math.isnan(middle + half) else count
    first = max(0, math.floor(middle - half))
    last = min(count, math.ceil(middle + half) + 1)
    return (first, last) if first < last - 1 else (0, 0)


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


def _plane(up_m: float) -> tuple[_Faces, _Edges]:
    """An endless horizontal plane at up_m above the centre: one face that every point is over."""
    maps = np.zeros((4, 3, 1))
    maps[2, 0, 0], maps[3, 0, 0] = 1.0, -up_m
    faces = _Faces(maps, np.array([[0.0], [0.0], [up_m]]), np.array([np.inf]))
    return faces, _Edges(np.zeros((5, 2, 0)), np.zeros(0), np.zeros((3, 0)), np.zeros(0))


def _elements(nodes: Floats, reach_m: float) -> tuple[_Faces, _Edges]:
    """The triangles and their sides within reach_m of the middle, from (i, j, 3) nodes about it."""
    n00, n10 = nodes[:-1, :-1].reshape(-1, 3), nodes[1:, :-1].reshape(-1, 3)
    n01, n11 = nodes[:-1, 1:].reshape(-1, 3), nodes[1:, 1:].reshape(-1, 3)
    a = np.concatenate((n00, n00)).T
    b = np.concatenate((n10, n11)).T
    c = np.concatenate((n11, n01)).T
    # A cell with one unknown corner is unknown as a whole: both of its triangles go.
    unknown = np.isnan(n01[:, 2] + n10[:, 2])
    centres = (a + b + c) / 3.0
    radii = np.sqrt(np.maximum(_square(a - centres), np.maximum(_square(b - centres), _square(c - centres))))
    keep = np.sqrt(_square(centres)) - radii <= reach_m
    keep &= ~np.concatenate((unknown, unknown))
    a, b, c, centres, radii = a[:, keep], b[:, keep], c[:, keep], centres[:, keep], radii[keep]
    ab, ac = b - a, c - a
    normal = _cross(ab, ac)
    square = _square(normal)
    maps = np.empty((4, 3, a.shape[1]))
    for k, direction in enumerate((normal / np.sqrt(square), _cross(ac, normal) / square, _cross(normal, ab) / square)):
        maps[:3, k] = direction
        maps[3, k] = -(direction * a).sum(axis=0)
    faces = _Faces(maps, centres, radii)

    starts = np.concatenate((nodes[:-1].reshape(-1, 3), nodes[:, :-1].reshape(-1, 3), n00)).T
    ends = np.concatenate((nodes[1:].reshape(-1, 3), nodes[:, 1:].reshape(-1, 3), n11)).T
    middles = (starts + ends) / 2.0
    halves = np.sqrt(_square(ends - starts)) / 2.0
    keep = np.sqrt(_square(middles)) - halves <= reach_m
    starts, ends, middles, halves = starts[:, keep], ends[:, keep], middles[:, keep], halves[keep]
    sides = ends - starts
    squares = _square(sides)
    along = np.empty((5, 2, starts.shape[1]))
    along[:3, 0] = sides / squares
    along[3, 0] = -(sides * starts).sum(axis=0) / squares
    along[4, 0] = 0.0
    along[:3, 1] = -2.0 * starts
    along[3, 1] = _square(starts)
    along[4, 1] = 1.0
    return faces, _Edges(along, squares, middles, halves)


def _square(vectors: Floats) -> Floats:
    """(k,) squared lengths of (3, k) vectors."""
    return np.asarray((vectors * vectors).sum(axis=0))


def _cross(a: Floats, b: Floats) -> Floats:
    """(3, k) cross products."""
    return np.stack((a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]))
