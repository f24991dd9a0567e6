"""The snapshot from above and from the side, as lines and signs in metres. Pure: no terminal, no colours.

From above: x east, y north. From the side: x along the line from the operator to the drone, y height above the operator.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from contourpy import contour_generator

from safety.vocabulary import Ned

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from m3r_app.snapshot import Craft, Snapshot
    from safety.polygons import Polygons
    from safety.situation import World

    Floats = NDArray[np.float64]

SAMPLES = (48, 40)
"""Where the ground is looked at, across and up."""
CONTOURS = 8
"""About so many are drawn."""
CIRCLE = np.linspace(0.0, 2.0 * math.pi, 49)
HEADING_M = 0.12
"""Length of the line that shows the heading, as a share of the reach."""
STALE_S = 1.0
"""A neighbour older than that is drawn as such (tau_max's default)."""
NEAR_PLANE_M = 8.0
"""A drone this near to the plane of the side view is drawn in it."""
BOTH_M = 30.0
"""From nearer than this the operator is kept in view."""
FARTHEST_M = 80.0
"""No view reaches farther."""
ARROWS = "↑↗→↘↓↙←↖"


@dataclass(frozen=True, slots=True)
class Window:
    """What is in view, metres."""

    x_min: float
    x_max: float
    y_min: float
    y_max: float


@dataclass(frozen=True, slots=True)
class Stroke:
    """A line. kind: what it is, which decides its looks. name: whose, a drone's colour, or empty."""

    kind: str
    xs: Floats
    ys: Floats
    name: str = ""


@dataclass(frozen=True, slots=True)
class Mark:
    """A sign at a place."""

    kind: str
    x: float
    y: float
    sign: str
    name: str = ""


@dataclass(frozen=True, slots=True)
class Drawing:
    """One view. caption: what the signs mean, and how old the neighbours are."""

    window: Window
    strokes: tuple[Stroke, ...]
    marks: tuple[Mark, ...]
    caption: str


@dataclass(frozen=True, slots=True)
class Asked:
    """The last move that was decided, for the part of it that was not granted. Metres; None where there are none."""

    requested_m: float | None
    granted_m: float | None


def from_above(snapshot: Snapshot, reach_m: float, aspect: float, asked: Asked | None = None) -> Drawing:
    """The map. reach_m: half the height in view; aspect: width over height of the view."""
    centre = _focus(snapshot, reach_m)
    window = Window(
        centre.east - reach_m * aspect, centre.east + reach_m * aspect, centre.north - reach_m, centre.north + reach_m
    )
    world, state = snapshot.setup.world, snapshot.state
    strokes = list(_ground_from_above(world, window))
    strokes += [Stroke("fence", xs, ys) for xs, ys in _outlines(world.geofence.polygon if world.geofence else None)]
    strokes += [Stroke("obstacle", xs, ys) for xs, ys in _outlines(world.obstacles.polygons)]
    marks: list[Mark] = []
    session = state.session
    if session is not None and session.anchor is not None:
        place, radius_m = session.anchor.position, state.limits.workspace_m
        strokes.append(
            Stroke("anchor", place.east + radius_m * np.sin(CIRCLE), place.north + radius_m * np.cos(CIRCLE))
        )
        marks.append(Mark("anchor", place.east, place.north, "+"))
    for kind, line in _plans(snapshot, asked):
        strokes.append(Stroke(kind, line[:, 1], line[:, 0]))
    operator = snapshot.setup.operator
    if operator is not None:
        marks.append(Mark("operator", operator.position.east, operator.position.north, "O"))
    for one in _placed(snapshot):
        place = one.position or Ned(0.0, 0.0, 0.0)
        kind = _kind(one, snapshot)
        if kind != "drone":
            spread_m = max(0.0, one.age_s) * (one.velocity.norm if one.velocity else 0.0)
            if spread_m > 0.05 * reach_m:
                strokes.append(
                    Stroke(
                        "spread",
                        place.east + spread_m * np.sin(CIRCLE),
                        place.north + spread_m * np.cos(CIRCLE),
                        one.name,
                    )
                )
            marks.append(Mark(kind, place.east, place.north, one.name[:1].upper(), one.name))
        else:
            length_m, yaw = HEADING_M * reach_m, math.radians(one.yaw_deg)
            if math.isfinite(yaw):
                ahead = np.array([0.0, length_m])
                strokes.append(
                    Stroke("heading", place.east + ahead * math.sin(yaw), place.north + ahead * math.cos(yaw), one.name)
                )
            marks.append(Mark("drone", place.east, place.north, _arrow(one.yaw_deg), one.name))
    return Drawing(window, tuple(strokes), tuple(marks), caption(snapshot))


def from_side(snapshot: Snapshot, reach_m: float, aspect: float, asked: Asked | None = None) -> Drawing:
    """Height against the ground, in the vertical plane through operator and drone (or along what is being flown)."""
    world, state = snapshot.setup.world, snapshot.state
    drone = snapshot.paired
    here = drone.position if drone is not None and drone.position is not None else _focus(snapshot, reach_m)
    operator = snapshot.setup.operator.position if snapshot.setup.operator is not None else Ned(0.0, 0.0, 0.0)
    origin, along = _plane(snapshot, operator, here)

    def at(place: Ned) -> tuple[float, float]:
        return _in_plane(place, origin, along)

    x, height_m = at(here)[0], _height_m(world, here)
    # The ground below stays in view.
    reach_m = max(reach_m, 0.5 * height_m + 2.0)
    y = -here.down - 0.5 * height_m
    step_m = reach_m / 4.0
    x, y = round(x / step_m) * step_m, round(y / step_m) * step_m
    window = Window(x - reach_m * aspect, x + reach_m * aspect, y - reach_m, y + reach_m)
    strokes = list(_ground_from_side(world, window, origin, along, state.limits.min_agl_m))
    if world.geofence is not None:
        ends = np.array([window.x_min, window.x_max])
        levels = (world.geofence.floor_amsl_m, world.geofence.ceiling_amsl_m)
        strokes += [
            Stroke("fence", ends, np.full(2, level - world.geofence.origin_amsl_m))
            for level in levels
            if math.isfinite(level)
        ]
    marks: list[Mark] = []
    session = state.session
    if session is not None and session.anchor is not None:
        place, radius_m = session.anchor.position, state.limits.workspace_m
        strokes.append(
            Stroke("anchor", at(place)[0] + radius_m * np.sin(CIRCLE), -place.down + radius_m * np.cos(CIRCLE))
        )
        marks.append(Mark("anchor", at(place)[0], -place.down, "+"))
    for kind, line in _plans(snapshot, asked):
        strokes.append(Stroke(kind, np.array([at(Ned(*p))[0] for p in line]), -line[:, 2]))
    marks.append(Mark("operator", at(operator)[0], -operator.down, "O"))
    for one in _placed(snapshot):
        place = one.position or Ned(0.0, 0.0, 0.0)
        beside_m = abs(at(place)[1])
        if one is drone:
            marks.append(Mark("drone", at(place)[0], -place.down, "◆", one.name))
        elif beside_m <= NEAR_PLANE_M:
            marks.append(Mark(_kind(one, snapshot), at(place)[0], -place.down, one.name[:1].upper(), one.name))
    return Drawing(window, tuple(strokes), tuple(marks), "height above you, towards the drone")


def caption(snapshot: Snapshot) -> str:
    """What the letters mean, and how old each position is."""
    drone = snapshot.paired
    here = drone.position if drone is not None else None
    told = ["O you"]
    for one in snapshot.craft:
        if one is drone:
            continue
        away = (
            " nowhere"
            if one.position is None
            else f" {one.position.minus(here).norm:.0f} m"
            if here is not None
            else ""
        )
        age = f"{one.age_s:.1f} s" if math.isfinite(one.age_s) else "never heard"
        told.append(f"{one.name[:1].upper()} {one.name}{away} {age}")
    return " · ".join(told)


def reach_of_all(snapshot: Snapshot) -> float:
    """How far the view must reach (m) to show the paired drone and its operator, or, unpaired, every drone nearby."""
    centre, drone = _focus(snapshot, 10.0), snapshot.paired
    shown = [drone] if drone is not None else [c for c in snapshot.craft if c.ours]
    places = [c.position for c in shown if c.position is not None]
    if snapshot.setup.operator is not None:
        places.append(snapshot.setup.operator.position)
    far = [place.minus(centre).horizontal for place in places]
    return max((f for f in far if math.isfinite(f) and f < 60.0), default=10.0) * 1.1 + 4.0


# ---------------------------------------------------------------- parts


def _focus(snapshot: Snapshot, reach_m: float) -> Ned:
    """The middle of drone and operator, in steps, so that the view does not jitter; without a pair, of everybody."""
    drone = snapshot.paired
    if drone is not None and drone.position is not None and drone.position.finite:
        operator = snapshot.setup.operator
        middle = drone.position
        if operator is not None and middle.minus(operator.position).horizontal < BOTH_M:
            middle = Ned(*(0.5 * (a + b) for a, b in zip(middle, operator.position, strict=True)))
        step_m = reach_m / 4.0
        return Ned(*(round(c / step_m) * step_m for c in middle))
    places = [c.position for c in snapshot.craft if c.ours and c.position is not None and c.position.finite]
    if snapshot.setup.operator is not None:
        places.append(snapshot.setup.operator.position)
    if not places:
        return Ned(0.0, 0.0, 0.0)
    low = [min(along) for along in zip(*places, strict=True)]
    high = [max(along) for along in zip(*places, strict=True)]
    return Ned(*(round(0.5 * (a + b)) for a, b in zip(low, high, strict=True)))


def _placed(snapshot: Snapshot) -> Iterator[Craft]:
    """Everybody whose place is known, the paired one last, so that it is drawn above all."""
    known = [c for c in snapshot.craft if c.position is not None and c.position.finite]
    yield from (c for c in known if c is not snapshot.paired)
    yield from (c for c in known if c is snapshot.paired)


def _kind(one: Craft, snapshot: Snapshot) -> str:
    if one is snapshot.paired:
        return "drone"
    return "stale" if not one.age_s <= STALE_S else "neighbour"


def _arrow(yaw_deg: float) -> str:
    return ARROWS[round(yaw_deg / 45.0) % 8] if math.isfinite(yaw_deg) else "?"


def _plans(snapshot: Snapshot, asked: Asked | None) -> Iterator[tuple[str, Floats]]:
    """What was granted, and beyond it what was asked for and not granted; (n, 3) NED."""
    flight, deciding = snapshot.state.flight, snapshot.state.deciding
    plan = flight.plan if flight is not None else deciding.decision.plan if deciding is not None else None
    if plan is None:
        return
    goal = plan.goal
    yield "granted", np.array([plan.start, goal])
    if asked is not None and asked.requested_m is not None and asked.requested_m > plan.length_m + 0.01:
        beyond = Ned(*(s + asked.requested_m * d for s, d in zip(plan.start, plan.direction, strict=True)))
        yield "refused", np.array([goal, beyond])


def _outlines(polygons: Polygons | None) -> Iterable[tuple[Floats, Floats]]:
    """Each edge as (east, north) lines."""
    if polygons is None or not len(polygons):
        return
    for north_0, east_0, north_1, east_1 in polygons.edges.T:
        yield np.array([east_0, east_1]), np.array([north_0, north_1])


@lru_cache(maxsize=4)
def _ground_from_above(world: World, window: Window) -> tuple[Stroke, ...]:
    """Contours of the ground, nice steps apart, between the round heights: a plain that lies at one of them is no contour."""
    terrain = world.terrain
    if terrain is None:
        return ()
    xs = np.linspace(window.x_min, window.x_max, SAMPLES[0])
    ys = np.linspace(window.y_min, window.y_max, SAMPLES[1])
    east, north = np.meshgrid(xs, ys)
    points = np.stack([north.ravel(), east.ravel(), np.zeros(east.size)], axis=1)
    heights = -terrain.agl_m(points).reshape(east.shape)
    known = heights[np.isfinite(heights)]
    if not known.size or np.ptp(known) < 0.1:
        return ()
    step_m = nice_step(float(np.ptp(known)) / CONTOURS)
    lines = contour_generator(xs, ys, np.ma.masked_invalid(heights))
    levels = (np.arange(math.floor(known.min() / step_m), math.ceil(known.max() / step_m)) + 0.5) * step_m
    found = []
    for level in levels:
        for line in lines.lines(float(level)):
            places = np.asarray(line, dtype=np.float64)
            found.append(Stroke("contour", places[:, 0], places[:, 1]))
    return tuple(found)


@lru_cache(maxsize=4)
def _ground_from_side(
    world: World, window: Window, origin: Ned, along: tuple[float, float], agl_m: float
) -> tuple[Stroke, ...]:
    """The ground in the plane, the height above it that is kept, and the obstacles in the plane."""
    xs = np.linspace(window.x_min, window.x_max, 3 * SAMPLES[0])
    points = np.stack([origin.north + xs * along[0], origin.east + xs * along[1], np.zeros(xs.size)], axis=1)
    found: list[Stroke] = []
    if world.terrain is not None:
        heights = -world.terrain.agl_m(points)
        found += [Stroke("ground", xs, heights), Stroke("agl", xs, heights + agl_m)]
    if len(world.obstacles):
        inside = world.obstacles.polygons.distance_m(points[:, :2]) < 0.0
        for number in range(len(world.obstacles)):
            base_m = float(world.obstacles.bases_amsl_m[number]) - world.obstacles.origin_amsl_m
            top_m = float(world.obstacles.tops_amsl_m[number]) - world.obstacles.origin_amsl_m
            for first, last in _runs(inside[:, number]):
                left, right = xs[first], xs[last]
                found.append(
                    Stroke(
                        "obstacle",
                        np.array([left, left, right, right]),
                        np.array([base_m, top_m, top_m, base_m]),
                        world.obstacles.names[number],
                    )
                )
    return tuple(found)


def _height_m(world: World, here: Ned) -> float:
    """Above the ground; 0 where that is not known."""
    height_m = float(world.terrain.agl_m(np.array([here]))[0]) if world.terrain is not None else 0.0
    return height_m if 0.0 < height_m < FARTHEST_M else 0.0


def _runs(flags: NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
    """First and last index of each run of True."""
    edges = np.diff(np.concatenate([[0], flags.astype(int), [0]]))
    yield from zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1, strict=True)


def _plane(snapshot: Snapshot, operator: Ned, here: Ned) -> tuple[Ned, tuple[float, float]]:
    """The vertical plane of the side view: a place in it, and its (north, east) direction."""
    flight = snapshot.state.flight
    if flight is not None:
        d = flight.plan.direction
        level = math.hypot(d.north, d.east)
        if level > 0.5:
            return flight.plan.start, (d.north / level, d.east / level)
    away = here.minus(operator)
    if away.horizontal < 1.0:
        return operator, (1.0, 0.0)
    bearing = round(math.degrees(math.atan2(away.east, away.north)) / 2.0) * 2.0  # in steps, against jitter
    return operator, (math.cos(math.radians(bearing)), math.sin(math.radians(bearing)))


def _in_plane(place: Ned, origin: Ned, along: tuple[float, float]) -> tuple[float, float]:
    """Along the plane, and beside it."""
    north, east = place.north - origin.north, place.east - origin.east
    return north * along[0] + east * along[1], east * along[0] - north * along[1]


def nice_step(at_least: float) -> float:
    """1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(at_least))
    return next(power * n for n in (1.0, 2.0, 5.0, 10.0) if power * n >= at_least)
