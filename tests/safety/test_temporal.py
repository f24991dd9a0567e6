"""Past-time temporal logic: the same robustness as RTAMT's on random traces, and what it says at the edges."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from safety.properties import LITERAL, PROPERTIES, Watch
from safety.temporal import FormulaError, monitor

VALUES = st.floats(-10.0, 10.0).map(lambda value: round(value, 3))
TRACES = st.lists(st.tuples(VALUES, VALUES), min_size=1, max_size=30)
SAME = [
    ("a", "a"),
    ("!a & b | a", "(not(a) and b) or a"),
    ("a -> b", "not(a) or b"),
    ("(a -> b) & a", "(not(a) or b) and a"),
    ("a >= b", "a - b"),
    ("a <= 3", "3 - a"),
    ("O a", "once(a)"),
    ("H a", "historically(a)"),
    ("O[0,2] a", "once[0:2](a)"),
    ("O[1,3] a & b", "once[1:3](a) and b"),
    ("H[0,4] (a | b)", "historically[0:4](a or b)"),
    ("H[2,2] a", "historically[2:2](a)"),
    ("a S b", "(a since b)"),
    ("!a S (b & a)", "(not(a) since (b and a))"),
    ("O[0,2] (a S b) -> H[0,1] b", "not(once[0:2](a since b)) or historically[0:1](b)"),
]


@pytest.mark.parametrize(("ours", "theirs"), SAME)
@given(trace=TRACES)
def test_robustness_is_that_of_rtamt(ours: str, theirs: str, trace: list[tuple[float, float]]) -> None:
    rtamt = pytest.importorskip("rtamt", reason="RTAMT's parser runs on Python up to 3.12")
    specification = rtamt.StlDiscreteTimeSpecification()
    for name in ("a", "b", "out"):
        specification.declare_var(name, "float")
    specification.spec = f"out = {theirs}"
    specification.parse()
    watched = monitor(ours)
    for t, (a, b) in enumerate(trace):
        expected = specification.update(t, [("a", a), ("b", b)])
        assert watched.update(float(t), {"a": a, "b": b}) == pytest.approx(expected)


def test_before_the_first_sample_nothing_held() -> None:
    watched = monitor("Y a")
    assert [watched.update(t, {"a": a}) for t, a in ((0.0, 1.0), (1.0, -2.0), (2.0, 3.0))] == [-math.inf, 1.0, -2.0]


def test_time_is_measured_and_not_counted() -> None:
    watched = monitor("O[0,2] a")
    times = (0.0, 0.1, 1.9, 2.0, 2.1, 9.0)
    assert [watched.update(t, {"a": 1.0 if t == 0.0 else -1.0}) > 0 for t in times] == [True] * 4 + [False] * 2


@pytest.mark.requirement("X6")
@pytest.mark.parametrize(
    "formula", ["a", "!a", "a >= 1", "1 >= a", "a -> b", "b -> a", "!(a >= 1)", "O a -> b", "H !a", "Y a | b", "!a S b"]
)
def test_what_is_unknown_does_not_hold_and_is_forgotten(formula: str) -> None:
    watched, untold = monitor(formula), monitor(formula)
    known = [(0.0, {"a": -2.0, "b": 1.0}), (2.0, {"a": -1.0, "b": 3.0}), (3.0, {"a": 2.0, "b": -1.0})]
    found = [watched.update(*known[0])]
    assert watched.update(1.0, {"a": math.nan, "b": 1.0}) == -math.inf
    assert watched.antecedent is None or watched.antecedent(1.0, {"a": math.nan, "b": 1.0}) == -math.inf
    found += [watched.update(*sample) for sample in known[1:]]
    assert found == [untold.update(*sample) for sample in known], "as if it had not been told"


def test_what_is_infinite_alike_differs_by_nothing() -> None:
    watched = monitor("a >= b")
    for a, b, robustness in ((math.inf, math.inf, 0.0), (math.inf, 1.0, math.inf), (1.0, math.inf, -math.inf)):
        assert watched.update(0.0, {"a": a, "b": b}) == robustness


@pytest.mark.parametrize("text", ["", "a &", "(a", "a b", "O[2,1] a", "O[x,1] a", "a $ b", ")", "a >= O"])
def test_what_is_no_formula_is_one_sentence(text: str) -> None:
    with pytest.raises(FormulaError):
        monitor(text)


def test_vacuity_and_robustness_stand_beside_each_other() -> None:
    watch = Watch(tuple(one for one in PROPERTIES if one.requirement in ("P1", "P3")))
    quiet = {"armed": -1.0, "paired": -1.0, "reduced": -1.0, "asked_m": 0.0, "granted_m": 0.0}
    assert watch.update(0.0, quiet) == ()
    assert all(result.vacuous and result.holds for result in watch.results())
    broken = watch.update(1.0, {**quiet, "armed": 1.0, "reduced": 1.0, "asked_m": 1.0, "granted_m": 0.4})
    assert [one.requirement for one in broken] == ["P1"]
    first, third = watch.results()
    assert not first.vacuous and first.robustness == -1.0 and first.at_s == 1.0
    assert not third.vacuous and third.robustness == pytest.approx(0.4)


def test_the_formula_as_printed_is_told_apart() -> None:
    watched = monitor(LITERAL.formula)
    assert watched.antecedent is not None and watched.names == {"low", "blocked"}
