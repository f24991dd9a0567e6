"""An autopilot of a few lines that does just what a test tells it, for refusals and silences that are hard to provoke.

Speaks MAVLink over loopback UDP like PX4: same modes, acknowledgements and parameter encoding.
"""

from __future__ import annotations

import math
import os
import random
import struct
import threading
import time
from dataclasses import dataclass, field
from typing import Self

os.environ.setdefault("MAVLINK20", "1")

from pymavlink import mavutil
from pymavlink.dialects.v20 import common as mavlink

OFFBOARD, HOLD, MISSION, TAKEOFF, POSCTL = 6 << 16, 4 << 16 | 3 << 24, 4 << 16 | 4 << 24, 4 << 16 | 2 << 24, 3 << 16


@dataclass
class StandIn:
    """Sends telemetry to 127.0.0.1:port from a thread until closed; obeys setpoints at once when in Offboard."""

    port: int
    system_id: int = 7
    north_m: float = 1.0
    east_m: float = 2.0
    down_m: float = -10.0
    yaw_deg: float = 30.0
    mode: int = HOLD
    armed: bool = True
    landed: bool = False
    healthy: bool = True
    silent: bool = False
    estimator_m: tuple[float, float] = (0.4, 0.6)
    gps_m: tuple[float, float] = (0.3, 0.9)
    parameters: dict[str, float | int] = field(default_factory=dict)
    refuse: dict[int, str] = field(default_factory=dict)
    """Command numbers that are denied, and the status text sent with the denial."""
    deny_first_offboards: int = 0
    rc_present: bool = False
    landed_unknown: bool = False
    """It does not say whether it stands (MAV_LANDED_STATE_UNDEFINED)."""
    gimbal: int | None = None
    """A gimbal beside it sends heartbeats that claim to be this kind of autopilot."""
    loss: float = 0.0
    """Share of the messages that are lost, each way."""
    every: int = 1
    """Only every so manieth position is sent."""
    rangefinder_m: float | None = None
    boots: int = 0
    """How often it has started anew."""
    setpoints: list[tuple[float, float, float, float, int]] = field(default_factory=list)
    """north, east, down, yaw (deg), type mask"""
    mode_commands: list[int] = field(default_factory=list)
    hellos: set[tuple[int, int, int]] = field(default_factory=set)
    """(system, component, type) of whoever sent a heartbeat."""

    def __post_init__(self) -> None:
        self._link = mavutil.mavlink_connection(
            f"udpout:127.0.0.1:{self.port}", source_system=self.system_id, source_component=1
        )
        self._mav = self._link.mav
        self.parameters = {"SYS_AUTOSTART": 4001, **self.parameters}  # every PX4 has it
        self._random = random.Random(self.port)
        self._booted_ms = 100_000
        self._seen_boots = self.boots
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def say(self, text: bytes) -> None:
        """STATUSTEXT"""
        self._mav.statustext_send(mavlink.MAV_SEVERITY_CRITICAL, text)

    def close(self) -> None:
        self._stop.set()
        self._thread.join(2.0)
        self._link.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _run(self) -> None:
        tick = 0
        next_s = time.monotonic()
        while not self._stop.is_set():
            while (message := self._link.recv_msg()) is not None:
                if not self.silent and self._random.random() >= self.loss:
                    self._receive(message)
            if not self.silent and self._random.random() >= self.loss:
                self._send(tick)
            tick += 1
            next_s += 0.02
            self._stop.wait(max(0.0, next_s - time.monotonic()))

    def _send(self, tick: int) -> None:
        ms = tick * 20
        mav = self._mav
        self._booted_ms += 20
        if self.boots != self._seen_boots:
            self._seen_boots, self._booted_ms = self.boots, 0
        if tick % 10 == 3:
            mav.system_time_send(0, self._booted_ms)
            if self.rangefinder_m is not None:
                centimetres = round(100.0 * self.rangefinder_m)
                mav.distance_sensor_send(ms, 20, 4000, centimetres, 0, 0, mavlink.MAV_SENSOR_ROTATION_PITCH_270, 255)
        if self.gimbal is not None and tick % 10 == 7:
            own = mav.srcComponent
            mav.srcComponent = mavlink.MAV_COMP_ID_GIMBAL
            mav.heartbeat_send(mavlink.MAV_TYPE_GIMBAL, self.gimbal, 0, 0, 4)
            mav.srcComponent = own
        if tick % 10 == 5:  # more often than PX4, to be found sooner
            base = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (mavlink.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0)
            mav.heartbeat_send(mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_PX4, base, self.mode, 4)
            mav.home_position_send(470000000, 80000000, 500000, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0)
            mav.battery_status_send(0, 0, 0, 2000, [4000] * 10, 100, -1, -1, 73)
        if tick % 10 == 0:
            sensors = 1 | 2 | 4 | 8 | 32 | 0x200000
            healthy = sensors if self.healthy else sensors & ~4
            present = sensors | (65536 if self.rc_present else 0)
            mav.sys_status_send(present, present, healthy, 100, 16000, 100, 73, 0, 0, 0, 0, 0, 0)
            mav.extended_sys_state_send(0, 0 if self.landed_unknown else 1 if self.landed else 2)
            horizontal_m, vertical_m = self.estimator_m
            mav.estimator_status_send(ms * 1000, 831, 0, 0, 0, 0, 0, 0, horizontal_m, vertical_m)
            mav.gps_raw_int_send(
                ms * 1000, 6, 470000000, 80000000, 510000, 80, 120, 0, 0, 12,
                alt_ellipsoid=510000, h_acc=int(self.gps_m[0] * 1000), v_acc=int(self.gps_m[1] * 1000),
                vel_acc=100, hdg_acc=0, yaw=0,
            )  # fmt: skip
        if tick % self.every:
            return
        mav.global_position_int_send(
            ms, 470000000, 80000000, int(1000 * (500 - self.down_m)), int(-1000 * self.down_m), 0, 0, 0, 0
        )
        mav.attitude_send(ms, 0, 0, math.radians(self.yaw_deg), 0, 0, math.radians(5.0))
        mav.local_position_ned_send(ms, self.north_m, self.east_m, self.down_m, 0.1, 0.2, 0.3)

    def _receive(self, message: object) -> None:
        kind = message.get_type()
        if kind == "HEARTBEAT":
            self.hellos.add((message.get_srcSystem(), message.get_srcComponent(), message.type))
        elif kind == "COMMAND_LONG":
            self._command(message)
        elif kind == "PARAM_REQUEST_READ":
            self._tell_parameter(message.param_id)
        elif kind == "PARAM_SET":
            if message.param_id in self.parameters:
                if message.param_type == mavlink.MAV_PARAM_TYPE_REAL32:
                    self.parameters[message.param_id] = message.param_value
                else:
                    self.parameters[message.param_id] = struct.unpack("<i", struct.pack("<f", message.param_value))[0]
            self._tell_parameter(message.param_id)
        elif kind == "SET_POSITION_TARGET_LOCAL_NED":
            self.setpoints.append((message.x, message.y, message.z, math.degrees(message.yaw), message.type_mask))
            if self.mode == OFFBOARD:
                self.north_m, self.east_m, self.down_m = message.x, message.y, message.z

    def _tell_parameter(self, name: str) -> None:
        if name not in self.parameters or self._random.random() < self.loss:
            return
        value = self.parameters[name]
        kind = mavlink.MAV_PARAM_TYPE_REAL32
        if isinstance(value, int):
            kind = mavlink.MAV_PARAM_TYPE_INT32
            value = struct.unpack("<f", struct.pack("<i", value))[0]
        self._mav.param_value_send(name.encode(), value, kind, len(self.parameters), 0)

    def _command(self, message: object) -> None:
        number = message.command
        result = mavlink.MAV_RESULT_ACCEPTED
        if number in self.refuse:
            self.say(self.refuse[number].encode())
            result = mavlink.MAV_RESULT_DENIED
        elif number == mavlink.MAV_CMD_DO_SET_MODE:
            mode = int(message.param2) << 16 | int(message.param3) << 24
            self.mode_commands.append(mode)
            if mode == OFFBOARD and self.deny_first_offboards > 0:
                self.deny_first_offboards -= 1
                result = mavlink.MAV_RESULT_DENIED
            else:
                self.mode = mode
        elif number == mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
            self.armed = message.param1 > 0.5
        elif number == mavlink.MAV_CMD_NAV_TAKEOFF:
            self.mode, self.landed, self.down_m = HOLD, False, self.down_m - float(self.parameters["MIS_TAKEOFF_ALT"])
        elif number != mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            result = mavlink.MAV_RESULT_UNSUPPORTED
        if self._random.random() < self.loss:
            return
        self._mav.command_ack_send(number, result, 0, 0, message.get_srcSystem(), message.get_srcComponent())
