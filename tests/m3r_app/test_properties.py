"""The temporal properties hold of whole flights on the table-top, and each is falsified by a flight that breaks it."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import pytest

from m3r_app.arbiter.effects import Effect, FaceOperator, Fly, Hold, Report
from m3r_app.arbiter.events import (
    Event,
    PairingAnswered,
    PropertyBroken,
    Requested,
    ReservationAnswered,
    Stalled,
    TelemetryArrived,
    Tick,
)
from m3r_app.arbiter.margins import SIGNAL_OF
from m3r_app.arbiter.signals import SignalReader
from m3r_app.arbiter.state import ArbiterState, Policy
from m3r_app.arbiter.step import step
from m3r_app.output import (
    Action,
    DecisionEvent,
    FindingTold,
    ModeEvent,
    PairEvent,
    PairStatus,
    RequestEvent,
    ViolationEvent,
)
from m3r_app.property_watch import PropertyWatch
from m3r_app.step_record import codec
from safety.constraints import RULES
from safety.limits import Limits
from safety.planner import plan_translation
from safety.properties import LITERAL, NO_PROPERTY, PROPERTIES, R11_AS_DESIGNED, PropertyResult, Watch
from safety.requirements import REQUIREMENTS
from safety.temporal import monitor
from safety.vocabulary import Cause, Command, ManeuverRequest, Modality, Mode, Ned, Primitive, State, Verdict
from tests.m3r_app.tabletop import FLAT, OPERATOR, Tabletop
from tests.m3r_app.tabletop_app import TabletopApp

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


@cache
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
        (Command.TURN_LEFT, 0.9, 30.0),
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
    assert vacuous == {"R10", "X5", "X7"}, "what it does not come to is said"


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


def _faster(effect: Effect) -> Effect:
    if isinstance(effect, Fly):
        return Fly(replace(effect.plan, move=replace(effect.plan.move, speed=9.0, distance=99.0)))
    return effect


def faster(steps: Steps) -> Steps:
    return [(t, e, tuple(_faster(x) for x in effects)) for t, e, effects in steps]


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


def judged_otherwise(rule: str, change: Callable[[FindingTold], tuple[FindingTold, ...]]) -> Callable[[Steps], Steps]:
    """What the decisions say of one rule is something else."""

    def changed(findings: tuple[FindingTold, ...]) -> tuple[FindingTold, ...]:
        return tuple(x for f in findings for x in (change(f) if f.constraint == rule else (f,)))

    def told(effect: Effect) -> Effect:
        if isinstance(effect, Report) and isinstance(effect.told, DecisionEvent):
            one = effect.told
            new = replace(one, findings=changed(one.findings), granted_findings=changed(one.granted_findings))
            return Report(new)
        return effect

    return lambda steps: [(t, e, tuple(told(x) for x in effects)) for t, e, effects in steps]


def failing(rule: str) -> Callable[[Steps], Steps]:
    return judged_otherwise(rule, lambda f: (replace(f, margin=-0.2, passed=False),))


def unasked(rule: str) -> Callable[[Steps], Steps]:
    return judged_otherwise(rule, lambda _: ())


def twice(steps: Steps) -> Steps:
    """The first maneuver begins once more when it is over."""
    at = next(i for i, (_, _, effects) in enumerate(steps) if any(isinstance(x, Fly) for x in effects))
    return [*steps, (steps[-1][0], *steps[at][1:])]


def while_flying(*more: Effect, event: Event = Tick()) -> Callable[[Steps], Steps]:  # noqa: B008  (it is frozen)
    """In the middle of the first maneuver, this step."""

    def change(steps: Steps) -> Steps:
        at = next(i for i, (_, _, effects) in enumerate(steps) if any(isinstance(x, Fly) for x in effects)) + 2
        return [*steps[:at], (steps[at][0], event, more), *steps[at:]]

    return change


def unheard(steps: Steps) -> Steps:
    return [(t, Tick() if isinstance(e, TelemetryArrived) else e, effects) for t, e, effects in steps]


def unaccepted(steps: Steps) -> Steps:
    return [
        (t, replace(e, reasons=("not ready",)) if isinstance(e, PairingAnswered) else e, effects)
        for t, e, effects in steps
    ]


def spinning(steps: Steps) -> Steps:
    def change(effect: Effect) -> Effect:
        if isinstance(effect, Fly) and effect.plan.primitive.is_scan:
            return Fly(replace(effect.plan, turn=replace(effect.plan.turn, speed=90.0, acceleration=90.0)))
        return effect

    return [(t, e, tuple(change(x) for x in effects)) for t, e, effects in steps]


def flown_while_flying(steps: Steps) -> Steps:
    fly = next(x for _, _, effects in steps for x in effects if isinstance(x, Fly))
    return while_flying(fly, event=ReservationAnswered("r9", "granted"))(steps)


CONTRADICTED = Report(
    DecisionEvent(
        "r9",
        Verdict.REJECTED,
        None,
        None,
        (FindingTold(("X5",), "contradiction", None, "", False, "voice says left but panel said right"),),
    )
)


def longer_than_asked(steps: Steps) -> Steps:
    return told_otherwise(DecisionEvent, verdict=Verdict.REDUCED, requested_m=0.5, granted_m=0.9)(steps)


OF_RULE = {
    "authority": "P2",
    "input_confidence": "G1",
    "localization": "R11",
    "terrain_confidence": "R11",
    "neighbour_age": "R11",
    "envelope": "R8",
    "workspace": "R7",
    "session": "X1",
    "geofence": "G4",
    "standoff": "X2",
    "terrain_clearance": "R4",
    "agl": "G5",
    "obstacle_clearance": "R4",
    "separation": "R6",
    "reservation": "R5",
}
"""The property that each rule's margin is in."""


