"""The authority in process: what one laptop alone needs. X10, R5."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from m3r_app.airspace.local import LocalAirspace
from safety.vocabulary import Geodetic, Ned, ReservedVolume

RED = ReservedVolume("red", Ned(0, 0, -10), Ned(1, 0, -10), 2.0, 100.0, 110.0)
NEAR = replace(RED, holder="blue", start=Ned(3, 0, -10), end=Ned(4, 0, -10))
FAR = replace(NEAR, start=Ned(30, 0, -10), end=Ned(31, 0, -10))


class Here:
    """A local airspace at a time that the test sets."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.airspace = LocalAirspace(lambda: self.now_s)

    def reserve(self, lease: str, volume: ReservedVolume) -> tuple[str, str]:
        answers: list[tuple[str, str]] = []
        self.airspace.reserve(volume.holder, lease, volume, lambda *answer: answers.append(answer))
        (only,) = answers
        return only


@pytest.mark.requirement("X10")
def test_who_comes_second_is_told_who_is_in_the_way() -> None:
    here = Here()
    assert here.reserve("a", RED) == ("granted", "")
    here.now_s = 101.0
    assert here.reserve("b", NEAR) == ("denied", "red holds it for another 9.0 s")
    assert here.reserve("c", FAR)[0] == "granted"
    assert here.airspace.held_by_others("blue") == (RED,)
    assert here.airspace.held_by_others("red") == (FAR,)


@pytest.mark.requirement("X10")
def test_freed_or_run_out_it_is_free() -> None:
    here = Here()
    assert here.reserve("a", RED)[0] == "granted"
    here.airspace.free("red", "a")
    here.airspace.free("red", "a")
    here.now_s = 101.0
    assert here.reserve("b", NEAR)[0] == "granted"
    here.now_s = 110.0
    assert here.reserve("c", replace(RED, from_s=110.0, until_s=120.0))[0] == "granted"
    assert here.airspace.held_by_others("red") == ()


def test_ones_own_volumes_do_not_meet() -> None:
    here = Here()
    assert here.reserve("a", RED)[0] == "granted"
    assert here.reserve("b", RED)[0] == "granted"


@pytest.mark.requirement("X6", "X10")
@pytest.mark.parametrize("bad", [
    {"start": Ned(math.nan, 0, 0)}, {"radius_m": math.nan}, {"until_s": math.inf}, {"from_s": math.nan},
])  # fmt: skip
def test_what_is_incomplete_is_not_granted(bad: dict[str, object]) -> None:
    """X6: it could neither be kept clear nor run out."""
    here = Here()
    assert here.reserve("a", replace(RED, **bad))[0] == "denied"  # type: ignore[arg-type]
    assert here.airspace.held_by_others("blue") == ()


async def test_alone_a_drone_is_always_ours() -> None:
    here = Here()
    assert await here.airspace.claim("red", Geodetic(47.0, 8.0, 500.0)) is None
    here.now_s = 1000.0
    assert here.airspace.lost("red") is None
    here.airspace.give_up("red")
    assert await here.airspace.claim("red", Geodetic(47.0, 8.0, 500.0)) is None


def test_letting_a_drone_go_frees_its_volumes() -> None:
    here = Here()
    assert here.reserve("a", RED)[0] == "granted"
    here.airspace.give_up("red")
    assert here.airspace.held_by_others("blue") == ()
