"""The MAVLink of a simulated drone, message by message, with a raw pymavlink peer over loopback UDP."""

from __future__ import annotations

import math
import select
import socket
import struct
from collections.abc import Iterator
from random import Random
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from m3r_app.sim.autopilot import Autopilot
from m3r_app.sim.dynamics import ZERO, Multirotor, PositionError
from m3r_app.sim.guidance import TICK_S
from m3r_app.sim.link import VehicleLink
from m3r_app.sim.modes import FlightMode
from m3r_app.sim.parameters import INT32, Parameters
from safety.frames import LocalFrame
from safety.vocabulary import Geodetic, Ned

FRAME = LocalFrame(Geodetic(46.679, 7.863, 580.0))
START = Ned(12.0, -7.0, -6.0)


class Peer:
    """A ground station that speaks to one drone in virtual time."""

    def __init__(self, obeys: bool = True, **params: float) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        error = PositionError(0.25, 0.35, 300.0, 0.01, Random(2))
        self.pilot = Autopilot(Multirotor(position=START), error, lambda n, e: 0.0, Parameters(params))
        self.link = VehicleLink(self.pilot, FRAME, 7, self.socket.getsockname(), obeys)
        self._in = mavlink.MAVLink(None)
        self._out = mavlink.MAVLink(None, srcSystem=245, srcComponent=190)

    def close(self) -> None:
        self.link.close()
        self.socket.close()

    def read(self) -> list[Any]:
        """Everything that has arrived."""
        found: list[Any] = []
        while select.select([self.socket], [], [], 0.0)[0]:
            found += self._in.parse_buffer(self.socket.recv(4096)) or []
        return found

    def fly(self, seconds: float) -> list[Any]:
        found = []
        for _ in range(round(seconds / TICK_S)):
            self.pilot.tick(ZERO)
            self.link.tick()
            found += self.read()
        return found

    def tell(self, message: Any, sender: socket.socket | None = None) -> list[Any]:
        """Send it and read the answers."""
        port = self.link.socket.getsockname()[1]
        (sender or self.socket).sendto(message.pack(self._out), ("127.0.0.1", port))
        assert select.select([self.link.socket], [], [], 5.0)[0]
        self.link.receive()
        return self.read()

    def command(self, command: int, *values: float) -> int:
        """The MAV_RESULT of a COMMAND_LONG."""
        message = mavlink.MAVLink_command_long_message(7, 1, command, 0, *(*values, *[0.0] * (7 - len(values))))
        (ack,) = (m for m in self.tell(message) if m.get_type() == "COMMAND_ACK")
        assert ack.command == command and (ack.target_system, ack.target_component) == (245, 190)
        return int(ack.result)


@pytest.fixture
def peer() -> Iterator[Peer]:
    one = Peer(SYS_FAILURE_EN=1)
    yield one
    one.close()


def named(messages: list[Any], name: str) -> list[Any]:
    return [m for m in messages if m.get_type() == name]


