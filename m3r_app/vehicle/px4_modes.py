"""PX4's flight modes as its HEARTBEAT and CURRENT_MODE tell them (custom_mode)."""

from __future__ import annotations

from safety.vocabulary import FlightMode

MAV_AUTOPILOT_PX4 = 12
MAIN = {
    1: FlightMode.MANUAL,
    2: FlightMode.ALTITUDE,
    3: FlightMode.POSITION,
    5: FlightMode.ACRO,
    6: FlightMode.OFFBOARD,
    7: FlightMode.STABILIZED,
    8: FlightMode.RATTITUDE,
}
"""PX4_CUSTOM_MAIN_MODE, byte 2 of custom_mode."""
AUTO, OFFBOARD, HOLD_SUB = 4, 6, 3
AUTO_SUB = {
    1: FlightMode.READY,
    2: FlightMode.TAKEOFF,
    3: FlightMode.HOLD,
    4: FlightMode.MISSION,
    5: FlightMode.RETURN,
    6: FlightMode.LAND,
    8: FlightMode.FOLLOW_ME,
    9: FlightMode.LAND,  # precision landing
}
"""PX4_CUSTOM_SUB_MODE_AUTO, byte 3."""


def mode_of(custom_mode: int) -> FlightMode:
    """One that is not known is somebody else's (OTHER), never UNKNOWN, which is silence."""
    main, sub = custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF
    if main == AUTO:
        return AUTO_SUB.get(sub, FlightMode.OTHER)
    return MAIN.get(main, FlightMode.OTHER)
