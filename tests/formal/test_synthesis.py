"""The mode machine against a controller synthesised from the requirements: realizable, nothing forbidden, every difference told."""

from __future__ import annotations

import pytest

from m3r_app.arbiter import modes
from m3r_app.arbiter.modes import TRANSITIONS, WHILE_HELD, next_state
from safety.requirements import REQUIREMENTS
from safety.vocabulary import Cause, State
from scripts import mode_machine
from tests.formal.justified import BESIDES, BY_CAUSE, STRICTER, WITHOUT_ENTRY, justification
from tests.formal.specification import CAUSES, FAIR, GUARANTEES, STATES, keys, realizable, solved

S, C = State, Cause


@pytest.mark.requirement("P1", "P2", "P3", "R10", "X3", "X4", "X5", "X10", "X14")
def test_the_specification_is_realizable() -> None:
    assert solved().realizable


@pytest.mark.parametrize("changes", [
    {"without": ("a request is delayed once",)},  # delayed for ever
    {"fair": {s: causes for s, causes in FAIR.items() if s is not S.EXECUTING}},  # a motion that never ends
    {"fair": {s: causes for s, causes in FAIR.items() if s is not S.PLANNED}},  # airspace never answers
    {"without": ("the way back is not approved after STOP until something is asked",)},  # asked to move and not to
    {"more": (f"s' # {STATES.index(S.EMERGENCY_HOLD)}",)},  # nowhere to go at a violation
], ids=["delay", "motion", "airspace", "return", "hold"])  # fmt: skip
def test_it_is_not_realizable_where_it_should_not_be(changes: dict[str, object]) -> None:
    assert not realizable(**changes)


def _table(without: tuple[S, C] | None = None) -> tuple[str, ...]:
    """The table as the only strategy: a formula for each question. without: this entry of WHILE_HELD is not there."""
    formulas = []
    for state, cause, held in keys():
        to = next_state(state, cause, held=held and (state, cause) != without)
        if to is None and (state, cause) in WITHOUT_ENTRY:
            to = WITHOUT_ENTRY[state, cause][0]
        if to is not None:
            here = f"(s = {STATES.index(state)}) /\\ (c = {CAUSES.index(cause)}) /\\ {'held' if held else '~ held'}"
            formulas.append(f"({here}) => (s' = {STATES.index(to)})")
    return tuple(formulas)


@pytest.mark.requirement("P1", "P2", "P3", "R10", "X3", "X4", "X5", "X10", "X14")
def test_the_table_wins_the_game() -> None:
    """Not only is each of its answers allowed: always answering so, it comes to rest again and again."""
    assert realizable(more=_table())


@pytest.mark.requirement("R10")
@pytest.mark.parametrize("entry", list(WHILE_HELD))
def test_a_table_that_leaves_emergency_hold_unapproved_loses(entry: tuple[S, C]) -> None:
    """This alone would have found that a refused request led from EmergencyHold to Armed."""
    assert not realizable(more=_table(without=entry))


def test_the_table_takes_nothing_that_is_forbidden_and_every_entry_is_met() -> None:
    assert mode_machine.forbidden(solved()) == []
    assert mode_machine.never_met(solved()) == []


def test_what_is_forbidden_would_be_found(monkeypatch: pytest.MonkeyPatch) -> None:
    for entry, to in (((S.EXECUTING, C.STOP), S.EXECUTING), ((S.VALIDATED, C.GUARDS_FAILED), S.PLANNED)):
        monkeypatch.setitem(modes.TRANSITIONS, entry, to)
        assert (*entry, False) in mode_machine.forbidden(solved())


def test_the_strategy_answers_within_what_is_allowed() -> None:
    """The synthesised machine answers every question, and nothing that the safety game alone forbids."""
    found = solved()
    assert set(found.strategy) == set(found.allowed)
    assert all(answers <= found.allowed[key] for key, answers in found.strategy.items())


def test_every_difference_is_explained_and_nothing_else_is() -> None:
    found = solved()
    assert {(s, c) for s, c, _ in mode_machine.without_entry(found)} == set(WITHOUT_ENTRY)
    assert {c for _, c, _ in mode_machine.stricter(found)} == set(STRICTER)
    for (state, cause), (to, _) in WITHOUT_ENTRY.items():
        assert to in found.allowed[state, cause, False]


def test_every_entry_is_justified() -> None:
    entries = [*((s, c, False) for s, c in TRANSITIONS), *((s, c, True) for s, c in WHILE_HELD)]
    for state, cause, held in entries:
        ids = justification(state, cause, held=held)
        assert ids
        assert set(ids) <= set(REQUIREMENTS), (state, cause)
    assert set(BY_CAUSE) == {c for _, c, _ in entries}
    assert set(BESIDES) <= set(TRANSITIONS)


def test_every_source_of_a_guarantee_is_known() -> None:
    for rule in GUARANTEES:
        for source in rule.source.split(", "):
            assert source in REQUIREMENTS or source == "meaning" or source.startswith("design "), rule


def test_the_page_is_what_the_script_makes() -> None:
    told = mode_machine.PAGE.read_text(encoding="utf-8")
    assert told == mode_machine.page(), "docs/mode-machine.md is old: .venv/bin/python -m scripts.mode_machine"
