"""The arbiter explored breadth first: every abstract state that real events lead to, against every event of an alphabet.

An abstract state is what `abstract` keeps of an arbiter's state; the first concrete state found of each stands for it. So what is
found wrong is wrong, and what is not found may still be hidden within an abstract state: the random histories of
tests/m3r_app/test_arbiter.py look there.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

from m3r_app.arbiter.effects import Effect, Fly, Hold, Report
from m3r_app.arbiter.events import (
    ClaimLost,
    Ended,
    Event,
    FrameMoved,
    NeighboursHeard,
    PairingAnswered,
    PairingAsked,
    PropertyBroken,
    Requested,
    ReservationAnswered,
    Stalled,
    TelemetryArrived,
    Tick,
)
from m3r_app.arbiter.modes import DECIDING, MODE_OF
from m3r_app.arbiter.state import ArbiterState, Policy
from m3r_app.arbiter.step import step
from safety.estimate import spans_s
from safety.limits import Limits
from safety.vocabulary import (
    Cause,
    Command,
    FlightMode,
    ManeuverRequest,
    Modality,
    Mode,
    Ned,
    Neighbours,
    Primitive,
    ReservedVolume,
    State,
    VehicleState,
    Verdict,
)
from tests.formal.justified import Entry
from tests.m3r_app.tabletop import FLAT, OPERATOR, PLACE, ball, check_step

NAN = math.nan
REST = (State.IDLE, State.ARMED, State.EMERGENCY_HOLD)


@dataclass(frozen=True)
class Happening:
    """An event of the alphabet: how it is made of a state and the time, and how long after the last one it comes."""

    name: str
    after_s: float
    make: Callable[[ArbiterState, float], Event]
    times: int = 1
    """It happens again and again so often, or until the state changes."""


# ---------------------------------------------------------------- what can happen


def vehicle(state: ArbiterState, now_s: float, *, still: bool = True) -> VehicleState:
    """The drone where its plan has it, or where it was, facing the operator or as planned."""
    velocity = Ned(0.0, 0.0, 0.0) if still else Ned(0.0, 0.4, 0.0)
    if state.flight is not None:
        plan, t_s = state.flight.plan, now_s - state.flight.started_at_s
        at, yaw_deg = plan.position(t_s), plan.yaw_deg(t_s)
        velocity = velocity.plus(Ned(*(c / 0.05 for c in at.minus(plan.position(t_s - 0.05)))))
    else:
        known = state.vehicle is not None and state.vehicle.position.finite
        at = state.vehicle.position if state.vehicle is not None and known else PLACE
        yaw_deg = math.degrees(math.atan2(-at.east, -at.north))
    return VehicleState(
        now_s, at, velocity, yaw_deg, 0.0, 0.1, 0.1, healthy=True, in_air=True, flight_mode=FlightMode.OFFBOARD
    )


def told(name: str, after_s: float = 0.1, *, still: bool = True, times: int = 1, **other: object) -> Happening:
    return Happening(name, after_s, lambda s, n: TelemetryArrived(replace(vehicle(s, n, still=still), **other)), times)


def asked(
    command: Command,
    modality: Modality = Modality.VOICE,
    confidence: float = 0.9,
    ago_s: float = 0.0,
    colour: str | None = "red",
) -> Happening:
    def make(_state: ArbiterState, now_s: float) -> Event:
        name = f"{now_s:.3f} {command} {modality}"
        return Requested(
            ManeuverRequest(name, command, modality, confidence, now_s - ago_s, now_s - ago_s, "", colour), 0.0
        )

    return Happening(f"{command} by {modality}, {confidence}, {ago_s} s ago, {colour}", 0.02, make)


def answered(answer: str, *, ours: bool = True) -> Happening:
    def make(state: ArbiterState, _now_s: float) -> Event:
        name = "nobody"
        if ours and state.deciding is not None:
            name = state.deciding.ask_id or name
        elif ours and state.flight is not None:
            name = state.flight.request_id
        return ReservationAnswered(name, answer)  # type: ignore[arg-type]

    return Happening(f"volume {answer}{'' if ours else ' for nobody'}", 0.02, make)


def _beside(state: ArbiterState, now_s: float) -> Event:
    """Near enough to shorten a move to the left."""
    return NeighboursHeard(
        ball("blue", vehicle(state, now_s).position.plus(Ned(0.0, -5.0, 0.0)), Ned(0.0, 0.0, 0.0), now_s)
    )


def _near(state: ArbiterState, now_s: float) -> Event:
    return NeighboursHeard(
        ball("blue", vehicle(state, now_s).position.plus(Ned(2.5, 0.0, 0.0)), Ned(0.0, 0.0, 0.0), now_s)
    )


def _lease(state: ArbiterState, now_s: float) -> Event:
    at = vehicle(state, now_s).position.plus(Ned(0.0, -2.0, 0.0))
    return NeighboursHeard(Neighbours.none(math.inf), (ReservedVolume("zoe", at, at, 1.5, now_s, now_s + 1.0),))


ALPHABET: tuple[Happening, ...] = (
    *(asked(c, m) for c in (Command.GO_LEFT, Command.TURN_LEFT, Command.CONTINUE) for m in (Modality.VOICE, Modality.GESTURE)),
    asked(Command.GO_UP), asked(Command.GO_LEFT, confidence=0.1), asked(Command.GO_LEFT, Modality.GESTURE, NAN),
    asked(Command.GO_LEFT, ago_s=30.0), asked(Command.STOP), asked(Command.STOP, Modality.GESTURE, NAN, NAN),
    asked(Command.ACTIVATE), asked(Command.ACTIVATE, colour="blue"), asked(Command.DISCONNECT),
    Happening("asked to pair", 0.02, lambda _s, _n: PairingAsked("red")),
    Happening("pairing accepted", 0.02, lambda _s, _n: PairingAnswered("red", (), OPERATOR, FLAT)),
    Happening("pairing refused", 0.02, lambda _s, _n: PairingAnswered("red", ("no",))),
    told("rests"), told("is told of all along", 0.2, times=40), told("moves", still=False), told("after a gap", 1.5),
    told("unhealthy", healthy=False), told("nowhere", position=Ned(NAN, NAN, NAN)), told("uncertain", sigma_h_m=30.0),
    told("flown by a pilot", flight_mode=FlightMode.POSITION), told("held by somebody", flight_mode=FlightMode.HOLD),
    told("in a mode unknown", flight_mode=FlightMode.UNKNOWN), told("on the ground", 1.3, in_air=False),
    Happening("sky clear", 0.02, lambda _s, _n: NeighboursHeard(Neighbours.none(math.inf))),
    Happening("somebody beside", 0.02, _beside), Happening("somebody near", 0.02, _near), Happening("a lease in the way", 0.02, _lease),
    Happening("feed dead", 0.02, lambda _s, n: NeighboursHeard(Neighbours.none(n - 3.0))),
    answered("granted"), answered("denied"), answered("expired"), answered("granted", ours=False),
    Happening("stalled", 0.02, lambda _s, _n: Stalled("it stalled")),
    Happening("frame moved", 0.02, lambda _s, _n: FrameMoved("the frame moved")),
    Happening("property broken", 0.02, lambda _s, _n: PropertyBroken("X4", "stop -> hold", "STOP holds at once")),
    Happening("claim lost", 0.02, lambda _s, _n: ClaimLost("the claim is lost")),
    Happening("run ended", 0.02, lambda _s, _n: Ended("the run is over")),
    *(Happening(f"tick after {s} s", s, lambda _s, _n: Tick()) for s in (0.1, 1.1, 3.1, 10.1, 31.0)),
)  # fmt: skip


# ---------------------------------------------------------------- what is kept of a state


def abstract(s: ArbiterState, now_s: float) -> tuple[object, ...]:
    """Everything that a branch of the arbiter looks at, cut into a few classes each."""

    def age(at_s: float) -> int:
        age_s = now_s - at_s
        return -1 if math.isnan(age_s) else sum(age_s > limit for limit in (-math.inf, 0.5, 3.0))

    v = s.vehicle
    known = None if v is None else (age(v.at_s), v.position.finite, v.healthy, s.motion.rests(s.noise, s.limits))
    if s.session is None or s.session.anchor is None:
        seen_s = spans_s(s.session.hover) if s.session is not None else 0.0
        return (
            s.state,
            s.pairing,
            s.pairing_off is not None,
            known,
            seen_s >= s.limits.hover_s,
            s.down_since_s is not None,
        )
    f, d = s.flight, s.deciding
    return (
        s.state,
        s.held,
        None
        if f is None
        else (f.plan.primitive, f.asked_for, bool(f.baseline), now_s - f.started_at_s > f.plan.duration_s),
        None
        if d is None
        else (d.decision.verdict, d.intent.primitive.is_scan, d.request is None, now_s > d.deadline_s),
        None if s.pending is None else s.pending.command is Command.CONTINUE,
        None
        if s.leftover is None
        else (s.leftover.primitive.is_scan, now_s - s.leftover.at_s > s.limits.continue_within_s),
        s.may_return,
        None if s.return_at_s is None else now_s >= s.return_at_s,
        bool(s.breached),
        len({r.request.command for r in s.recent if abs(now_s - r.request.captured_at_s) <= s.limits.fusion_window_s}),
        known,
        s.settling_since_s is not None and now_s - s.settling_since_s > s.limits.settling_timeout_s,
        s.down_since_s is not None,
        age(s.neighbours.feed_at_s),
        min(len(s.neighbours), 1),
        min(len(s.reservations), 1),
    )


# ---------------------------------------------------------------- what must hold of every step


@dataclass(frozen=True)
class Taken:
    """One step."""

    before: ArbiterState
    event: Event
    after: ArbiterState
    effects: tuple[Effect, ...]

    @property
    def decisions(self) -> list[dict[str, object]]:
        return [e.fields for e in self.effects if isinstance(e, Report) and e.event == "decision"]

    @property
    def flies(self) -> bool:
        return any(isinstance(e, Fly) for e in self.effects)

    def asks(self, *commands: Command) -> bool:
        return isinstance(self.event, Requested) and self.event.request.command in commands


def _well_formed(t: Taken) -> bool:
    check_step(t.before, t.event, t.after, t.effects)
    return True


def _armed_is_paired(t: Taken) -> bool:
    paired = t.after.session is not None and t.after.session.anchor is not None
    return paired or MODE_OF[t.after.state] is Mode.NORMAL_AUTONOMY


def _flown_is_approved(t: Taken) -> bool:
    if not t.flies or t.after.flight is None or not t.after.flight.asked_for:
        return True
    mine = [d for d in t.decisions if d["request"] == t.after.flight.request_id]
    return bool(mine) and mine[-1]["verdict"] in (Verdict.APPROVED, Verdict.REDUCED)


def _reduced_is_less(t: Taken) -> bool:
    reduced = [d for d in t.decisions if d["verdict"] is Verdict.REDUCED]
    return all(d["granted_m"] < d["requested_m"] for d in reduced)  # type: ignore[operator]


def _granted_is_flown(t: Taken) -> bool:
    return not t.flies or (isinstance(t.event, ReservationAnswered) and t.event.answer == "granted")


def _stop_holds(t: Taken) -> bool:
    if not t.asks(Command.STOP) or not t.before.authority:
        return True
    none_left = t.after.flight is t.after.deciding is t.after.pending is None and not t.after.may_return
    return isinstance(t.effects[0], Hold) and none_left


def _doubt_never_flies(t: Taken) -> bool:
    unsure = isinstance(t.event, Requested) and not t.event.request.confidence >= 0.5
    return not (unsure and t.flies)


def _blocked_has_a_reason(t: Taken) -> bool:
    said = [d for d in t.decisions if d["verdict"] in (Verdict.REJECTED, Verdict.REPLACED)]
    return t.after.state is not State.BLOCKED or bool(said)


def _hold_is_left_by_approval(t: Taken) -> bool:
    inside = t.before.state is State.EMERGENCY_HOLD or t.before.held
    still = t.after.state in (State.EMERGENCY_HOLD, State.IDLE) or t.after.held
    return not inside or still or (t.flies and t.after.state in (State.EXECUTING, State.RETURN_TO_ANCHOR))


def _way_back_only_from_hold(t: Taken) -> bool:
    begins = t.flies and t.after.flight is not None and t.after.flight.plan.primitive is Primitive.RETURN
    return not begins or t.before.state is State.EMERGENCY_HOLD or t.before.held


def _takeover_is_not_fought(t: Taken) -> bool:
    taken = isinstance(t.event, TelemetryArrived) and t.event.vehicle.flight_mode == FlightMode.POSITION
    return not (taken and t.before.authority) or (
        not t.after.authority and not any(isinstance(e, Hold | Fly) for e in t.effects)
    )


INVARIANTS: dict[str, tuple[tuple[str, ...], Callable[[Taken], bool]]] = {
    "every step is well formed: transitions are the tables', STOP holds first, nothing is commanded without authority": (("X3", "X4", "X10"), _well_formed),
    "no mode but NormalAutonomy without a pairing": (("P1",), _armed_is_paired),
    "what is flown was approved in the same step": (("P2",), _flown_is_approved),
    "what is reduced is less than was asked": (("P3",), _reduced_is_less),
    "only a grant is flown": (("X10",), _granted_is_flown),
    "STOP holds, and nothing that waits or returns is left": (("X4",), _stop_holds),
    "a request in doubt never flies": (("R11", "G1"), _doubt_never_flies),
    "Blocked is told with a refusal": (("P3",), _blocked_has_a_reason),
    "EmergencyHold is left by an approval or with the session": (("R10",), _hold_is_left_by_approval),
    "a way back begins in EmergencyHold": (("R10",), _way_back_only_from_hold),
    "a takeover ends the session and is not fought": (("X3",), _takeover_is_not_fought),
}  # fmt: skip


ABOUT: dict[str, Callable[[Taken], bool]] = {
    "a flight begins": lambda t: t.flies,
    "a way back begins": lambda t: t.flies and t.after.state is State.RETURN_TO_ANCHOR,
    "reduced": lambda t: any(d["verdict"] is Verdict.REDUCED for d in t.decisions),
    "STOP while paired": lambda t: t.asks(Command.STOP) and t.before.authority,
    "in doubt": lambda t: isinstance(t.event, Requested) and not t.event.request.confidence >= 0.5,
    "Blocked": lambda t: t.after.state is State.BLOCKED,
    "in EmergencyHold": lambda t: t.before.state is State.EMERGENCY_HOLD,
    "held": lambda t: t.before.held,
    "taken over": lambda t: (
        t.before.authority
        and isinstance(t.event, TelemetryArrived)
        and t.event.vehicle.flight_mode == FlightMode.POSITION
    ),
    "paired": lambda t: t.after.session is not None and t.after.session.anchor is not None,
}
"""What the invariants speak of: one that never comes about would hold for want of it."""


# ---------------------------------------------------------------- the search


Node = tuple[ArbiterState, float]
Key = tuple[object, ...]


@dataclass
class Explored:
    """What was found. nodes: a representative for each abstract state; onward: which lead to which."""

    nodes: dict[Key, Node] = field(default_factory=dict)
    onward: dict[Key, set[Key]] = field(default_factory=dict)
    entries: set[Entry] = field(default_factory=set)
    broken: list[tuple[str, str, str]] = field(default_factory=list)
    steps: int = 0
    met: Counter[str] = field(default_factory=Counter)
    """How often what the invariants are about was there at all."""
    whole: bool = True
    """Whether every abstract state found was also expanded."""

    def edges(self) -> int:
        return sum(map(len, self.onward.values()))

    def without_way_to_rest(self) -> set[Key]:
        """Abstract states that were expanded and from which no state of rest is reached."""
        back: dict[Key, set[Key]] = {}
        for here, there in self.onward.items():
            for k in there:
                back.setdefault(k, set()).add(here)
        reached = {k for k, (s, _) in self.nodes.items() if s.state in REST}
        todo = list(reached)
        while todo:
            for k in back.get(todo.pop(), ()):
                if k not in reached:
                    reached.add(k)
                    todo.append(k)
        return set(self.onward) - reached


def entries_of(
    before: ArbiterState, effects: tuple[Effect, ...], while_held: frozenset[tuple[State, Cause]]
) -> Iterator[Entry]:
    """The entries of the two tables that a step took, in their order."""
    state, held = before.state, before.held
    for fields in (e.fields for e in effects if isinstance(e, Report) and e.event == "mode"):
        cause, to = fields["cause"], fields["state"]
        yield state, cause, held and (state, cause) in while_held
        held = state is State.EMERGENCY_HOLD if to is State.DETECTED else held and to in DECIDING
        state = to


def explore(
    starts: list[Node],
    most: int,
    while_held: frozenset[tuple[State, Cause]],
    act: Callable[..., tuple[ArbiterState, tuple[Effect, ...]]] = step,
) -> Explored:
    """From `starts`, what was found first goes first, until `most` abstract states are expanded. act: the arbiter's step."""
    found = Explored()
    waiting: dict[tuple[State, bool], deque[Key]] = {}

    def find(state: ArbiterState, now_s: float) -> Key:
        key = abstract(state, now_s)
        if key not in found.nodes:
            found.nodes[key] = state, now_s
            waiting.setdefault((state.state, state.held), deque()).append(key)
        return key

    for node in starts:
        find(*node)
    while any(waiting.values()):
        if len(found.onward) >= most:
            found.whole = False
            break
        # Each state of the machine in turn, so that few that have many kinds do not keep the others waiting.
        kind = next(k for k, keys in waiting.items() if keys)
        key = waiting[kind].popleft()
        waiting[kind] = waiting.pop(kind)
        state, now_s = found.nodes[key]
        onward = found.onward.setdefault(key, set())
        for happening in ALPHABET:
            after, then_s = state, now_s
            for _ in range(happening.times):
                before, then_s = after, then_s + happening.after_s
                event = happening.make(before, then_s)
                after, effects = act(before, event, then_s)
                found.steps += 1
                judge(found, Taken(before, event, after, effects), happening.name)
                found.entries.update(entries_of(before, effects, while_held))
                if after.state is not state.state:
                    break
            onward.add(find(after, then_s))
    return found


