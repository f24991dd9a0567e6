"""Worlds and situations for the golden cases: by chance, but the same in every run."""

from __future__ import annotations

import math
import random
from collections.abc import Iterator

import numpy as np
import shapely

from safety.geofence import Geofence
from safety.obstacles import Obstacles
from safety.situation import Situation, World
from safety.terrain import Terrain
from safety.vocabulary import Anchor, Ned, Operator, ReservedVolume
from tests.safety.scene import NOW_S, sky, vehicle


def hills() -> Terrain:
    """12 x 11 nodes, turned, about the origin, from -3 m to 3 m; a hole in a corner."""
    rows, cols = np.arange(12.0)[:, None], np.arange(11.0)
    heights = 2.0 * np.sin(0.9 * rows) + np.cos(1.3 * cols) - 0.1 * rows
    heights[10, 2] = np.nan
    steps = ((3.2, -2.4), (2.4, 3.2))
    middle = np.array(steps) @ np.array((5.5, 5.0))
    return Terrain(heights, (-middle[0], -middle[1]), steps, 0.2, 0.0)


def worlds() -> list[World]:
    boxes = [shapely.box(12.2, -3.0, 13.0, 3.0), shapely.Polygon([(6.0, -8.0), (9.0, -4.5), (8.0, -9.0)])]
    yard = shapely.Polygon(
        [(-14.0, -15.0), (17.0, -13.0), (16.0, 14.0), (-13.0, 15.0)], [[(2.0, 6.0), (6.0, 6.0), (6.0, 9.0), (2.0, 9.0)]]
    )
    built = Obstacles.of(["shed", "tree {1}"], boxes, [-2.0, 0.0], [12.0, 9.0], 0.0)
    return [
        World(Terrain.flat(0.0, 0.1, 0.0), Obstacles.none(), None),
        World(Terrain.flat(-1.0, 0.2, 5.0), built, Geofence.of(yard, 2.0, 22.0, 5.0)),
        World(hills(), built, None),
        World(hills(), Obstacles.none(), Geofence.of(yard, -math.inf, math.inf, 0.0)),
    ]


def situations() -> Iterator[Situation]:
    """By chance: near the ground, walls, borders and others, with accuracies good and bad."""
    chance = random.Random(7)

    def within(low: float, high: float) -> float:
        return low + (high - low) * chance.random()

    def ned(size: float) -> Ned:
        return Ned(within(-size, size), within(-size, size), within(-0.3 * size, 0.3 * size))

    for number in range(80):
        place = (
            Ned(within(6.5, 10.5), within(-5.0, 4.0), -within(3.0, 9.0))
            if number % 4
            else Ned(within(-12.0, 14.0), within(-13.0, 12.0), -within(4.0 if number % 2 else 7.0, 13.0))
        )
        now_s, sigma_m = NOW_S, (0.05, 0.1, 0.3, 1.2)[number % 4]
        state = vehicle(
            at_s=now_s - within(0.0, 0.3), position=place, velocity=ned(0.04), yaw_deg=within(-180.0, 180.0),
            sigma_h_m=sigma_m, sigma_v_m=0.7 * sigma_m, battery=(None, 0.5)[number % 2],
        )  # fmt: skip
        blue, green = place.plus(ned(6.0)), place.plus(ned(9.0))
        others = sky(
            ("blue", blue, ned(1.2), 0.2, now_s - within(0.0, 0.5)), ("green", green, ned(3.0), 0.1, now_s - within(0.0, 1.5)),
            feed_at_s=now_s - within(0.0, 0.6),
        )  # fmt: skip
        near = place.plus(ned(4.0))
        lease = ReservedVolume("green", near, near.plus(ned(2.0)), 0.8, now_s + within(-5.0, 15.0), now_s + 20.0)
        anchor = place.plus(ned(4.0 if number % 8 == 1 else 0.5))
        yield Situation(
            now_s, state, Operator(Ned(-9.0, within(-3.0, 3.0), 0.0), 0.3), Anchor(anchor, within(-180.0, 180.0), now_s - 20.0),
            place.plus(ned(48.0 if number % 16 == 5 else 9.0)), now_s - 60.0, others if number % 3 == 2 else sky(feed_at_s=now_s),
            (lease,) if number % 4 == 2 else (), worlds()[number % 4 if number % 5 else 0], number % 13 != 3,
        )  # fmt: skip
