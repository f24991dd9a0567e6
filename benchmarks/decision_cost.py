"""What one full decision costs: plan, every constraint, shortening; beside the same with off-the-shelf geometry.

The scene: a 1000 x 1000 terrain model at 1 m, a 50-corner geofence with a no-fly area, a wall and two sheds, and
traffic. The drone flies a few metres above a hillside, each time in a new place, and is asked to move towards the wall, so
that every decision has to shorten the move: the dearest kind; in the second row of each pair it is far enough from the
wall for the whole move. Traffic passes clear of it, since a conflict would end the decision early.

The rival is given what it is good at: one exact swept-capsule query per check (python-fcl: the terrain as a bounding
volume hierarchy, prisms as boxes, every neighbour as a capsule in the drone's moving frame, two per neighbour instead of
one per piece of the path, and a coarse reject of those too far away), shapely with prepared geometry for the fence, the same
planner, the same cheap scalar rules, and the same bisection on what failed. It gives no margin along the path, so it
cannot tell a limit that the move mends from one that it breaks.

    python benchmarks/decision_cost.py [--decisions N] [--plot docs/decision-cost.svg]
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path as File

import numpy as np
import shapely

from safety.confidence import authority, input_confidence, localization, terrain_confidence
from safety.envelope import envelope
from safety.geofence import Geofence
from safety.limits import Limits
from safety.obstacles import Obstacles
from safety.planner import swept
from safety.separation import neighbour_age, reservation
from safety.situation import Situation, World
from safety.spatial import error_m, session, standoff, workspace
from safety.supervisor import decide, interpret, propose
from safety.terrain import Terrain
from safety.vocabulary import (
    Anchor,
    Command,
    ManeuverRequest,
    Modality,
    Ned,
    Neighbours,
    Operator,
    Path,
    Plan,
    VehicleState,
    Verdict,
)

LIMITS = Limits()
NOW_S = 1000.0
HALF = 500
MESH_HALF = 150
"""The rival's terrain is a part only: the whole takes it 16 s and 1.3 GB to build, and answers no faster."""


def landscape() -> tuple[Terrain, np.ndarray]:
    rng = np.random.default_rng(7)
    i, j = np.mgrid[: 2 * HALF, : 2 * HALF]
    heights = 12.0 * np.sin(i / 45.0) + 9.0 * np.cos(j / 35.0) + rng.normal(0.0, 0.05, i.shape)
    return Terrain(heights, (-HALF, -HALF), ((1.0, 0.0), (0.0, 1.0)), 0.1, 0.0), heights


class Scene:
    """The world, and situations in it: the drone somewhere before the wall, somewhat above the ground."""

    def __init__(self) -> None:
        self.terrain, self.heights = landscape()
        angles = np.linspace(0.0, 2.0 * np.pi, 50, endpoint=False)
        ring = np.c_[120.0 * np.cos(angles), 120.0 * np.sin(angles)]
        self.fence = shapely.Polygon(ring, holes=[shapely.box(-9.0, 12.0, -5.0, 16.0).exterior.coords])
        self.boxes = [
            shapely.box(8.0, -40.0, 8.5, 40.0),
            shapely.box(-30.0, 5.0, -26.0, 9.0),
            shapely.box(20, 20, 25, 25),
        ]
        self.bases, self.tops = [-40.0, -40.0, -40.0], [60.0, 30.0, 30.0]
        self.world = World(
            self.terrain,
            Obstacles.of(["wall", "shed", "barn"], self.boxes, self.bases, self.tops, 0.0),
            Geofence.of(self.fence, -50.0, 120.0, 0.0),
        )

    def situation(self, rng: np.random.Generator, count: int, back_m: float = 0.0) -> Situation:
        """back_m: how much farther from the wall than where the move must be shortened."""
        north, east = rng.uniform(4.9, 5.3) - back_m, rng.uniform(-5.0, 5.0)
        ground = -float(self.terrain.agl_m(np.array([[north, east, 0.0]]))[0])
        place = Ned(north, east, -(ground + rng.uniform(4.5, 7.0)))
        state = VehicleState(
            NOW_S, place, Ned(0.0, 0.0, 0.0), 180.0, sigma_h_m=0.1, sigma_v_m=0.1, healthy=True, in_air=True
        )
        return Situation(
            now_s=NOW_S,
            vehicle=state,
            operator=Operator(Ned(north - 10.0, east, place.down + 3.0), 0.3),
            anchor=Anchor(place, 180.0, NOW_S),
            session_centre=place,
            paired_at_s=NOW_S - 60.0,
            neighbours=traffic(rng, place, count),
            reservations=(),
            world=self.world,
            authority=True,
        )


