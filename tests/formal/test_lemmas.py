"""The arithmetic that the rules rest on, proved by z3 for all values in bounds, and each formula tied to the code."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import z3

from config.settings import Settings
from m3r_app.arbiter.fusion import fused
from safety.confidence import confidence_of
from safety.findings import between
from safety.limits import Limits
from safety.planner import length_reaching_m, stopping_m
from safety.separation import nearest_m
from safety.vocabulary import Command, ManeuverRequest, Modality, Profile
from tests.formal import formulas
from tests.formal.formulas import Terms
from tests.formal.lemmas import LEMMAS, Lemma, bounds, counter_example

NAMES = [make.__name__ for make in LEMMAS]


@pytest.mark.requirement("P3", "R6", "R8", "R11", "X11", "X13")
@pytest.mark.parametrize("make", LEMMAS, ids=NAMES)
def test_it_holds_for_all_values(make: Callable[[], Lemma]) -> None:
    lemma = make()
    assert counter_example(lemma.given, lemma.claim) is None, lemma.name


@pytest.mark.parametrize("make", LEMMAS, ids=NAMES)
def test_its_wrong_twin_has_a_counter_example(make: Callable[[], Lemma]) -> None:
    """What is turned or lacks an assumption is refuted; and what is assumed can be."""
    lemma = make()
    assert counter_example(lemma.wrong_given, lemma.wrong_claim) is not None, lemma.name
    assert counter_example(lemma.given, z3.BoolVal(False)) is not None, f"{lemma.name}: nothing satisfies what is given"


# ---------------------------------------------------------------- the formula is the code


def _real(value: float) -> z3.RatNumRef:
    top, below = value.as_integer_ratio()
    return z3.Q(top, below)


@dataclass(frozen=True)
class Tie:
    """A formula and the code that it states, both of the same numbers, which lie between `low` and `high`."""

    name: str
    low: tuple[float, ...]
    high: tuple[float, ...]
    stated: Callable[..., z3.ArithRef]
    code: Callable[..., float]


def _limits(acceleration: float = 1.0, braking: float = 1.0, lag: float = 1.0) -> Limits:
    return Limits(acceleration_m_s2=acceleration, stop_deceleration_m_s2=braking, lag_s=lag)


def _request(confidence: float) -> ManeuverRequest:
    return ManeuverRequest("a", Command.GO_LEFT, Modality.VOICE, confidence, 0.0, 0.0, "", "red")


def _nearest_square(ax: float, ay: float, bx: float, by: float) -> float:
    apart = np.array([[[ax], [bx]], [[ay], [by]], [[0.0], [0.0]]])
    return float(nearest_m(apart)[0, 0]) ** 2


def _stated_nearest(ax: z3.ArithRef, ay: z3.ArithRef, bx: z3.ArithRef, by: z3.ArithRef, terms: Terms) -> z3.ArithRef:
    first, last = ax * ax + ay * ay, bx * bx + by * by
    nearest = formulas.nearest_square(first, last, ax * bx + ay * by - first, terms)
    return formulas.most(nearest, z3.RealVal(0))


def _stated_at(d: z3.ArithRef, v: z3.ArithRef, a: z3.ArithRef, t: z3.ArithRef, terms: Terms) -> z3.ArithRef:
    return formulas.covered_at(d, v, a, t, terms)[0]


def _stated_speed(d: z3.ArithRef, v: z3.ArithRef, a: z3.ArithRef, t: z3.ArithRef, terms: Terms) -> z3.ArithRef:
    return formulas.covered_at(d, v, a, t, terms)[1]


PROFILE = ((0.01, 0.05, 0.1), (10.0, 2.0, 2.0))
TIES = (
    Tie("stopping_m", (0.0, 0.1, 0.2), (2.0, 3.0, 5.0), formulas.stopping_m, lambda v, lag, b: stopping_m(v, _limits(1.0, b, lag))),
    Tie("peak", *PROFILE, formulas.peak, lambda d, v, a: Profile(d, v, a).peak),
    Tie("duration_s", *PROFILE, formulas.duration_s, lambda d, v, a: Profile(d, v, a).duration_s),
    Tie("confidence_of", (0.0, 0.1), (30.0, 5.0), formulas.confidence_of, confidence_of),
    Tie(
        "fused", (0.0, 0.0), (1.0, 1.0), lambda a, b, _terms: formulas.fused(a, b),
        lambda a, b: fused(_request(a), _request(b), "ab").confidence,
    ),
    Tie(
        "between", (-5.0, -5.0, 0.0), (5.0, 5.0, 3.0), lambda a, b, gap, _terms: formulas.between(a, b, gap),
        lambda a, b, gap: float(between(np.array([a, b]), np.array([gap]))[0]),
    ),
    Tie("nearest_m", (-5.0,) * 4, (5.0,) * 4, _stated_nearest, _nearest_square),
    Tie(
        "length_reaching_m", (0.01, 0.05, 0.1, 0.2, 0.1), (20.0, 2.0, 2.0, 5.0, 3.0), formulas.reaching_m,
        lambda reach, v, a, b, lag: length_reaching_m(reach, v, _limits(a, b, lag)),
    ),
    # The fourth number is a share of the duration.
    Tie("at", (*PROFILE[0], 0.01), (*PROFILE[1], 0.99), _stated_at, lambda d, v, a, t: Profile(d, v, a).at(t)),
    Tie("speed_at", (*PROFILE[0], 0.01), (*PROFILE[1], 0.99), _stated_speed, lambda d, v, a, t: Profile(d, v, a).speed_at(t)),
)  # fmt: skip
SAMPLES = 25
ROUNDING = 1e-9


def _differs(tie: Tie, code: Callable[..., float]) -> list[tuple[float, ...]]:
    """The sampled numbers at which the formula and `code` are not the same."""
    rng = np.random.default_rng(7)
    found = []
    for _ in range(SAMPLES):
        numbers = [float(x) for x in rng.uniform(tie.low, tie.high)]
        if tie.name in {"at", "speed_at"}:
            numbers[3] *= Profile(*numbers[:3]).duration_s
        terms = Terms()
        stated = tie.stated(*map(_real, numbers), terms)
        answer = code(*numbers)
        assert math.isfinite(answer)
        near = ROUNDING * max(1.0, abs(answer))
        same = z3.And(stated - _real(answer) <= near, _real(answer) - stated <= near)
        if counter_example(tuple(terms.given), same) is not None:
            found.append(tuple(numbers))
    return found


@pytest.mark.parametrize("tie", TIES, ids=[t.name for t in TIES])
def test_the_formula_is_what_the_code_computes(tie: Tie) -> None:
    assert _differs(tie, tie.code) == []


@pytest.mark.parametrize("tie", TIES, ids=[t.name for t in TIES])
def test_code_that_computes_otherwise_is_noticed(tie: Tie) -> None:
    assert len(_differs(tie, lambda *numbers: tie.code(*numbers) + 1e-6)) == SAMPLES


def test_every_formula_is_tied() -> None:
    terms = {"Terms", "dataclass", "field", "count", "least", "most", "annotations"}
    stated = {n for n, v in vars(formulas).items() if callable(v) and not n.startswith("_") and n not in terms}
    tied = {t.name for t in TIES} | {
        "nearest_square",
        "reaching_m",
        "covered_at",
    }  # nearest_m, length_reaching_m, at and speed_at
    assert stated <= tied, stated - tied


def test_the_bounds_are_those_of_the_settings() -> None:
    """A bound that is widened there widens what must be proved here."""

    def within(section: str, name: str) -> tuple[float, float]:
        found = Settings.model_fields[section].annotation.model_fields[name].metadata
        return min(getattr(m, "ge", math.inf) for m in found), max(getattr(m, "le", -math.inf) for m in found)

    sections = {"speed": ("envelope", "speed_m_s"), "acceleration": ("envelope", "acceleration_m_s2"),
                "lag": ("uncertainty", "lag_s"), "braking": ("uncertainty", "stop_deceleration_m_s2")}  # fmt: skip
    for symbol, (section, name) in sections.items():
        low, high = within(section, name)
        x = getattr(bounds(), symbol)
        given = tuple(bounds().terms.given)
        assert counter_example(given, z3.And(x >= low, x <= high)) is None, f"{name}: wider here than in the settings"
        for edge in (low, high):
            assert counter_example((*given, x == edge), z3.BoolVal(False)) is not None, (
                f"{name}: narrower here than in the settings"
            )


def test_the_page_names_every_lemma() -> None:
    page = (Path(__file__).resolve().parents[2] / "docs" / "lemmas.md").read_text(encoding="utf-8")
    for make in LEMMAS:
        lemma = make()
        assert f"| {lemma.name} | {', '.join(lemma.requirements)} |" in page, lemma.name
