"""What the autopilot must do by itself when our setpoints stop: required at pairing, read back, never assumed (X7, X8).

The parameters and their values are PX4's (parameter reference, group Commander); its defaults are none of these. With
them, setpoints that stop (a dead app, a lost link) end in Hold within the time-out and the vehicle's stopping time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from m3r_app.vehicle.interface import ParameterAccess

OFFBOARD_LOSS_MAX_S = 1.0
OFFBOARD_LOSS_APPLIED_S = 0.5
"""What applying sets: soon, and ten of MAVSDK's setpoints long."""
HOLD_ACTION = 5
"""COM_OBL_RC_ACT: 0 Position, 1 Altitude, 2 Stabilized, 3 Return, 4 Land, 5 Hold, 6 Terminate, 7 Disarm."""
OVERRIDE_IN_OFFBOARD = 2
"""COM_RC_OVERRIDE bit 1: moving the sticks takes over from Offboard too (bit 0: from automatic modes)."""


@dataclass(frozen=True, slots=True)
class RequiredParameter:
    """One parameter that pairing depends on."""

    name: str
    accepts: Callable[[float], bool]
    required: str
    """In words, for the operator."""
    why: str
    remedied: Callable[[float], float]
    """The value to set, given the present one."""
    only_with_rc: bool = False


REQUIRED = (
    RequiredParameter(
        "COM_OF_LOSS_T",
        lambda value: 0.0 < value <= OFFBOARD_LOSS_MAX_S,
        f"above 0 and at most {OFFBOARD_LOSS_MAX_S:g} s",
        "setpoints that stop must be noticed at once",
        lambda _: OFFBOARD_LOSS_APPLIED_S,
    ),
    RequiredParameter(
        "COM_OBL_RC_ACT",
        lambda value: value == HOLD_ACTION,
        f"{HOLD_ACTION} (Hold)",
        "without setpoints the drone must stay where it is",
        lambda _: HOLD_ACTION,
    ),
    RequiredParameter(
        "COM_RC_OVERRIDE",
        lambda value: value == int(value) and bool(int(value) & OVERRIDE_IN_OFFBOARD),
        "with bit 1 set (stick override in Offboard)",
        "the pilot's sticks must always take over",
        lambda value: int(value) | OVERRIDE_IN_OFFBOARD,
        only_with_rc=True,
    ),
)


@dataclass(frozen=True, slots=True)
class Mismatch:
    """A required parameter that is not as required. value None: the vehicle does not have it; NaN: it did not answer."""

    name: str
    value: float | None
    required: str
    remedy: str

    @property
    def text(self) -> str:
        """One sentence for the operator."""
        found = "does not exist on this vehicle" if self.value is None else f"is {self.value:g}"
        if self.value is not None and math.isnan(self.value):
            return f"{self.name} did not answer: the link loses messages, so {self.remedy}."
        return f"{self.name} {found} and must be {self.required}: {self.remedy}."


def required_for(rc_present: bool | None) -> tuple[RequiredParameter, ...]:
    """What is required; a remote control that may be there (None: unknown) counts as there."""
    return tuple(parameter for parameter in REQUIRED if rc_present is not False or not parameter.only_with_rc)


def mismatches(values: Mapping[str, float | None], rc_present: bool | None) -> tuple[Mismatch, ...]:
    """Every required parameter that is missing, unreadable or not as required. Empty: pairing may go on (X8)."""
    found = []
    for parameter in required_for(rc_present):
        value = values.get(parameter.name)
        if value is None:
            remedy = f"{parameter.why}, so fly a PX4 that has this parameter"
        elif math.isnan(value):
            remedy = "come nearer or better the link, and pair again"
        elif math.isfinite(value) and parameter.accepts(value):
            continue
        else:
            remedied = parameter.remedied(value if math.isfinite(value) else 0.0)
            remedy = f"{parameter.why}, so set it to {remedied:g} or run with --apply-failsafe"
        found.append(Mismatch(parameter.name, value, parameter.required, remedy))
    return tuple(found)


async def check(vehicle: ParameterAccess, rc_present: bool | None) -> tuple[Mismatch, ...]:
    """Read the required parameters back from the vehicle and compare. Raises what the vehicle raises."""
    names = [parameter.name for parameter in required_for(rc_present)]
    return mismatches(await vehicle.parameters(names), rc_present)


async def apply(vehicle: ParameterAccess, rc_present: bool | None) -> tuple[Mismatch, ...]:
    """Set what is not as required, then read all of it back: what is returned still is not as required."""
    by_name = {parameter.name: parameter for parameter in REQUIRED}
    for mismatch in await check(vehicle, rc_present):
        if mismatch.value is not None and math.isfinite(mismatch.value):
            present = mismatch.value if math.isfinite(mismatch.value) else 0.0
            await vehicle.set_parameter(mismatch.name, by_name[mismatch.name].remedied(present))
    return await check(vehicle, rc_present)
