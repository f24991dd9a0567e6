"""What the arbiter and the rules do in a few thousand cases, kept in tests/golden/: a change of behaviour is a difference to be agreed to.

    .venv/bin/python -m tests.golden             renew the files; `git diff` then shows which cases changed
    .venv/bin/python -m tests.golden CASE ...    show all of a case, to compare before and after

A line is a case: what it is, what came of it in short, and a short name for every value of it (numbers to six places). These
files are no oracle of what is right, for that look at the other tests: they notice what nobody meant to change.
"""

from __future__ import annotations

import math
import random
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from m3r_app.arbiter.events import (
    ClaimLost,
    FrameMoved,
    GroundWorkEnded,
    LandingAsked,
    NeighboursHeard,
    PairingAnswered,
    Requested,
    ReservationAnswered,
    Stalled,
    TakeOffAsked,
    TelemetryArrived,
    Tick,
)
from m3r_app.arbiter.modes import mermaid
from m3r_app.arbiter.preview import preview
from m3r_app.arbiter.signals import SignalReader
from m3r_app.arbiter.state import Policy
from m3r_app.arbiter.step import step
from safety.limits import Limits
from safety.monitor import watch
from safety.supervisor import decide, interpret, propose
from safety.vocabulary import (
    Command,
    FlightMode,
    ManeuverRequest,
    Modality,
    Ned,
    Neighbours,
    ReservedVolume,
    State,
)
from tests import golden_parts
from tests.golden_scenes import situations, worlds
from tests.golden_text import line, shown
from tests.m3r_app.tabletop import Tabletop
from tests.m3r_app.test_arbiter import MADE, ball, every_event, flying, held, settling
from tests.safety.scene import NOW_S

FOLDER = Path(__file__).with_name("golden")
MOVES = [c for c in Command if c not in (Command.STOP, Command.ACTIVATE, Command.DISCONNECT, Command.CONTINUE)]


# ---------------------------------------------------------------- the arbiter


def _worked() -> Tabletop:
    table = Tabletop()
    table.put(TakeOffAsked("green", 5.0))
    return table


def _waits_for_rest() -> Tabletop:
    table = flying()
    table.ask(Command.GO_UP)
    return table


TABLES: dict[str, Callable[[], Tabletop]] = {
    **{state.value: make for state, make in MADE.items()},
    "TakingOff": _worked,
    "WaitsForRest": _waits_for_rest,
    "Stopped": lambda: settling().until(State.ARMED),
    "Scanning": lambda: flying(Command.TURN_LEFT),
    "HeldAsk": lambda: held(policy=Policy(return_to_anchor="ask", position_lost="land")),
    "DryRun": lambda: Tabletop(policy=Policy(dry_run=True, on_disconnect="resume")).paired(),
}


def arbiter(number: int) -> Iterator[str]:
    """Every event in one state, a little or much later, then what a preview says."""
    state, make = list(TABLES.items())[number]
    table = make()
    for each, event in enumerate(every_event(table)):
        after, effects = step(table.state, event, table.now_s + (0.3 if each % 4 else 4.0))
        yield line(f"{state}-{type(event).__name__}-{each}", f"{after.state.value} {len(effects)}", after, effects)
    for each, event in enumerate(_seldom(table)):
        vehicle = event.vehicle if isinstance(event, TelemetryArrived) else table.vehicle()
        then = [
            (0.1, event),
            (0.2, TelemetryArrived(vehicle)),
            (0.3, Tick()),
            (1.6, TelemetryArrived(vehicle)),
            (4.0, Tick()),
        ]
        state_now, told = table.state, []
        for later_s, what in then:
            if isinstance(what, TelemetryArrived):
                what = TelemetryArrived(replace(what.vehicle, at_s=table.now_s + later_s))  # noqa: PLW2901
            state_now, effects = step(state_now, what, table.now_s + later_s)
            told += effects
        yield line(
            f"{state}-{type(event).__name__}-seldom-{each}",
            f"{state_now.state.value} {len(told)}",
            state_now,
            told,
        )
    for command in Command:
        found = preview(table.state, table.request(command), table.now_s)
        yield line(f"{state}-preview-{command.value}", "", found)