def judge(found: Explored, taken: Taken, name: str) -> None:
    found.met.update(what for what, there in ABOUT.items() if there(taken))
    for what, (_, holds) in INVARIANTS.items():
        try:
            fine = holds(taken)
        except (AssertionError, IndexError) as error:
            what, fine = f"{what}: {error}", False  # noqa: PLW2901
        if not fine:
            found.broken.append((what, taken.before.state, name))


TO_ARMED = (
    "sky clear",
    "rests",
    "asked to pair",
    "pairing accepted",
    "is told of all along",
    "somebody beside",
    "sky clear",
)
TO_HOLD = ("go_left by voice, 0.9, 0.0 s ago, red", "volume granted", "rests", "somebody near", "rests", "sky clear")
TO_RETURN = (*("rests",) * 30, "volume granted")
ASKED_TO_RETURN = ("rests", "rests", "rests", "continue by voice, 0.9, 0.0 s ago, red", "volume granted")


def journey(policy: Policy) -> list[Node]:
    """The first state, and those that lie on a way through pairing, a move, EmergencyHold and back: where to look from."""
    by_name = {h.name: h for h in ALPHABET}
    state, now_s = ArbiterState(Limits(), policy), 100.0
    nodes = [(state, now_s)]
    names = [
        *TO_ARMED,
        *(() if policy.dry_run else (*TO_HOLD, *(TO_RETURN if policy.return_to_anchor == "auto" else ASKED_TO_RETURN))),
    ]
    for name in names:
        if name == "rests" and state.deciding is not None and state.deciding.request is None:
            continue  # airspace for the way back has been asked for
        happening, began = by_name[name], state.state
        for _ in range(happening.times):
            now_s += happening.after_s
            state, _ = step(state, happening.make(state, now_s), now_s)
            if state.state is not began:
                break
        nodes.append((state, now_s))
    return nodes


