"""One simulated drone's MAVLink: telemetry out over UDP, commands, parameters and setpoints in.

It sends to the address where a ground station listens, as PX4 does, and answers whoever asks. Source: MAVLink common
messages; PX4 1.17's answers (MAV_RESULT), parameter encoding and message rates.
"""

from __future__ import annotations

import math
import socket
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from m3r_app.sim.autopilot import FORCE, TICK_S, Answer, Autopilot, FlightMode
from m3r_app.sim.dynamics import Setpoint
from safety.frames import LocalFrame
from safety.vocabulary import Geodetic, Ned

Address = tuple[str, int]
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
_RATES_S: dict[int, float] = {
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 0.02,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 0.02,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: 0.02,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 0.02,
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 0.1,
    mavlink.MAVLINK_MSG_ID_ODOMETRY: 0.1,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 0.1,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 0.1,
    mavlink.MAVLINK_MSG_ID_RC_CHANNELS: 0.2,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 0.5,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: 0.5,
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: 1.0,
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: 1.0,
}
_ON_REQUEST = {
    mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION,
    mavlink.MAVLINK_MSG_ID_MISSION_CURRENT,
}
_PARAMETERS_PER_TICK = 5
_TANGENT_M = 5.0
_TEXT_BYTES = 50
_IGNORE_POSITION, _IGNORE_VELOCITY, _IGNORE_ACCELERATION, _IGNORE_YAW, _IGNORE_YAW_RATE = 7, 56, 448, 1024, 2048