def traffic(rng: np.random.Generator, place: Ned, count: int) -> Neighbours:
    """Aircraft over a square kilometre, up to 8 m/s, none of which comes too close within the horizon."""
    found: list[tuple[np.ndarray, np.ndarray, float]] = []
    while len(found) < count:
        position = np.array((*rng.uniform(-500.0, 500.0, 2), -rng.uniform(5.0, 120.0)))
        velocity = np.array((*rng.uniform(-5.6, 5.6, 2), rng.uniform(-0.5, 0.5)))
        age_s = rng.uniform(0.0, 0.4)
        apart = position + velocity * age_s - place
        when_s = float(np.clip(-(apart @ velocity) / (velocity @ velocity), 0.0, 20.0))
        if np.linalg.norm(apart + when_s * velocity) > 12.0:
            found.append((position, velocity, age_s))
    return Neighbours(
        tuple(f"aircraft {i}" for i in range(count)),
        np.array([f[0] for f in found]).reshape(-1, 3),
        np.array([f[1] for f in found]).reshape(-1, 3),
        np.full(count, 0.5),
        NOW_S - np.array([f[2] for f in found]),
        NOW_S,
    )


REQUEST = ManeuverRequest("1", Command.GO_FORWARD, Modality.VOICE, 0.9, NOW_S, NOW_S)


