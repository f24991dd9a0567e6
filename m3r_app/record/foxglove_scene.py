"""The flight as a 3D scene in Foxglove's SceneUpdate messages, for the record and for the live view alike.

Frame "local": east, north, up (m) about the session's origin. Entities keep their ids, so that a newer one replaces the
older. `Scene` remembers what one message alone does not tell: where the drone is, what was last decided, the trail.
Source: Foxglove's message schema reference (SceneUpdate).
"""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING, Any

from m3r_app.record.foxglove_views import LOCAL, View, enu, heading, numbers, xyz
from m3r_app.record.prism_mesh import prism_mesh

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

SCENE_TOPICS = ("stage", "flight", "anchor", "plan", "blocked", "neighbours")
TRAIL_S = 60.0
TRAIL_EVERY_S = 0.2
TRAIL_SHOWN_S = 1.0
"""The trail is long, so it is sent anew less often than the drone."""
STALE_S = 1.0
BLOCKED_S = 8
"""How long a blocked request stays in the scene."""
NEIGHBOUR_S = 2
FOR_EVER = 0
INK = {
    "ground": (0.45, 0.40, 0.30, 1.0),
    "obstacle": (0.75, 0.45, 0.20, 0.8),
    "fence": (0.80, 0.20, 0.80, 1.0),
    "operator": (0.10, 0.10, 0.10, 1.0),
    "anchor": (0.00, 0.65, 0.81, 0.15),
    "granted": (0.16, 0.62, 0.29, 1.0),
    "refused": (0.84, 0.16, 0.16, 1.0),
    "flown": (0.12, 0.47, 0.71, 1.0),
    "drone": (0.12, 0.47, 0.71, 1.0),
    "fresh": (0.48, 0.37, 0.65, 0.5),
    "stale": (0.90, 0.65, 0.00, 0.5),
    "text": (1.0, 1.0, 1.0, 1.0),
}


