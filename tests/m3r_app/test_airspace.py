"""The authority for volumes, in process. X10, R5."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from m3r_app.airspace import Grant, LocalAirspace
from safety.vocabulary import Ned, ReservedVolume

RED = ReservedVolume("red", Ned(0, 0, -10), Ned(1, 0, -10), 2.0, 100.0, 110.0)
NEAR = replace(RED, holder="blue", start=Ned(3, 0, -10), end=Ned(4, 0, -10))
FAR = replace(NEAR, start=Ned(30, 0, -10), end=Ned(31, 0, -10))


def test_who_comes_second_is_told_who_is_in_the_way() -> None:
    airspace = LocalAirspace()
    assert isinstance(airspace.reserve("a", RED, 100.0), Grant)
    assert airspace.reserve("b", NEAR, 101.0) == "red holds it for another 9.0 s"
    assert isinstance(airspace.reserve("c", FAR, 101.0), Grant)
    assert airspace.held_by_others("blue", 101.0) == (RED,)
    assert airspace.held_by_others("red", 101.0) == (FAR,)


def test_released_or_run_out_it_is_free() -> None:
    airspace = LocalAirspace()
    first = airspace.reserve("a", RED, 100.0)
    airspace.release("a")
    airspace.release("a")
    second = airspace.reserve("b", NEAR, 101.0)
    assert isinstance(first, Grant)
    assert isinstance(second, Grant)
    assert second.fence > first.fence
    assert isinstance(airspace.reserve("c", replace(RED, from_s=110.0, until_s=120.0), 110.0), Grant)
    assert airspace.held_by_others("red", 110.0) == ()


def test_ones_own_volumes_do_not_meet() -> None:
    airspace = LocalAirspace()
    airspace.reserve("a", RED, 100.0)
    assert isinstance(airspace.reserve("b", RED, 100.0), Grant)


@pytest.mark.parametrize("bad", [
    {"start": Ned(math.nan, 0, 0)}, {"radius_m": math.nan}, {"until_s": math.inf}, {"from_s": math.nan},
])  # fmt: skip
def test_what_is_incomplete_is_not_granted(bad: dict[str, object]) -> None:
    """X6: it could neither be kept clear nor run out."""
    airspace = LocalAirspace()
    assert isinstance(airspace.reserve("a", replace(RED, **bad), 100.0), str)  # type: ignore[arg-type]
    assert airspace.held_by_others("blue", 100.0) == ()
