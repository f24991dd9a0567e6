"""An obstacle as triangles, for the scene in Foxglove and for the report."""

from __future__ import annotations

from collections.abc import Sequence

Point = tuple[float, float, float]
Triangle = tuple[int, int, int]


def prism_mesh(
    corners_ne_m: Sequence[Sequence[float]], base_m: float, top_m: float
) -> tuple[list[Point], list[Triangle]]:
    """Walls and roof of a prism: its points (east, north, up in metres), and three of them by index for each triangle.

    The roof is a fan about the first corner, so it is exact for convex outlines.
    """
    n = len(corners_ne_m)
    points = [(east, north, height_m) for height_m in (base_m, top_m) for north, east in corners_ne_m]
    walls = [triangle for a in range(n) for b in ((a + 1) % n,) for triangle in ((a, b, a + n), (b, b + n, a + n))]
    roof = [(n, n + a, n + a + 1) for a in range(1, n - 1)]
    return points, walls + roof
