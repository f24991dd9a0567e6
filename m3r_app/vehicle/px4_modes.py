"""PX4's flight modes as its HEARTBEAT and CURRENT_MODE tell them (custom_mode), by the names that MAVSDK gives them."""

from __future__ import annotations

MAV_AUTOPILOT_PX4 = 12
MAIN = {
    1: "MANUAL",
    2: "ALTCTL",
    3: "POSCTL",
    5: "ACRO",
    6: "OFFBOARD",
    7: "STABILIZED",
    8: "RATTITUDE",
}
"""PX4_CUSTOM_MAIN_MODE, byte 2 of custom_mode."""
AUTO, OFFBOARD, HOLD_SUB = 4, 6, 3
AUTO_SUB = {
    1: "READY",
    2: "TAKEOFF",
    3: "HOLD",
    4: "MISSION",
    5: "RETURN_TO_LAUNCH",
    6: "LAND",
    8: "FOLLOW_ME",
    9: "LAND",  # precision landing
}
"""PX4_CUSTOM_SUB_MODE_AUTO, byte 3."""


def name_of(custom_mode: int) -> str:
    """The mode's name. One that is not known has a name too: it is somebody else's, never UNKNOWN, which is silence."""
    main, sub = custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF
    if main == AUTO:
        return AUTO_SUB.get(sub, f"AUTO_{sub}")
    return MAIN.get(main, f"MODE_{main}")
