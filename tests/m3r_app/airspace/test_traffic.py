"""What others say of where they are, as it is judged: fresh, plausible, one aircraft per name. R5, R11, X6."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from m3r_app.airspace import traffic as module
from m3r_app.airspace.messages import Place, State, Velocity
from m3r_app.airspace.topics import cells_near
from m3r_app.airspace.traffic import DOUBT_S, FORGET_S, SPEED_MAX_M_S, TRANSIT_S, RemoteTraffic
from safety.frames import LocalFrame
from safety.vocabulary import Geodetic, Ned, Neighbours

HERE = Geodetic(46.679, 7.863, 580.0)
FRAME = LocalFrame(HERE)
CELLS = cells_near(HERE)
THERE, STILL = Ned(10, 0, -10), Ned(0, 0, 0)


def state(place: Ned = THERE, velocity: Ned = STILL, sigma_m: float = 0.3, age_s: float = 0.0) -> State:
    speeds = Velocity(north_m_s=velocity.north, east_m_s=velocity.east, down_m_s=velocity.down)
    return State(place=Place.of(FRAME.geodetic(place)), velocity=speeds, sigma_m=sigma_m, age_s=age_s)


class Watched:
    """A sky, and what was said of it."""

    def __init__(self) -> None:
        self.said: list[str] = []
        self.sky = RemoteTraffic(self.said.append)

    def heard(self, now_s: float, one: State, drone: str = "blue", life: str = "a", early_s: float = 0.0) -> None:
        self.sky.heard(drone, life, one, early_s, now_s)

    def seen(self, now_s: float, **linked: tuple[Geodetic | None, float]) -> Neighbours:
        return self.sky.neighbours(FRAME, CELLS, linked, now_s, now_s)

    def nowhere(self, now_s: float) -> bool:
        return bool(np.isnan(self.seen(now_s).positions_ned_m).all())


@pytest.mark.requirement("R11")
@given(st.floats(-4.0, 4.0), st.lists(st.floats(0.0, 0.8), min_size=1, max_size=10), st.floats(0.0, 1.0))
def test_a_state_is_never_thought_fresher_than_clocks_allow(
    ahead_s: float, transits_s: list[float], age_s: float
) -> None:
    """Whatever the sender's clock says: its real age, less the 50 ms, where one message has come as fast as that or its clock is behind."""
    sky, now_s = Watched(), 1000.0
    for transit_s in [0.0, *transits_s]:
        now_s += 1.0
        sky.heard(now_s, state(age_s=age_s), early_s=ahead_s - transit_s)
        told_age_s = now_s - sky.seen(now_s).at_s[0]
        assert told_age_s >= age_s + transit_s + TRANSIT_S - 1e-9 - 1e-6


@pytest.mark.requirement("R11")
def test_a_clock_behind_makes_it_older_never_younger() -> None:
    sky = Watched()
    sky.heard(100.0, state(), early_s=-2.0)
    assert 100.0 - sky.seen(100.0).at_s[0] == pytest.approx(2.0 + TRANSIT_S)


def test_what_was_overtaken_changes_nothing() -> None:
    sky = Watched()
    sky.heard(100.0, state(Ned(10, 0, -10)))
    sky.heard(100.1, state(Ned(9, 0, -10), age_s=2.0))
    assert sky.seen(100.1).positions_ned_m[0] == pytest.approx(Ned(10, 0, -10), abs=1e-6)


@pytest.mark.requirement("R11", "X6")
@pytest.mark.parametrize(("second", "why"), [
    (state(Ned(40, 0, -10)), "jumped by 30 m"),
    (state(Ned(10, 0, -10), Ned(0, SPEED_MAX_M_S + 1.0, 0)), "says that it flies 61 m/s"),
])  # fmt: skip
def test_what_cannot_be_puts_it_nowhere_for_a_while(second: State, why: str) -> None:
    sky = Watched()
    sky.heard(100.0, state())
    sky.heard(100.1, second)
    assert sky.nowhere(100.1) and len(sky.said) == 1 and why in sky.said[0]
    for tenth in range(2, 40):
        sky.heard(100.0 + 0.1 * tenth, state(second.place.geodetic and FRAME.ned(second.place.geodetic)))
    assert sky.nowhere(100.1 + DOUBT_S - 0.01)
    assert not sky.nowhere(104.1)


@pytest.mark.requirement("R11")
def test_two_aircraft_of_one_name_are_nowhere_as_long_as_both_tell() -> None:
    sky = Watched()
    for tenth in range(50):
        sky.heard(100.0 + 0.1 * tenth, state(Ned(10, 0, -10)), life="a")
        sky.heard(100.0 + 0.1 * tenth + 0.05, state(Ned(60, 0, -10)), life="b")
        if tenth > 0:
            assert sky.nowhere(100.0 + 0.1 * tenth + 0.05)
    assert sky.said == ["Blue is not to be relied on: two aircraft 50 m apart call themselves so"]


