"""What a drone's state is told as: known or not at all, ten times a second, in every cell it is near. R5, R11, X6."""

from __future__ import annotations

import math
from typing import Any

import pytest

from m3r_app.airspace.messages import State
from m3r_app.airspace.state_publisher import PERIOD_S, StatePublisher
from m3r_app.airspace.topics import StateTopic, cell_of, cells_near
from safety.vocabulary import Geodetic, Ned

HERE, STILL = Geodetic(46.679, 7.863, 580.0), Ned(0.0, 0.0, 0.0)


class Told:
    """Stands for an exchange that may sign for red."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.sent: list[tuple[StateTopic, State]] = []
        self.publisher = StatePublisher(self, lambda: self.now_s)  # type: ignore[arg-type]

    def may_sign(self, key_id: str) -> bool:
        return key_id == "drone.red"

    def send(self, topic: StateTopic, body: State, signer: str) -> None:
        assert signer == f"drone.{topic.drone}"
        self.sent.append((topic, body))


def test_a_state_is_told_ten_times_a_second_at_most() -> None:
    told = Told()
    for step in range(50):
        told.now_s = 100.0 + 0.02 * step
        told.publisher.tell("red", HERE, STILL, 0.3, 0.01)
    assert 9 <= len(told.sent) <= 10 + 1
    assert told.sent[0][0] == StateTopic(cell_of(HERE), "red")
    assert told.publisher.near == cells_near(HERE)
    assert told.publisher.tells
    told.now_s += 1.0 + PERIOD_S
    assert not told.publisher.tells


@pytest.mark.requirement("X6")
@pytest.mark.parametrize("bad", [
    {"place": Geodetic(math.nan, 8.0, 500.0)}, {"velocity": Ned(math.nan, 0, 0)}, {"sigma_m": math.nan}, {"sigma_m": -1.0},
    {"age_s": math.nan}, {"age_s": math.inf}, {"age_s": 10.1}, {"place": Geodetic(46.0, 8.0, 30_000.0)},
])  # fmt: skip
def test_what_is_not_known_is_not_told(bad: dict[str, Any]) -> None:
    told = Told()
    whole: dict[str, Any] = {"place": HERE, "velocity": STILL, "sigma_m": 0.3, "age_s": 0.01}
    told.publisher.tell("red", **whole | bad)
    assert told.sent == []


def test_a_drone_of_somebody_else_is_listened_about_but_not_told() -> None:
    told = Told()
    told.publisher.tell("blue", HERE, STILL, 0.3, 0.01)
    assert told.sent == [] and told.publisher.near == cells_near(HERE)
