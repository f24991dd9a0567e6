"""The search for the longest passing length."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from safety.length_search import longest_passing

STEP_M = 0.01
SHAPES: dict[str, Callable[[float], float]] = {
    "even": lambda over_m: -over_m,
    "steep": lambda over_m: -40.0 * over_m,
    "cut off": lambda over_m: min(-1.6 * over_m, 0.3),
    "curved": lambda over_m: -over_m if over_m > 0.0 else over_m**2,
    "no numbers": lambda over_m: -math.inf if over_m > 0.0 else math.inf,
    "never negative": lambda over_m: 1.0,
    "flat": lambda over_m: -1e-9 if over_m > 0.0 else 1e-9,
}


def search(shape: Callable[[float], float], limit_m: float) -> tuple[float | None, int]:
    tried = []

    def attempt(length_m: float) -> tuple[bool, float]:
        tried.append(length_m)
        return length_m <= limit_m, shape(length_m - limit_m)

    return longest_passing(attempt, 0.1, 1.0, (False, shape(1.0 - limit_m)), STEP_M), len(tried)


@given(st.sampled_from(sorted(SHAPES)), st.floats(0.1, 0.9999))
def test_it_ends_within_a_step_below_the_limit(shape: str, limit_m: float) -> None:
    found, tries = search(SHAPES[shape], limit_m)
    assert found is not None
    assert found <= limit_m < found + STEP_M + 1e-12
    assert tries <= 1 + 3 * math.ceil(math.log2(0.9 / STEP_M))


@pytest.mark.parametrize("limit_m", [0.101, 0.13, 0.2, 0.4567, 0.7, 0.983, 0.995])
def test_margins_save_tries(limit_m: float) -> None:
    assert search(SHAPES["even"], limit_m)[1] <= 4
    assert search(SHAPES["steep"], limit_m)[1] <= 4


def test_a_limit_met_head_on_takes_two_tries() -> None:
    assert search(SHAPES["even"], 0.4567) == (pytest.approx(0.4527), 2)


def test_nothing_passes() -> None:
    assert search(SHAPES["even"], 0.0999)[0] is None
