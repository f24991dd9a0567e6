"""From MAVSDK's subscriptions into latest-value slots, on MAVSDK's threads.

Nothing here may raise or print: MAVSDK reports a callback's exception on standard output. A value that is not finite is
dropped, so that its slot ages (X6).
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from typing import Any

from mavsdk.plugins.mavlink_direct import MavlinkDirect, MavlinkMessage
from mavsdk.plugins.telemetry import Telemetry as TelemetryPlugin

from m3r_app.readable import readable
from m3r_app.vehicle import px4_modes
from m3r_app.vehicle.adsb import AdsbTraffic
from m3r_app.vehicle.telemetry import Accuracy, Health, Slots
from safety.frames import wrap_deg
from safety.vocabulary import FlightMode, Geodetic, Ned

RC_RECEIVER = 65536
"""MAV_SYS_STATUS_SENSOR_RC_RECEIVER; PX4 sets it present while a manual control signal is heard."""
AUTOPILOT_COMPONENT = 1
"""MAV_COMP_ID_AUTOPILOT1: of gimbals, cameras and others on the same system nothing is believed."""
INVALID_AUTOPILOT = 8
"""MAV_AUTOPILOT_INVALID: no flight controller."""
ARMED = 128
"""MAV_MODE_FLAG_SAFETY_ARMED"""
IN_AIR = {1: False, 2: True, 3: True, 4: True}
"""MAV_LANDED_STATE: on ground, in air, taking off, landing; 0 is undefined."""
DOWNWARD = 25
"""MAV_SENSOR_ROTATION_PITCH_270"""
RESTARTED_MS = 1000
"""The time since boot that falls back by more is that of another boot."""
HEARTBEAT_ID, CURRENT_MODE_ID, ESTIMATOR_STATUS_ID, EXTENDED_SYS_STATE_ID, SYSTEM_TIME_ID = 0, 436, 230, 245, 2
INTERVALS_US = {
    HEARTBEAT_ID: 200_000,
    CURRENT_MODE_ID: 200_000,
    ESTIMATOR_STATUS_ID: 200_000,
    EXTENDED_SYS_STATE_ID: 200_000,
    SYSTEM_TIME_ID: 500_000,
}
"""How often each is asked for: a takeover, a landing and a restart must be known soon, and HEARTBEAT alone comes at 1 Hz."""
SET_MESSAGE_INTERVAL = 511
MODES = {mode.value: mode for mode in FlightMode}
"""By the names that MAVSDK gives them, whatever autopilot it is that told them."""

HEALTH_CHECKS = {
    "is_gyrometer_calibration_ok": "gyroscope",
    "is_accelerometer_calibration_ok": "accelerometer",
    "is_magnetometer_calibration_ok": "magnetometer",
    "is_local_position_ok": "local position",
    "is_global_position_ok": "global position",
    "is_home_position_ok": "home position",
}


class Reception:
    """Subscribes to what is needed and keeps the latest of each in `slots`."""

    def __init__(
        self,
        clock: Callable[[], float],
        telemetry: Any,
        direct: Any,
        transponder: Any,
        on_position: Callable[[], None],
        on_status_text: Callable[[str, str], None],
    ) -> None:
        """telemetry, direct, transponder: MAVSDK's plugins. on_position, on_status_text: called on MAVSDK's threads."""
        self.slots = Slots()
        self.aircraft = AdsbTraffic()
        self._clock = clock
        self._telemetry: TelemetryPlugin = telemetry
        self._direct: MavlinkDirect = direct
        self._transponder = transponder  # it ends with whoever keeps it
        self._on_position = on_position
        self._on_status_text = on_status_text
        self._px4 = False
        self._since_boot_ms = -math.inf
        telemetry.subscribe_position(self._position)
        telemetry.subscribe_position_velocity_ned(self._position_velocity)
        telemetry.subscribe_attitude_euler(self._attitude)
        telemetry.subscribe_attitude_angular_velocity_body(self._angular_velocity)
        telemetry.subscribe_raw_gps(self._raw_gps)
        telemetry.subscribe_flight_mode(self._flight_mode)
        telemetry.subscribe_health(self._health)
        telemetry.subscribe_battery(self._battery)
        telemetry.subscribe_status_text(self._status_text)
        direct.subscribe_message("HEARTBEAT", self._heartbeat)
        direct.subscribe_message("CURRENT_MODE", self._current_mode)
        direct.subscribe_message("EXTENDED_SYS_STATE", self._extended_sys_state)
        direct.subscribe_message("SYSTEM_TIME", self._system_time)
        direct.subscribe_message("HOME_POSITION", self._home_position)
        direct.subscribe_message("DISTANCE_SENSOR", self._distance_sensor)
        direct.subscribe_message("ESTIMATOR_STATUS", self._estimator_status)
        direct.subscribe_message("SYS_STATUS", self._sys_status)
        direct.subscribe_message("ADSB_VEHICLE", self._adsb_flags)
        transponder.subscribe_transponder(self._adsb)

    def request_rates(self, motion_hz: float) -> None:
        """Ask for position and attitude at motion_hz, the rest slower. Refusals show in the ages, which are judged."""

        def answered(*_: Any) -> None:
            return

        telemetry = self._telemetry
        telemetry.set_rate_position_async(motion_hz, answered)
        telemetry.set_rate_position_velocity_ned_async(motion_hz, answered)
        telemetry.set_rate_attitude_euler_async(motion_hz, answered)
        telemetry.set_rate_raw_gps_async(5.0, answered)
        telemetry.set_rate_battery_async(1.0, answered)
        for message_id, interval_us in INTERVALS_US.items():
            fields = {"target_system": 0, "target_component": 1, "command": SET_MESSAGE_INTERVAL, "confirmation": 0}
            fields |= {f"param{i}": 0 for i in range(1, 8)} | {"param1": message_id, "param2": interval_us}
            interval = MavlinkMessage("COMMAND_LONG", 0, 0, 0, AUTOPILOT_COMPONENT, json.dumps(fields))
            self._direct.send_command_async(interval, lambda *_: None)

    @property
    def is_px4(self) -> bool:
        """Whether the autopilot itself, by its own component's HEARTBEAT, is a PX4."""
        return self._px4

    # MAVSDK's threads

    def _position(self, position: Any, _: Any) -> None:
        place = Geodetic(position.latitude_deg, position.longitude_deg, position.absolute_altitude_m)
        if all(map(math.isfinite, place)):
            self.slots.geodetic.put(place, self._clock())

    def _position_velocity(self, both: Any, _: Any) -> None:
        position = Ned(both.position.north_m, both.position.east_m, both.position.down_m)
        velocity = Ned(both.velocity.north_m_s, both.velocity.east_m_s, both.velocity.down_m_s)
        if position.finite and velocity.finite:
            now_s = self._clock()
            self.slots.local.put((position, velocity), now_s)
            self.slots.positions.put(now_s)
            self._on_position()

    def _attitude(self, euler: Any, _: Any) -> None:
        if math.isfinite(euler.yaw_deg):
            self.slots.yaw_deg.put(wrap_deg(euler.yaw_deg), self._clock())

    def _angular_velocity(self, rates: Any, _: Any) -> None:
        if math.isfinite(rates.yaw_rad_s):
            self.slots.yaw_rate_deg_s.put(math.degrees(rates.yaw_rad_s), self._clock())

    def _raw_gps(self, gps: Any, _: Any) -> None:
        stated = Accuracy(float(gps.horizontal_uncertainty_m), float(gps.vertical_uncertainty_m))
        self.slots.receiver.put(stated, self._clock())

    def _flight_mode(self, mode: Any, _: Any) -> None:
        # MAVSDK takes whoever fills in an autopilot for the autopilot; of a PX4 the mode is read from its own messages.
        if not self._px4:
            self.slots.flight_mode.put(MODES.get(str(mode.name), FlightMode.OTHER), self._clock())

    def _heartbeat(self, message: Any, _: Any) -> None:
        fields = _fields(message)
        autopilot = _number(fields, "autopilot")
        if message.component_id != AUTOPILOT_COMPONENT or autopilot == INVALID_AUTOPILOT:
            return
        base_mode, custom_mode = _number(fields, "base_mode"), _number(fields, "custom_mode")
        if math.isfinite(base_mode):
            self.slots.armed.put(bool(int(base_mode) & ARMED), self._clock())
        self._px4 = autopilot == px4_modes.MAV_AUTOPILOT_PX4
        self._custom_mode(custom_mode)

    def _current_mode(self, message: Any, _: Any) -> None:
        if message.component_id == AUTOPILOT_COMPONENT:
            self._custom_mode(_number(_fields(message), "custom_mode"))

    def _custom_mode(self, custom_mode: float) -> None:
        if self._px4 and math.isfinite(custom_mode):
            self.slots.flight_mode.put(px4_modes.mode_of(int(custom_mode)), self._clock())

    def _extended_sys_state(self, message: Any, _: Any) -> None:
        in_air = IN_AIR.get(int(_number(_fields(message), "landed_state", 0.0)))
        if message.component_id == AUTOPILOT_COMPONENT and in_air is not None:
            self.slots.in_air.put(in_air, self._clock())

    def _system_time(self, message: Any, _: Any) -> None:
        since_boot_ms = _number(_fields(message), "time_boot_ms")
        if message.component_id != AUTOPILOT_COMPONENT or not math.isfinite(since_boot_ms):
            return
        if since_boot_ms < self._since_boot_ms - RESTARTED_MS:
            self.slots.restarts.put((self.slots.restarts.value or 0) + 1, self._clock())
        self._since_boot_ms = since_boot_ms

    def _home_position(self, message: Any, _: Any) -> None:
        fields = _fields(message)
        home = Geodetic(
            _number(fields, "latitude") * 1e-7,
            _number(fields, "longitude") * 1e-7,
            _number(fields, "altitude") / 1000.0,
        )
        if message.component_id == AUTOPILOT_COMPONENT and all(map(math.isfinite, home)):
            self.slots.home.put(home, self._clock())

    def _distance_sensor(self, message: Any, _: Any) -> None:
        fields = _fields(message)
        measured_cm = _number(fields, "current_distance")
        in_reach = _number(fields, "min_distance") <= measured_cm <= _number(fields, "max_distance")
        if in_reach and _number(fields, "orientation") == DOWNWARD:
            self.slots.ground_distance_m.put(measured_cm / 100.0, self._clock())

    def _health(self, health: Any, _: Any) -> None:
        checks = {name: bool(getattr(health, field)) for field, name in HEALTH_CHECKS.items()}
        self.slots.health.put(Health(checks), self._clock())

    def _battery(self, battery: Any, _: Any) -> None:
        remaining = battery.remaining_percent / 100.0
        if 0.0 <= remaining <= 1.0:
            self.slots.battery.put(remaining, self._clock())

    def _status_text(self, status: Any, _: Any) -> None:
        self._on_status_text(str(getattr(status.type, "name", status.type)), readable(str(status.text)))

    def _estimator_status(self, message: Any, _: Any) -> None:
        fields = _fields(message)
        stated = Accuracy(_number(fields, "pos_horiz_accuracy"), _number(fields, "pos_vert_accuracy"))
        self.slots.estimator.put(stated, self._clock())

    def _sys_status(self, message: Any, _: Any) -> None:
        present = _number(_fields(message), "onboard_control_sensors_present")
        if math.isfinite(present):
            self.slots.rc_present.put(bool(int(present) & RC_RECEIVER), self._clock())

    def _adsb_flags(self, message: Any, _: Any) -> None:
        fields = _fields(message)
        icao, flags = _number(fields, "ICAO_address"), _number(fields, "flags")
        if math.isfinite(icao) and math.isfinite(flags):
            self.aircraft.flags(int(icao), int(flags))

    def _adsb(self, vehicle: Any, _: Any) -> None:
        self.aircraft.put(vehicle, self._clock())


def _fields(message: Any) -> dict[str, Any]:
    """A message's fields; none of them if it cannot be read."""
    try:
        fields = json.loads(message.fields_json)
    except ValueError:
        return {}
    return fields if isinstance(fields, dict) else {}


def _number(fields: dict[str, Any], name: str, otherwise: float = math.nan) -> float:
    value = fields.get(name)
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else otherwise
