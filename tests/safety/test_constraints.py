"""The registry of constraints, and that cutting the world down to what is near changes no decision."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from safety.constraints import RULES, PathRule, findings, nearby
from safety.findings import SPARE_M, amount, once
from safety.geofence import Geofence
from safety.obstacles import Obstacles
from safety.planner import plan_translation, swept
from safety.requirements import REQUIREMENTS
from safety.situation import Situation, World, near_as_before
from safety.terrain import Terrain
from safety.vocabulary import Command, ManeuverRequest, Modality, Ned, Neighbours, Operator, Path, Primitive
from tests.safety.scene import LIMITS, NOW_S, START, hover, situation, square_fence, straight, vehicle, wall, world

NAMES = {
    "terrain_clearance", "agl", "obstacle_clearance", "separation", "reservation", "workspace", "session", "geofence",
    "envelope", "standoff", "input_confidence", "localization", "terrain_confidence", "neighbour_age", "authority",
}  # fmt: skip
HARD = {
    "terrain_clearance", "agl", "obstacle_clearance", "separation", "workspace", "session", "geofence", "envelope",
    "standoff",
}  # fmt: skip
Cutting = Callable[[World, Ned, float, Ned], World]
REQUEST = ManeuverRequest("1", Command.GO_FORWARD, Modality.VOICE, 0.9, NOW_S, NOW_S)


def judged(path: Path, scene: Situation) -> dict[str, object]:
    plan = plan_translation(Primitive.MOVE_FORWARD, START, 180.0, scene.operator.position, 1.0, LIMITS)
    return {f.constraint: f for f in findings(path, scene, LIMITS, plan, REQUEST)}


def test_the_registry_is_the_contracts_list() -> None:
    assert {rule.name for rule in RULES} == NAMES
    assert len(RULES) == len(NAMES)
    assert {rule.name for rule in RULES if rule.constraint.hard} == HARD


def test_every_finding_names_its_rule_and_requirements_that_exist() -> None:
    everything = situation(world=world(obstacles=wall(40.0), geofence=square_fence()))
    nothing = replace(
        everything,
        world=world(terrain=None),
        authority=False,
        neighbours=Neighbours.none(-math.inf),
        vehicle=vehicle(sigma_h_m=math.nan, sigma_v_m=math.nan),
    )
    path = straight(START.plus(Ned(1.0, 0.0, 0.0)))
    plan = plan_translation(Primitive.MOVE_FORWARD, START, 180.0, everything.operator.position, 1.0, LIMITS)
    for scene in (everything, nothing):
        found = findings(path, scene, LIMITS, plan, REQUEST)
        assert len(found) == len(RULES)
        for rule, finding in zip(RULES, found, strict=True):
            assert finding.constraint == rule.name
            assert finding.requirements == rule.constraint.requirements
            assert finding.text
            assert not finding.text.endswith(".")
            json.dumps(finding.margin, allow_nan=False)
        for name in {r for f in found for r in f.requirements}:
            assert name in REQUIREMENTS
    assert all(f.passed for f in findings(path, everything, LIMITS, plan, REQUEST))
    failing = {f.constraint for f in findings(path, nothing, LIMITS, plan, REQUEST) if not f.passed}
    assert failing == NAMES - {
        "envelope",
        "input_confidence",
        "separation",
        "reservation",
        "geofence",
        "obstacle_clearance",
    }


def test_rules_about_a_plan_or_a_request_are_left_out_without_one() -> None:
    found = findings(hover(), situation(), LIMITS)
    assert {f.constraint for f in found} == {r.name for r in RULES if isinstance(r, PathRule)}
    assert {f.constraint for f in findings(hover(), situation(), LIMITS, request=REQUEST)} == NAMES - {"envelope"}


def test_a_rule_can_be_switched_off() -> None:
    without = tuple(rule for rule in RULES if rule.name != "standoff")
    close = situation(operator=Operator(Ned(2.0, 0.0, 0.0), 0.0))
    path = straight(START.plus(Ned(1.0, 0.0, 0.0)))
    assert not all(f.passed for f in findings(path, close, LIMITS))
    assert all(f.passed for f in findings(path, close, LIMITS, rules=without))


def landscape(seed: int) -> Situation:
    """Hills, obstacles and a fence with holes, all close by, and where the drone is in it."""
    rng = np.random.default_rng(seed)
    heights = rng.uniform(0.0, 3.0, (60, 60))
    if seed % 3 == 0:
        heights[rng.integers(0, 60, 3), rng.integers(0, 60, 3)] = np.nan
    steps = ((0.8, -0.6), (0.6, 0.8))
    middle = np.array(steps) @ (29.5, 29.5)
    corners = rng.uniform(-20.0, 20.0, (5, 2))
    boxes = [shapely.box(n, e, n + rng.uniform(0.5, 6.0), e + rng.uniform(0.5, 6.0)) for n, e in corners]
    holes = [shapely.box(n, e, n + 4.0, e + 4.0) for n, e in rng.uniform(-20.0, 20.0, (3, 2))]
    fence = shapely.Point(0.0, 0.0).buffer(18.0).difference(shapely.union_all(holes))
    fence = max(fence.geoms, key=lambda g: g.area) if fence.geom_type == "MultiPolygon" else fence
    place = Ned(*rng.uniform((-8.0, -8.0, -9.0), (8.0, 8.0, -3.5)))
    return situation(
        vehicle=vehicle(position=place, sigma_h_m=rng.uniform(0.0, 0.5), sigma_v_m=rng.uniform(0.0, 0.5)),
        world=world(
            terrain=Terrain(heights, (-middle[0], -middle[1]), steps, 0.1, 0.0),
            obstacles=Obstacles.of(list("abcde"), boxes, rng.uniform(-1, 3, 5), rng.uniform(4, 9, 5), 0.0),
            geofence=Geofence.of(fence, 1.0, 12.0, 0.0),
        ),
    )


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 100_000),
    st.sampled_from([Primitive.MOVE_LEFT, Primitive.MOVE_FORWARD, Primitive.DESCEND]),
)
def test_cutting_the_world_down_changes_no_decision(seed: int, primitive: Primitive) -> None:
    scene = landscape(seed)
    full = swept(plan_translation(primitive, scene.vehicle.position, 0.0, Ned(-10.0, 0.0, 0.0), 1.0, LIMITS), LIMITS)
    near = nearby(scene, full, LIMITS)
    half = len(full.times_s) // 2
    for path in (full, Path(full.points_ned_m[:half], full.times_s[:half], full.along_track_tolerance_m)):
        whole, cut = judged(path, scene), judged(path, near)
        for name in NAMES:
            a, b = whole[name], cut[name]
            assert a.passed == b.passed, name
            if a.margin is None or b.margin is None:
                assert a.margin == b.margin, name
            elif a.margin < SPARE_M:
                assert b.margin == pytest.approx(a.margin, abs=1e-6), name
                assert a.text == b.text or name == "obstacle_clearance"
            else:
                assert b.margin >= SPARE_M - 1e-6, name


def test_looks_from_nearby_places_share_one_cut() -> None:
    """Those a few centimetres on, in the same box of the grid, see the very same terrain, and so does whoever looks there again later."""
    scene = landscape(1)
    here, there = Ned(0.3, 0.4, -5.2), Ned(0.35, 0.38, -5.25)
    first = near_as_before(scene.world, here, 5.3, Ned(0.1, 0.0, 0.0))
    assert near_as_before(scene.world, there, 5.6, Ned(0.2, 0.1, 0.0)) is first
    assert near_as_before(scene.world, Ned(5.3, 0.4, -5.2), 5.3, Ned(0.1, 0.0, 0.0)) is not first
    assert near_as_before(landscape(1).world, here, 5.3, Ned(0.1, 0.0, 0.0)) is not first


def test_what_cannot_be_located_is_not_cut_down() -> None:
    lost = situation(vehicle=vehicle(sigma_h_m=math.nan))
    assert nearby(lost, hover(), LIMITS) is lost
    nowhere = Path(np.full((2, 3), math.nan), np.array([0.0, 1.0]))
    assert nearby(situation(), nowhere, LIMITS) is not None
    assert not any(
        f.passed for f in findings(nowhere, situation(), LIMITS) if f.constraint in HARD and f.margin is not None
    )


@pytest.mark.parametrize(
    ("size", "text"),
    [
        (3.14, "3.1 m"),
        (0.1, "0.1 m"),
        (0.05, "0.05 m"),
        (0.001, "less than 0.01 m"),
        (-0.3, "0.3 m"),
        (0.0, "less than 0.01 m"),
    ],
)
def test_amounts_are_read_easily(size: float, text: str) -> None:
    assert amount(size) == text


def test_asking_once_means_the_same_objects() -> None:
    calls = []
    length = once(lambda what: calls.append(what) or len(what))
    first, same = [1, 2], [1, 2]
    assert [length(first), length(first), length(same), length(first)] == [2, 2, 2, 2]
    assert len(calls) == 3
