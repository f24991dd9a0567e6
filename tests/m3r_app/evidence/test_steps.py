"""The arbiter's steps, taken apart without its classes, tell what the plain messages tell."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest

from m3r_app.arbiter.announcements import Announce
from m3r_app.arbiter.effects import Fly, Hold
from m3r_app.arbiter.events import NeighboursHeard, PairingAnswered, TelemetryArrived, Tick
from m3r_app.evidence.judge import judge
from m3r_app.evidence.reading import EvidenceError, flight_of
from m3r_app.evidence.steps import steps_of
from m3r_app.output import Notice
from m3r_app.step_record import codec
from safety.vocabulary import Ned, Neighbours, VehicleState
from tests.m3r_app.evidence.recorded import STARTED_S, RecordedFlight


class SteppedFlight(RecordedFlight):
    """Also records its steps, as `m3r_app.step_record` does."""

    def __init__(self, seed: int, **more: Any) -> None:
        self.steps: list[dict[str, Any]] = []
        self.text = codec()
        super().__init__(seed, **more)

    def put(self, event: Any) -> None:
        self.step(event, ())
        super().put(event)

    def carry_out(self, effect: object) -> None:
        super().carry_out(effect)
        if isinstance(effect, Fly):
            self.step(Tick(), (Hold("before it"), effect))
        if isinstance(effect, Hold):
            self.step(PairingAnswered("red", (), self.operator, self.world), ())

    def step(self, event: object, effects: tuple[object, ...]) -> None:
        self.steps.append(
            {
                "t": self.now_s - STARTED_S,
                "now_s": self.now_s,
                "event": json.loads(self.text.text(event)),
                "effects": json.loads(self.text.text(effects)),
            }
        )


@pytest.fixture(scope="module")
def flown() -> tuple[SteppedFlight, Any]:
    flight = SteppedFlight(11, duration_s=16.5)
    return flight, flight.told()


def test_a_flight_by_its_steps_is_judged_as_by_its_messages(flown: tuple[SteppedFlight, Any]) -> None:
    flight, told = flown
    messages = steps_of(told.messages, flight.steps, flight.text.shapes(), flight.text.documents)
    metadata = {**told.metadata, "started_s": STARTED_S, "world": None}  # it is in the steps
    by_steps = judge(flight_of(metadata, messages, closed=True))
    assert by_steps == judge(flight_of(told.metadata, told.messages, closed=True))
    assert by_steps.plans == 2
    assert by_steps.passed


def test_every_sample_comes_from_the_steps_alone(flown: tuple[SteppedFlight, Any]) -> None:
    flight, told = flown
    thinned = [m for i, m in enumerate(told.messages) if m[0] != "telemetry" or i % 5 == 0]
    messages = steps_of(thinned, flight.steps, flight.text.shapes(), flight.text.documents)
    assert sum(m[0] == "telemetry" for m in messages) == len(told.of("telemetry"))


def test_values_that_json_lacks_come_back() -> None:
    text = codec()
    event = TelemetryArrived(_state(math.nan))
    (message,) = steps_of([], [{"t": 1.0, "event": json.loads(text.text(event))}], text.shapes(), {})
    assert message[:2] == ("telemetry", 1.0)
    assert message[2]["position"] == [1.0, 2.0, -3.0]
    assert math.isnan(message[2]["sigma_h_m"])
    sky = NeighboursHeard(_sky())
    messages = steps_of([], [{"t": 1.0, "event": json.loads(text.text(sky))}], text.shapes(), {})
    assert [m[0] for m in messages] == ["neighbours", "reservations"]
    assert np.array_equal(messages[0][2]["neighbours"]["positions_ned_m"], np.array([[1.0, 2.0, 3.0]]))


def test_a_world_that_was_changed_is_found(flown: tuple[SteppedFlight, Any]) -> None:
    flight, told = flown
    changed = {name: text.replace("0.1", "0.2") for name, text in flight.text.documents.items()}
    with pytest.raises(EvidenceError, match="is missing or was changed"):
        steps_of(told.messages, flight.steps, flight.text.shapes(), changed)


def test_a_tube_widened_for_a_noisy_estimate_counts(flown: tuple[SteppedFlight, Any]) -> None:
    """As it was told when pairing was confirmed: farther from everything, and no speed is known better than its noise."""
    flight, told = flown
    (confirmed_s, _), *_ = told.of("pair")
    said = (Announce(Notice.PAIRED, "red", (), (0.1, 0.7)),)
    step = {"t": confirmed_s, "event": ["Tick"], "effects": json.loads(flight.text.text(said))}
    messages = steps_of(told.messages, [*flight.steps, step], flight.text.shapes(), flight.text.documents)
    wider = judge(flight_of(told.metadata, messages, closed=True))
    before = judge(flight_of(told.metadata, told.messages, closed=True))
    less = {
        (a.part, a.limit, a.note): round(b.margin - a.margin, 6)
        for a, b in zip(wider.lines, before.lines, strict=True)
        if a.margin is not None and b.margin is not None
    }
    assert less["plan", "standoff", ""] == less["plan", "workspace", ""] == 0.7
    assert less["plan", "envelope", "where it starts"] == -0.7
    assert less["telemetry", "speed", ""] == pytest.approx(-3.0 * 0.1 / 0.5)
    assert less["telemetry", "standoff", ""] == 0.0


def _state(sigma_m: float) -> VehicleState:
    return VehicleState(1.0, Ned(1.0, 2.0, -3.0), Ned(0.0, 0.0, 0.0), 0.0, 0.0, sigma_m, 0.1)


def _sky() -> Neighbours:
    one = np.array([0.1])
    return Neighbours(("zoe",), np.array([[1.0, 2.0, 3.0]]), np.zeros((1, 3)), one, one, 1.0)
