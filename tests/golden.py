"""What the arbiter and the rules do in a few thousand cases, kept in tests/golden/: a change of behaviour is a difference to be agreed to.

    .venv/bin/python -m tests.golden             renew the files; `git diff` then shows which cases changed
    .venv/bin/python -m tests.golden CASE ...    show all of a case, to compare before and after

A line is a case: what it is, what came of it in short, and a short name for every value of it (numbers to six places). These
files are no oracle of what is right, for that look at the other tests: they notice what nobody meant to change.
"""

from __future__ import annotations

import hashlib
import math
import random
import sys
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass, replace
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from m3r_app.arbiter.events import ReservationAnswered, Stalled, TelemetryArrived, Tick
from m3r_app.arbiter.preview import preview
from m3r_app.arbiter.state import Policy
from m3r_app.arbiter.step import step
from safety.geofence import Geofence
from safety.limits import Limits
from safety.monitor import watch
from safety.obstacles import Obstacles
from safety.situation import Situation, World
from safety.supervisor import decide, interpret, propose
from safety.terrain import Terrain
from safety.vocabulary import (
    Anchor,
    Command,
    FlightMode,
    ManeuverRequest,
    Modality,
    Ned,
    Neighbours,
    Operator,
    ReservedVolume,
)
from tests.m3r_app.tabletop import Tabletop
from tests.m3r_app.test_arbiter import MADE, ball, every_event
from tests.safety.scene import NOW_S, sky, vehicle

FOLDER = Path(__file__).with_name("golden")
MOVES = [c for c in Command if c not in (Command.STOP, Command.ACTIVATE, Command.DISCONNECT, Command.CONTINUE)]


def shown(value: Any) -> str:
    """Every value as text, by name; what is as by default is left out, numbers to six places."""
    match value:
        case float():
            return f"{0.0 if abs(value) < 1e-9 else value:.6g}"
        case Enum():
            return str(value.value)
        case World():
            return "World"
        case np.ndarray():
            return shown(value.tolist())
        case _ if is_dataclass(value):
            told = ((f.name, getattr(value, f.name), f.default) for f in fields(value) if not f.name.startswith("_"))
            parts = [
                f"{name}={shown(each)}" for name, each, default in told if name != "rules" and not _same(each, default)
            ]
            return f"{type(value).__name__}({', '.join(parts)})"
        case tuple() | list():
            return f"[{', '.join(shown(each) for each in value)}]"
        case dict():
            return f"{{{', '.join(sorted(f'{shown(k)}: {shown(v)}' for k, v in value.items()))}}}"
        case set() | frozenset():
            return f"{{{', '.join(sorted(map(shown, value)))}}}"
    return repr(value)


def _same(a: Any, b: Any) -> bool:
    return type(a) is type(b) and not isinstance(a, np.ndarray) and bool(a == b)


def line(name: str, short: str, *values: Any) -> str:
    text = "\n".join(shown(value) for value in values)
    if name in sys.argv[1:]:
        print(name, short, text, sep="\n")
    return f"{name}: {short} {hashlib.sha256(text.encode()).hexdigest()[:8]}"


# ---------------------------------------------------------------- the arbiter


def arbiter(number: int) -> Iterator[str]:
    """Every event in one state, a little or much later, then what a preview says."""
    state, make = list(MADE.items())[number]
    table = make()
    for each, event in enumerate(every_event(table)):
        after, effects = step(table.state, event, table.now_s + (0.3 if each % 4 else 4.0))
        yield line(
            f"{state.value}-{type(event).__name__}-{each}", f"{after.state.value} {len(effects)}", after, effects
        )
    for command in Command:
        found = preview(table.state, table.request(command), table.now_s)
        yield line(f"{state.value}-preview-{command.value}", "", found)


def story(seed: int) -> Iterator[str]:
    """Half a minute of whatever may happen, by chance; every step counts."""
    chance = random.Random(seed)
    policy = Policy(
        return_to_anchor=("auto", "ask", "never")[seed % 3],  # type: ignore[arg-type]
        replace="offer" if seed % 2 else "off",
        on_disconnect="resume" if seed % 4 == 1 else "hold",
        position_lost="land" if seed % 5 == 2 else "hold",
    )
    table = Tabletop(policy=policy, world=worlds()[seed % len(worlds())])
    table.paired()
    for _ in range(24):
        _happens(table, chance)
    table.wait(0.5)
    steps = [(shown(event), shown(after), shown(effects)) for _, event, after, effects in table.steps]
    for number, part in enumerate(steps[i : i + 60] for i in range(0, len(steps), 60)):
        yield line(f"story-{seed}-{number}", table.state.state.value, part)
    yield line(f"story-{seed}-said", str(len(table.said())), table.said())