@pytest.mark.requirement("R1", "R4", "R5", "R6", "R7", "R8", "R11", "G1", "G2", "G3", "G4", "G5", "X1", "X2", "X5")
@pytest.mark.requirement("X6", "X7", "X8", "X9", "X14")
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
        (untold(RequestEvent), "R1"),
        (twice, "X5"),
        (while_flying(CONTRADICTED), "X5"),
        (unheard, "X6"),
        (while_flying(event=Stalled("it stalled")), "X7"),
        (unaccepted, "X8"),
        (spinning, "X9"),
        (flown_while_flying, "X14"),
        *((change(rule), broken) for change in (failing, unasked) for rule, broken in OF_RULE.items()),
    ],
)
def test_a_flight_that_breaks_one_is_found(change: Callable[[Steps], Steps], broken: str) -> None:
    found = judged(change(flight().taken()))
    assert broken in {name.split()[0] for name, result in found.items() if not result.holds}


def test_every_requirement_is_a_property_or_says_why_not() -> None:
    stated = {name for one in (*PROPERTIES, R11_AS_DESIGNED) for name in (one.requirement, *one.also)}
    assert stated.isdisjoint(NO_PROPERTY)
    by_rules = {name for rule in RULES for name in rule.constraint.requirements}  # of every rule: P2, the least margin
    assert stated | by_rules | NO_PROPERTY.keys() == REQUIREMENTS.keys()
    assert SIGNAL_OF.keys() <= {rule.name for rule in RULES}


def test_every_signal_that_a_property_names_is_told() -> None:
    told = SignalReader(Limits()).read(Tick(), ())
    for one in (*PROPERTIES, R11_AS_DESIGNED, LITERAL):
        assert monitor(one.formula).names <= told.keys(), one