class OffTheShelf:
    """The same decision with shapely and python-fcl."""

    def __init__(self, scene: Scene) -> None:
        import fcl  # only the comparison needs it

        self.fcl = fcl
        low, high = HALF - MESH_HALF, HALF + MESH_HALF
        part = scene.heights[low:high, low:high]
        i, j = np.mgrid[low:high, low:high]
        corners = np.stack((i - HALF, j - HALF, -part), axis=-1).reshape(-1, 3).astype(float)
        n = high - low
        first = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
        faces = np.concatenate((np.c_[first, first + n, first + n + 1], np.c_[first, first + n + 1, first + 1]))
        mesh = fcl.BVHModel()
        mesh.beginModel(len(corners), len(faces))
        mesh.addSubModel(corners, faces)
        mesh.endModel()
        self.ground = fcl.CollisionObject(mesh, fcl.Transform())
        self.prisms = []
        for box, base, top in zip(scene.boxes, scene.bases, scene.tops, strict=True):
            n0, e0, n1, e1 = box.bounds
            centre = np.array(((n0 + n1) / 2.0, (e0 + e1) / 2.0, -(base + top) / 2.0))
            self.prisms.append(fcl.CollisionObject(fcl.Box(n1 - n0, e1 - e0, top - base), fcl.Transform(centre)))
        self.point = fcl.CollisionObject(fcl.Sphere(1e-4), fcl.Transform(np.zeros(3)))
        self.fence, self.edge = scene.fence, shapely.boundary(scene.fence)
        shapely.prepare(self.fence)
        shapely.prepare(self.edge)

    def capsule(self, start: np.ndarray, end: np.ndarray) -> object:
        """The stretch from start to end, with practically no radius."""
        axis = end - start
        length = math.sqrt(float(axis @ axis))
        if length < 1e-9:
            return self.fcl.CollisionObject(self.fcl.Sphere(1e-4), self.fcl.Transform(start))
        z = axis / length
        across = np.array((1.0, 0.0, 0.0)) if abs(z[0]) < 0.9 else np.array((0.0, 1.0, 0.0))
        x = across - z * float(across @ z)
        x /= math.sqrt(float(x @ x))
        y = np.array((z[1] * x[2] - z[2] * x[1], z[2] * x[0] - z[0] * x[2], z[0] * x[1] - z[1] * x[0]))
        turn = np.array((x, y, z)).T
        return self.fcl.CollisionObject(self.fcl.Capsule(1e-4, length), self.fcl.Transform(turn, (start + end) / 2.0))

    def terrain(self, path: Path, here: Situation) -> float:
        assert here.world.terrain is not None
        sigma_m = here.world.terrain.sigma_m
        required_m = LIMITS.clearance_m + error_m(here.vehicle.sigma_m, LIMITS) + LIMITS.sigma_k * sigma_m
        gap_m = self.fcl.distance(self.capsule(path.points_ned_m[0], path.points_ned_m[-1]), self.ground)
        return float(gap_m) - required_m

    def agl(self, path: Path, here: Situation) -> float:
        assert here.world.terrain is not None
        wrong_m = error_m(here.vehicle.sigma_m, LIMITS) + LIMITS.sigma_k * here.world.terrain.sigma_m
        return float(here.world.terrain.agl_m(path.points_ned_m).min()) - LIMITS.min_agl_m - wrong_m

    def obstacles(self, path: Path, here: Situation) -> float:
        stretch = self.capsule(path.points_ned_m[0], path.points_ned_m[-1])
        nearest = min(self.fcl.distance(stretch, prism) for prism in self.prisms)
        return float(nearest) - LIMITS.obstacle_clearance_m - error_m(here.vehicle.sigma_m, LIMITS)

    def geofence(self, path: Path, here: Situation) -> float:
        line = shapely.linestrings(path.points_ned_m[[0, -1], :2])
        side = float(shapely.distance(self.edge, line))
        side = side if shapely.contains_properly(self.fence, line) else -side
        up = -path.points_ned_m[:, 2]
        fence = here.world.geofence
        assert fence is not None and fence.floor_amsl_m is not None and fence.ceiling_amsl_m is not None
        upright = min(float(up.min()) - fence.floor_amsl_m, fence.ceiling_amsl_m - float(up.max()))
        return min(side - error_m(here.vehicle.sigma_h_m, LIMITS), upright - error_m(here.vehicle.sigma_v_m, LIMITS))

    def separation(self, path: Path, here: Situation) -> float:
        start, end = path.points_ned_m[0], path.points_ned_m[-1]
        arrives_s = float(path.times_s[-1])
        until_s = max(arrives_s, LIMITS.horizon_s)
        reach_m = math.dist(start, end)
        neighbours = here.neighbours
        own_m = LIMITS.separation_m + error_m(here.vehicle.sigma_m, LIMITS) + path.along_track_tolerance_m
        lowest = math.inf
        for position, velocity, sigma_m, at_s in zip(
            neighbours.positions_ned_m, neighbours.velocities_ned_m_s, neighbours.sigmas_m, neighbours.at_s, strict=True
        ):
            age_s = here.now_s - at_s
            speed_m_s = math.sqrt(float(velocity @ velocity))
            required_m = own_m + LIMITS.sigma_k * sigma_m
            required_m += (speed_m_s + 0.5 * LIMITS.neighbour_acceleration_m_s2 * age_s) * age_s
            now = position + velocity * age_s
            if math.dist(now, start) - reach_m - speed_m_s * until_s > required_m:
                continue
            a, b, c = start - now, end - now - velocity * arrives_s, end - now - velocity * until_s
            nearest = min(
                self.fcl.distance(self.capsule(a, b), self.point), self.fcl.distance(self.capsule(b, c), self.point)
            )
            lowest = min(lowest, nearest - required_m)
        return lowest

    def decide(self, here: Situation) -> float | None:
        """Metres granted, None if rejected."""
        intent = interpret(REQUEST, LIMITS)
        scalar = (authority, localization, terrain_confidence, neighbour_age, reservation, workspace, session, standoff)
        geometric = (self.terrain, self.agl, self.obstacles, self.geofence, self.separation)

        def fails(plan: Plan) -> list[Callable[[Path, Situation], float]]:
            path = swept(plan, LIMITS)
            if not all(rule(path, here, LIMITS).passed for rule in scalar):
                return [lambda *_: -1.0]
            if not (envelope(plan, here, LIMITS).passed and input_confidence(REQUEST, LIMITS).passed):
                return [lambda *_: -1.0]
            return [check for check in geometric if not check(path, here) >= 0.0]

        plan = propose(intent, here, LIMITS)
        failing = fails(plan)
        if not failing:
            return plan.length_m

        def fits(length_m: float) -> bool:
            path = swept(propose(replace(intent, amount=length_m), here, LIMITS), LIMITS)
            return all(check(path, here) >= 0.0 for check in failing)

        if not fits(LIMITS.shortest_m):
            return None
        low_m, high_m = LIMITS.shortest_m, plan.length_m
        while high_m - low_m > LIMITS.bisection_m:
            middle_m = 0.5 * (low_m + high_m)
            low_m, high_m = (middle_m, high_m) if fits(middle_m) else (low_m, middle_m)
        return low_m if not fails(propose(replace(intent, amount=low_m), here, LIMITS)) else None


def timed(decision: Callable[[Situation], object], situations: list[Situation]) -> tuple[np.ndarray, np.ndarray]:
    """(n,) milliseconds that each decision took, and (n,) of the processor's: they differ where others keep it busy."""
    for here in situations[:5]:
        decision(here)
    took, busy = np.empty(len(situations)), np.empty(len(situations))
    for i, here in enumerate(situations):
        busy_s, start_s = time.thread_time(), time.perf_counter()
        decision(here)
        took[i], busy[i] = time.perf_counter() - start_s, time.thread_time() - busy_s
    return took * 1e3, busy * 1e3


def percentiles(times: tuple[np.ndarray, np.ndarray]) -> tuple[float, float, str]:
    """p50 and p99 of what they took, and the same for a person."""
    (p50, p99), (busy50, busy99) = (np.percentile(t, (50, 99)) for t in times)
    return float(p50), float(p99), f"{p50:7.2f} ({busy50:5.2f}) {p99:7.2f} ({busy99:5.2f})"


