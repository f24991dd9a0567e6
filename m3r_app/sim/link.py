"""One simulated drone's MAVLink: telemetry out over UDP, commands, parameters and setpoints in.

It sends to the address where a ground station listens, as PX4 does, and answers any station that asks. Source: MAVLink common
messages; PX4 1.17's answers (MAV_RESULT), parameter encoding and message rates.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from random import Random

from pymavlink.dialects.v20 import common as mavlink

from m3r_app.environment.scenario import LinkModel
from m3r_app.sim.autopilot import FORCE, Autopilot
from m3r_app.sim.channel import Address, Channel
from m3r_app.sim.dynamics import Setpoint
from m3r_app.sim.guidance import TICK_S
from m3r_app.sim.messages import KINDS, CurrentMode, Message, Telemetry
from m3r_app.sim.modes import FlightMode, MavResult
from safety.frames import LocalFrame
from safety.vocabulary import Geodetic, Ned

# After a boot PX4's heartbeat comes before all else.
_RATES_S: dict[int, float] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
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
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: 1.0,
    mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR: 0.1,
    CurrentMode.msgid: 2.0,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: 1.0,
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: 1.0,
}
_PARAMETERS_PER_TICK = 5
_TEXT_BYTES = 50
_IGNORE_POSITION, _IGNORE_VELOCITY, _IGNORE_YAW, _IGNORE_YAW_RATE = 7, 56, 1024, 2048


class VehicleLink:
    """The MAVLink endpoint of one `Autopilot`."""

    def __init__(
        self,
        autopilot: Autopilot,
        frame: LocalFrame,
        system_id: int,
        destination: Address,
        obeys: bool = True,
        model: LinkModel | None = None,
        rng: Random | None = None,
    ) -> None:
        """frame: the scenario's. obeys False: somebody else's drone; it tells where it is and refuses every command.

        Raises ValueError that names a message which it does not send anyway.
        """
        self.autopilot, self._frame, self._obeys = autopilot, frame, obeys
        self.telemetry = Telemetry(autopilot, frame, system_id)
        self._model = model = model or LinkModel()
        self.channel = Channel(destination[0], rng or Random(system_id), model.loss, model.delay_ms / 1000.0)
        self.socket = self.channel.socket
        self._slowest_s = 1.0 / model.rate_hz_max if model.rate_hz_max else 0.0
        self._silent = {_number(name) for name in model.without}
        self._destination = destination
        self._mav = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=1)
        # Different drones' messages of one kind do not all fall on the same tick.
        self._every_s = {kind: max(every_s, self._slowest_s) for kind, every_s in _RATES_S.items()}
        self._next_s = {kind: (kind * 7 + system_id * 3) % 10 * TICK_S for kind in _RATES_S}
        self._long_texts = 0
        self._to_list: list[tuple[str, Address]] = []
        self._mode_sent: tuple[FlightMode, bool] | None = None
        self._boots = 0
        self._companions: list[_Companion] = []
        self._double: mavlink.MAVLink | None = None
        """Somebody else's autopilot, whose telemetry comes to the same port."""
        self.tunes = 0
        """How many it was asked to play."""

    def close(self) -> None:
        self.channel.close()

    # Out

    def tick(self) -> None:
        """Send what is due. Call it after each tick of the autopilot."""
        pilot = self.autopilot
        self.receive()
        self.channel.flush(pilot.now_s)
        self._tell_companions()
        if self._boots != pilot.boots:
            self._boots = pilot.boots
            self._every_s = {kind: max(every_s, self._slowest_s) for kind, every_s in _RATES_S.items()}
            self._next_s = dict.fromkeys(_RATES_S, pilot.now_s)
        if pilot.link_silent or not pilot.running:
            pilot.texts.clear()
            self._to_list.clear()
            return
        for severity, text in pilot.texts:
            self.say(int(severity), text.encode())
        pilot.texts.clear()
        # By default a change of mode is told at once; PX4 itself waits for its next heartbeat.
        if self._model.mode_at_once and (told := (pilot.mode, pilot.armed)) != self._mode_sent:
            self._mode_sent = told
            self._next_s[mavlink.MAVLINK_MSG_ID_HEARTBEAT] = pilot.now_s
        for kind, at_s in self._next_s.items():
            if at_s <= pilot.now_s + 1e-6:
                self._next_s[kind] = max(at_s + self._every_s[kind], pilot.now_s)
                self._send_kind(kind, self._destination)
        for name, address in self._to_list[:_PARAMETERS_PER_TICK]:
            self._send_parameter(name, address)
        del self._to_list[:_PARAMETERS_PER_TICK]

    def tell(self, message: Message) -> None:
        """Pass on what its receivers hear."""
        if not self.autopilot.link_silent and self.autopilot.running:
            self._send(message)

    def hear_component(self, component: int, kind: int, autopilot: int) -> None:
        """From now on the heartbeat of another component of this drone is heard. kind: MAV_TYPE."""
        self._companions.append(_Companion(mavlink.MAVLink(None, self._mav.srcSystem, component), kind, autopilot))

    def hear_autopilot(self, system_id: int) -> None:
        """From now on another autopilot tells the same at the same port, under its own system id."""
        self._double = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=1)

    def _tell_companions(self) -> None:
        for one in self._companions:
            if self.autopilot.now_s >= one.next_s:
                one.next_s = self.autopilot.now_s + 1.0
                heartbeat = mavlink.MAVLink_heartbeat_message(one.kind, one.autopilot, 0, 0, 4, 3)
                self._send(heartbeat, mav=one.mav)

    def _send(self, message: Message, address: Address | None = None, mav: mavlink.MAVLink | None = None) -> None:
        mav = mav or self._mav
        self.channel.send(self.autopilot.now_s, message.pack(mav), address or self._destination)
        mav.seq = (mav.seq + 1) % 256

    def say(self, severity: int, text: bytes) -> None:
        """STATUSTEXT, in numbered pieces if it is long."""
        pieces = [text[i : i + _TEXT_BYTES] for i in range(0, len(text), _TEXT_BYTES)]
        number = 0
        if len(pieces) > 1:
            self._long_texts = number = self._long_texts % 65535 + 1
        for i, piece in enumerate(pieces):
            self._send(mavlink.MAVLink_statustext_message(severity, piece, number, i))

    def _send_kind(self, kind: int, address: Address) -> bool:
        if kind not in KINDS or kind in self._silent:
            return False
        if (message := self.telemetry.build(kind)) is not None:
            self._send(message, address)
            if self._double is not None:
                self._send(message, address, self._double)
        return True

    # In

    def receive(self) -> None:
        """Read and answer everything that has arrived."""
        for data, address in self.channel.arrived(self.autopilot.now_s):
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
        if not pilot.running:
            return
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
            case "PLAY_TUNE" if self._obeys and message.tune.startswith("M"):
                self.tunes += 1
            case "TIMESYNC" if message.tc1 == 0:
                self._send(mavlink.MAVLink_timesync_message(self.telemetry.boot_us * 1000, message.ts1), address)

    def _acknowledge(self, message: Message, answer: MavResult, address: Address) -> None:
        ack = mavlink.MAVLink_command_ack_message(
            message.command, int(answer), 255, 0, message.get_srcSystem(), message.get_srcComponent()
        )
        self._send(ack, address)

    def _command(self, command: int, values: list[float], address: Address) -> MavResult:
        """Carry out a MAV_CMD; values: its seven parameters, latitude and longitude in degrees."""
        pilot = self.autopilot
        match command:
            case mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
                return self._set_interval(values[0], values[1])
            case mavlink.MAV_CMD_REQUEST_MESSAGE:
                return MavResult.ACCEPTED if self._send_kind(_int(values[0]), address) else MavResult.UNSUPPORTED
            case mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES:
                self._send_kind(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION, address)
                return MavResult.ACCEPTED
        if not self._obeys:
            return MavResult.DENIED
        match command:
            case mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
                force = _int(values[1]) == FORCE
                return pilot.arm(force) if values[0] == 1.0 else pilot.disarm(force)
            case mavlink.MAV_CMD_DO_SET_MODE:
                if not _int(values[0]) & 1:
                    return MavResult.DENIED
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
            case mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN if _int(values[0]) == 1:
                pilot.restart(0.0)
                return MavResult.ACCEPTED
            case mavlink.MAV_CMD_INJECT_FAILURE:
                return pilot.inject(_int(values[0]), _int(values[1]))
        return MavResult.UNSUPPORTED

    def _reposition(self, values: list[float]) -> MavResult:
        lat, lon, amsl = values[4:7]
        here = self._frame.geodetic(self.autopilot.position)
        place = Geodetic(*(new if math.isfinite(new) else old for new, old in zip((lat, lon, amsl), here, strict=True)))
        if not abs(place.lat_deg) <= 90.0:
            return MavResult.DENIED
        goal = self._frame.ned(place)
        if goal.minus(self.autopilot.position).norm > 10_000.0:
            return MavResult.DENIED
        return self.autopilot.reposition(goal, math.degrees(values[3]))

    def _set_interval(self, kind: float, interval_us: float) -> MavResult:
        """SET_MESSAGE_INTERVAL: -1 none, 0 the default, never faster than the tick."""
        number = _int(kind)
        if number not in _RATES_S or not math.isfinite(interval_us):
            return MavResult.DENIED if number not in KINDS else MavResult.UNSUPPORTED
        if interval_us < 0.0:
            self._every_s[number], self._next_s[number] = math.inf, math.inf
            return MavResult.ACCEPTED
        every_s = interval_us * 1e-6 if interval_us else _RATES_S[number]
        self._every_s[number] = max(TICK_S, self._slowest_s, every_s)
        self._next_s[number] = self.autopilot.now_s
        return MavResult.ACCEPTED

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


@dataclass(slots=True)
class _Companion:
    """Another component that is heard through this drone's link."""

    mav: mavlink.MAVLink
    kind: int
    autopilot: int
    next_s: float = 0.0


def _number(name: str) -> int:
    """The id of a message that it can send, by its MAVLink name. Raises ValueError."""
    kind = CurrentMode.msgid if name == "CURRENT_MODE" else getattr(mavlink, f"MAVLINK_MSG_ID_{name}", None)
    if kind not in KINDS:
        raise ValueError(f"without: {name} is no message that it sends")
    return int(kind)


def _int(value: float) -> int:
    """A number that travels as a float; -1, which is no id, for NaN and infinity."""
    return int(value) if math.isfinite(value) else -1


def _masked(values: tuple[float, float, float], mask: int) -> Ned:
    return Ned(
        *(value if math.isfinite(value) and not mask >> axis & 1 else math.nan for axis, value in enumerate(values))
    )
