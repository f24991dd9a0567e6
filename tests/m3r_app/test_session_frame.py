"""Telemetry in the session's frame: believed as the vehicle's own local position, until its origin moves against the session's."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from m3r_app.session_frame import JUMP_M, InSessionFrame, in_session_frame
from m3r_app.vehicle.telemetry import Telemetry
from safety.frames import LocalFrame
from safety.vocabulary import FlightMode, Geodetic, Ned
from tests.m3r_app.tabletop_vehicle import flying

FRAME = LocalFrame(Geodetic(47.0, 8.0, 500.0))
OWN = Ned(100.0, -50.0, 3.0)
"""Where the session's origin is in the vehicle's own frame."""


def told(place: Ned, drift: Ned = Ned(0.0, 0.0, 0.0)) -> Telemetry:  # noqa: B008
    return flying(FRAME.geodetic(place), place.plus(OWN).plus(drift))


def found(telemetry: Telemetry, shift: Ned | None, *, battery_may_be_unknown: bool = False) -> InSessionFrame:
    made = in_session_frame(
        telemetry,
        FRAME,
        shift,
        FlightMode.OFFBOARD,
        unasked_hold=False,
        battery_may_be_unknown=battery_may_be_unknown,
    )
    assert made is not None
    return made


@pytest.mark.requirement("X6")
@pytest.mark.parametrize(("drift_m", "moved"), [(0.0, False), (JUMP_M - 0.01, False), (JUMP_M + 0.01, True)])
def test_a_local_origin_that_moves_is_seen(drift_m: float, moved: bool) -> None:
    first = found(told(Ned(10.0, 0.0, -10.0)), None)
    assert not first.moved and first.shift.minus(OWN).norm < 1e-6
    place = Ned(11.0, 0.0, -10.0)
    next_one = found(told(place, Ned(0.0, drift_m, 0.0)), first.shift)
    assert next_one.moved == moved
    off_m = next_one.state.position.minus(place).norm
    assert off_m == pytest.approx(0.0 if moved else drift_m, abs=1e-6)
    assert next_one.shift.minus(OWN).norm == pytest.approx(drift_m if moved else 0.0, abs=1e-6)


@pytest.mark.requirement("X6")
def test_what_is_not_told_is_no_state() -> None:
    whole = told(Ned(10.0, 0.0, -10.0))
    for missing in ("local", "geodetic", "velocity"):
        part = replace(whole, **{missing: None})  # type: ignore[arg-type]
        made = in_session_frame(part, FRAME, None, FlightMode.HOLD, unasked_hold=False, battery_may_be_unknown=False)
        assert made is None


def test_an_unknown_battery_is_not_a_number_unless_it_was_declared() -> None:
    silent = replace(told(Ned(10.0, 0.0, -10.0)), battery=None)
    assert math.isnan(found(silent, None).state.battery or 0.0)
    assert found(silent, None, battery_may_be_unknown=True).state.battery is None