def _seldom(table: Tabletop) -> list[Any]:
    """What `every_event` does not have."""
    vehicle, here = table.vehicle(), table.position
    lease = ReservedVolume("green", here, here.plus(Ned(1.0, 0.0, 0.0)), 1.0, table.now_s, table.now_s + 9.0)
    changes: list[dict[str, Any]] = [
        {"armed": False}, {"unasked_hold": True}, {"restarts": 1}, {"healthy": False}, {"battery": 0.1}, {"in_air": None},
        {"position": here.plus(Ned(1.0, -0.5, 0.2))}, {"position": here.plus(Ned(0.2, 0.2, 0.0))}, {"yaw_deg": vehicle.yaw_deg + 20.0},
        {"velocity": Ned(1.5, 0.0, 0.0)}, {"sigma_h_m": 8.0}, {"mode_at_s": table.now_s - 1.0}, {"in_air": False, "armed": False},
        {"flight_mode": FlightMode.UNKNOWN, "armed": False},
    ]  # fmt: skip
    return [
        *(TelemetryArrived(replace(vehicle, **each)) for each in changes),
        NeighboursHeard(table.sky, (lease,)),
        FrameMoved("its estimator moved"),
        ClaimLost("lost, silent for 5 s", silent=True),
        TakeOffAsked("red", 5.0),
        LandingAsked("red"),
        GroundWorkEnded("red"),
        PairingAnswered("red", (), table.operator),
        *(
            Requested(table.request(command, modality, 0.95, ago_s=0.2), 0.0)
            for command in (Command.GO_LEFT, Command.GO_UP, Command.GO_RIGHT, Command.CONTINUE, Command.TURN_LEFT)
            for modality in (Modality.GESTURE, Modality.VOICE)
        ),
    ]


def story(seed: int) -> Iterator[str]:
    """Half a minute of whatever may happen, by chance; the effects of every step count, and every seventh state."""
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
    reader = SignalReader(Limits())
    steps = [
        (shown(after) if i % 7 == 0 else "", shown(effects), reader.read(event, effects))
        for i, (_, event, after, effects) in enumerate(table.steps)
    ]
    for number, part in enumerate(steps[i : i + 60] for i in range(0, len(steps), 60)):
        yield line(f"story-{seed}-{number}", table.state.state.value, part)
    yield line(f"story-{seed}-said", str(len(table.said())), table.said(), mermaid())


HAPPENINGS = "ask ask ask ask again again stop sky volume mode silence gust grant late unsure stall frozen part pair pair jump ground".split()


def _happens(table: Tabletop, chance: random.Random) -> None:
    def one_of(things: list[Any]) -> Any:
        return things[int(chance.random() * len(things))]

    match one_of(HAPPENINGS):
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
        case "part":
            table.ask(Command.DISCONNECT)
        case "pair":
            table.ask(Command.ACTIVATE)
            table.wait(4.0)
        case "jump":
            table.position = table.position.plus(Ned(one_of([0.7, -0.9]), 0.0, 0.0))
        case "ground":
            table.in_air = False
            table.wait(one_of([0.2, 0.2, 1.6]))
            table.in_air = True
        case "frozen":
            table.put(TelemetryArrived(replace(table.vehicle(), velocity=Ned(1.5, 0.0, 0.0))))
            table.put(Tick())
    table.wait(one_of([0.2, 0.7, 1.5]))


# ---------------------------------------------------------------- the rules


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
    "arbiter": (arbiter, len(TABLES)),
    "stories": (story, 11),
    "rules": (rules, PARTS),
    "parts": (lambda number: golden_parts.PARTS[number](), len(golden_parts.PARTS)),
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