def test_what_is_only_mended_and_what_is_near_nothing_holds() -> None:
    mends = judged_otherwise("agl", lambda f: (replace(f, margin=-0.2, passed=True),))
    alone = judged_otherwise("separation", lambda f: (replace(f, margin=None, passed=True),))
    found = judged(alone(mends(flight().taken())))
    assert found["G5 granting -> agl_m >= 0"].robustness == 0.0
    assert found["R6 granting -> separation_m >= 0"].holds
    unknown = judged(judged_otherwise("agl", lambda f: (replace(f, margin=None, passed=False),))(flight().taken()))
    assert unknown["G5 granting -> agl_m >= 0"].robustness == -1.0, "as false as that it was granted is true"


def test_the_state_is_followed_from_what_is_told() -> None:
    reader = SignalReader(Limits())
    table = flight()
    for (_, event, after, effects), signals in ((one, reader.read(one[1], one[3])) for one in table.steps):
        assert (signals["emergency"] > 0) == (after.state is State.EMERGENCY_HOLD), (event, effects)


# ---------------------------------------------------------------- a property that does not hold, in flight


BROKEN = PropertyBroken("X4", "stop & authority -> hold", "STOP holds at once")


def idle() -> Tabletop:
    return Tabletop()


def facing() -> Tabletop:
    table = Tabletop()
    table.neighbours()
    table.tell()
    table.ask(Command.ACTIVATE)
    return table


def armed() -> Tabletop:
    return Tabletop().paired()


def flying() -> Tabletop:
    table = armed()
    table.ask(Command.GO_LEFT)
    return table.wait(1.0)


def asking(table: Tabletop) -> Tabletop:
    table.grant = None
    table.ask(Command.GO_UP)
    return table


def asking_while_held() -> Tabletop:
    table = flying()
    table.put(BROKEN)
    return asking(table.wait(3.0))


@pytest.mark.requirement("R10", "X4")
@pytest.mark.parametrize(
    ("made", "before", "after"),
    [
        (idle, State.IDLE, State.IDLE),
        (facing, State.FACING, State.IDLE),
        (armed, State.ARMED, State.ARMED),
        (flying, State.EXECUTING, State.EMERGENCY_HOLD),
        (lambda: asking(armed()), State.PLANNED, State.SETTLING),
        (asking_while_held, State.PLANNED, State.EMERGENCY_HOLD),
    ],
)
def test_a_property_that_does_not_hold_is_a_violation_and_a_hold(
    made: Callable[[], Tabletop], before: State, after: State
) -> None:
    table = made()
    assert table.state.state is before
    violations, ours = table.state.tally.violations, table.state.authority
    effects = table.put(BROKEN)
    assert table.state.state is after
    assert table.state.tally.violations == violations + 1
    assert table.reports("violation")[-1]["requirements"] == ["X4"]
    assert isinstance(effects[0], Hold) == ours
    assert table.state.flight is None and table.state.deciding is None and table.state.pending is None
    table.grant = "granted"
    flown = len(table.effects(Fly))
    table.wait(6.0)
    assert len(table.effects(Fly)) == flown, "nothing flies that nobody asks for"


def too_fast(state: ArbiterState, event: Event, now_s: float) -> tuple[ArbiterState, tuple[Effect, ...]]:
    """An arbiter with a fault: it flies everything 99 m far, at up to 9 m/s."""
    after, effects = step(state, event, now_s)
    return after, tuple(_faster(effect) for effect in effects)