def test_rates(peer: Peer) -> None:
    peer.fly(0.5)
    heard = peer.fly(4.0)
    per_s = {m.get_type(): len(named(heard, m.get_type())) / 4.0 for m in heard}
    for name in ("LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "ATTITUDE", "ATTITUDE_QUATERNION"):
        assert per_s[name] == pytest.approx(50.0, abs=1.0)
    for name in ("ESTIMATOR_STATUS", "GPS_RAW_INT", "EXTENDED_SYS_STATE", "ODOMETRY"):
        assert per_s[name] == pytest.approx(10.0, abs=0.5)
    for name in ("HEARTBEAT", "HOME_POSITION", "GPS_GLOBAL_ORIGIN"):
        assert per_s[name] == pytest.approx(1.0, abs=0.5)
    assert {"SYS_STATUS", "BATTERY_STATUS"} <= set(per_s)
    assert "RC_CHANNELS" not in per_s


def test_positions_agree_with_each_other_and_with_the_estimate(peer: Peer) -> None:
    heard = peer.fly(0.2)
    local = named(heard, "LOCAL_POSITION_NED")[-1]
    place = named(heard, "GLOBAL_POSITION_INT")[-1]
    raw = named(peer.fly(1.2), "GPS_GLOBAL_ORIGIN")[-1]
    assert peer.pilot.origin == (12.0, -7.0, 0.0)
    origin = FRAME.ned(Geodetic(raw.latitude * 1e-7, raw.longitude * 1e-7, raw.altitude * 1e-3))
    assert origin == pytest.approx((12.0, -7.0, 0.0), abs=0.02)
    here = FRAME.ned(Geodetic(place.lat * 1e-7, place.lon * 1e-7, place.alt * 1e-3))
    assert here.minus(origin) == pytest.approx((local.x, local.y, local.z), abs=0.03)
    assert Ned(local.x, local.y, local.z).plus(origin).minus(START).norm < 2.0 * 0.35 + 0.05


def test_the_cheap_conversion_is_exact(peer: Peer) -> None:
    for east in (0.0, 3.0, 4.9, 5.1, 80.0):
        peer.pilot.drone.position = Ned(40.0, east, -9.0)
        cheap, exact = peer.link.telemetry.geodetic(), FRAME.geodetic(peer.pilot.position)
        assert FRAME.ned(cheap).minus(FRAME.ned(exact)).norm < 1e-4


def test_accuracies_are_told_honestly(peer: Peer) -> None:
    heard = peer.fly(0.3)
    estimator, raw = named(heard, "ESTIMATOR_STATUS")[-1], named(heard, "GPS_RAW_INT")[-1]
    assert estimator.pos_horiz_accuracy == pytest.approx(0.25) and estimator.pos_vert_accuracy == pytest.approx(0.35)
    assert (raw.h_acc, raw.v_acc, raw.fix_type) == (250, 350, 3)
    odometry = named(heard, "ODOMETRY")[-1]
    assert odometry.pose_covariance[0] + odometry.pose_covariance[6] == pytest.approx(0.25**2, rel=1e-5)
    assert peer.command(mavlink.MAV_CMD_INJECT_FAILURE, 4, 1) == 0
    heard = peer.fly(1.0)
    assert named(heard, "ESTIMATOR_STATUS")[-1].pos_horiz_accuracy > 0.6
    assert named(heard, "GPS_RAW_INT")[-1].fix_type == 0


def test_heartbeats_say_px4_its_mode_and_armed(peer: Peer) -> None:
    beat = named(peer.fly(1.2), "HEARTBEAT")[-1]
    assert (beat.type, beat.autopilot, beat.get_srcComponent()) == (2, 12, 1)
    assert beat.custom_mode == 4 << 16 | 3 << 24 and beat.base_mode & 128
    assert peer.command(mavlink.MAV_CMD_NAV_LAND) == 0
    beat = named(peer.fly(TICK_S), "HEARTBEAT")[-1]
    assert beat.custom_mode == 4 << 16 | 6 << 24


@pytest.mark.parametrize(
    ("command", "values", "result"),
    [
        (mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (0.0,), mavlink.MAV_RESULT_TEMPORARILY_REJECTED),
        (mavlink.MAV_CMD_DO_SET_MODE, (1.0, 6.0), mavlink.MAV_RESULT_TEMPORARILY_REJECTED),
        (mavlink.MAV_CMD_DO_SET_MODE, (0.0, 4.0, 3.0), mavlink.MAV_RESULT_DENIED),
        (mavlink.MAV_CMD_DO_SET_MODE, (1.0, 4.0, 3.0), mavlink.MAV_RESULT_ACCEPTED),
        (mavlink.MAV_CMD_DO_SET_MODE, (1.0, 77.0, 3.0), mavlink.MAV_RESULT_DENIED),
        (mavlink.MAV_CMD_DO_SET_MODE, (1.0, math.nan, 3.0), mavlink.MAV_RESULT_DENIED),
        (mavlink.MAV_CMD_MISSION_START, (), mavlink.MAV_RESULT_TEMPORARILY_REJECTED),
        (mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH, (), mavlink.MAV_RESULT_ACCEPTED),
        (mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, (2.0,), mavlink.MAV_RESULT_UNSUPPORTED),
        (mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, (1.0,), mavlink.MAV_RESULT_ACCEPTED),
        (mavlink.MAV_CMD_INJECT_FAILURE, (0.0, 1.0), mavlink.MAV_RESULT_UNSUPPORTED),
        (mavlink.MAV_CMD_REQUEST_MESSAGE, (148.0,), mavlink.MAV_RESULT_ACCEPTED),
        (mavlink.MAV_CMD_REQUEST_MESSAGE, (9999.0,), mavlink.MAV_RESULT_UNSUPPORTED),
        (mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, (9999.0, 1000.0), mavlink.MAV_RESULT_DENIED),
    ],
)
def test_acknowledgements(peer: Peer, command: int, values: tuple[float, ...], result: int) -> None:
    assert peer.command(command, *values) == result


def test_a_refusals_reason_comes_as_status_text(peer: Peer) -> None:
    peer.command(mavlink.MAV_CMD_DO_SET_MODE, 1.0, 6.0)
    pieces = named(peer.fly(TICK_S), "STATUSTEXT")
    assert [piece.chunk_seq for piece in pieces] == list(range(len(pieces)))
    assert len({piece.id for piece in pieces}) == 1
    assert "".join(piece.text for piece in pieces) == "Switching to Offboard is not available: no offboard signal"


def test_message_intervals(peer: Peer) -> None:
    assert peer.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_ATTITUDE, 100_000.0) == 0
    assert peer.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_ODOMETRY, -1.0) == 0
    peer.fly(0.2)
    heard = peer.fly(2.0)
    assert len(named(heard, "ATTITUDE")) == pytest.approx(20, abs=1)
    assert not named(heard, "ODOMETRY")
    assert peer.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_ATTITUDE, 0.0) == 0
    assert len(named(peer.fly(1.0), "ATTITUDE")) == pytest.approx(50, abs=1)


