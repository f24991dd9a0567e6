"""State x event x delay, and somebody takes the drone over in each: nothing of ours commands it from then on (X3).

`make test` tries every 29th event at two delays; `M3R_SOAK=1` all of them at eight, which cover saFUZZ's bands.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from m3r_app.arbiter import sessions
from m3r_app.arbiter.effects import Effect, FaceOperator, Fly, Hold
from m3r_app.arbiter.events import (
    ClaimLost,
    Ended,
    FrameMoved,
    Requested,
    ReservationAnswered,
    Stalled,
    TelemetryArrived,
    Tick,
)
from m3r_app.arbiter.state import ArbiterState
from m3r_app.arbiter.step import step
from safety.vocabulary import Command, FlightMode, State
from tests.m3r_app.tabletop import Tabletop
from tests.m3r_app.test_arbiter import MADE, every_event
from tests.soak.figures import SOAK, record

DELAYS_S = (0.0, 0.05, 0.2, 0.6, 1.2, 4.0, 12.0, 40.0) if SOAK else (0.2, 1.2)
EVERY = 1 if SOAK else 29
MODES = (FlightMode.POSITION, FlightMode.LAND, FlightMode.HOLD)
TOLD_S = 0.02
"""From the takeover until its telemetry is here."""


def taken(table: Tabletop, mode: FlightMode, at_s: float) -> TelemetryArrived:
    """Somebody else's mode. A Hold that we did not ask for is somebody's STOP."""
    vehicle = replace(table.vehicle(), at_s=at_s, flight_mode=mode, unasked_hold=mode is FlightMode.HOLD)
    return TelemetryArrived(vehicle)


def afterwards(table: Tabletop, told: TelemetryArrived) -> list[Any]:
    """Whatever might still command it: what was asked, answered or noticed too late. Pairing anew is not among them."""
    asked = (Command.STOP, Command.GO_LEFT, Command.TURN_LEFT, Command.CONTINUE, Command.DISCONNECT)
    deciding = table.state.deciding
    late = deciding.ask_id if deciding is not None else "r1"
    return [
        *(Requested(table.request(command), 0.0) for command in asked),
        ReservationAnswered(late, "granted"),
        ReservationAnswered("return", "granted"),
        told,
        TelemetryArrived(replace(told.vehicle, flight_mode=FlightMode.OFFBOARD, unasked_hold=False)),
        Stalled("it stalled"),
        FrameMoved("it moved"),
        ClaimLost("its claim is lost"),
        Tick(),
        Ended("the run is over"),
    ]


def commands(effects: tuple[Effect, ...]) -> int:
    return sum(isinstance(effect, Hold | Fly | FaceOperator) for effect in effects)


def fought(made: State) -> tuple[int, int]:
    """How many takeovers in this state were tried, and how many of them were fought."""
    table = MADE[made]()
    tried = unsafe = 0
    for event in every_event(table)[::EVERY]:
        for delay_s in DELAYS_S:
            at_s = table.now_s + delay_s
            before, _ = step(table.state, event, at_s)
            for mode in MODES:
                told = taken(table, mode, at_s + TOLD_S)
                tried += 1
                unsafe += _fights(before, told, afterwards(table, told), at_s + TOLD_S)
    return tried, unsafe


def _fights(state: ArbiterState, told: TelemetryArrived, after: list[Any], now_s: float) -> bool:
    state, effects = step(state, told, now_s)
    if state.authority or commands(effects):
        return True
    for event in after:
        _, effects = step(state, event, now_s + TOLD_S)
        if commands(effects):
            return True
    return False


@pytest.mark.requirement("X3")
@pytest.mark.parametrize("made", list(MADE))
def test_a_takeover_is_never_fought_whatever_happened_before(made: State, monkeypatch: pytest.MonkeyPatch) -> None:
    """X3: and the look at whose the drone is, is what prevents it."""
    tried, unsafe = fought(made)
    assert tried > 0
    monkeypatch.setattr(sessions, "lost", lambda _run, _vehicle: False)
    without_tried, without = fought(made)
    record(
        "state x event x delay, takeover in each", made.value, count=tried, unsafe=unsafe,
        without_guard=f"{without} of {without_tried} fought: the look at whose the drone is, switched off",
    )  # fmt: skip
    assert unsafe == 0
    if MADE[made]().state.authority:
        assert without > 0
