"""The mode machine: the paper's transitions are in the table, and the diagram is the table. P1, design 3-6, 14, 15."""

from __future__ import annotations

import re

import pytest

from m3r_app.arbiter.modes import MODE_OF, TRANSITIONS, WHILE_HELD, mermaid, next_state
from safety.vocabulary import Cause, Mode, State

PAPER = [
    (State.ARMED, State.DETECTED), (State.DETECTED, State.VALIDATED), (State.VALIDATED, State.PLANNED),
    (State.VALIDATED, State.BLOCKED), (State.PLANNED, State.EXECUTING), (State.EXECUTING, State.EMERGENCY_HOLD),
    (State.EXECUTING, State.ARMED), (State.EMERGENCY_HOLD, State.RETURN_TO_ANCHOR),
]  # fmt: skip


@pytest.mark.parametrize(("a", "b"), PAPER)
def test_the_papers_transitions(a: State, b: State) -> None:
    assert b in {to for (state, _), to in TRANSITIONS.items() if state is a}


@pytest.mark.requirement("P1")
def test_armed_only_through_pairing() -> None:
    """P1: from NormalAutonomy there is one way into Armed, and it begins with an accepted pairing."""
    into = {
        (s, c)
        for (s, c), to in TRANSITIONS.items()
        if MODE_OF[s] is Mode.NORMAL_AUTONOMY and MODE_OF[to] is not MODE_OF[s]
    }
    assert into == {(State.FACING, Cause.FACING_OPERATOR)}
    assert {s for (s, c), to in TRANSITIONS.items() if to is State.FACING} == {State.PAIRING}


def test_low_confidence_leads_to_blocked_and_nowhere_else() -> None:
    assert next_state(State.DETECTED, Cause.CONFIDENCE_LOW) is State.BLOCKED
    assert {s for (s, c) in TRANSITIONS if c is Cause.CONFIDENCE_LOW} == {State.DETECTED}


def test_stop_never_leads_to_motion_and_every_session_ends() -> None:
    for state in State:
        if MODE_OF[state] is Mode.NORMAL_AUTONOMY:
            continue
        assert next_state(state, Cause.STOP) in (State.SETTLING, State.EMERGENCY_HOLD)
        for cause in (Cause.RELEASED, Cause.AUTHORITY_LOST):
            assert next_state(state, cause) is State.IDLE


def test_every_state_and_cause_is_used_and_every_mode_has_a_state() -> None:
    reached = {State.IDLE} | set(TRANSITIONS.values())
    assert reached == set(State) == {s for s, _ in TRANSITIONS}
    assert {c for _, c in TRANSITIONS} == set(Cause)
    assert set(MODE_OF.values()) == set(Mode)


ARROW = re.compile(r"^    (\[\*\]|\w+) --> (\w+)(?: : ([a-z_]+(?:, [a-z_]+)*))?$")
NAME = re.compile(r'^    state "(\w+) \((\w+)\)" as (\w+)$')


def test_the_diagram_is_the_table() -> None:
    """Every line is Mermaid that we know; every entry of the table is drawn, and nothing else."""
    first, *lines = mermaid().splitlines()
    assert first == "stateDiagram-v2"
    composite = lines.index("    state ManeuverResponseArmed {")
    end = lines.index("    }")
    inner = [line.strip() for line in lines[composite + 1 : end]]
    assert inner == [s.value for s in State if MODE_OF[s] is Mode.ARMED]
    drawn: set[tuple[State, Cause, State]] = set()
    for line in lines[:composite] + lines[end + 1 :]:
        if name := NAME.match(line):
            assert MODE_OF[State(name[3])].value == name[2]
            assert name[1] == name[3]
            continue
        arrow = ARROW.match(line)
        assert arrow is not None, line
        if arrow[1] == "[*]":
            assert arrow[2] == State.IDLE
            continue
        sources = inner if arrow[1] == Mode.ARMED else [arrow[1]]
        for source in sources:
            for cause in arrow[3].split(", "):
                entry = State(source), Cause(cause), State(arrow[2])
                assert entry not in drawn, "drawn twice"
                drawn.add(entry)
    assert drawn == {(*key, to) for table in (TRANSITIONS, WHILE_HELD) for key, to in table.items()}
