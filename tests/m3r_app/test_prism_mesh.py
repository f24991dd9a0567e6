"""An obstacle as triangles covers its walls and its roof, once."""

from __future__ import annotations

import numpy as np
import pytest

from m3r_app.record.prism_mesh import prism_mesh


def test_a_box_has_the_area_of_its_walls_and_roof() -> None:
    points, triangles = prism_mesh([(0.0, 0.0), (2.0, 0.0), (2.0, 5.0), (0.0, 5.0)], base_m=1.0, top_m=4.0)
    assert points[0] == (0.0, 0.0, 1.0)
    assert points[6] == (5.0, 2.0, 4.0), "east comes first, then north"
    a, b, c = (np.array([points[t[i]] for t in triangles]) for i in range(3))
    area_m2 = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()
    assert area_m2 == pytest.approx(2 * (2 + 5) * 3 + 2 * 5)
