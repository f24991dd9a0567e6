"""The failsafe parameters that pairing requires: compared, reported with a remedy, set and read back (X7, X8)."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Iterable, Mapping

import pytest

from m3r_app.vehicle.px4_failsafe import HOLD_ACTION, apply, check, mismatches

GOOD: dict[str, float | None] = {"COM_OF_LOSS_T": 0.5, "COM_OBL_RC_ACT": 5, "COM_RC_OVERRIDE": 3}
PX4_DEFAULTS: dict[str, float | None] = {"COM_OF_LOSS_T": 1.0, "COM_OBL_RC_ACT": 0, "COM_RC_OVERRIDE": 1}


class Memory:
    """Parameters of a vehicle; `stuck` ones acknowledge a new value and keep the old."""

    def __init__(self, values: Mapping[str, float | None], stuck: Iterable[str] = ()) -> None:
        self.values = dict(values)
        self.stuck = set(stuck)
        self.written: list[tuple[str, float]] = []

    async def parameters(self, names: Iterable[str]) -> dict[str, float | None]:
        return {name: self.values.get(name) for name in names}

    async def set_parameter(self, name: str, value: float) -> None:
        self.written.append((name, value))
        if name not in self.stuck:
            self.values[name] = value


@pytest.mark.requirement("X8")
def test_as_required_nothing_is_found() -> None:
    assert mismatches(GOOD, rc_present=True) == ()


@pytest.mark.requirement("X7", "X8")
@pytest.mark.parametrize(
    ("value", "passes"),
    [(1.0, True), (math.nextafter(1.0, 2), False), (0.01, True), (0.0, False), (-1.0, False), (60.0, False),
     (math.nan, False), (math.inf, False), (None, False)],
)  # fmt: skip
def test_offboard_loss_is_noticed_within_a_second(value: float | None, passes: bool) -> None:
    found = mismatches({**GOOD, "COM_OF_LOSS_T": value}, rc_present=False)
    assert [m.name for m in found] == ([] if passes else ["COM_OF_LOSS_T"])


@pytest.mark.requirement("X7", "X8")
@pytest.mark.parametrize("value", [-1, 0, 1, 2, 3, 4, 6, 7, math.nan, None])
def test_only_hold_will_do_after_offboard_is_lost(value: float | None) -> None:
    assert [m.name for m in mismatches({**GOOD, "COM_OBL_RC_ACT": value}, False)] == ["COM_OBL_RC_ACT"]


@pytest.mark.requirement("X8")
@pytest.mark.parametrize("value", [0, 1, 4, 5, math.nan, None])
def test_the_sticks_must_take_over_from_offboard_where_there_may_be_a_remote_control(value: float | None) -> None:
    values = {**GOOD, "COM_RC_OVERRIDE": value}
    assert [m.name for m in mismatches(values, rc_present=True)] == ["COM_RC_OVERRIDE"]
    assert [m.name for m in mismatches(values, rc_present=None)] == ["COM_RC_OVERRIDE"]
    assert mismatches(values, rc_present=False) == ()


@pytest.mark.parametrize("value", [2, 3, 6, 7])
def test_any_override_with_bit_1_will_do(value: float) -> None:
    assert mismatches({**GOOD, "COM_RC_OVERRIDE": value}, True) == ()


@pytest.mark.requirement("X8")
def test_every_mismatch_is_told_with_value_requirement_and_remedy() -> None:
    found = mismatches({"COM_OF_LOSS_T": 5.0, "COM_OBL_RC_ACT": 0}, rc_present=True)
    assert [m.name for m in found] == ["COM_OF_LOSS_T", "COM_OBL_RC_ACT", "COM_RC_OVERRIDE"]
    loss, action, override = (m.text for m in found)
    assert "is 5 " in loss and "at most 1 s" in loss and "set it to 0.5" in loss and "--apply-failsafe" in loss
    assert "is 0 " in action and f"{HOLD_ACTION} (Hold)" in action
    assert "COM_RC_OVERRIDE does not exist" in override and "--apply-failsafe" not in override


def test_px4s_defaults_are_refused_then_applied_and_read_back() -> None:
    vehicle = Memory(PX4_DEFAULTS)
    assert {m.name for m in asyncio.run(check(vehicle, True))} == {"COM_OBL_RC_ACT", "COM_RC_OVERRIDE"}
    assert asyncio.run(apply(vehicle, True)) == ()
    assert vehicle.values == {"COM_OF_LOSS_T": 1.0, "COM_OBL_RC_ACT": 5, "COM_RC_OVERRIDE": 3}
    assert all(name != "COM_OF_LOSS_T" for name, _ in vehicle.written), "what is as required is left alone"


@pytest.mark.requirement("X8")
def test_a_value_that_does_not_stick_is_still_a_mismatch() -> None:
    vehicle = Memory(PX4_DEFAULTS, stuck=["COM_OBL_RC_ACT"])
    assert [m.name for m in asyncio.run(apply(vehicle, False))] == ["COM_OBL_RC_ACT"]


@pytest.mark.requirement("X8")
def test_a_missing_parameter_is_not_set_but_told() -> None:
    vehicle = Memory({"COM_OBL_RC_ACT": 5})
    found = asyncio.run(apply(vehicle, False))
    assert [(m.name, m.value) for m in found] == [("COM_OF_LOSS_T", None)]
    assert vehicle.written == []