def _happens(table: Tabletop, chance: random.Random) -> None:
    def one_of(things: list[Any]) -> Any:
        return things[int(chance.random() * len(things))]

    match one_of(
        [
            "ask",
            "ask",
            "ask",
            "again",
            "stop",
            "sky",
            "volume",
            "mode",
            "silence",
            "gust",
            "grant",
            "late",
            "unsure",
            "stall",
            "frozen",
        ]
    ):
        case "ask":
            confidence, ago_s = one_of([0.9, 0.9, 0.95, 0.4]), one_of([0.0, 0.0, 0.3, 9.0])
            table.ask(one_of([*MOVES, Command.CONTINUE]), one_of(list(Modality)[:3]), confidence, ago_s=ago_s)
        case "again":
            command = one_of(MOVES)
            table.ask(command, Modality.VOICE, one_of([0.9, 0.5]))
            table.tick()
            table.ask(one_of([command, command, one_of(MOVES)]), Modality.GESTURE, one_of([0.9, 0.6]))
        case "stop":
            table.ask(Command.STOP)
        case "sky":
            beside = table.position.plus(Ned(one_of([5.0, -4.5, 9.0]), one_of([0.0, 3.0]), 0.0))
            table.sky = one_of(
                [Neighbours.none(math.inf), ball("blue", beside, Ned(one_of([-1.0, 0.5]), 0.0, 0.0), table.now_s)]
            )
        case "volume":
            ahead = table.position.plus(Ned(0.0, one_of([-2.0, 3.0]), 0.0))
            lease = ReservedVolume("green", ahead, ahead, 1.0, table.now_s + one_of([0.0, 4.0]), table.now_s + 7.0)
            table.volumes = one_of([(), (lease,)])
        case "mode":
            table.flight_mode = one_of([FlightMode.OFFBOARD, FlightMode.OFFBOARD, FlightMode.HOLD])
        case "silence":
            for _ in range(one_of([3, 7])):
                table.tick(telemetry=False)
        case "gust":
            table.position = table.position.plus(Ned(one_of([0.1, -0.2]), one_of([0.0, 0.25]), 0.05))
        case "grant":
            table.grant = one_of(["granted", "granted", "denied", None])
        case "late":
            for request_id in list(table.reserved):
                table.held.discard(request_id)
                table.put(ReservationAnswered(request_id, one_of(["denied", "expired"])))
        case "unsure":
            table.sigma_m = one_of([0.1, 0.1, 0.4, 8.0])
        case "stall":
            table.put(Stalled("it stalled"))
        case "frozen":
            table.put(TelemetryArrived(replace(table.vehicle(), velocity=Ned(1.5, 0.0, 0.0))))
            table.put(Tick())
    table.wait(one_of([0.2, 0.7, 1.5]))


# ---------------------------------------------------------------- the rules


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

    for number in range(96):
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


def rules(part: int) -> Iterator[str]:
    """What is decided of maneuvers in some of the situations, and what the monitor sees of them."""
    for number, situation in list(enumerate(situations()))[part::PARTS]:
        limits = Limits() if number % 3 else replace(Limits(), tracking_m=0.1, workspace_m=3.0, horizon_s=4.0)
        for command in MOVES[number % 2 :: 2]:
            request = ManeuverRequest("r", command, Modality.VOICE, 0.95, NOW_S, NOW_S)
            made = decide(request, interpret(request, limits), situation, limits, may_delay=number % 2 == 0, offer=True)
            short = f"{made.verdict.value} {shown(made.granted_m)} {sum(not f.passed for f in made.findings)}"
            yield line(f"rules-{number}-{command.value}", short, made)
            plan = made.plan
            if plan is not None:
                times = [0.01 + 0.43 * i for i in range(int(plan.duration_s / 0.43))]
                tracks = [(plan.led(t, 0.8), plan.yaw_deg(t), plan.move.time_at(plan.move.at(t))) for t in times]
                yield line(f"plan-{number}-{command.value}", f"{len(times)}", plan, tracks)
        seen = watch(situation, None, 0.0, 0.3, {}, limits)
        yield line(f"watch-{number}", f"{len(seen.breaches)}", seen)
        way = propose(interpret(request, limits), situation, limits)
        flown = watch(situation, way, 3.0, 0.9, seen.negative, limits)
        yield line(f"watch-{number}-flown", f"{len(flown.breaches)}", flown)


PARTS = 16
CASES: dict[str, tuple[Callable[[int], Iterator[str]], int]] = {
    "arbiter": (arbiter, len(MADE)),
    "stories": (story, 14),
    "rules": (rules, PARTS),
}
"""By file: what makes a part of it, and how many parts."""


def made(name: str, part: int) -> list[str]:
    """The lines of a part of a file, each with its number."""
    return [f"{part:02} {each}" for each in CASES[name][0](part)]


def main() -> None:
    FOLDER.mkdir(exist_ok=True)
    for name, (_, parts) in CASES.items():
        text = "".join(f"{each}\n" for part in range(parts) for each in made(name, part))
        if len(sys.argv) == 1:
            (FOLDER / f"{name}.txt").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