class VehicleLink:
    """The MAVLink endpoint of one `Autopilot`."""

    def __init__(
        self,
        autopilot: Autopilot,
        frame: LocalFrame,
        system_id: int,
        destination: Address,
        obeys: bool = True,
    ) -> None:
        """frame: the scenario's. obeys False: somebody else's drone; it tells where it is and refuses every command."""
        self.autopilot, self._frame, self._obeys = autopilot, frame, obeys
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind((destination[0], 0))
        self.socket.setblocking(False)
        self._destination = destination
        self._mav = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=1)
        # Different drones' messages of one kind do not all fall on the same tick.
        self._every_s = dict(_RATES_S)
        self._next_s = {kind: (kind * 7 + system_id * 3) % 10 * TICK_S for kind in _RATES_S}
        self._long_texts = 0
        self._to_list: list[tuple[str, Address]] = []
        self._mode_sent: tuple[FlightMode, bool] | None = None
        self._origin = frame.geodetic(autopilot.origin)
        self._tangent: tuple[Ned, Geodetic, Geodetic, Geodetic] | None = None

    def close(self) -> None:
        self.socket.close()

    # Out

    def tick(self) -> None:
        """Send what is due. Call it after each tick of the autopilot."""
        pilot = self.autopilot
        if pilot.link_silent:
            pilot.texts.clear()
            self._to_list.clear()
            return
        for severity, text in pilot.texts:
            self._say(int(severity), text.encode())
        pilot.texts.clear()
        # A change of mode is told at once, as PX4 does.
        if (told := (pilot.mode, pilot.armed)) != self._mode_sent:
            self._mode_sent = told
            self._next_s[mavlink.MAVLINK_MSG_ID_HEARTBEAT] = pilot.now_s
        for kind, at_s in self._next_s.items():
            if at_s <= pilot.now_s + 1e-6:
                self._next_s[kind] = max(at_s + self._every_s[kind], pilot.now_s)
                self._send_kind(kind, self._destination)
        for name, address in self._to_list[:_PARAMETERS_PER_TICK]:
            self._send_parameter(name, address)
        del self._to_list[:_PARAMETERS_PER_TICK]

    def _send(self, message: Message, address: Address | None = None) -> None:
        try:
            self.socket.sendto(message.pack(self._mav), address or self._destination)
        except OSError:
            # Nobody listens there yet, or any more: a drone goes on flying.
            return
        self._mav.seq = (self._mav.seq + 1) % 256

    def _say(self, severity: int, text: bytes) -> None:
        """STATUSTEXT, in numbered pieces if it is long."""
        pieces = [text[i : i + _TEXT_BYTES] for i in range(0, len(text), _TEXT_BYTES)]
        number = 0
        if len(pieces) > 1:
            self._long_texts = number = self._long_texts % 65535 + 1
        for i, piece in enumerate(pieces):
            self._send(mavlink.MAVLink_statustext_message(severity, piece, number, i))

    def _send_kind(self, kind: int, address: Address) -> bool:
        build = _BUILDERS.get(kind)
        if build is None:
            return False
        if (message := build(self)) is not None:
            self._send(message, address)
        return True

    @property
    def _boot_ms(self) -> int:
        return int(self.autopilot.now_s * 1000.0) & 0xFFFFFFFF

    @property
    def _boot_us(self) -> int:
        return int(self.autopilot.now_s * 1e6)

    def _geodetic(self) -> Geodetic:
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
        return mavlink.MAVLink_heartbeat_message(2, 12, base_mode, pilot.mode.custom_mode, status, 3)

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
        percent = round(100.0 * pilot.battery)
        return mavlink.MAVLink_sys_status_message(
            present, present, present & ~bad, 150, int(volts * 1000), 800, percent, 0, 0, 0, 0, 0, 0
        )

    def _battery_status(self) -> Message:
        pilot = self.autopilot
        cells = [int(3500 + 700 * pilot.battery)] * 4 + [65535] * 6
        percent = round(100.0 * pilot.battery)
        state = 1 + sum(
            pilot.battery <= pilot.parameters[name] for name in ("BAT_LOW_THR", "BAT_CRIT_THR", "BAT_EMERGEN_THR")
        )
        return mavlink.MAVLink_battery_status_message(0, 1, 3, 2500, cells, 800, -1, -1, percent, 0, state)

    def _extended_sys_state(self) -> Message:
        pilot = self.autopilot
        landed = 1
        if pilot.in_air:
            landed = {FlightMode.TAKEOFF: 3, FlightMode.LAND: 4}.get(pilot.mode, 2)
        return mavlink.MAVLink_extended_sys_state_message(0, landed)

    def _home_position(self) -> Message:
        home = self.autopilot.home
        place, local = self._frame.geodetic(home), home.minus(self.autopilot.origin)
        return mavlink.MAVLink_home_position_message(
            *_scaled(place), *local, [1.0, 0.0, 0.0, 0.0], math.nan, math.nan, math.nan, self._boot_us
        )

    def _global_origin(self) -> Message:
        return mavlink.MAVLink_gps_global_origin_message(*_scaled(self._origin), self._boot_us)

    def _gps_raw(self) -> Message:
        pilot = self.autopilot
        if not pilot.gps_fix:
            return mavlink.MAVLink_gps_raw_int_message(self._boot_us, 0, 0, 0, 0, 65535, 65535, 65535, 65535, 0)
        sigma_h, sigma_v = pilot.sigmas_m
        speed = pilot.velocity.horizontal
        course = math.degrees(math.atan2(pilot.velocity.east, pilot.velocity.north)) % 360.0
        return mavlink.MAVLink_gps_raw_int_message(
            self._boot_us, 3, *_scaled(self._geodetic()), 80, 120, int(speed * 100),
            int(course * 100), 16, 0, round(sigma_h * 1000), round(sigma_v * 1000), 100, 0,
        )  # fmt: skip

    def _global_position(self) -> Message:
        pilot = self.autopilot
        lat, lon, alt = _scaled(self._geodetic())
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
            self._boot_us, flags, 0.1, 0.1, 0.1, 0.1, 0.0, 0.0, sigma_h, sigma_v
        )

    def _odometry(self) -> Message:
        pilot, unknown = self.autopilot, [math.nan] + [0.0] * 20
        sigma_h, sigma_v = pilot.sigmas_m
        covariance = [0.0] * 21
        # sigma_h is that of the horizontal distance; each axis has half the variance.
        covariance[0] = covariance[6] = sigma_h**2 / 2.0
        covariance[11] = sigma_v**2
        yaw = math.radians(pilot.drone.yaw_deg)
        north, east, down = pilot.velocity
        # Velocity in the body's frame, as the child frame says; tilt is left out of it, it is a few degrees.
        forward, right = north * math.cos(yaw) + east * math.sin(yaw), east * math.cos(yaw) - north * math.sin(yaw)
        return mavlink.MAVLink_odometry_message(
            self._boot_us, 1, 12, *self._local(), self._quaternion(), forward, right, down, 0.0, 0.0,
            math.radians(pilot.drone.yaw_rate_deg_s), covariance, unknown, 0, 8, 100,
        )  # fmt: skip

    def _rc_channels(self) -> Message | None:
        if not self.autopilot.rc_alive:
            return None
        return mavlink.MAVLink_rc_channels_message(self._boot_ms, 8, *([1500] * 8 + [65535] * 10), 100)

    def _autopilot_version(self) -> Message:
        version = 1 << 24 | 17 << 16 | 255
        identity = self._mav.srcSystem
        return mavlink.MAVLink_autopilot_version_message(
            _CAPABILITIES, version, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, identity
        )

    def _mission_current(self) -> Message:
        return mavlink.MAVLink_mission_current_message(self.autopilot.waypoint)

    # In

    def receive(self) -> None:
        """Read and answer everything that has arrived."""
        while True:
            try:
                data, address = self.socket.recvfrom(65535)
            except BlockingIOError:
                return
            except OSError:
                # Linux reports here that an earlier datagram found nobody listening.
                continue
            # A datagram holds whole messages: what is broken in one cannot swallow the next.
            parser = mavlink.MAVLink(None)
            parser.robust_parsing = True
            for message in parser.parse_buffer(data) or ():
                self._handle(message, address)

    def _handle(self, message: Message, address: Address) -> None:
        target = getattr(message, "target_system", 0)
        if target not in (0, self._mav.srcSystem):
            return
        pilot = self.autopilot
        kind = message.get_type()
        if pilot.link_silent and getattr(message, "command", None) != mavlink.MAV_CMD_INJECT_FAILURE:
            return
        match kind:
            case "HEARTBEAT" if message.type == mavlink.MAV_TYPE_GCS:
                pilot.ground_station_at_s = pilot.now_s
            case "COMMAND_LONG":
                values = [getattr(message, f"param{i}") for i in range(1, 8)]
                self._acknowledge(message, self._command(message.command, values, address), address)
            case "COMMAND_INT":
                values = [message.param1, message.param2, message.param3, message.param4]
                values += [message.x * 1e-7, message.y * 1e-7, message.z]
                self._acknowledge(message, self._command(message.command, values, address), address)
            case "SET_POSITION_TARGET_LOCAL_NED" if self._obeys:
                if (setpoint := self._setpoint(message)) is not None:
                    pilot.offboard_setpoint(setpoint)
            case "PARAM_REQUEST_READ":
                self._read_parameter(message, address)
            case "PARAM_REQUEST_LIST":
                self._to_list = [(name, address) for name in pilot.parameters.names]
            case "PARAM_SET" if self._obeys:
                if pilot.parameters.set_wire(message.param_id, message.param_value, message.param_type):
                    self._send_parameter(message.param_id, address)
            case "MISSION_REQUEST_LIST":
                answer = mavlink.MAVLink_mission_count_message(message.get_srcSystem(), message.get_srcComponent(), 0)
                self._send(answer, address)
            case "MISSION_COUNT":
                # Missions come from the scenario; uploads are refused, not lost.
                unsupported = mavlink.MAV_MISSION_UNSUPPORTED
                answer = mavlink.MAVLink_mission_ack_message(
                    message.get_srcSystem(), message.get_srcComponent(), unsupported
                )
                self._send(answer, address)
            case "TIMESYNC" if message.tc1 == 0:
                self._send(mavlink.MAVLink_timesync_message(self._boot_us * 1000, message.ts1), address)

    def _acknowledge(self, message: Message, answer: Answer, address: Address) -> None:
        ack = mavlink.MAVLink_command_ack_message(
            message.command, int(answer), 255, 0, message.get_srcSystem(), message.get_srcComponent()
        )
        self._send(ack, address)

    def _command(self, command: int, values: list[float], address: Address) -> Answer:
        """Carry out a MAV_CMD; values: its seven parameters, latitude and longitude in degrees."""
        pilot = self.autopilot
        match command:
            case mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
                return self._set_interval(values[0], values[1])
            case mavlink.MAV_CMD_REQUEST_MESSAGE:
                return Answer.ACCEPTED if self._send_kind(_int(values[0]), address) else Answer.UNSUPPORTED
            case mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES:
                self._send(self._autopilot_version(), address)
                return Answer.ACCEPTED
        if not self._obeys:
            return Answer.DENIED
        match command:
            case mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
                force = _int(values[1]) == FORCE
                return pilot.arm(force) if values[0] == 1.0 else pilot.disarm(force)
            case mavlink.MAV_CMD_DO_SET_MODE:
                if not _int(values[0]) & 1:
                    return Answer.DENIED
                return pilot.set_mode(_int(values[1]), _int(values[2]))
            case mavlink.MAV_CMD_NAV_TAKEOFF:
                return pilot.take_off()
            case mavlink.MAV_CMD_NAV_LAND:
                return pilot.change_mode(FlightMode.LAND)
            case mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH:
                return pilot.change_mode(FlightMode.RTL)
            case mavlink.MAV_CMD_MISSION_START:
                return pilot.change_mode(FlightMode.MISSION)
            case mavlink.MAV_CMD_DO_REPOSITION:
                return self._reposition(values)
            case mavlink.MAV_CMD_INJECT_FAILURE:
                return pilot.inject(_int(values[0]), _int(values[1]))
        return Answer.UNSUPPORTED

    def _reposition(self, values: list[float]) -> Answer:
        lat, lon, amsl = values[4:7]
        here = self._frame.geodetic(self.autopilot.position)
        place = Geodetic(*(new if math.isfinite(new) else old for new, old in zip((lat, lon, amsl), here, strict=True)))
        if not abs(place.lat_deg) <= 90.0:
            return Answer.DENIED
        goal = self._frame.ned(place)
        if goal.minus(self.autopilot.position).norm > 10_000.0:
            return Answer.DENIED
        return self.autopilot.reposition(goal, math.degrees(values[3]))

    def _set_interval(self, kind: float, interval_us: float) -> Answer:
        """SET_MESSAGE_INTERVAL: -1 none, 0 the default, never faster than the tick."""
        number = _int(kind)
        if number not in _RATES_S or not math.isfinite(interval_us):
            return Answer.DENIED if number not in _BUILDERS else Answer.UNSUPPORTED
        if interval_us < 0.0:
            self._every_s[number], self._next_s[number] = math.inf, math.inf
            return Answer.ACCEPTED
        self._every_s[number] = max(TICK_S, interval_us * 1e-6) if interval_us else _RATES_S[number]
        self._next_s[number] = self.autopilot.now_s
        return Answer.ACCEPTED

    def _setpoint(self, message: Message) -> Setpoint | None:
        """The setpoint in the scenario's frame; None for frames and masks that are not flown.

        A NaN coordinate is accepted, as PX4 does; the drone brakes on that axis.
        """
        mask, pilot = message.type_mask, self.autopilot
        yaw_rad = math.radians(pilot.drone.yaw_deg)
        position, velocity = Ned(math.nan, math.nan, math.nan), Ned(math.nan, math.nan, math.nan)
        if mask & _IGNORE_POSITION != _IGNORE_POSITION and message.coordinate_frame == mavlink.MAV_FRAME_LOCAL_NED:
            here = _masked((message.x, message.y, message.z), mask)
            position = here.plus(pilot.origin)
        if mask & _IGNORE_VELOCITY != _IGNORE_VELOCITY:
            velocity = _masked((message.vx, message.vy, message.vz), mask >> 3)
            if message.coordinate_frame == mavlink.MAV_FRAME_BODY_NED:
                cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
                forward, right, down = velocity
                velocity = Ned(forward * cos - right * sin, forward * sin + right * cos, down)
            elif message.coordinate_frame != mavlink.MAV_FRAME_LOCAL_NED:
                return None
        if mask & _IGNORE_POSITION == _IGNORE_POSITION and mask & _IGNORE_VELOCITY == _IGNORE_VELOCITY:
            return None
        brake = [v if math.isfinite(v) or math.isfinite(p) else 0.0 for v, p in zip(velocity, position, strict=True)]
        # The cascade treats north and east together: one unknown coordinate stops both.
        if not (math.isfinite(position.north) and math.isfinite(position.east)):
            position = Ned(math.nan, math.nan, position.down)
            brake[0] = brake[0] if math.isfinite(brake[0]) else 0.0
            brake[1] = brake[1] if math.isfinite(brake[1]) else 0.0
        yaw_deg = math.nan if mask & _IGNORE_YAW else math.degrees(message.yaw)
        rate = 0.0 if mask & _IGNORE_YAW_RATE else math.degrees(message.yaw_rate)
        return Setpoint(position, Ned(*brake), yaw_deg, rate if math.isfinite(rate) else 0.0)

    def _read_parameter(self, message: Message, address: Address) -> None:
        """Unknown names get no answer, as from PX4."""
        names = self.autopilot.parameters.names
        index = message.param_index
        if 0 <= index < len(names):
            self._send_parameter(names[index], address)
        elif index == -1 and message.param_id in names:
            self._send_parameter(message.param_id, address)

    def _send_parameter(self, name: str, address: Address) -> None:
        parameters = self.autopilot.parameters
        index = parameters.names.index(name)
        self._send(
            mavlink.MAVLink_param_value_message(
                name.encode(), parameters.wire(name), parameters.type_of(name), len(parameters.names), index
            ),
            address,
        )