# ---------------------------------------------------------------- to rest, and how soon


def rests_after_s(node: Node, within_s: float) -> float | None:
    """How long until a state of rest is reached where all goes well: the drone does as it is told, everybody answers.

    None: not within within_s.
    """
    state, now_s = node
    for i in range(round(within_s / 0.1)):
        if state.state in REST:
            return i * 0.1
        now_s += 0.1
        events: list[Event] = [NeighboursHeard(Neighbours.none(math.inf)), TelemetryArrived(vehicle(state, now_s))]
        if state.state is State.PAIRING and state.pairing is not None:
            events.append(PairingAnswered(state.pairing, (), OPERATOR, FLAT))
        if state.deciding is not None and state.deciding.ask_id is not None:
            events.append(ReservationAnswered(state.deciding.ask_id, "granted"))
        for event in (*events, Tick()):
            state, _ = step(state, event, now_s)
    return within_s if state.state in REST else None


def left_in_silence_after_s(node: Node, within_s: float) -> float | None:
    """How long until its state is left where nothing happens but time. None: not within within_s."""
    state, now_s = node
    for i in range(1, round(within_s / 0.1) + 1):
        after, _ = step(state, Tick(), now_s + i * 0.1)
        if after.state is not node[0].state:
            return i * 0.1
        state = after
    return None
