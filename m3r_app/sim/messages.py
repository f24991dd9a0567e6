"""What a simulated drone's telemetry says: one MAVLink message of each kind, from the state of its `Autopilot`.

Source: MAVLink common messages, filled in as PX4 1.17 does.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import Any, ClassVar

from pymavlink.dialects.v20 import common as mavlink

from m3r_app.sim.autopilot import Autopilot
from m3r_app.sim.modes import FlightMode
from safety.frames import LocalFrame
from safety.vocabulary import Geodetic, Ned

Message = Any
"""pymavlink is untyped."""

_SENSORS = 1 | 2 | 4 | 8  # gyro, accelerometer, magnetometer, pressure
_GPS, _CONTROL, _MOTORS, _RC = 32, 1024 | 2048 | 4096 | 8192 | 16384, 32768, 65536
_AHRS, _BATTERY, _PREARM = 0x200000, 0x2000000, 0x10000000
_CAPABILITIES = (
    mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
)
_TANGENT_M = 5.0
_NO_FIX_MM = 100_000
"""Accuracy of a receiver without a fix, as PX4 tells it."""


class CurrentMode(mavlink.MAVLink_message):  # type: ignore[misc]
    """CURRENT_MODE, which pymavlink's common dialect has not got yet."""

    id = msgid = 436
    msgname = "CURRENT_MODE"
    fieldnames: ClassVar = ["custom_mode", "intended_custom_mode", "standard_mode"]
    ordered_fieldnames: ClassVar = fieldnames
    fieldtypes: ClassVar = ["uint32_t", "uint32_t", "uint8_t"]
    crc_extra = 193
    unpacker = struct.Struct("<IIB")
    instance_field = None

    def __init__(self, custom_mode: int, intended_custom_mode: int, standard_mode: int) -> None:
        """intended_custom_mode: what was commanded, where a failsafe flies another. standard_mode 0: none of them."""
        super().__init__(self.msgid, self.msgname)
        self._fieldnames, self._instance_field = self.fieldnames, None
        self.custom_mode, self.intended_custom_mode, self.standard_mode = (
            custom_mode,
            intended_custom_mode,
            standard_mode,
        )

    def pack(self, mav: Any, force_mavlink1: bool = False) -> bytes:
        payload = self.unpacker.pack(self.custom_mode, self.intended_custom_mode, self.standard_mode)
        packed: bytes = self._pack(mav, self.crc_extra, payload, force_mavlink1=force_mavlink1)
        return packed