def test_requested_version_says_bytewise_parameters_and_mavlink_2(peer: Peer) -> None:
    message = mavlink.MAVLink_command_long_message(7, 1, mavlink.MAV_CMD_REQUEST_MESSAGE, 0, 148, 0, 0, 0, 0, 0, 0)
    (version,) = named(peer.tell(message), "AUTOPILOT_VERSION")
    bytewise, mavlink2 = (
        mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE, mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    )  # fmt: skip
    assert version.capabilities & bytewise and version.capabilities & mavlink2
    assert version.flight_sw_version >> 16 == 1 << 8 | 17


def test_parameters_over_the_link(peer: Peer) -> None:
    (value,) = peer.tell(mavlink.MAVLink_param_request_read_message(7, 1, b"COM_OBL_RC_ACT", -1))
    assert value.param_id == "COM_OBL_RC_ACT" and value.param_type == INT32
    carried = struct.unpack("<f", struct.pack("<i", 5))[0]
    (value,) = peer.tell(mavlink.MAVLink_param_set_message(7, 1, b"COM_OBL_RC_ACT", carried, INT32))
    assert struct.unpack("<i", struct.pack("<f", value.param_value))[0] == 5
    assert peer.pilot.parameters.bits("COM_OBL_RC_ACT") == 5
    assert peer.tell(mavlink.MAVLink_param_request_read_message(7, 1, b"NOPE", -1)) == []
    assert peer.tell(mavlink.MAVLink_param_request_read_message(7, 1, b"", 999)) == []
    peer.tell(mavlink.MAVLink_param_request_list_message(7, 1))
    listed = named(peer.fly(1.0), "PARAM_VALUE")
    assert [v.param_id for v in listed] == peer.pilot.parameters.names
    assert {v.param_count for v in listed} == {len(peer.pilot.parameters.names)}


POSITION_AND_YAW = 0b100111111000
VELOCITY_AND_YAW = 0b100111000111


def target(mask: int, frame: int = 1, **values: float) -> Any:
    keys = ("x", "y", "z", "vx", "vy", "vz", "ax", "ay", "az", "yaw", "yaw_rate")
    numbers = [values.get(key, 0.0) for key in keys]
    return mavlink.MAVLink_set_position_target_local_ned_message(0, 7, 1, frame, mask, *numbers)


def offboard(peer: Peer, message: Any, seconds: float) -> None:
    peer.tell(message)
    assert peer.command(mavlink.MAV_CMD_DO_SET_MODE, 1.0, 6.0) == 0
    for _ in range(round(seconds / 0.1)):
        peer.tell(message)
        peer.fly(0.1)
    assert peer.pilot.mode is FlightMode.OFFBOARD


def test_position_setpoints_are_in_the_drones_own_frame(peer: Peer) -> None:
    offboard(peer, target(POSITION_AND_YAW, x=2.0, y=-1.0, z=-7.0, yaw=math.pi / 2), 10.0)
    assert peer.pilot.position == pytest.approx((14.0, -8.0, -7.0), abs=0.1)
    assert peer.pilot.drone.yaw_deg == pytest.approx(90.0, abs=1.0)


def test_velocity_setpoints_in_both_frames(peer: Peer) -> None:
    offboard(peer, target(VELOCITY_AND_YAW, vx=1.0, yaw=math.pi / 2), 6.0)
    assert peer.pilot.velocity == pytest.approx((1.0, 0.0, 0.0), abs=0.1)
    offboard(peer, target(VELOCITY_AND_YAW, frame=mavlink.MAV_FRAME_BODY_NED, vx=1.0, yaw=math.pi / 2), 6.0)
    assert peer.pilot.velocity == pytest.approx((0.0, 1.0, 0.0), abs=0.1)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("axis", ["x", "z"])
def test_a_setpoint_that_is_no_number_is_accepted_and_brakes(peer: Peer, bad: float, axis: str) -> None:
    offboard(peer, target(VELOCITY_AND_YAW, vx=1.0), 3.0)
    still = {"x": 0.0, "y": 0.0, "z": -6.0, axis: bad}
    offboard(peer, target(POSITION_AND_YAW, **still), 8.0)
    assert peer.pilot.velocity.norm < 0.05
    assert peer.pilot.position.finite