COUNTS = (1, 10, 100, 1000)
LABEL_HEIGHT = 15.0


def plot(costs: dict[str, list[float]]) -> str:
    """How the median cost (ms) grows with the number of neighbours, both axes logarithmic, as an SVG."""
    left, top, width, height = 60, 20, 420, 260
    low, high = 0.1, 100.0

    def place(count: int, cost_ms: float) -> tuple[float, float]:
        along = math.log10(count) / math.log10(COUNTS[-1])
        up = math.log(cost_ms / low) / math.log(high / low)
        return left + width * along, top + height * (1.0 - up)

    parts = [
        (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {left + width + 230} {top + height + 50}" '
            'font-family="sans-serif" font-size="13">'
        ),
        '<rect width="100%" height="100%" fill="white"/>',
    ]
    for cost_ms in (0.1, 1.0, 10.0, 100.0):
        _, y = place(1, cost_ms)
        parts.append(f'<path d="M{left} {y:.1f}H{left + width}" stroke="#ccc"/>')
        parts.append(f'<text x="{left - 8}" y="{y + 4:.1f}" text-anchor="end">{cost_ms:g}</text>')
    for count in COUNTS:
        x, y = place(count, low)
        parts.append(f'<text x="{x:.1f}" y="{y + 18:.1f}" text-anchor="middle">{count}</text>')
    parts.append(f'<text x="{left + width / 2}" y="{top + height + 40}" text-anchor="middle">neighbours</text>')
    parts.append(f'<text x="{left}" y="{top - 6}">median of one decision, ms</text>')
    labelled_y: list[float] = []
    for (name, found), ink in zip(costs.items(), ("#0072b2", "#d55e00", "#56b4e9", "#e69f00"), strict=False):
        points = [place(count, cost_ms) for count, cost_ms in zip(COUNTS, found, strict=True)]
        line = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
        parts.append(f'<polyline points="{line}" fill="none" stroke="{ink}" stroke-width="2"/>')
        x, y = points[-1]
        while any(abs(y - other) < LABEL_HEIGHT for other in labelled_y):
            y += 1.0
        labelled_y.append(y)
        parts.append(f'<text x="{x + 8:.1f}" y="{y + 4:.1f}" fill="{ink}">{name}</text>')
    return "\n".join([*parts, "</svg>", ""])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--decisions", type=int, default=1000)
    parser.add_argument("--plot", type=File, help="write a plot of how the cost grows, as SVG")
    arguments = parser.parse_args()
    intent = interpret(REQUEST, LIMITS)

    def ours(here: Situation) -> float | None:
        return decide(REQUEST, intent, here, LIMITS).granted_m

    scene = Scene()
    try:
        rival = OffTheShelf(scene)
    except ImportError:
        rival = None
        print("python-fcl is not installed, so there is no comparison: pip install python-fcl")
    rng = np.random.default_rng(11)
    costs: dict[str, list[float]] = {}
    print("one decision, ms (in brackets: of the processor's time)")
    print(f"{'':27s} ours p50             p99  | shapely + python-fcl p50             p99  | ratio of p50s, of p99s")
    for count in COUNTS:
        for verdict, back_m in ((Verdict.REDUCED, 0.0), (Verdict.APPROVED, 3.0)):
            situations = [scene.situation(rng, count, back_m) for _ in range(arguments.decisions)]
            for here in situations:
                became = decide(REQUEST, intent, here, LIMITS).verdict
                assert became is verdict, f"a decision was {became}, not {verdict}"
            p50, p99, text = percentiles(timed(ours, situations))
            costs.setdefault(f"ours, {verdict}", []).append(p50)
            line = f"{count:5d} neighbours, {verdict:8s} {text}"
            if rival is not None:
                # The dear one gets fewer samples at a thousand neighbours, or it would take minutes.
                some = situations if count < 1000 else situations[: max(50, len(situations) // 5)]
                r50, r99, text = percentiles(timed(rival.decide, some))
                costs.setdefault(f"shapely + python-fcl, {verdict}", []).append(r50)
                line += f"  |        {text}  | {p50 / r50:8.2f} {p99 / r99:8.2f}"
                differ = [
                    (a, b) for a, b in ((ours(here), rival.decide(here)) for here in situations[:50])
                    if (a is None) != (b is None) or (a is not None and b is not None and abs(a - b) > 0.1)
                ]  # fmt: skip
                if differ:
                    line += f"  ({len(differ)} of 50 differ by more than 0.1 m: {differ[0]})"
            print(line, flush=True)
    if arguments.plot is not None:
        arguments.plot.write_text(plot(costs), encoding="utf-8")


if __name__ == "__main__":
    main()
