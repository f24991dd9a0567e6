"""One vehicle's telemetry in the session's frame, for the arbiter. Source: X6, design "Estimators jump", paper III-A."""

from __future__ import annotations

import math
from dataclasses import dataclass

from m3r_app.vehicle.telemetry import Telemetry
from safety.frames import LocalFrame
from safety.vocabulary import FlightMode, Ned, VehicleState

JUMP_M = 0.5
"""The two forms of the vehicle's position may differ by this; more, and its local origin has moved."""


@dataclass(frozen=True, slots=True)
class InSessionFrame:
    """A vehicle's state in the session's frame. shift: from there to the vehicle's own frame, added (m)."""

    state: VehicleState
    shift: Ned
    moved: bool
    """The vehicle's own frame has moved against the session's since the last."""


def in_session_frame(
    telemetry: Telemetry,
    frame: LocalFrame,
    shift: Ned | None,
    flight_mode: FlightMode,
    *,
    unasked_hold: bool,
    battery_may_be_unknown: bool,
) -> InSessionFrame | None:
    """shift: as it last was; None: this is the first. None: it does not say where it is, or how fast.

    Within the session the vehicle's own local position is believed, for that is what its setpoints are about.
    """
    if telemetry.local is None or telemetry.geodetic is None or telemetry.velocity is None:
        return None
    place = frame.ned(telemetry.geodetic)
    present = telemetry.local.minus(place)
    moved = shift is not None and not telemetry.local.minus(shift).minus(place).norm <= JUMP_M
    kept = present if shift is None or moved else shift
    state = VehicleState(
        telemetry.at_s,
        place if moved else telemetry.local.minus(kept),
        telemetry.velocity,
        telemetry.yaw_deg,
        telemetry.yaw_rate_deg_s,
        telemetry.sigma_h_m,
        telemetry.sigma_v_m,
        telemetry.healthy,
        telemetry.in_air,
        flight_mode,
        math.nan if telemetry.battery is None and not battery_may_be_unknown else telemetry.battery,
        armed=telemetry.armed,
        mode_at_s=telemetry.mode_at_s,
        unasked_hold=unasked_hold,
        restarts=telemetry.restarts,
    )
    return InSessionFrame(state, kept, moved)
