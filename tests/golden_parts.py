"""What the parts of the rules answer by themselves, where a whole decision would not show it: which lengths are tried, what is
left out of a situation, distances of pieces, plans by the tenth of a second.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import shapely

from m3r_app.arbiter.signals import SignalReader
from safety.confidence import underground_m
from safety.constraints import nearby
from safety.estimate import Noise, adapted, too_noisy
from safety.findings import between, fine_points, gaps_m
from safety.frames import bearing_deg, operator_direction, wrap_deg
from safety.length_search import longest_passing
from safety.limits import Limits
from safety.monitor import stopping_path
from safety.planner import full_length_m, length_reaching_m, plan_return, plan_scan, plan_translation, spaced, swept
from safety.polygons import Polygons
from safety.properties import Watch
from safety.spatial import profile
from safety.supervisor import over_in_time
from safety.temporal import monitor
from safety.vocabulary import Ned, Neighbours, Plan, Primitive, Profile, ReservedVolume
from safety.volumes import segment_distance_m, swept_volume, volumes_meet
from tests.golden_scenes import hills, situations
from tests.golden_text import line
from tests.m3r_app.test_arbiter import flying, held
from tests.safety.test_length_search import SHAPES

LIMITS = Limits()


def searches() -> Iterator[str]:
    """Which lengths are tried, one after another."""
    for name, shape in SHAPES.items():
        for limit_m in (0.05, 0.1, 0.104, 0.23, 0.5, 0.777, 0.96, 0.9999):
            tried: list[float] = []

            def attempt(
                length_m: float,
                tried: list[float] = tried,
                shape: Callable[[float], float] = shape,
                limit_m: float = limit_m,
            ) -> tuple[bool, float]:
                tried.append(length_m)
                return length_m <= limit_m, shape(length_m - limit_m)

            found = longest_passing(attempt, 0.1, 1.0, (False, shape(1.0 - limit_m)), 0.01)
            yield line(f"search-{name}-{limit_m}", str(len(tried)), found, tried)


def plans() -> Iterator[str]:
    """Every primitive, by the fifth of a second, from places that face away, near the operator and straight above."""
    chance = random.Random(3)
    for number in range(40):
        start = Ned(9.0 * chance.random() - 4.0, 9.0 * chance.random(), -9.0 * chance.random())
        operator, yaw_deg = Ned(-5.0 * chance.random(), 1.0, 0.0), 360.0 * chance.random() - 180.0
        primitive = list(Primitive)[number % len(Primitive)]
        if primitive.is_scan:
            plan = plan_scan(primitive, start, yaw_deg, operator, (360.0, 140.0)[number % 2], LIMITS)
        elif primitive is Primitive.RETURN:
            plan = plan_return(start, yaw_deg, operator, start.plus(Ned(1.0, -2.0, 0.5)), LIMITS, yaw_deg + 90.0)
        else:
            plan = plan_translation(primitive, start, yaw_deg, operator, chance.random(), LIMITS, 1.0 + number % 3)
        yield line(f"plan-{number}", primitive.value, plan, swept(plan, LIMITS), _flown(plan))
        volume = swept_volume(plan, "red", 0.2, 5.0, LIMITS)
        leases = [ReservedVolume("b", start, start, 0.1, 5.0 + at_s, 60.0) for at_s in (9.0, 10.5, 14.0, 25.0)]
        about = next(situations())
        cut = [
            over_in_time(plan, replace(about, now_s=5.0, reservations=(lease,)), LIMITS).max_duration_s
            for lease in leases
        ]
        yield line(f"volume-{number}", "", volume, [volumes_meet(volume, lease) for lease in leases], cut)
    for speed_m_s in (0.1, 0.25, 0.5, 2.0):
        lengths = [length_reaching_m(0.05 + 0.2 * i, speed_m_s, LIMITS) for i in range(12)]
        yield line(
            f"reaching-{speed_m_s}",
            "",
            lengths,
            [spaced(size) for size in lengths],
            full_length_m(Primitive.ASCEND, LIMITS),
        )


def _flown(plan: Plan) -> list[tuple[float, ...]]:
    times = [0.2 * i - 0.2 for i in range(int(plan.duration_s / 0.2) + 4)]
    return [(*plan.position(t), *plan.led(t, 0.8), plan.yaw_deg(t), plan.move.speed_at(t)) for t in times]


def pieces() -> Iterator[str]:
    """Distances of segments, polygons and ground; angles; profiles at their corners."""
    chance = np.random.default_rng(11)
    for number in range(24):
        ends = [Ned(*each) for each in chance.uniform(-2.0, 2.0, (4, 3)).round(number % 3).tolist()]
        if number % 4 == 3:
            ends[1] = ends[0]
        yield line(
            f"segments-{number}", "", segment_distance_m(*ends), segment_distance_m(ends[2], ends[3], ends[0], ends[0])
        )
        profile_of = Profile(*(0.05 + chance.uniform(0.0, 2.0, 3)).tolist())
        times = [profile_of.duration_s * i / 9.0 for i in range(-1, 11)]
        told = [
            (profile_of.at(t), profile_of.speed_at(t), profile_of.time_at(profile_of.distance * i / 10.0))
            for i, t in enumerate(times)
        ]
        yield line(f"profile-{number}", "", told, profile_of.duration_s)
    angles = [-720.0, -540.0, -180.0, -179.0, 0.0, 90.0, 180.0, 181.0, 360.0, 725.0]
    yield line(
        "angles",
        "",
        [wrap_deg(a) for a in angles],
        [bearing_deg(Ned(0.0, 0.0, 0.0), Ned(math.cos(a), math.sin(a), 1.0)) for a in range(6)],
    )
    moves = [p for p in Primitive if not p.is_scan and p is not Primitive.RETURN]
    yield line("directions", "", [operator_direction(p, Ned(0.3, 0.4, 0.0), Ned(3.0, -2.0, -5.0)) for p in moves])
    shapes = [
        shapely.box(0, 0, 3, 2),
        shapely.Polygon([(5, 5), (9, 6), (7, 9), (6, 7)], [[(6.5, 6.5), (7, 6.5), (7, 7)]]),
    ]
    polygons = Polygons.of(shapes)
    for number in range(12):
        centre, reach_m = Ned(*chance.uniform(-2.0, 10.0, 2).tolist(), 0.0), float(chance.uniform(0.2, 6.0))
        for deep in (True, False):
            cut, which = polygons.near(centre, reach_m, np.array([True, number % 2 == 0]), deep=deep)
            yield line(f"polygons-{number}-{deep}", str(len(which)), cut, which, cut.may_end_within(centre, reach_m))
    ground = hills()
    for number in range(10):
        centre = Ned(*chance.uniform((-9, -9, -8), (9, 9, -1)).tolist())
        patch = ground.near(centre, 1.0 + number, Ned(0.5, 0.2, 0.3))
        points = np.asarray(centre) + chance.uniform(-1.5, 1.5, (9, 3))
        kept = (patch._cells.maps.shape[2], patch._unknown_ne_m.shape[1], patch.border, patch.is_complete)
        yield line(
            f"ground-{number}", str(kept[0]), kept, patch.clearance_m(points), patch.unknown_m(points), ground.slope
        )


def cut_down() -> Iterator[str]:
    """What of a situation is looked at on a path; how a drone stops; what noise widens."""
    for number, situation in enumerate(situations()):
        if number % 3 == 0:
            path = stopping_path(situation, LIMITS) if number % 2 else swept(plan_return(
                situation.vehicle.position, 10.0, situation.operator.position, situation.anchor.position, LIMITS), LIMITS)  # fmt: skip
            scene, world = nearby(situation, path, LIMITS), situation.world
            fence, terrain = scene.world.geofence, scene.world.terrain
            assert world.terrain is not None and terrain is not None
            told = (
                scene.neighbours.names, scene.world.obstacles.names, fence and fence.polygon.lengths_m, fence and fence.all_inside,
                getattr(terrain, "reach_m", None), getattr(terrain, "half", None),
                underground_m(situation.vehicle, 0.1, world.terrain.slope, LIMITS),
            )  # fmt: skip
            yield line(f"nearby-{number}", str(len(scene.neighbours)), told, path, fine_points(path), gaps_m(path), profile(path, terrain),
                       between(profile(path, terrain)[1], gaps_m(path)))  # fmt: skip
    for size in (0.0, 0.01, 0.1, 0.2, 0.6):
        noises = [
            Noise(Ned(size * (i == 0), 0.0, 0.0), size * (i == 1), size * (i == 2), size * (i == 3)) for i in range(4)
        ]
        yield line(f"noise-{size}", "", [adapted(LIMITS, n) for n in noises], [too_noisy(n, LIMITS) for n in noises])
    yield line("nobody", "", Neighbours.none(3.0))


def properties() -> Iterator[str]:
    """Formulas over a trace by chance, and the properties over two flights."""
    for text in (
        "Y a & !b | b -> a",
        "O[0,2] a",
        "H[1,3] (a >= b)",
        "a S b",
        "O (a > 3)",
        "H a <= 2",
        "(a < b) -> O[0,0] a",
        "Y Y a",
        "Y O[0,1] a",
        "O[0,3] O[0,1] a",
        "O[0,1] a & H[0,2] b",
        "a S O[0,1] b",
        "!O[1,2] a | b",
    ):
        chance, made = random.Random(5), monitor(text)
        trace = [
            (0.7 * i, {"a": round(8.0 * chance.random() - 4.0, 2), "b": round(4.0 * chance.random(), 1)})
            for i in range(24)
        ]
        yield line(f"formula-{text}", str(sorted(made.names)), [made.update(t_s, signals) for t_s, signals in trace])
    for table in (flying(), held()):
        reader, watch = SignalReader(LIMITS), Watch()
        for number, (_, event, _, effects) in enumerate(table.steps):
            watch.update(0.1 * number, reader.read(event, effects))
        yield line(f"properties-{len(table.steps)}", "", watch.results())


PARTS: tuple[Callable[[], Iterator[str]], ...] = (searches, plans, pieces, cut_down, properties)