@pytest.mark.requirement("R8", "R10")
@pytest.mark.parametrize(("arbiter", "broken"), [(step, False), (too_fast, True)])
def test_a_faulty_arbiter_is_stopped_by_the_shell(
    arbiter: Callable[..., object], broken: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The shell watches every step; what it finds is the next event, before all that waits, and so in the record."""
    table = Timed()
    table.paired().ask(Command.GO_LEFT)
    table.wait(1.0)
    monkeypatch.setattr("m3r_app.runtime.step", arbiter)

    async def replayed() -> TabletopApp:
        app = TabletopApp()
        shell = app.shell
        shell.state = ArbiterState(Limits(), Policy())
        for at_s, event, _ in table.taken():
            shell.clock = lambda at_s=at_s: at_s  # type: ignore[misc]
            app.put(Tick())
            shell.take(event)
            first = await shell.inbox.get()
            if isinstance(first, PropertyBroken):  # before the tick that waited
                shell.take(first)
                break
            while not shell.inbox.empty:  # the tick, and what the shell's own airspace answers: the table's has
                await shell.inbox.get()
        await shell.close()
        return app

    app = asyncio.run(replayed())
    taken = [data for topic, data in app.recorded if topic == "step"]
    found = [data for data in taken if isinstance(data["event"], PropertyBroken)]
    assert bool(found) is broken
    if broken:
        assert app.shell.state.state is State.EMERGENCY_HOLD
        assert taken[-1] is found[0] and isinstance(found[0]["effects"][0], Hold)  # type: ignore[index]
        assert [one.requirements for one in app.output if isinstance(one, ViolationEvent)] == [("R8",)]
        text = codec()
        assert text.value(json.loads(text.text(found[0]["event"]))) == found[0]["event"], "it can be replayed"


def test_what_goes_on_not_to_hold_is_told_once() -> None:
    watch = PropertyWatch(Limits())
    armed = Report(ModeEvent(Mode.ARMED, Mode.ARMED, State.ARMED, Cause.FACING_OPERATOR))
    assert [one.requirement for one in watch.after(Tick(), (armed,), 1.0)] == ["P1"]
    assert watch.after(PairingAnswered("red", (), OPERATOR, FLAT), (), 1.1) == (), "still not paired, and told"
    confirmed = Report(PairEvent("red", PairStatus.CONFIRMED))
    released = Report(PairEvent("red", PairStatus.RELEASED))
    assert watch.after(Tick(), (confirmed,), 1.2) == ()
    assert [one.requirement for one in watch.after(Tick(), (released,), 1.3)] == ["P1"], "once more"


# ---------------------------------------------------------------- the signals, step by step


def found(passed: bool, constraint: str = "agl") -> FindingTold:
    return FindingTold((), constraint, None, "", passed, "")


def decided(verdict: Verdict, *passed: bool, granted: tuple[bool, ...] = (), why: str = "agl") -> Report:
    findings = tuple(found(one, why) for one in passed)
    return Report(DecisionEvent("r", verdict, 1.0, 0.4, findings, tuple(found(one) for one in granted)))


def mode(state: State) -> Report:
    return Report(ModeEvent(Mode.ARMED, Mode.ARMED, state, Cause.TOLD))


PLAN = plan_translation(Primitive.MOVE_LEFT, Ned(10.0, 0.0, -10.0), 180.0, Ned(0.0, 0.0, 0.0), 0.5, Limits())
ASKED = ManeuverRequest("r", Command.STOP, Modality.VOICE, 0.9, 1.0, 1.0)


@pytest.mark.parametrize(
    ("event", "effects", "signals"),
    [
        (Tick(), (), {"stop": -1, "hold": -1, "commanded": -1, "start": -1, "start_any": -1, "granted": -1, "peak_m_s": 0}),
        (Tick(), (), {"asked_m": 0, "granted_m": 0, "length_m": 0, "duration_s": 0, "duration_limit_s": 0, "low": -1}),
        (Tick(), (), {"speed_limit_m_s": 0.5, "length_limit_m": 1.0, "cleared": -1, "reduced": -1, "aborting": -1}),
        (Requested(ASKED, 0.0), (Hold("stop"),), {"stop": 1, "hold": 1, "commanded": 1}),
        (Requested(replace(ASKED, command=Command.GO_UP), 0.0), (FaceOperator(1.0),), {"stop": -1, "hold": -1, "commanded": 1}),
        (Tick(), (Fly(PLAN),), {"start": 1, "start_any": 1, "commanded": 1, "length_m": 0.5, "peak_m_s": 0.5}),
        (Tick(), (Fly(PLAN),), {"duration_s": PLAN.duration_s, "duration_limit_s": PLAN.max_duration_s}),
        (Tick(), (Fly(PLAN), mode(State.RETURN_TO_ANCHOR), mode(State.ARMED)), {"start": -1, "start_any": 1}),
        (Tick(), (mode(State.EXECUTING),), {"armed": 1, "flying": 1, "authority": 1, "blocked": -1, "emergency": -1}),
        (Tick(), (mode(State.RETURN_TO_ANCHOR),), {"armed": 1, "flying": 1}),
        (Tick(), (mode(State.FACING),), {"armed": -1, "flying": -1, "authority": 1}),
        (Tick(), (mode(State.PAIRING),), {"armed": -1, "authority": -1}),
        (Tick(), (mode(State.BLOCKED),), {"blocked": 1, "flying": -1}),
        (Tick(), (mode(State.EMERGENCY_HOLD),), {"emergency": 1}),
        (Tick(), (Report(PairEvent("red", PairStatus.CONFIRMED)),), {"paired": 1}),
        (Tick(), (Report(PairEvent("red", PairStatus.REFUSED)),), {"paired": -1}),
        (Tick(), (Report(PairEvent("red", PairStatus.CONFIRMED)), Report(PairEvent("b", PairStatus.REFUSED))), {"paired": 1}),
        (Tick(), (Report(PairEvent("red", PairStatus.CONFIRMED)), Report(PairEvent("b", PairStatus.RELEASED))), {"paired": -1}),
        (ReservationAnswered("r", "granted"), (), {"granted": 1}),
        (ReservationAnswered("r", "denied"), (), {"granted": -1}),
        (Tick(), (decided(Verdict.APPROVED, True, True),), {"cleared": 1, "reduced": -1, "asked_m": 0}),
        (Tick(), (decided(Verdict.APPROVED, True, False),), {"cleared": -1}),
        (Tick(), (decided(Verdict.REJECTED, True),), {"cleared": -1, "low": -1}),
        (Tick(), (decided(Verdict.REDUCED, False, granted=(True,)),), {"cleared": 1, "reduced": 1, "asked_m": 1.0, "granted_m": 0.4}),
        (Tick(), (decided(Verdict.REDUCED, True, granted=(False, True)),), {"cleared": -1, "reduced": 1}),
        (Tick(), (decided(Verdict.REJECTED, False, True, why="input_confidence"),), {"low": 1}),
        (Tick(), (decided(Verdict.REJECTED, False, False, why="input_confidence"),), {"low": -1}),
        (Tick(), (decided(Verdict.DELAYED, False, why="input_confidence"),), {"low": -1}),
        (Tick(), (decided(Verdict.REJECTED, False), decided(Verdict.REJECTED, False, why="input_confidence")), {"low": 1}),
        (Tick(), (Report(ViolationEvent("actual", (), "agl", -1.0, Action.ABORT, "")),), {"aborting": 1}),
        (Tick(), (Report(ViolationEvent("actual", (), "agl", -1.0, Action.MENDING, "")),), {"aborting": -1}),
        (Tick(), (Report(RequestEvent("r", Command.GO_UP, Modality.VOICE, 0.9, "", 1.0)),), {"request": 1}),
        (Tick(), (Report(RequestEvent("r", Command.STOP, Modality.VOICE, 0.9, "", 1.0)),), {"request": -1}),
    ],
)  # fmt: skip
def test_what_a_step_says(event: Event, effects: tuple[Effect, ...], signals: dict[str, float]) -> None:
    read = SignalReader(Limits()).read(event, effects)
    assert {name: read[name] for name in signals} == pytest.approx(signals, abs=1e-8)
    assert read["speed_limit_m_s"] > 0.5 and read["length_limit_m"] > 1.0, "rounding is no violation"


def test_authority_lasts_for_the_step_that_ends_it() -> None:
    reader = SignalReader(Limits())
    said = [
        reader.read(Tick(), effects)["authority"] for effects in ((), (mode(State.ARMED),), (mode(State.IDLE),), ())
    ]
    assert said == [-1.0, 1.0, 1.0, -1.0]