def test_one_drone_told_of_by_two_is_one_drone() -> None:
    sky = Watched()
    for tenth in range(20):
        sky.heard(100.0 + 0.1 * tenth, state(Ned(10, 0, -10)), life="a")
        sky.heard(100.0 + 0.1 * tenth + 0.05, state(Ned(10.5, 0, -10)), life="b")
    assert sky.seen(102.0).names == ("blue",) and not sky.nowhere(102.0) and sky.said == []


def test_of_two_who_tell_of_one_drone_the_fresher_counts() -> None:
    sky = Watched()
    for tenth in range(20):
        sky.heard(100.0 + 0.1 * tenth, state(Ned(10, 0, -10)), life="a")
        sky.heard(100.0 + 0.1 * tenth + 0.01, state(Ned(10.5, 0, -10), age_s=1.5), life="b")
    assert 101.95 - sky.seen(101.95).at_s[0] < 0.2 and sky.said == []


@pytest.mark.requirement("R11")
def test_who_flies_away_is_forgotten_and_who_falls_silent_is_not() -> None:
    sky = Watched()
    sky.heard(100.0, state(), "blue")
    sky.heard(100.0, state(Ned(20, 0, -10)), "green")
    sky.heard(101.0, state(Ned(21, 0, -10)), "green")
    assert sky.seen(100.0 + FORGET_S).names == ("blue", "green")
    assert sky.seen(100.5 + FORGET_S).names == ("green",)
    assert sky.said == ["Blue was not heard of for 120 s and is not counted any more: look for it"]
    far = FRAME.geodetic(Ned(5000, 0, -10))
    for step in range(400):
        there = Ned(20 + 20.0 * step, 0, -10)
        sky.heard(300.0 + step, state(there, Ned(20, 0, 0)), "yellow")
    assert "yellow" not in sky.seen(700.0).names and far


@pytest.mark.requirement("X6")
def test_what_is_real_but_unreadable_makes_it_nowhere() -> None:
    sky = Watched()
    sky.sky.doubt("blue", "its messages cannot be read", 100.0)
    assert sky.seen(100.0).names == ("blue",) and sky.nowhere(100.0)
    sky.heard(100.1, state())
    assert sky.nowhere(100.2), "still in doubt"
    assert not sky.nowhere(100.0 + DOUBT_S + 0.1)


@pytest.mark.requirement("R5")
def test_a_linked_drone_is_no_neighbour_but_its_double_is() -> None:
    sky = Watched()
    sky.heard(100.0, state(Ned(10, 0, -10)), "red")
    near, far = FRAME.geodetic(Ned(11, 0, -10)), FRAME.geodetic(Ned(40, 0, -10))
    assert sky.seen(100.0, red=(near, 0.02)).names == ()
    assert sky.seen(100.0, red=(far, 0.02)).names == ("another red",)
    assert sky.seen(100.0, red=(None, math.inf)).names == ("another red",)


@pytest.mark.requirement("X6")
def test_it_is_bounded_and_whom_it_cannot_keep_is_nowhere(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "TRACKS_MAX", 3)
    sky = Watched()
    for i in range(10):
        sky.heard(100.0, state(), f"d{i}")
    seen = sky.seen(100.0)
    assert len(sky.sky) == 3 and len(seen) == 4
    assert seen.names[3] == "somebody else (there are too many)" and np.isnan(seen.positions_ned_m[3]).all()


@pytest.mark.requirement("R5")
@given(
    st.lists(
        st.tuples(
            st.sampled_from(["green", "red", "yellow"]), st.sampled_from("ab"), st.floats(-300, 300), st.floats(-3, 3)
        ),
        max_size=30,
    )
)
def test_nobody_takes_another_out_of_the_sky(others: list[tuple[str, str, float, float]]) -> None:
    """Whatever the others tell, authentic as it may be, blue stays where it told to be."""
    sky = Watched()
    sky.heard(100.0, state())
    for i, (drone, life, north_m, early_s) in enumerate(others):
        sky.heard(100.0 + 0.01 * i, state(Ned(north_m, 0, -10)), drone, life, early_s)
        sky.sky.doubt(drone, "x", 100.0 + 0.01 * i)
    seen = sky.seen(100.5)
    assert seen.positions_ned_m[seen.names.index("blue")] == pytest.approx(Ned(10, 0, -10), abs=1e-6)
