"""The temporal properties hold of whole flights on the table-top, and each is falsified by a flight that breaks it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from m3r_app.arbiter.effects import Effect, Fly, Hold, Report
from m3r_app.arbiter.events import Event, Requested, ReservationAnswered
from m3r_app.arbiter.signals import SignalReader
from m3r_app.output import Action, DecisionEvent, ModeEvent, PairEvent, ViolationEvent
from safety.limits import Limits
from safety.properties import PropertyResult, Watch
from safety.vocabulary import Command, Modality, State, Verdict
from tests.m3r_app.tabletop import Tabletop

Steps = list[tuple[float, Event, tuple[Effect, ...]]]


class Timed(Tabletop):
    """Remembers when each step was taken."""

    def __init__(self, **settings: object) -> None:
        super().__init__(**settings)  # type: ignore[arg-type]
        self.at_s: list[float] = []

    def put(self, event: Event) -> tuple[Effect, ...]:
        self.at_s.append(self.now_s)
        return super().put(event)

    def taken(self) -> Steps:
        return [(at_s, event, effects) for at_s, (_, event, _, effects) in zip(self.at_s, self.steps, strict=True)]


def flight() -> Timed:
    """Flown, shortened at the workspace, refused for confidence, stopped, gone on with."""
    table = Timed(limits=replace(Limits(), workspace_m=1.5))
    table.paired()
    for command, confidence, wait_s in (
        (Command.GO_LEFT, 0.9, 8.0),
        (Command.GO_UP, 0.3, 2.0),
        (Command.GO_BACK, 0.9, 1.5),
        (Command.STOP, 0.1, 3.0),
        (Command.CONTINUE, 0.9, 8.0),
        (Command.GO_FORWARD, 0.9, 1.0),
        (Command.GO_RIGHT, 0.4, 4.0),
    ):
        table.ask(command, Modality.VOICE, confidence)
        table.wait(wait_s)
    table.ask(Command.DISCONNECT)
    table.wait(1.0)
    return table


def judged(steps: Steps) -> dict[str, PropertyResult]:
    reader, watch = SignalReader(replace(Limits(), workspace_m=1.5)), Watch()
    for at_s, event, effects in steps:
        watch.update(at_s, reader.read(event, effects))
    return {f"{result.of.requirement} {result.of.formula}": result for result in watch.results()}


@pytest.mark.requirement("P1", "P2", "P3", "R8", "R10", "G6", "X3", "X4", "X10")
def test_a_flight_holds_them_all() -> None:
    found = judged(flight().taken())
    assert [name for name, result in found.items() if not result.holds] == []
    vacuous = {name.split()[0] for name, result in found.items() if result.vacuous}
    assert vacuous <= {"R10", "P3"}, "what it does not come to is said"


def without(kind: type) -> Callable[[Steps], Steps]:
    return lambda steps: [(t, e, tuple(x for x in effects if not isinstance(x, kind))) for t, e, effects in steps]


def told_otherwise(kind: type, **fields: object) -> Callable[[Steps], Steps]:
    def change(effect: Effect) -> Effect:
        if isinstance(effect, Report) and isinstance(effect.told, kind):
            return Report(replace(effect.told, **fields))
        return effect

    return lambda steps: [(t, e, tuple(change(x) for x in effects)) for t, e, effects in steps]


def untold(kind: type) -> Callable[[Steps], Steps]:
    def kept(effect: Effect) -> bool:
        return not (isinstance(effect, Report) and isinstance(effect.told, kind))

    return lambda steps: [(t, e, tuple(x for x in effects if kept(x))) for t, e, effects in steps]


def faster(steps: Steps) -> Steps:
    def change(effect: Effect) -> Effect:
        if isinstance(effect, Fly):
            move = replace(effect.plan.move, speed=9.0, distance=99.0)
            return Fly(replace(effect.plan, move=move))
        return effect

    return [(t, e, tuple(change(x) for x in effects)) for t, e, effects in steps]


def ungranted(steps: Steps) -> Steps:
    return [
        (t, replace(e, answer="denied") if isinstance(e, ReservationAnswered) else e, effects)
        for t, e, effects in steps
    ]


def flown_after_stop(steps: Steps) -> Steps:
    """What was flown first is flown once more, right after STOP."""
    fly = next(x for _, _, effects in steps for x in effects if isinstance(x, Fly))
    at = next(i for i, (_, e, _) in enumerate(steps) if isinstance(e, Requested) and e.request.command is Command.STOP)
    grant = ReservationAnswered("r1", "granted")
    return [*steps[: at + 1], (steps[at][0], grant, (fly,)), *steps[at + 1 :]]


def aborted_without_a_hold(steps: Steps) -> Steps:
    at = next(i for i, (_, _, effects) in enumerate(steps) if any(isinstance(x, Fly) for x in effects)) + 3
    broken = ViolationEvent("actual", ("R4",), "terrain_clearance", -0.1, Action.ABORT, "too low")
    t, event, effects = steps[at]
    return [*steps[:at], (t, event, (*effects, Report(broken))), *steps[at + 1 :]]


def longer_than_asked(steps: Steps) -> Steps:
    return told_otherwise(DecisionEvent, verdict=Verdict.REDUCED, requested_m=0.5, granted_m=0.9)(steps)


@pytest.mark.parametrize(
    ("change", "broken"),
    [
        (untold(PairEvent), "P1"),
        (untold(DecisionEvent), "P2"),
        (longer_than_asked, "P3"),
        (faster, "R8"),
        (faster, "G6"),
        (aborted_without_a_hold, "R10"),
        (untold(ModeEvent), "X3"),
        (without(Hold), "X4"),
        (flown_after_stop, "X4"),
        (ungranted, "X10"),
    ],
)
def test_a_flight_that_breaks_one_is_found(change: Callable[[Steps], Steps], broken: str) -> None:
    found = judged(change(flight().taken()))
    assert broken in {name.split()[0] for name, result in found.items() if not result.holds}


def test_the_state_is_followed_from_what_is_told() -> None:
    reader = SignalReader(Limits())
    table = flight()
    for (_, event, after, effects), signals in ((step, reader.read(step[1], step[3])) for step in table.steps):
        assert (signals["emergency"] > 0) == (after.state is State.EMERGENCY_HOLD), (event, effects)