def _cos_sin(angle: float) -> tuple[float, float]:
    return math.cos(angle), math.sin(angle)


def _int(value: float) -> int:
    """A number that travels as a float; -1, which is no id, for NaN and infinity."""
    return int(value) if math.isfinite(value) else -1


def _scaled(place: Geodetic) -> tuple[int, int, int]:
    """1e-7 degrees and millimetres."""
    return round(place.lat_deg * 1e7), round(place.lon_deg * 1e7), round(place.amsl_m * 1000)


def _masked(values: tuple[float, float, float], mask: int) -> Ned:
    return Ned(
        *(value if math.isfinite(value) and not mask >> axis & 1 else math.nan for axis, value in enumerate(values))
    )


_BUILDERS: dict[int, Callable[[VehicleLink], Message | None]] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: VehicleLink._heartbeat,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: VehicleLink._sys_status,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: VehicleLink._battery_status,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: VehicleLink._extended_sys_state,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: VehicleLink._home_position,
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: VehicleLink._global_origin,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: VehicleLink._gps_raw,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: VehicleLink._global_position,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: VehicleLink._local_position,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: VehicleLink._attitude,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: VehicleLink._attitude_quaternion,
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: VehicleLink._estimator_status,
    mavlink.MAVLINK_MSG_ID_ODOMETRY: VehicleLink._odometry,
    mavlink.MAVLINK_MSG_ID_RC_CHANNELS: VehicleLink._rc_channels,
    mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: VehicleLink._autopilot_version,
    mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: VehicleLink._mission_current,
}
