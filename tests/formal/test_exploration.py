"""The arbiter, explored: its invariants in every step, every entry of the table taken, rest reached from everywhere."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import pytest

from m3r_app.arbiter.modes import WHILE_HELD
from m3r_app.arbiter.state import Policy
from m3r_app.arbiter.step import step
from safety.requirements import REQUIREMENTS
from safety.vocabulary import Cause, State
from tests.formal.exploration import (
    ABOUT,
    INVARIANTS,
    REST,
    Explored,
    explore,
    journey,
    left_in_silence_after_s,
    rests_after_s,
)
from tests.formal.justified import ENTRIES, PASSING, UNTAKEN

HELD = frozenset(WHILE_HELD)

POLICIES = {"auto": Policy(), "ask": Policy(return_to_anchor="ask"), "dry run": Policy(dry_run=True)}
SMALL = {"auto": 150, "ask": 40, "dry run": 25}
SETTLES_WITHIN_S = 40.0
"""A turn of 360 degrees at 30 degrees/s, its ramps, what lingers and what was waited for before it."""
SILENT = (State.FACING, State.DELAYED, State.PLANNED, State.EXECUTING, State.RETURN_TO_ANCHOR, State.BLOCKED)
"""What is left although nothing is heard. Pairing waits for the shell, Settling for a drone that is heard: both hold still."""
LEFT_WITHIN_S = 21.0
"""As long as facing the operator may take, and a step."""


@cache
def small(policy: str) -> Explored:
    return explore(journey(POLICIES[policy]), SMALL[policy], HELD)


def _check(found: Explored) -> None:
    assert found.broken == []
    assert not {s.state for s, _ in found.nodes.values()} & set(PASSING)


@pytest.mark.requirement("P1", "P2", "P3", "R10", "R11", "X3", "X4", "X10")
@pytest.mark.parametrize("policy", POLICIES)
def test_every_step_keeps_every_invariant(policy: str) -> None:
    found = small(policy)
    assert found.steps > 40 * SMALL[policy]
    _check(found)


def test_every_entry_is_taken_but_those_that_cannot_be() -> None:
    taken = frozenset().union(*(small(policy).entries for policy in POLICIES))
    assert taken <= ENTRIES
    assert ENTRIES - taken == frozenset().union(*UNTAKEN.values())


def test_no_invariant_holds_for_want_of_what_it_is_about() -> None:
    met = small("auto").met + small("ask").met + small("dry run").met
    assert {what for what in ABOUT if not met[what]} == set()


def test_a_dry_run_moves_nothing() -> None:
    reached = {s.state for s, _ in small("dry run").nodes.values()}
    assert not reached & {State.EXECUTING, State.EMERGENCY_HOLD, State.RETURN_TO_ANCHOR}


def _each(found: Explored) -> list[tuple[State, bool]]:
    return sorted({(s.state, s.held) for s, _ in found.nodes.values()}, key=str)


def test_the_journey_comes_to_where_it_should() -> None:
    for policy in ("auto", "ask"):
        assert journey(POLICIES[policy])[-1][0].state is State.RETURN_TO_ANCHOR
    assert journey(POLICIES["dry run"])[-1][0].state is State.ARMED


@pytest.mark.requirement("X6", "R8")
def test_rest_is_reached_from_everywhere_and_nothing_lasts_for_ever() -> None:
    found = small("auto")
    for kind in _each(found):
        nodes = [n for n in found.nodes.values() if (n[0].state, n[0].held) == kind][:3]
        _settles(nodes)


def _settles(nodes: list[tuple[object, float]]) -> tuple[float, float]:
    """The longest until rest, and until what may not last in silence is left."""
    longest = silent = 0.0
    for node in nodes:
        after_s = rests_after_s(node, SETTLES_WITHIN_S)
        assert after_s is not None, f"no rest from {node[0].state}"
        longest = max(longest, after_s)
        if node[0].state in SILENT:
            left_s = left_in_silence_after_s(node, LEFT_WITHIN_S)
            assert left_s is not None, f"{node[0].state} lasts in silence"
            silent = max(silent, left_s)
    return longest, silent


def test_every_invariant_serves_a_requirement() -> None:
    for requirements, _ in INVARIANTS.values():
        assert set(requirements) <= set(REQUIREMENTS)


# ---------------------------------------------------------------- a broken arbiter is found


def _broken(change: object) -> set[str]:
    """What is found from a few states of every kind that the real one reaches."""
    starts = [
        n
        for kind in ((State.IDLE, False), (State.ARMED, False), (State.EMERGENCY_HOLD, False), (State.BLOCKED, True))
        for n in small("auto").nodes.values()
        if (n[0].state, n[0].held) == kind
    ][::8]
    found = explore(starts, 20, HELD, act=change)
    return {what.split(":")[0] for what, _, _ in found.broken}


def test_an_arbiter_that_forgets_the_anchor_is_found() -> None:
    def act(state, event, now_s):
        after, effects = step(state, event, now_s)
        if after.session is not None and after.state is State.SETTLING:
            after = replace(after, session=replace(after.session, anchor=None))
        return after, effects

    assert "no mode but NormalAutonomy without a pairing" in _broken(act)


def test_an_arbiter_that_holds_late_is_found() -> None:
    def act(state, event, now_s):
        after, effects = step(state, event, now_s)
        return after, effects[::-1]

    assert "STOP holds, and nothing that waits or returns is left" in _broken(act)


def test_an_arbiter_whose_refusal_leaves_emergency_hold_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    rest = {e: to for e, to in WHILE_HELD.items() if e != (State.BLOCKED, Cause.TOLD)}
    monkeypatch.setattr("m3r_app.arbiter.modes.WHILE_HELD", rest)
    assert "EmergencyHold is left by an approval or with the session" in _broken(step)


# ---------------------------------------------------------------- the long count


@pytest.mark.soak
@pytest.mark.parametrize("policy", POLICIES)
def test_the_large_exploration(policy: str, record_property) -> None:
    found = explore(journey(POLICIES[policy]), 6000, HELD)
    _check(found)
    nodes = list(found.nodes.values())
    longest, silent = _settles([n for n in nodes if n[0].state not in REST][::10])
    if found.whole:
        assert found.without_way_to_rest() == set()
    for name, value in (
        ("abstract states", len(nodes)), ("expanded", len(found.onward)), ("edges", found.edges()), ("steps", found.steps),
        ("longest to rest, s", longest), ("longest in silence, s", silent), ("whole", found.whole),
    ):  # fmt: skip
        record_property(name, value)