class Telemetry:
    """The messages of one drone."""

    def __init__(self, autopilot: Autopilot, frame: LocalFrame, system_id: int) -> None:
        """frame: the scenario's."""
        self.autopilot, self._frame, self._system_id = autopilot, frame, system_id
        self.battery_unknown = self.rangefinder = False
        self._tangent: tuple[Ned, Geodetic, Geodetic, Geodetic] | None = None

    def build(self, kind: int) -> Message | None:
        """The message of that id; None if there is nothing to say. Raises KeyError for a kind it never sends."""
        return _BUILDERS[kind](self)

    @property
    def _boot_ms(self) -> int:
        return self.boot_us // 1000 & 0xFFFFFFFF

    @property
    def boot_us(self) -> int:
        return max(0, int((self.autopilot.now_s - self.autopilot.booted_at_s) * 1e6))

    def geodetic(self) -> Geodetic:
        """The estimate as latitude, longitude, altitude.

        The full conversion costs more than all else here, so it is made afresh every few metres; in between, straight
        lines from there are off by micrometres.
        """
        here = self.autopilot.position
        if self._tangent is None or here.minus(self._tangent[0]).norm > _TANGENT_M:
            base, convert = here, self._frame.geodetic
            steps = (convert(base.plus(Ned(1.0, 0.0, 0.0))), convert(base.plus(Ned(0.0, 1.0, 0.0))))
            self._tangent = (base, convert(base), *steps)
        base, place, to_north, to_east = self._tangent
        north, east, down = here.minus(base)
        return Geodetic(
            place.lat_deg + north * (to_north.lat_deg - place.lat_deg) + east * (to_east.lat_deg - place.lat_deg),
            place.lon_deg + north * (to_north.lon_deg - place.lon_deg) + east * (to_east.lon_deg - place.lon_deg),
            place.amsl_m - down,
        )

    def _local(self) -> Ned:
        # The frames of one fleet are parallel to a few micrometres over a few hundred metres.
        return self.autopilot.position.minus(self.autopilot.origin)

    def _heartbeat(self) -> Message:
        pilot = self.autopilot
        auto = 0 if pilot.mode in (FlightMode.MANUAL, FlightMode.ALTCTL, FlightMode.POSCTL) else 4 | 8
        base_mode = 1 | 16 | auto | (128 if pilot.armed else 0)
        status = 5 if pilot.failsafe else 4 if pilot.armed else 3
        mode = pilot.mode.custom_mode if pilot.mode_known else 0
        return mavlink.MAVLink_heartbeat_message(2, 12, base_mode, mode, status, 3)

    def _current_mode(self) -> Message:
        pilot = self.autopilot
        if not pilot.mode_known:
            return CurrentMode(0, 0, 0)
        return CurrentMode(pilot.mode.custom_mode, pilot.intended.custom_mode, 0)

    def _distance_sensor(self) -> Message | None:
        """Height above the ground by a rangefinder that looks down, 0.1 to 50 m; told only where there is one."""
        if not self.rangefinder:
            return None
        pilot = self.autopilot
        height_cm = round(100.0 * min(50.0, max(0.1, pilot.height_m)))
        return mavlink.MAVLink_distance_sensor_message(self._boot_ms, 10, 5000, height_cm, 0, 0, 25, 255)

    def _system_time(self) -> Message:
        return mavlink.MAVLink_system_time_message(0, self._boot_ms)

    def _sys_status(self) -> Message:
        pilot = self.autopilot
        present = _SENSORS | _GPS | _CONTROL | _MOTORS | _AHRS | _BATTERY | _PREARM | (_RC if pilot.rc else 0)
        bad = 0
        if not pilot.position_valid:
            bad |= _CONTROL | _AHRS
        if not pilot.gps_fix:
            bad |= _GPS
        if pilot.battery <= pilot.parameters["BAT_CRIT_THR"]:
            bad |= _BATTERY
        if pilot.drone.thrust_fraction < 1.0:
            bad |= _MOTORS
        if pilot.rc and not pilot.rc_alive:
            bad |= _RC
        if bad & ~_RC:
            bad |= _PREARM
        volts = 14.0 + 2.8 * pilot.battery
        percent = self._percent
        return mavlink.MAVLink_sys_status_message(
            present, present, present & ~bad, 150, int(volts * 1000), 800, percent, 0, 0, 0, 0, 0, 0
        )

    def _battery_status(self) -> Message:
        pilot = self.autopilot
        cells = [int(3500 + 700 * pilot.battery)] * 4 + [65535] * 6
        percent = self._percent
        state = (
            0
            if percent < 0
            else 1
            + sum(
                pilot.battery <= pilot.parameters[name] for name in ("BAT_LOW_THR", "BAT_CRIT_THR", "BAT_EMERGEN_THR")
            )
        )
        return mavlink.MAVLink_battery_status_message(0, 1, 3, 2500, cells, 800, -1, -1, percent, 0, state)

    @property
    def _percent(self) -> int:
        """-1: unknown"""
        return -1 if self.battery_unknown else round(100.0 * self.autopilot.battery)

    def _extended_sys_state(self) -> Message:
        pilot = self.autopilot
        landed = 1
        # PX4 takes what is disarmed for landed, even while it falls.
        if pilot.in_air and pilot.armed:
            landed = {FlightMode.TAKEOFF: 3, FlightMode.LAND: 4}.get(pilot.mode, 2)
        return mavlink.MAVLink_extended_sys_state_message(0, landed)

    def _home_position(self) -> Message:
        home = self.autopilot.home
        place, local = self._frame.geodetic(home), home.minus(self.autopilot.origin)
        return mavlink.MAVLink_home_position_message(
            *_scaled(place), *local, [1.0, 0.0, 0.0, 0.0], math.nan, math.nan, math.nan, self.boot_us
        )

    def _global_origin(self) -> Message:
        return mavlink.MAVLink_gps_global_origin_message(
            *_scaled(self._frame.geodetic(self.autopilot.origin)), self.boot_us
        )

    def _gps_raw(self) -> Message:
        pilot = self.autopilot
        if not pilot.gps_fix:
            return mavlink.MAVLink_gps_raw_int_message(
                self.boot_us, 0, 0, 0, 0, 65535, 65535, 65535, 65535, 0, 0, _NO_FIX_MM, _NO_FIX_MM, _NO_FIX_MM
            )
        stated, blind_h, blind_v = pilot.error.stated, *pilot.sigmas_m
        receiver_h_m = stated.receiver_h_m + blind_h - stated.estimate_h_m
        receiver_v_m = stated.receiver_v_m + blind_v - stated.estimate_v_m
        speed = pilot.velocity.horizontal
        course = math.degrees(math.atan2(pilot.velocity.east, pilot.velocity.north)) % 360.0
        return mavlink.MAVLink_gps_raw_int_message(
            self.boot_us, 3, *_scaled(self.geodetic()), 80, 120, int(speed * 100),
            int(course * 100), 16, 0, round(receiver_h_m * 1000), round(receiver_v_m * 1000), round(stated.receiver_m_s * 1000), 0,
        )  # fmt: skip

    def _global_position(self) -> Message:
        pilot = self.autopilot
        lat, lon, alt = _scaled(self.geodetic())
        above_home = round((pilot.home.down - pilot.position.down) * 1000)
        velocity = (round(v * 100) for v in pilot.velocity)
        heading = round(pilot.drone.yaw_deg % 360.0 * 100) % 36000
        return mavlink.MAVLink_global_position_int_message(self._boot_ms, lat, lon, alt, above_home, *velocity, heading)

    def _local_position(self) -> Message:
        return mavlink.MAVLink_local_position_ned_message(self._boot_ms, *self._local(), *self.autopilot.velocity)

    def _attitude(self) -> Message:
        drone = self.autopilot.drone
        roll, pitch = drone.roll_pitch_rad
        yaw, rate = math.radians(drone.yaw_deg), math.radians(drone.yaw_rate_deg_s)
        return mavlink.MAVLink_attitude_message(self._boot_ms, roll, pitch, yaw, 0.0, 0.0, rate)

    def _quaternion(self) -> list[float]:
        drone = self.autopilot.drone
        roll, pitch = (angle / 2.0 for angle in drone.roll_pitch_rad)
        yaw = math.radians(drone.yaw_deg) / 2.0
        cr, sr, cp, sp, cy, sy = *_cos_sin(roll), *_cos_sin(pitch), *_cos_sin(yaw)
        return [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]

    def _attitude_quaternion(self) -> Message:
        rate = math.radians(self.autopilot.drone.yaw_rate_deg_s)
        return mavlink.MAVLink_attitude_quaternion_message(self._boot_ms, *self._quaternion(), 0.0, 0.0, rate)

    def _estimator_status(self) -> Message:
        pilot = self.autopilot
        sigma_h, sigma_v = pilot.sigmas_m
        flags = 1 | 2 | 4 | 8 | 16 | 32 | 256 | 512 if pilot.position_valid else 1
        return mavlink.MAVLink_estimator_status_message(
            self.boot_us, flags, 0.1, 0.1, 0.1, 0.1, 0.0, 0.0, sigma_h, sigma_v
        )

    def _odometry(self) -> Message:
        pilot, of_velocity = self.autopilot, [math.nan] + [0.0] * 20
        sigma_h, sigma_v = pilot.sigmas_m
        if math.isfinite(sigma := pilot.error.stated.velocity_m_s):
            of_velocity[0] = of_velocity[6] = of_velocity[11] = sigma**2 / 2.0
        covariance = [0.0] * 21
        # sigma_h is that of the horizontal distance; each axis has half the variance.
        covariance[0] = covariance[6] = sigma_h**2 / 2.0
        covariance[11] = sigma_v**2
        yaw = math.radians(pilot.drone.yaw_deg)
        north, east, down = pilot.velocity
        # Velocity in the body's frame, as the child frame says; tilt is left out of it, it is a few degrees.
        forward, right = north * math.cos(yaw) + east * math.sin(yaw), east * math.cos(yaw) - north * math.sin(yaw)
        return mavlink.MAVLink_odometry_message(
            self.boot_us, 1, 12, *self._local(), self._quaternion(), forward, right, down, 0.0, 0.0,
            math.radians(pilot.drone.yaw_rate_deg_s), covariance, of_velocity, pilot.resets & 255, 8, 100,
        )  # fmt: skip

    def _rc_channels(self) -> Message | None:
        if not self.autopilot.rc_alive:
            return None
        return mavlink.MAVLink_rc_channels_message(self._boot_ms, 8, *([1500] * 8 + [65535] * 10), 100)

    def _autopilot_version(self) -> Message:
        version = 1 << 24 | 17 << 16 | 255
        identity = self._system_id
        return mavlink.MAVLink_autopilot_version_message(
            _CAPABILITIES, version, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, identity
        )

    def _mission_current(self) -> Message:
        return mavlink.MAVLink_mission_current_message(self.autopilot.waypoint)