def test_what_is_no_setpoint_does_not_keep_offboard_alive(peer: Peer) -> None:
    nothing = target(0b111111111111)
    attitude = mavlink.MAVLink_set_attitude_target_message(0, 7, 1, 0, [1.0, 0.0, 0.0, 0.0], 0, 0, 0, 0.5)
    elsewhere = target(VELOCITY_AND_YAW, frame=mavlink.MAV_FRAME_GLOBAL_INT, vx=1.0)
    for message in (nothing, attitude, elsewhere):
        peer.tell(message)
        assert peer.command(mavlink.MAV_CMD_DO_SET_MODE, 1.0, 6.0) == mavlink.MAV_RESULT_TEMPORARILY_REJECTED


def test_goes_where_it_is_repositioned(peer: Peer) -> None:
    goal = FRAME.geodetic(Ned(20.0, 0.0, -9.0))
    message = mavlink.MAVLink_command_int_message(
        7, 1, 5, mavlink.MAV_CMD_DO_REPOSITION, 0, 0, -1.0, 1.0, 0.0, math.nan,
        round(goal.lat_deg * 1e7), round(goal.lon_deg * 1e7), goal.amsl_m,
    )  # fmt: skip
    (ack,) = named(peer.tell(message), "COMMAND_ACK")
    assert ack.result == 0
    peer.fly(12.0)
    assert peer.pilot.position == pytest.approx((20.0, 0.0, -9.0), abs=0.2)
    far = mavlink.MAVLink_command_int_message(
        7, 1, 5, mavlink.MAV_CMD_DO_REPOSITION, 0, 0, -1.0, 1.0, 0.0, 0.0, 0, 0, 500.0
    )
    (ack,) = named(peer.tell(far), "COMMAND_ACK")
    assert ack.result == mavlink.MAV_RESULT_DENIED


def test_commands_to_another_system_are_not_ours(peer: Peer) -> None:
    message = mavlink.MAVLink_command_long_message(8, 1, mavlink.MAV_CMD_NAV_LAND, 0, 0, 0, 0, 0, 0, 0, 0)
    assert peer.tell(message) == []
    assert peer.pilot.mode is FlightMode.LOITER


def test_a_second_ground_station_is_obeyed_and_answered(peer: Peer) -> None:
    """As PX4: who asks last decides. Noticing that is the app's duty."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        land = mavlink.MAVLink_command_long_message(7, 1, mavlink.MAV_CMD_NAV_LAND, 0, 0, 0, 0, 0, 0, 0, 0)
        assert peer.tell(land, other) == []
        assert select.select([other], [], [], 5.0)[0]
        (ack,) = mavlink.MAVLink(None).parse_buffer(other.recv(1000))
        assert ack.get_type() == "COMMAND_ACK" and ack.result == 0
    assert peer.pilot.mode is FlightMode.LAND


def test_a_silent_link_hears_only_its_mending(peer: Peer) -> None:
    peer.fly(0.1)
    assert peer.command(mavlink.MAV_CMD_INJECT_FAILURE, 105, 1) == 0
    assert peer.fly(2.0) == []
    land = mavlink.MAVLink_command_long_message(7, 1, mavlink.MAV_CMD_NAV_LAND, 0, 0, 0, 0, 0, 0, 0, 0)
    assert peer.tell(land) == []
    assert peer.pilot.mode is FlightMode.LOITER
    assert peer.command(mavlink.MAV_CMD_INJECT_FAILURE, 105, 0) == 0
    assert named(peer.fly(0.2), "LOCAL_POSITION_NED")


def test_noise_on_the_line_is_skipped(peer: Peer) -> None:
    port = peer.link.socket.getsockname()[1]
    for data in (b"", b"\xfd\x00", bytes(range(256)), b"\xfd" + b"\x99" * 40):
        peer.socket.sendto(data, ("127.0.0.1", port))
    assert peer.command(mavlink.MAV_CMD_NAV_LAND) == 0


def test_traffic_tells_where_it_is_and_obeys_nobody() -> None:
    courier = Peer(obeys=False)
    assert named(courier.fly(0.1), "GLOBAL_POSITION_INT")
    for command in (mavlink.MAV_CMD_NAV_LAND, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, mavlink.MAV_CMD_DO_SET_MODE):
        assert courier.command(command, 1.0, 6.0) == mavlink.MAV_RESULT_DENIED
    carried = struct.unpack("<f", struct.pack("<i", 5))[0]
    assert courier.tell(mavlink.MAVLink_param_set_message(7, 1, b"COM_OBL_RC_ACT", carried, INT32)) == []
    assert courier.pilot.parameters.bits("COM_OBL_RC_ACT") == 0
    courier.close()
