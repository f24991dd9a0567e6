"""What seldom happens to the rules, and must come out right all the same."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from safety.constraints import RULES
from safety.geofence import Geofence
from safety.planner import full_length_m, plan_scan, plan_translation, swept
from safety.separation import neighbour_age, reservation
from safety.spatial import geofence
from safety.supervisor import Intent, slower
from safety.terrain import Terrain
from safety.vocabulary import Ned, Path, Primitive, ReservedVolume
from tests.safety.scene import LIMITS, NOW_S, START, hover, situation, sky, square_fence, straight, world


def test_a_scan_has_no_length_and_no_slower_one_is_offered() -> None:
    assert full_length_m(Primitive.SCAN_LEFT, LIMITS) == 0.0
    assert slower(None, Intent(Primitive.SCAN_LEFT, 360.0), situation(), LIMITS, RULES) is None


@pytest.mark.requirement("X11")
def test_a_plan_that_coasts_no_farther_is_swept_to_its_end() -> None:
    plan = plan_translation(Primitive.MOVE_LEFT, START, 0.0, Ned(10.0, 0.0, 0.0), 1.0, LIMITS)
    path = swept(replace(plan, stop_m=0.0), LIMITS)
    assert tuple(path.points_ned_m[-1]) == pytest.approx(tuple(plan.goal))


def test_a_scan_is_swept_where_it_stands() -> None:
    path = swept(plan_scan(Primitive.SCAN_LEFT, START, 0.0, Ned(10.0, 0.0, 0.0), 360.0, LIMITS), LIMITS)
    assert (path.points_ned_m == np.array(START)).all()


@pytest.mark.requirement("X6", "X10")
def test_volumes_cannot_be_judged_on_a_path_without_times() -> None:
    volume = ReservedVolume("blue", START, START, 1.0, NOW_S, NOW_S + 10.0)
    timeless = Path(np.array([START, START.plus(Ned(1.0, 0.0, 0.0))]), np.array([0.0, math.nan]))
    found = reservation(replace(timeless, until_s=math.inf), situation(reservations=(volume,)), LIMITS)
    assert not found.passed
    assert found.text == "reserved volumes cannot be judged: the path has no times"


@pytest.mark.requirement("R11", "X6")
def test_a_neighbour_whose_time_is_unknown_could_be_anywhere() -> None:
    found = neighbour_age(
        hover(), situation(neighbours=sky(("blue", START, Ned(0.0, 0.0, 0.0), 0.0, math.nan))), LIMITS
    )
    assert not found.passed
    assert found.text == "blue: the time of its state is unknown"


@pytest.mark.requirement("G4")
def test_a_fence_without_floor_and_ceiling_bounds_the_sides_alone() -> None:
    fence = replace(square_fence(), floor_amsl_m=-math.inf, ceiling_amsl_m=math.inf)
    high = straight(START.plus(Ned(1.0, 0.0, -40.0)))
    assert isinstance(fence, Geofence)
    assert geofence(high, situation(world=world(geofence=fence)), LIMITS).passed


@pytest.mark.requirement("R3")
def test_patches_of_terrain() -> None:
    ground = Terrain(np.zeros((5, 5)), (-2.0, -2.0), ((1.0, 0.0), (0.0, 1.0)), 0.1, 0.0)
    patch = ground.near(START, 3.0)
    assert patch.near(Ned(0.0, 0.0, -1.0), 3.0).terrain is ground
    assert ground.near(Ned(math.nan, 0.0, -1.0), 3.0).border
    far = ground.near(Ned(0.0, 0.0, -1.0), 3.0).clearance_m(np.array([(0.0, 0.0, -1.0), (0.2, 0.2, -1.1)]))
    assert far == pytest.approx([1.0, 1.1])
