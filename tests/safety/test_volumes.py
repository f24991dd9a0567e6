"""Reserved volumes: what a plan needs, and whether two meet. R5, X10, X11."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from safety.planner import plan_translation, swept
from safety.vocabulary import Ned, Primitive, ReservedVolume
from safety.volumes import segment_distance_m, swept_volume, volumes_meet
from tests.safety.scene import LIMITS, START

points = st.builds(Ned, *[st.floats(-20.0, 20.0)] * 3)


@given(points, points, points, points)
def test_segment_distance_against_brute_force(p1: Ned, q1: Ned, p2: Ned, q2: Ned) -> None:
    shares = np.linspace(0.0, 1.0, 60)[:, None]
    first = np.asarray(p1) + shares * np.asarray(q1.minus(p1))
    second = np.asarray(p2) + shares * np.asarray(q2.minus(p2))
    brute = np.linalg.norm(first[:, None] - second[None], axis=2).min()
    found = segment_distance_m(p1, q1, p2, q2)
    coarse = (q1.minus(p1).norm + q2.minus(p2).norm) / 59.0
    assert found <= brute + 1e-6
    assert found >= brute - coarse - 1e-6
    assert found == pytest.approx(segment_distance_m(p2, q2, p1, q1), abs=1e-6)


@given(points, points)
def test_points_are_segments_too(p: Ned, q: Ned) -> None:
    assert segment_distance_m(p, p, q, q) == pytest.approx(p.minus(q).norm)


def volume(**changes: object) -> ReservedVolume:
    return replace(ReservedVolume("blue", Ned(0, 0, 0), Ned(10, 0, 0), 2.0, 0.0, 10.0), **changes)  # type: ignore[arg-type]


@pytest.mark.requirement("X6", "X10")
@pytest.mark.parametrize(("other", "meet"), [
    ({"start": Ned(5, 3.99, 0), "end": Ned(5, 9, 0)}, True),
    ({"start": Ned(5, 4.0, 0), "end": Ned(5, 9, 0)}, False),
    ({"from_s": 10.0, "until_s": 20.0}, True),
    ({"from_s": 10.01, "until_s": 20.0}, False),
    ({"start": Ned(math.nan, 90, 0)}, True),
    ({"start": Ned(90, 0, 0), "end": Ned(99, 0, 0), "radius_m": math.nan}, True),
    ({"from_s": math.nan}, True),
])  # fmt: skip
def test_meeting_in_space_and_time(other: dict[str, object], meet: bool) -> None:
    """X6: what is not finite meets everything."""
    assert volumes_meet(volume(), volume(**other)) is meet
    assert volumes_meet(volume(**other), volume()) is meet


@pytest.mark.requirement("X10", "X11")
def test_a_plans_volume_holds_its_swept_path_and_time() -> None:
    plan = plan_translation(Primitive.MOVE_LEFT, START, 180.0, Ned(-10.0, 0.0, 0.0), 1.0, LIMITS)
    made = swept_volume(plan, "red", 0.2, 50.0, LIMITS)
    for point in swept(plan, LIMITS).points_ned_m:
        at = Ned(*map(float, point))
        apart = segment_distance_m(made.start, made.end, at, at)
        assert apart + LIMITS.tracking_m + LIMITS.sigma_k * 0.2 + LIMITS.separation_m / 2 <= made.radius_m + 1e-9
    assert (made.from_s, made.until_s) == (50.0, 50.0 + plan.max_duration_s)