class Scene:
    """From the messages of one run, in their order and as `plain` made them, to updates of its scene."""

    def __init__(self) -> None:
        self._place: list[float] | None = None
        self._decision: Mapping[str, Any] = {}
        self._name = ""
        self._trail: deque[tuple[float, list[float]]] = deque()
        self._trail_shown_s = -math.inf

    def views(self, topic: str, data: Mapping[str, Any], log_ns: int) -> list[View]:
        """The updates by this message; none where the scene stays as it is. Values that are not finite are left out."""
        stamp = {"sec": log_ns // 1_000_000_000, "nsec": log_ns % 1_000_000_000}
        match topic:
            case "stage":
                return _update("stage", stamp, _static_scene(data, stamp))
            case "telemetry":
                return self._telemetry(data, stamp)
            case "anchor":
                return _anchor(data, stamp)
            case "decision":
                return self._decided(data, stamp)
            case "plan":
                return self._plan(data, stamp)
            case "neighbours":
                return _neighbours(data, stamp)
        return []

    def _telemetry(self, data: Mapping[str, Any], stamp: dict[str, int]) -> list[View]:
        place, t_s = data.get("position"), data.get("t")
        if not numbers(place, 3) or not isinstance(t_s, (int, float)):
            return []
        assert isinstance(place, list)
        name = str(data.get("vehicle", "drone"))
        if name != self._name:
            self._name = name
            self._trail.clear()
            self._trail_shown_s = -math.inf
        self._place = place
        if self._trail and t_s - self._trail[-1][0] < TRAIL_EVERY_S:
            return []
        self._trail.append((t_s, place))
        while t_s - self._trail[0][0] > TRAIL_S:
            self._trail.popleft()
        arrow = {
            "pose": _pose(),
            "shaft_length": 0.5,
            "shaft_diameter": 0.15,
            "head_length": 0.3,
            "head_diameter": 0.35,
            "color": _ink("drone"),
        }
        drone = _entity("drone", stamp, arrows=[arrow], frame=name, texts=[_text(name, [0.0, 0.0, -0.6])])
        if t_s - self._trail_shown_s < TRAIL_SHOWN_S:
            return _update("flight", stamp, [drone])
        self._trail_shown_s = t_s
        trail = _entity("flown", stamp, lines=[_line([p for _, p in self._trail], "flown", 0.04)])
        return _update("flight", stamp, [drone, trail])

    def _decided(self, data: Mapping[str, Any], stamp: dict[str, int]) -> list[View]:
        self._decision = data
        if data.get("verdict") != "rejected" or self._place is None:
            return []
        findings = data.get("findings")
        failing = (
            [f for f in findings if isinstance(f, dict) and not f.get("passed")] if isinstance(findings, list) else []
        )
        why = "; ".join(str(f.get("text")) for f in failing)
        north, east, down = self._place
        ball = {"pose": _pose(self._place), "size": xyz(0.5, 0.5, 0.5), "color": _ink("refused")}
        label = _text(f"blocked: {why}", [north, east, down - 1.0], "refused")
        return _update("blocked", stamp, [_entity("blocked", stamp, BLOCKED_S, spheres=[ball], texts=[label])])

    def _plan(self, data: Mapping[str, Any], stamp: dict[str, int]) -> list[View]:
        points = data.get("points_ned_m")
        if not isinstance(points, list) or not points or not all(numbers(point, 3) for point in points):
            return []
        entities = [_entity("plan", stamp, lines=[_line(points, "granted", 0.06)])]
        gone = ["refused"]
        first, last = points[0], points[-1]
        length_m, requested_m = math.dist(first, last), self._decision.get("requested_m")
        self._decision = {}  # of this plan only: a way back has none
        if isinstance(requested_m, (int, float)) and length_m > 0.01 and requested_m > length_m + 0.01:
            far = [a + (b - a) * requested_m / length_m for a, b in zip(first, last, strict=True)]
            entities.append(_entity("refused", stamp, lines=[_line([last, far], "refused", 0.06)]))
            gone = []
        return _update("plan", stamp, entities, gone)


# ---------------------------------------------------------------- what stands still


def _static_scene(data: Mapping[str, Any], stamp: dict[str, int]) -> list[dict[str, Any]]:
    """Ground, obstacles, fence, operator; on the topic "stage". data: made by `m3r_app.environment.static_scene`."""
    entities = []
    ground = data.get("ground")
    if isinstance(ground, dict):
        entities.append(_entity("ground", stamp, triangles=[_mesh(ground)]))
    walls = [_prism(one) for one in data.get("obstacles") or []]
    labels = [
        _text(one["name"], [*_middle(one["corners_ne_m"]), -one["top_m"] - 0.5]) for one in data.get("obstacles") or []
    ]
    entities.append(_entity("obstacles", stamp, triangles=walls, texts=labels))
    lines = [
        _line([[north_0, east_0, -level_m], [north_1, east_1, -level_m]], "fence", 0.05)
        for north_0, east_0, north_1, east_1 in data.get("fence_ne_m") or []
        for level_m in data.get("fence_levels_m") or [0.0]
    ]
    entities.append(_entity("fence", stamp, lines=lines))
    operator = data.get("operator")
    if numbers(operator, 3):
        assert isinstance(operator, list)
        ball = {"pose": _pose(operator), "size": xyz(0.6, 0.6, 1.8), "color": _ink("operator")}
        north, east, down = operator
        entities.append(
            _entity("operator", stamp, spheres=[ball], texts=[_text("operator", [north, east, down - 1.5])])
        )
    return entities


def _mesh(ground: Mapping[str, Any]) -> dict[str, Any]:
    """The ground's grid as triangles; cells without data are holes."""
    norths, easts, heights = ground["norths_m"], ground["easts_m"], ground["heights_m"]
    points, indices = [], []
    columns = len(easts)
    for north, row in zip(norths, heights, strict=True):
        for east, height in zip(easts, row, strict=True):
            points.append(xyz(east, north, height if numbers([height], 1) else 0.0))
    known = [[numbers([height], 1) for height in row] for row in heights]
    for r in range(len(norths) - 1):
        for c in range(columns - 1):
            if known[r][c] and known[r][c + 1] and known[r + 1][c] and known[r + 1][c + 1]:
                a = r * columns + c
                indices += [a, a + 1, a + columns, a + 1, a + columns + 1, a + columns]
    return _triangles(points, indices, "ground")


def _prism(one: Mapping[str, Any]) -> dict[str, Any]:
    points, triangles = prism_mesh(one["corners_ne_m"], one["base_m"], one["top_m"])
    return _triangles([xyz(*point) for point in points], [i for triangle in triangles for i in triangle], "obstacle")


def _triangles(points: list[dict[str, float]], indices: list[int], ink: str) -> dict[str, Any]:
    return {"pose": _pose(), "points": points, "color": _ink(ink), "colors": [], "indices": indices}


def _middle(corners: Sequence[Sequence[float]]) -> list[float]:
    return [sum(c[axis] for c in corners) / len(corners) for axis in (0, 1)]


# ---------------------------------------------------------------- what moves


def _anchor(data: Mapping[str, Any], stamp: dict[str, int]) -> list[View]:
    place, radius_m = data.get("position"), data.get("radius_m")
    if not numbers(place, 3) or not numbers([radius_m], 1):
        return _update("anchor", stamp, [], ["anchor"])
    assert isinstance(place, list) and isinstance(radius_m, (int, float))
    width_m = 2.0 * radius_m
    ball = {"pose": _pose(place), "size": xyz(width_m, width_m, width_m), "color": _ink("anchor")}
    middle = {"pose": _pose(place), "size": xyz(0.15, 0.15, 0.15), "color": _ink("granted")}
    return _update("anchor", stamp, [_entity("anchor", stamp, spheres=[ball, middle])])


def _neighbours(data: Mapping[str, Any], stamp: dict[str, int]) -> list[View]:
    heard = data.get("neighbours")
    if not isinstance(heard, dict):
        return []
    entities = []
    columns = ("names", "positions_ned_m", "velocities_ned_m_s", "sigmas_m", "at_s")
    feed_at_s = heard.get("feed_at_s")
    for name, place, velocity, sigma_m, at_s in zip(*(heard.get(column) or [] for column in columns), strict=False):
        if not numbers(place, 3):
            continue
        age_s = max(0.0, feed_at_s - at_s) if numbers([feed_at_s, at_s], 2) else math.inf
        speed_m_s = math.hypot(*velocity) if numbers(velocity, 3) else 0.0
        reach_m = (sigma_m if numbers([sigma_m], 1) else 1.0) + (speed_m_s * age_s if math.isfinite(age_s) else 5.0)
        ink = "fresh" if age_s <= STALE_S else "stale"
        width_m = 2.0 * max(0.3, reach_m)
        ball = {"pose": _pose(place), "size": xyz(width_m, width_m, width_m), "color": _ink(ink)}
        age = f"{age_s:.1f} s" if math.isfinite(age_s) else "silent"
        north, east, down = place
        label = _text(f"{name} {age}", [north, east, down - 0.5 * width_m - 0.3], ink)
        entities.append(_entity(f"neighbour {name}", stamp, NEIGHBOUR_S, spheres=[ball], texts=[label]))
    return _update("neighbours", stamp, entities)


# ---------------------------------------------------------------- messages


def _update(name: str, stamp: dict[str, int], entities: list[dict[str, Any]], gone: Sequence[str] = ()) -> list[View]:
    if not entities and not gone:
        return []
    deletions = [{"timestamp": stamp, "type": 0, "id": one} for one in gone]
    return [View(f"scene/{name}", "foxglove.SceneUpdate", {"deletions": deletions, "entities": entities})]


def _entity(
    name: str, stamp: dict[str, int], lifetime_s: int = FOR_EVER, frame: str = LOCAL, **shapes: Any
) -> dict[str, Any]:
    kinds = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
    return {
        "timestamp": stamp,
        "frame_id": frame,
        "id": name,
        "lifetime": {"sec": lifetime_s, "nsec": 0},
        "frame_locked": True,
        "metadata": [],
        **{kind: shapes.get(kind, []) for kind in kinds},
    }


def _line(points: Sequence[Sequence[float]], ink: str, thickness_m: float) -> dict[str, Any]:
    return {
        "type": 0,
        "pose": _pose(),
        "thickness": thickness_m,
        "scale_invariant": False,
        "points": [enu(point) for point in points],
        "color": _ink(ink),
        "colors": [],
        "indices": [],
    }


def _text(text: str, place: Sequence[float], ink: str = "text") -> dict[str, Any]:
    return {
        "pose": _pose(place),
        "billboard": True,
        "font_size": 14.0,
        "scale_invariant": True,
        "color": {**_ink(ink), "a": 1.0},
        "text": text,
    }


def _pose(place: Sequence[float] = (0.0, 0.0, 0.0)) -> dict[str, Any]:
    return {"position": enu(place), "orientation": heading(90.0)}


def _ink(name: str) -> dict[str, float]:
    return dict(zip("rgba", INK[name], strict=True))
