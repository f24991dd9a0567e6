"""The parameters that a simulated autopilot has: PX4's names, types and defaults, for what it obeys.

Source: PX4 1.17 parameter reference. Integers travel bytewise in PARAM_VALUE's float, as PX4 does.
"""

from __future__ import annotations

import struct

INT32 = 6
"""MAV_PARAM_TYPE_INT32"""
REAL32 = 9
"""MAV_PARAM_TYPE_REAL32"""

# fmt: off
DEFAULTS: dict[str, int | float] = {
    "BAT_CRIT_THR": 0.07, "BAT_EMERGEN_THR": 0.05, "BAT_LOW_THR": 0.15,
    "CBRK_SUPPLY_CHK": 0,
    "COM_DISARM_LAND": 2.0,      # s after landing
    "COM_DISARM_PRFLT": 10.0,    # s after arming without take-off
    "COM_DL_LOSS_T": 10,         # s without a ground station's heartbeat
    "COM_LOW_BAT_ACT": 0,        # 0 warn, 2 land, 3 return at critical and land at emergency level
    "COM_OBL_RC_ACT": 0,         # offboard lost: 0 position, 1 altitude, 2 manual, 3 return, 4 land, 5 hold,
                                 # 6 terminate, 7 disarm
    "COM_OF_LOSS_T": 1.0,        # s without a setpoint
    "COM_RCL_EXCEPT": 0,         # RC loss does not matter in: bit 0 mission, 1 hold, 2 offboard
    "COM_RC_IN_MODE": 3,
    "COM_RC_LOSS_T": 0.5,
    "COM_RC_OVERRIDE": 1,        # sticks take over from: bit 0 auto modes, 1 offboard
    "COM_RC_STICK_OV": 30.0,
    "MAV_SYS_ID": 1,
    "MAV_TYPE": 2,
    "MIS_TAKEOFF_ALT": 2.5,
    "MPC_ACC_HOR": 3.0,
    "MPC_LAND_SPEED": 0.7,
    "MPC_TKO_SPEED": 1.5,
    "MPC_XY_CRUISE": 5.0,
    "NAV_ACC_RAD": 1.0,          # PX4: 10; a waypoint is passed at this distance
    "NAV_DLL_ACT": 0,            # ground station lost: 0 nothing, 1 hold, 2 return, 3 land
    "NAV_RCL_ACT": 2,            # RC lost: 1 hold, 2 return, 3 land
    "RTL_RETURN_ALT": 60.0,
    "SYS_AUTOSTART": 10040,
    "SYS_FAILURE_EN": 0,         # MAV_CMD_INJECT_FAILURE is obeyed
}
# fmt: on


class Parameters:
    """Named values of fixed type, int (INT32) or float (REAL32)."""

    def __init__(self, changed: dict[str, int | float]) -> None:
        """Raises ValueError naming a parameter that does not exist or a fraction given for an integer."""
        self._values = dict(DEFAULTS)
        for name, value in changed.items():
            if name not in DEFAULTS:
                raise ValueError(f"there is no parameter {name}")
            if isinstance(DEFAULTS[name], int) and value != int(value):
                raise ValueError(f"parameter {name} is an integer, not {value}")
            self._values[name] = type(DEFAULTS[name])(value)
        self.names = sorted(self._values)

    def __getitem__(self, name: str) -> float:
        return float(self._values[name])

    def bits(self, name: str) -> int:
        """An integer parameter's value."""
        return int(self._values[name])

    def type_of(self, name: str) -> int:
        return INT32 if isinstance(self._values[name], int) else REAL32

    def wire(self, name: str) -> float:
        """The float that carries it in PARAM_VALUE."""
        value = self._values[name]
        if isinstance(value, int):
            return float(struct.unpack("<f", struct.pack("<i", value))[0])
        return value

    def set_wire(self, name: str, carried: float, kind: int) -> bool:
        """Set from PARAM_SET; False where the name or the type is not ours."""
        if name not in self._values or kind != self.type_of(name):
            return False
        self._values[name] = struct.unpack("<i", struct.pack("<f", carried))[0] if kind == INT32 else carried
        return True
