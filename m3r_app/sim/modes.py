"""What a simulated autopilot reports: modes, results, severities, and the faults that can be injected. Pure.

Source: PX4 1.17 custom modes, MAVLink common enumerations.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, IntEnum


class FlightMode(Enum):
    """PX4's custom main and sub mode."""

    MANUAL = (1, 0)
    ALTCTL = (2, 0)
    POSCTL = (3, 0)
    READY = (4, 1)
    TAKEOFF = (4, 2)
    LOITER = (4, 3)
    MISSION = (4, 4)
    RTL = (4, 5)
    LAND = (4, 6)
    OFFBOARD = (6, 0)

    @property
    def custom_mode(self) -> int:
        """HEARTBEAT.custom_mode"""
        return self.value[0] << 16 | self.value[1] << 24

    @property
    def title(self) -> str:
        """Its name in PX4's texts for people."""
        return {"LOITER": "Hold", "RTL": "Return", "POSCTL": "Position", "ALTCTL": "Altitude"}.get(
            self.name, self.name.capitalize()
        )


class MavResult(IntEnum):
    """MAV_RESULT"""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3


class Severity(IntEnum):
    """MAV_SEVERITY"""

    EMERGENCY = 0
    CRITICAL = 2
    WARNING = 4
    INFO = 6


class Fault(Enum):
    """Failures that MAV_CMD_INJECT_FAILURE makes: (FAILURE_UNIT, FAILURE_TYPE)."""

    GPS_OFF = (4, 1)
    GPS_STUCK = (4, 2)
    GPS_WRONG = (4, 4)
    BATTERY_OFF = (100, 1)
    MOTOR_OFF = (101, 1)
    RC_OFF = (104, 1)
    RC_WRONG = (104, 4)
    """The pilot moves the sticks."""
    LINK_OFF = (105, 1)


FAULT_UNITS = {fault.value[0] for fault in Fault}


@dataclass(frozen=True, slots=True)
class Failsafe:
    """What the autopilot does by itself, and why."""

    mode: FlightMode
    reason: str
    blind: bool = False
    """Position is lost: descend level, drifting with the wind."""