def _cos_sin(angle: float) -> tuple[float, float]:
    return math.cos(angle), math.sin(angle)


def _scaled(place: Geodetic) -> tuple[int, int, int]:
    """1e-7 degrees and millimetres."""
    return round(place.lat_deg * 1e7), round(place.lon_deg * 1e7), round(place.amsl_m * 1000)


_BUILDERS: dict[int, Callable[[Telemetry], Message | None]] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: Telemetry._heartbeat,
    CurrentMode.msgid: Telemetry._current_mode,
    mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR: Telemetry._distance_sensor,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: Telemetry._sys_status,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: Telemetry._battery_status,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: Telemetry._extended_sys_state,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: Telemetry._home_position,
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: Telemetry._global_origin,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: Telemetry._gps_raw,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: Telemetry._global_position,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: Telemetry._local_position,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: Telemetry._attitude,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: Telemetry._attitude_quaternion,
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: Telemetry._estimator_status,
    mavlink.MAVLINK_MSG_ID_ODOMETRY: Telemetry._odometry,
    mavlink.MAVLINK_MSG_ID_RC_CHANNELS: Telemetry._rc_channels,
    mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: Telemetry._autopilot_version,
    mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: Telemetry._mission_current,
}

KINDS = frozenset(_BUILDERS)
"""Message ids that it can send."""


def adsb_vehicle(icao: int, callsign: str, place: Geodetic, velocity: Ned) -> Message:
    """ADSB_VEHICLE of an aircraft that says everything."""
    lat, lon, amsl_mm = _scaled(place)
    heading_deg = math.degrees(math.atan2(velocity.east, velocity.north)) % 360.0
    flags = 1 | 2 | 4 | 8 | 16 | 128  # coordinates, altitude, heading, velocity, callsign, vertical velocity are valid
    return mavlink.MAVLink_adsb_vehicle_message(
        icao, lat, lon, mavlink.ADSB_ALTITUDE_TYPE_GEOMETRIC, amsl_mm, round(heading_deg * 100.0) % 36_000,
        round(velocity.horizontal * 100.0), round(-velocity.down * 100.0), callsign.upper()[:8].encode(),
        mavlink.ADSB_EMITTER_TYPE_UAV, 0, flags, 7000,
    )  # fmt: skip
