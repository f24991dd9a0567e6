"""The mode machine's specification as a game of reactivity (GR(1)), written from the requirements and not from the table.

Each turn the environment has a cause happen, and the machine chooses the next state. What a cause means says where it can happen
(assumptions); what the requirements say bounds the answer (guarantees). Three bits of history go with the state: `held`, what is
being decided was asked for in EmergencyHold; `waited`, it was delayed once; `stopped`, no request since STOP.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import product
from time import perf_counter
from typing import Any

from omega.games import gr1
from omega.symbolic import temporal

from safety.vocabulary import Cause, State

S, C = State, Cause

STATES, CAUSES = tuple(S), tuple(C)
NOTHING = len(CAUSES)
"""The number of the cause that nothing happens."""

UNPAIRED = (S.IDLE, S.PAIRING)
PAIRED = tuple(s for s in S if s not in UNPAIRED)
MOVING = (S.EXECUTING, S.RETURN_TO_ANCHOR)
DECIDING = (S.DETECTED, S.VALIDATED, S.DELAYED, S.PLANNED, S.BLOCKED)
WAITING = (S.DELAYED, S.PLANNED)
ANCHORED = tuple(s for s in PAIRED if s is not S.FACING)
REST = (S.IDLE, S.ARMED, S.EMERGENCY_HOLD)
"""Where the machine may stay for ever."""

HAPPENS: dict[C, tuple[S, ...]] = {
    C.PAIR_REQUESTED: (S.IDLE,),
    C.PAIR_ACCEPTED: (S.PAIRING,),
    C.PAIR_REFUSED: (S.PAIRING, S.FACING),
    C.FACING_OPERATOR: (S.FACING,),
    C.RELEASED: PAIRED,
    C.AUTHORITY_LOST: PAIRED,
    C.REQUEST: (S.ARMED, S.EMERGENCY_HOLD),
    C.CONFIDENCE_OK: (S.DETECTED,),
    C.CONFIDENCE_LOW: (S.DETECTED,),
    C.GUARDS_OK: (S.VALIDATED,),
    C.GUARDS_FAILED: (S.VALIDATED, S.PLANNED),
    C.DELAY: (S.VALIDATED,),
    C.DELAY_OVER: (S.DELAYED,),
    C.VOLUME_GRANTED: (S.PLANNED,),
    C.VOLUME_DENIED: (S.PLANNED,),
    C.DRY_RUN: (S.PLANNED,),
    C.CONTRADICTED: (S.ARMED, S.SETTLING, *WAITING, *MOVING, S.EMERGENCY_HOLD),
    C.TOLD: (S.BLOCKED,),
    C.COMPLETED: (S.EXECUTING,),
    C.STOP: tuple(S),
    C.INTERRUPTED: (S.SETTLING, *WAITING, *MOVING),
    C.STALLED: (S.FACING, *MOVING),
    C.SETTLED: (S.SETTLING,),
    C.VIOLATION: MOVING,
    C.RETURN_APPROVED: (S.EMERGENCY_HOLD, S.PLANNED),
    C.RETURNED: (S.RETURN_TO_ANCHOR,),
}
"""Where each cause can happen by what it means, whatever the table does with it."""


@dataclass(frozen=True)
class Rule:
    """One assumption or guarantee: its requirement or decision, its sentence, its formula."""

    source: str
    says: str
    formula: str


def at(*states: S, then: bool = False) -> str:
    return _one_of("s'" if then else "s", [STATES.index(s) for s in states])


def cause(*causes: C) -> str:
    return _one_of("c", [CAUSES.index(c) for c in causes])


def _one_of(name: str, numbers: list[int]) -> str:
    return "(" + r" \/ ".join(f"({name} = {n})" for n in numbers) + ")"


def goes(*states: S) -> str:
    return at(*states, then=True)


STAYS = "(s' = s)"
ENDS = cause(C.RELEASED, C.AUTHORITY_LOST)

ASSUMPTIONS = (
    *(
        Rule("meaning", f"{c} happens only in {', '.join(where)}", f"(c' = {CAUSES.index(c)}) => {at(*where, then=True)}")
        for c, where in HAPPENS.items()
    ),
    Rule("design 7", "a request is delayed once", f"~ (waited' /\\ (c' = {CAUSES.index(C.DELAY)}))"),
    Rule(
        "X4, design 14", "the way back is not approved after STOP until something is asked",
        f"~ (stopped' /\\ (c' = {CAUSES.index(C.RETURN_APPROVED)}))",
    ),
)  # fmt: skip

FAIR: dict[S, tuple[C, ...]] = {
    S.PAIRING: (C.PAIR_ACCEPTED, C.PAIR_REFUSED),
    S.FACING: (C.FACING_OPERATOR, C.PAIR_REFUSED),
    S.SETTLING: (C.SETTLED,),
    S.DETECTED: (C.CONFIDENCE_OK, C.CONFIDENCE_LOW),
    S.VALIDATED: (C.GUARDS_OK, C.GUARDS_FAILED),
    S.DELAYED: (C.DELAY_OVER,),
    S.PLANNED: (C.VOLUME_GRANTED, C.VOLUME_DENIED),
    S.BLOCKED: (C.TOLD,),
    S.EXECUTING: (C.COMPLETED, C.VIOLATION),
    S.RETURN_TO_ANCHOR: (C.RETURNED, C.VIOLATION),
}
"""What comes again and again while the machine stays there: an answer, rest, the end of a motion, each with a deadline."""

GUARANTEES = (
    Rule("P1", "pairing begins only by being asked for", f"{goes(S.PAIRING)} => (({at(S.IDLE)} /\\ {cause(C.PAIR_REQUESTED)}) \\/ {at(S.PAIRING)})"),
    Rule("P1, X8", "a session begins only by an accepted pairing", f"({at(*UNPAIRED)} /\\ ~ {goes(*UNPAIRED)}) => ({at(S.PAIRING)} /\\ {cause(C.PAIR_ACCEPTED)} /\\ {goes(S.FACING)})"),
    Rule("P1", "Armed is first reached only facing the operator", f"({at(S.FACING)} /\\ ~ {goes(S.FACING, S.IDLE)}) => ({cause(C.FACING_OPERATOR)} /\\ {goes(S.ARMED)})"),
    Rule("P1", "nobody goes back to facing", f"{goes(S.FACING)} => {at(S.PAIRING, S.FACING)}"),
    Rule("P1", "pairing that succeeds goes on", f"({cause(C.PAIR_REQUESTED)} => {goes(S.PAIRING)}) /\\ ({cause(C.PAIR_ACCEPTED)} => {goes(S.FACING)}) /\\ ({cause(C.FACING_OPERATOR)} => {goes(S.ARMED)})"),
    Rule("X8", "a refused pairing is no session", f"{cause(C.PAIR_REFUSED)} => {goes(S.IDLE)}"),
    Rule("X3", "the end of authority is the end of the session, and nothing else is", f"({ENDS} => {goes(S.IDLE)}) /\\ (({at(*ANCHORED)} /\\ {goes(*UNPAIRED)}) => {ENDS})"),
    Rule("R1", "a request is detected, and only a request is", f"({cause(C.REQUEST)} => {goes(S.DETECTED)}) /\\ (({goes(S.DETECTED)} /\\ ~ {at(S.DETECTED)}) => {cause(C.REQUEST)})"),
    Rule("P2, G1", "Validated only with confidence, or judged again after a delay", f"({goes(S.VALIDATED)} /\\ ~ {at(S.VALIDATED)}) => ({cause(C.CONFIDENCE_OK)} \\/ {cause(C.DELAY_OVER)})"),
    Rule("R11, G1", "too little confidence is Blocked", f"{cause(C.CONFIDENCE_LOW)} => {goes(S.BLOCKED)}"),
    Rule("P2, R2", "Planned only with every rule satisfied", f"({goes(S.PLANNED)} /\\ ~ {at(S.PLANNED)}) => {cause(C.GUARDS_OK)}"),
    Rule("P3, R4, R6", "what fails a rule is Blocked", f"{cause(C.GUARDS_FAILED)} => {goes(S.BLOCKED)}"),
    Rule("X10", "no volume, no flight: Blocked", f"{cause(C.VOLUME_DENIED)} => {goes(S.BLOCKED)}"),
    Rule("design 7", "a delay waits, and only a delay does", f"({cause(C.DELAY)} => {goes(S.DELAYED)}) /\\ (({goes(S.DELAYED)} /\\ ~ {at(S.DELAYED)}) => {cause(C.DELAY)})"),
    Rule("X10, P2", "Executing only on a grant", f"({goes(S.EXECUTING)} /\\ ~ {at(S.EXECUTING)}) => {cause(C.VOLUME_GRANTED)}"),
    Rule("design 14", "ReturnToAnchor only by approval", f"({goes(S.RETURN_TO_ANCHOR)} /\\ ~ {at(S.RETURN_TO_ANCHOR)}) => {cause(C.RETURN_APPROVED)}"),
    Rule("design 5", "Blocked only by a refusal, and for one step", f"(({goes(S.BLOCKED)} /\\ ~ {at(S.BLOCKED)}) => {cause(C.CONFIDENCE_LOW, C.GUARDS_FAILED, C.VOLUME_DENIED)}) /\\ ({cause(C.TOLD)} => ~ {goes(S.BLOCKED)})"),
    Rule("R10", "a violation is EmergencyHold, and only a violation is, or what was asked for in it", f"({cause(C.VIOLATION)} => {goes(S.EMERGENCY_HOLD)}) /\\ (({goes(S.EMERGENCY_HOLD)} /\\ ~ {at(S.EMERGENCY_HOLD)}) => ({cause(C.VIOLATION)} \\/ held))"),
    Rule("R10, design 14", "EmergencyHold is left only by an approval, to be judged, or with the session", f"({at(S.EMERGENCY_HOLD)} /\\ ~ {goes(S.EMERGENCY_HOLD)}) => ({ENDS} \\/ {cause(C.RETURN_APPROVED)} \\/ ({cause(C.REQUEST)} /\\ {goes(S.DETECTED)}))"),
    Rule("R10, design 14", "what was asked for in EmergencyHold leads back to it, or is approved", f"held => ({goes(*DECIDING, S.EMERGENCY_HOLD)} \\/ {ENDS} \\/ {cause(C.VOLUME_GRANTED, C.RETURN_APPROVED)})"),
    Rule("X4", "STOP: no motion, nothing waits, no pairing goes on", f"{cause(C.STOP)} => {goes(S.IDLE, S.PAIRING, S.ARMED, S.SETTLING, S.EMERGENCY_HOLD)}"),
    Rule("X4", "after STOP no motion without a request", f"stopped => ~ {goes(*MOVING)}"),
    Rule("X5, X14, X7", "what is contradicted, interrupted or stalled neither flies nor waits on", f"{cause(C.CONTRADICTED, C.INTERRUPTED, C.STALLED)} => ~ {goes(*MOVING, *DECIDING)}"),
    Rule("design 2", "from motion to Armed only at rest", f"({at(*MOVING, S.SETTLING)} /\\ {goes(S.ARMED)}) => {cause(C.COMPLETED, C.RETURNED, C.SETTLED)}"),
    Rule("design 2", "the end of a motion is Armed", f"{cause(C.COMPLETED, C.RETURNED, C.SETTLED)} => {goes(S.ARMED)}"),
    Rule("P2", "an approval is not lost", f"({cause(C.CONFIDENCE_OK, C.DELAY_OVER)} => {goes(S.VALIDATED)}) /\\ ({cause(C.GUARDS_OK)} => {goes(S.PLANNED)}) /\\ ({cause(C.VOLUME_GRANTED)} => {goes(S.EXECUTING)}) /\\ ({cause(C.RETURN_APPROVED)} => {goes(S.RETURN_TO_ANCHOR)})"),
    Rule("design 15", "a dry run flies nothing and is over", f"{cause(C.DRY_RUN)} => ~ {goes(*MOVING, *DECIDING)}"),
    Rule("meaning", "nothing happens: nothing changes", f"(c = {NOTHING}) => {STAYS}"),
    Rule("meaning", "held: asked for in EmergencyHold and still being decided", f"held' <=> (({at(S.EMERGENCY_HOLD)} /\\ {goes(S.DETECTED)}) \\/ (held /\\ {goes(*DECIDING)}))"),
    Rule("meaning", "waited: delayed once and still being decided", f"waited' <=> ({goes(S.DELAYED)} \\/ (waited /\\ {goes(*DECIDING)}))"),
    Rule("meaning", "stopped: no request since STOP", f"stopped' <=> ({cause(C.STOP)} \\/ (stopped /\\ ~ {cause(C.REQUEST)}))"),
)  # fmt: skip


@dataclass(frozen=True)
class Solved:
    """The game and its winning set. allowed: (state, cause, held) -> what the most permissive strategy may answer."""

    realizable: bool
    winning: int
    allowed: dict[tuple[S, C, bool], frozenset[S]]
    reached: int
    strategy: dict[tuple[S, C, bool], frozenset[S]]
    """What a synthesised strategy, with liveness, answers in what it reaches itself; empty where unrealizable."""
    seconds: float


def game(without: tuple[str, ...] = (), fair: dict[S, tuple[C, ...]] | None = None, more: tuple[str, ...] = ()) -> Any:
    """The automaton. without: sentences of rules that are left out; more: formulas of further guarantees."""
    aut = temporal.default_streett_automaton()
    aut.declare_variables(s=(0, len(STATES) - 1), c=(0, NOTHING), held="bool", waited="bool", stopped="bool")
    aut.varlist.update(env=["c"], sys=["s", "held", "waited", "stopped"])
    aut.prime_varlists()
    aut.init.update(
        env=aut.add_expr(f"c = {NOTHING}"),
        sys=aut.add_expr(f"(s = {STATES.index(S.IDLE)}) /\\ ~ held /\\ ~ waited /\\ ~ stopped"),
    )
    limits = rf"(s \in 0..{len(STATES) - 1}) /\ (s' \in 0..{len(STATES) - 1})"
    env = aut.add_expr(rf"(c \in 0..{NOTHING}) /\ (c' \in 0..{NOTHING})")
    for rule in ASSUMPTIONS:
        if rule.says not in without:
            env &= aut.add_expr(rule.formula)
    sys = aut.add_expr(limits)
    for formula in (*(r.formula for r in GUARANTEES if r.says not in without), *more):
        sys &= aut.add_expr(formula)
    aut.action.update(env=env, sys=sys)
    comes = FAIR if fair is None else fair
    aut.win["<>[]"] = [aut.add_expr(f"{at(s)} /\\ ~ {cause(*causes)}") for s, causes in comes.items()] or [aut.false]
    aut.win["[]<>"] = [aut.add_expr(at(*REST))]
    aut.qinit, aut.moore, aut.plus_one = r"\E \A", True, True
    return aut


def realizable(**changes: Any) -> bool:
    aut = game(**changes)
    winning, _, _ = gr1.solve_streett_game(aut)
    return _wins(winning, aut)


def _wins(winning: Any, aut: Any) -> bool:
    return bool((aut.init["sys"] & aut.init["env"] & ~winning) == aut.false)


@cache
def solved() -> Solved:
    began = perf_counter()
    aut = game()
    winning, yij, xijk = gr1.solve_streett_game(aut)
    wins = _wins(winning, aut)
    count = int(aut.count(winning, care_vars=["s", "c", "held", "waited", "stopped"]))
    env, sys = aut.action["env"], aut.action["sys"]
    primed = {v: f"{v}'" for v in ("s", "c", "held", "waited", "stopped")}
    safe = sys & aut.forall(["c'"], aut.let(primed, winning) | ~env)
    allowed, reached = _answers(aut, safe & winning, env)
    strategy: dict[tuple[S, C, bool], frozenset[S]] = {}
    if wins:
        gr1.make_streett_transducer(winning, yij, xijk, aut)
        strategy, _ = _answers(aut, aut.exist(["_goal", "_goal'"], aut.action["impl"]), env)
    return Solved(wins, count, allowed, reached, strategy, perf_counter() - began)


def _answers(aut: Any, action: Any, env: Any) -> tuple[dict[tuple[S, C, bool], frozenset[S]], int]:
    """Walk from the first state through all that the environment can do and `action` answers."""
    first = (STATES.index(S.IDLE), NOTHING, False, False, False)
    seen, todo = {first}, [first]
    names = ("s", "c", "held", "waited", "stopped")
    found: dict[tuple[S, C, bool], set[S]] = {}
    while todo:
        here = todo.pop()
        now = dict(zip(names, here, strict=True))
        after = aut.let(now, action)
        then_env = aut.let(now, env)
        for answer in aut.pick_iter(after, care_vars=["s'", "held'", "waited'", "stopped'"]):
            if here[1] != NOTHING:
                key = (STATES[here[0]], CAUSES[here[1]], here[2])
                found.setdefault(key, set()).add(STATES[answer["s'"]])
            comes = aut.let(answer, then_env)
            for happens in aut.pick_iter(comes, care_vars=["c'"]):
                there = (answer["s'"], happens["c'"], answer["held'"], answer["waited'"], answer["stopped'"])
                if there not in seen:
                    seen.add(there)
                    todo.append(there)
    return {k: frozenset(v) for k, v in found.items()}, len(seen)


def keys() -> list[tuple[S, C, bool]]:
    return [(s, c, held) for s, c, held in product(STATES, CAUSES, (False, True)) if not held or s in DECIDING]
