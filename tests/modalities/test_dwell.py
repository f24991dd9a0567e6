"""Held long enough, in most frames, once; and losing the hand is never a request (R1, X4)."""

from __future__ import annotations

import math
from collections.abc import Iterable

import pytest

from modalities.hands.dwell import HOLD_S, LONGEST_GAP_S, REARM_S, DwellFilter, Held
from modalities.hands.gestures import NO_HAND, Reading
from safety.vocabulary import Command

LEFT = Reading(Command.GO_LEFT, 0.9, "index finger left")
RIGHT = Reading(Command.GO_RIGHT, 0.9, "index finger right")
PALM = Reading(Command.STOP, 0.8, "open palm")
NOTHING = NO_HAND


def play(hold: DwellFilter, readings: Iterable[Reading], rate_hz: float = 30.0, begin_s: float = 0.0) -> list[Held]:
    held = (hold.accept(reading, begin_s + number / rate_hz) for number, reading in enumerate(readings))
    return [one for one in held if one is not None]


@pytest.mark.requirement("R1")
@pytest.mark.parametrize("rate_hz", [2.2, 3.0, 4.0, 6.0, 10.0, 15.0, 24.0, 30.0, 60.0, 120.0])
def test_one_held_gesture_is_one_request_at_any_frame_rate(rate_hz: float) -> None:
    held = play(DwellFilter(), [LEFT] * round(5.0 * rate_hz), rate_hz)
    assert [one.command for one in held] == [Command.GO_LEFT]
    assert HOLD_S - 1e-6 <= held[0].captured_at_s <= HOLD_S + (1.0 if rate_hz >= 4.0 else 3.0) / rate_hz
    assert held[0].confidence == pytest.approx(0.9)
    assert held[0].held_s == HOLD_S


@pytest.mark.requirement("X4")
@pytest.mark.parametrize("rate_hz", [2.2, 3.0, 6.0, 15.0, 30.0])
def test_a_palm_stops_after_half_the_time(rate_hz: float) -> None:
    held = play(DwellFilter(), [PALM] * round(3.0 * rate_hz), rate_hz)
    assert [one.command for one in held] == [Command.STOP]
    assert held[0].captured_at_s <= 0.5 * HOLD_S + (1.0 if rate_hz >= 4.0 else 3.0) / rate_hz


def test_too_short_is_nothing() -> None:
    assert play(DwellFilter(), [LEFT] * 15 + [NOTHING] * 60) == []
    assert play(DwellFilter(), [PALM] * 7 + [NOTHING] * 60) == []
    assert play(DwellFilter(), [NOTHING] * 30 + [LEFT] * 12 + [NOTHING] * 60) == []
    assert len(play(DwellFilter(), [NOTHING] * 30 + [LEFT] * 13 + [NOTHING] * 60)) == 1, (
        "13 of the 16 frames of half a second"
    )


@pytest.mark.requirement("R1")
def test_losing_the_hand_is_never_a_request() -> None:
    for shown in range(15):
        assert play(DwellFilter(), [LEFT] * shown + [NOTHING] * 100) == []


def test_most_frames_are_enough_but_half_are_not() -> None:
    most = [NOTHING if number % 8 == 7 else LEFT for number in range(60)]
    assert len(play(DwellFilter(), most)) == 1
    half = [NOTHING if number % 2 else LEFT for number in range(300)]
    assert play(DwellFilter(), half) == []


def test_a_frame_of_another_gesture_begins_anew() -> None:
    held = play(DwellFilter(), [LEFT] * 14 + [RIGHT] + [LEFT] * 30)
    assert [one.command for one in held] == [Command.GO_LEFT]
    assert held[0].captured_at_s == pytest.approx((15 + 15) / 30.0)


def test_armed_again_after_the_hand_has_left_or_changed_but_not_by_a_flicker() -> None:
    left_it = round(REARM_S * 30) + 1
    assert len(play(DwellFilter(), [LEFT] * 20 + [NOTHING] * left_it + [LEFT] * 20)) == 2
    assert len(play(DwellFilter(), [LEFT] * 20 + [NOTHING] * (left_it - 3) + [LEFT] * 40)) == 1
    flicker = ([LEFT] * 10 + [NOTHING] * 4) * 20
    assert len(play(DwellFilter(), flicker)) <= 1
    changed = play(DwellFilter(), [LEFT] * 20 + [RIGHT] * 20 + [LEFT] * 20)
    assert [one.command for one in changed] == [Command.GO_LEFT, Command.GO_RIGHT, Command.GO_LEFT]


def test_time_without_frames_is_neither_holding_nor_leaving() -> None:
    hold = DwellFilter()
    assert hold.accept(LEFT, 0.0) is None
    assert hold.accept(LEFT, 0.1) is None
    assert hold.accept(LEFT, 0.1 + 2.0 * HOLD_S) is None, "nobody saw what was in between"
    assert len(play(hold, [LEFT] * 30, begin_s=1.2)) == 1
    assert play(hold, [LEFT] * 60, begin_s=60.0) == [], "nor that the hand had left"


@pytest.mark.requirement("X4")
def test_a_stall_in_the_middle_of_a_palm_does_not_complete_it() -> None:
    hold = DwellFilter()
    hold.accept(PALM, 0.0)
    assert hold.accept(PALM, LONGEST_GAP_S + 0.01) is None


@pytest.mark.requirement("X4")
def test_a_stall_is_one_at_any_frame_rate() -> None:
    """Twice the usual time without a frame, in a fast stream and in a slow one."""
    for rate_hz in (30.0, 3.0):
        hold = DwellFilter()
        before = [NOTHING] * 8
        assert play(hold, before, rate_hz) == []
        last_s = (len(before) - 1) / rate_hz
        assert hold.accept(LEFT, last_s + 1.0 / rate_hz) is None
        assert hold.accept(LEFT, last_s + 1.0 / rate_hz + HOLD_S + 0.02) is None


def test_too_few_frames_to_hold_anything_are_known() -> None:
    hold = DwellFilter()
    assert play(hold, [LEFT] * 20, 1.5) == []
    assert hold.rate_hz == pytest.approx(1.5)
    assert hold.rate_hz < hold.slowest_hz == 2.0
    assert play(hold, [NOTHING] * 10, 30.0, begin_s=60.0) == []
    assert hold.rate_hz == pytest.approx(30.0)


def test_frames_out_of_order_and_without_a_time_are_none() -> None:
    hold = DwellFilter()
    hold.accept(LEFT, 1.0)
    for at_s in (1.0, 0.5, math.nan, math.inf, -math.inf):
        assert hold.accept(LEFT, at_s) is None
    assert len(play(hold, [LEFT] * 20, begin_s=1.03)) == 1


def test_confidence_is_the_mean_of_the_frames_that_show_it() -> None:
    readings = [Reading(Command.GO_UP, 0.5 + 0.4 * (number % 2), "index finger up") for number in range(20)]
    assert play(DwellFilter(), readings)[0].confidence == pytest.approx(0.7, abs=0.02)


@pytest.mark.parametrize("hold_s", [0.0, -1.0, math.nan, math.inf])
def test_a_hold_time_that_is_none_is_refused(hold_s: float) -> None:
    with pytest.raises(ValueError, match="positive"):
        DwellFilter(hold_s)


def test_another_hold_time_is_kept() -> None:
    assert play(DwellFilter(1.0), [LEFT] * 60)[0].captured_at_s == pytest.approx(1.0, abs=0.04)
