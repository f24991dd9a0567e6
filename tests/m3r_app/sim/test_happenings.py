"""What a scenario lets happen to a drone is what its telemetry then tells: message by message, in virtual time."""

from __future__ import annotations

import math
import select
import socket
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from m3r_app.environment.scenario import SHIPPED, ScenarioError, load_scenario
from m3r_app.ports import free_udp_block
from m3r_app.sim.fleet import Fleet
from m3r_app.sim.guidance import TICK_S
from m3r_app.sim.messages import CurrentMode
from m3r_app.sim.modes import FlightMode
from safety.vocabulary import Ned

PLAIN = (SHIPPED / "plain.toml").read_text(encoding="utf-8")
RED_ENDS = "params = { COM_OF_LOSS_T = 0.5, COM_OBL_RC_ACT = 5 }\n"


class Station:
    """The ground station of red, flying beside it in virtual time."""

    def __init__(self, scenario: Path) -> None:
        port = free_udp_block(3)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", port))
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        self.fleet = Fleet(load_scenario(scenario), port)
        self.link = self.fleet.links["red"]
        self.pilot = self.link.autopilot
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True
        self._out = mavlink.MAVLink(None, srcSystem=245, srcComponent=190)

    def close(self) -> None:
        self.fleet.close()
        self.socket.close()

    def read(self) -> list[Any]:
        found: list[Any] = []
        while select.select([self.socket], [], [], 0.0)[0]:
            found += self._parser.parse_buffer(self.socket.recv(4096)) or []
        return found

    def fly(self, seconds: float, each: Callable[[], None] | None = None) -> list[Any]:
        """What was heard meanwhile."""
        found = []
        for _ in range(round(seconds / TICK_S)):
            if each:
                each()
            self.fleet.tick()
            found += self.read()
        return found

    def send(self, message: Any) -> None:
        self.socket.sendto(message.pack(self._out), self.link.socket.getsockname())

    def command(self, command: int, *values: float) -> None:
        self.send(mavlink.MAVLink_command_long_message(1, 1, command, 0, *(*values, *[0.0] * (7 - len(values)))))

    def stream(self, north_m: float = 0.0) -> None:
        """One setpoint, north of where red's frame begins."""
        self.send(
            mavlink.MAVLink_set_position_target_local_ned_message(
                0, 1, 1, mavlink.MAV_FRAME_LOCAL_NED, 0b101111111000, north_m, 0, -6.0, 0, 0, 0, 0, 0, 0, 0, 0
            )
        )

    def offboard(self) -> list[Any]:
        self.stream()
        self.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 6, 0)
        return self.fly(0.1, self.stream)


@pytest.fixture
def station(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Station]:
    """Its parameter: what the scenario says more about red."""
    path = tmp_path / "scenario.toml"
    path.write_text(PLAIN.replace(RED_ENDS, RED_ENDS + request.param, 1), encoding="utf-8")
    one = Station(path)
    yield one
    one.close()


def named(messages: list[Any], name: str, system: int = 1, component: int = 1) -> list[Any]:
    return [
        m for m in messages if m.get_type() == name and (m.get_srcSystem(), m.get_srcComponent()) == (system, component)
    ]


def event(text: str) -> str:
    return f"\n[[vehicles.red.events]]\n{text}\n"


def with_events(*texts: str) -> Any:
    return pytest.mark.parametrize("station", ["".join(map(event, texts))], ids=[""], indirect=True)


def with_red(text: str) -> Any:
    return pytest.mark.parametrize("station", [text], ids=[""], indirect=True)


def modes(messages: list[Any]) -> list[int]:
    return [m.custom_mode for m in named(messages, "HEARTBEAT")]


def current_modes(messages: list[Any]) -> int:
    """How many; pymavlink does not know them."""
    return sum(m.get_type() == f"UNKNOWN_{CurrentMode.msgid}" for m in messages)


@with_events('after = "offboard"\nat_s = 1.0\nkind = "estimate_jump"\nned_m = [2.0, 0.0, 0.0]')
def test_an_estimate_jumps_and_the_offboard_setpoint_moves_the_real_drone(station: Station) -> None:
    station.fly(1.5)
    station.offboard()
    heard = station.fly(0.7, station.stream)
    before = station.pilot.drone.position
    assert named(heard, "ODOMETRY")[-1].reset_counter == 0
    heard = station.fly(0.4, station.stream)
    local = [m.x for m in named(heard, "LOCAL_POSITION_NED")]
    assert max(b - a for a, b in pairwise(local)) == pytest.approx(2.0, abs=0.1)
    assert max(abs(m.vx) for m in named(heard, "LOCAL_POSITION_NED")[:3]) < 0.1
    assert named(heard, "ODOMETRY")[-1].reset_counter == 1
    station.fly(8.0, station.stream)
    assert station.pilot.drone.position.north - before.north == pytest.approx(-2.0, abs=0.2)


@with_events('at_s = 1.0\nkind = "estimate_jump"\nned_m = [0.0, 3.0, 1.0]')
def test_the_autopilots_own_hold_jumps_with_its_estimate(station: Station) -> None:
    before = station.pilot.drone.position
    station.fly(6.0)
    assert station.pilot.resets == 1
    assert station.pilot.drone.position.minus(before).norm < 0.15


@with_events('at_s = 1.0\nkind = "gps_lost"\nfor_s = 3.0')
def test_gps_is_lost_and_back(station: Station) -> None:
    assert named(station.fly(0.5), "GPS_RAW_INT")[-1].fix_type == 3
    heard = station.fly(2.5)
    raw = named(heard, "GPS_RAW_INT")[-1]
    assert (raw.fix_type, raw.h_acc, raw.v_acc) == (0, 100_000, 100_000)
    assert not named(heard, "SYS_STATUS")[-1].onboard_control_sensors_health & 32
    assert named(heard, "ESTIMATOR_STATUS")[-1].pos_horiz_accuracy > 0.9
    heard = station.fly(2.0)
    assert named(heard, "GPS_RAW_INT")[-1].fix_type == 3
    assert named(heard, "SYS_STATUS")[-1].onboard_control_sensors_health & 32


@with_red('noise = "px4-sih"\n' + event('at_s = 0.0\nkind = "gps_lost"'))
def test_without_gps_px4_says_little_for_5_s_and_then_lands(station: Station) -> None:
    """Its own accuracy is still below a metre after 3 s; only its receiver says at once that there is no fix."""
    heard = station.fly(3.0)
    assert 0.6 < named(heard, "ESTIMATOR_STATUS")[-1].pos_horiz_accuracy < 0.9
    assert named(heard, "GPS_RAW_INT")[-1].fix_type == 0
    station.fly(1.9)
    assert station.pilot.mode is FlightMode.LOITER
    heard = station.fly(0.5)
    assert station.pilot.mode is FlightMode.LAND
    assert any("position lost" in m.text for m in named(heard, "STATUSTEXT"))


@with_red('noise = "px4-sih"\n')
def test_px4s_simulation_states_what_it_states(station: Station) -> None:
    heard = station.fly(2.0)
    estimator, raw, odometry = (named(heard, name)[-1] for name in ("ESTIMATOR_STATUS", "GPS_RAW_INT", "ODOMETRY"))
    assert estimator.pos_horiz_accuracy == pytest.approx(0.29) and estimator.pos_vert_accuracy == pytest.approx(0.29)
    assert (raw.h_acc, raw.v_acc, raw.vel_acc) == (900, 1780, 400)
    assert odometry.velocity_covariance[0] + odometry.velocity_covariance[6] == pytest.approx(0.13**2, rel=1e-5)
    speeds = [Ned(m.vx, m.vy, m.vz).norm for m in named(heard, "LOCAL_POSITION_NED")]
    assert max(speeds) > 0.1


@pytest.mark.parametrize(
    ("station", "mode"),
    [
        (event(f'after = "offboard"\nat_s = 1.0\nkind = "mode"\nmode = "{told}"'), mode)
        for told, mode in (
            ("HOLD", FlightMode.LOITER),
            ("LAND", FlightMode.LAND),
            ("RTL", FlightMode.RTL),
            ("POSCTL", FlightMode.POSCTL),
            ("ALTCTL", FlightMode.ALTCTL),
        )
    ],
    ids=lambda value: value.name if isinstance(value, FlightMode) else "",
    indirect=["station"],
)
def test_another_station_takes_the_drone_for_good(station: Station, mode: FlightMode) -> None:
    station.fly(0.5)
    assert modes(station.offboard())[-1] == FlightMode.OFFBOARD.custom_mode
    assert mode.custom_mode in modes(station.fly(3.0, station.stream))
    assert station.pilot.mode is mode


@pytest.mark.parametrize(
    ("station", "words"),
    [
        (event('after = "offboard"\nat_s = 1.0\nkind = "disarm"'), "Disarmed"),
        (event('after = "offboard"\nat_s = 1.0\nkind = "kill"'), "Kill"),
    ],
    ids=["disarm", "kill"],
    indirect=["station"],
)
def test_disarmed_in_the_air_it_falls_and_px4_calls_it_landed(station: Station, words: str) -> None:
    station.offboard()
    station.fly(0.7, station.stream)
    height_m = station.pilot.height_m
    heard = station.fly(0.6, station.stream)
    assert any(words in m.text for m in named(heard, "STATUSTEXT"))
    assert not named(heard, "HEARTBEAT")[-1].base_mode & 128
    assert 0.1 < station.pilot.height_m < height_m - 0.3
    assert named(heard, "EXTENDED_SYS_STATE")[-1].landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND


@with_events('after = "move"\nat_s = 0.5\nkind = "restart"\nfor_s = 2.0')
def test_the_autopilot_restarts_in_flight(station: Station) -> None:
    station.fly(3.0)
    station.offboard()
    station.fly(1.0, station.stream)
    assert station.pilot.armed

    def north() -> None:
        station.stream(1.0)

    station.fly(0.4, north)
    assert station.pilot.armed
    station.fly(0.3, north)
    station.command(mavlink.MAV_CMD_NAV_LAND)
    assert station.fly(1.7, north) == []
    heard = station.fly(3.0, north)
    assert named(heard, "ATTITUDE")[0].time_boot_ms < 200
    beats = named(heard, "HEARTBEAT")
    assert beats[0].custom_mode == 0 and beats[-1].custom_mode == FlightMode.LOITER.custom_mode
    assert not any(beat.base_mode & 128 for beat in beats)
    assert named(heard, "EXTENDED_SYS_STATE")[-1].landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND
    # Its own frame begins where it fell.
    local = named(heard, "LOCAL_POSITION_NED")[-1]
    assert Ned(local.x, local.y, local.z).norm < 0.1


@with_events('after = "offboard"\nat_s = 1.0\nkind = "link_cut"\nfor_s = 3.0')
def test_after_a_link_cut_px4_goes_back_to_offboard_by_itself(station: Station) -> None:
    """What was commanded last is still Offboard: whoever goes on streaming is flown again."""
    station.offboard()
    station.fly(0.95, station.stream)
    assert station.fly(2.9, station.stream) == []
    assert station.pilot.mode is FlightMode.LOITER and station.pilot.failsafe is not None
    heard = station.fly(1.0, station.stream)
    assert station.pilot.mode is FlightMode.OFFBOARD
    assert any("cleared" in m.text for m in named(heard, "STATUSTEXT"))


@with_events('after = "offboard"\nat_s = 1.0\nkind = "link_cut"\nfor_s = 3.0')
def test_after_a_link_cut_without_setpoints_it_stays_in_hold(station: Station) -> None:
    station.offboard()
    station.fly(0.95, station.stream)
    station.fly(4.0)
    assert station.pilot.mode is FlightMode.LOITER
    station.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 4, 3)
    station.fly(1.0, station.stream)
    # Hold commanded: streaming alone brings nothing back.
    station.fly(1.0, station.stream)
    assert station.pilot.mode is FlightMode.LOITER and station.pilot.failsafe is None


@with_red("link = { mode_at_once = false }\n" + event('at_s = 1.0\nkind = "mode"\nmode = "LAND"'))
def test_the_mode_is_told_with_the_heartbeat_and_sooner_when_asked(station: Station) -> None:
    station.fly(0.5)
    assert current_modes(station.fly(6.0)) == 3
    for kind in (mavlink.MAVLINK_MSG_ID_HEARTBEAT, CurrentMode.msgid, mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE):
        station.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, kind, 100_000)
    station.fly(0.2)
    heard = station.fly(2.0)
    assert len(named(heard, "HEARTBEAT")) == pytest.approx(20, abs=1)
    assert len(named(heard, "EXTENDED_SYS_STATE")) == pytest.approx(20, abs=1)
    assert current_modes(heard) == pytest.approx(20, abs=1)


@with_red("link = { mode_at_once = false }\n" + event('at_s = 0.3\nkind = "mode"\nmode = "LAND"'))
def test_a_change_of_mode_waits_for_the_heartbeat(station: Station) -> None:
    told = FlightMode.LAND.custom_mode
    delays = [tick * TICK_S - 0.3 for tick in range(100) if told in modes(station.fly(TICK_S))]
    assert delays and 0.0 <= delays[0] <= 1.0
    assert len(delays) <= 2


def test_current_mode_is_what_mavlink_says() -> None:
    packed = CurrentMode(FlightMode.LOITER.custom_mode, FlightMode.OFFBOARD.custom_mode, 0).pack(
        mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    )
    assert packed[7:10] == (436).to_bytes(3, "little")
    # MAVLink 2 leaves trailing zeros out: custom_mode, intended_custom_mode, no standard mode.
    assert packed[1] == 7 and packed[10:17] == bytes([0, 0, 4, 3, 0, 0, 6])


@with_red("link = { rate_hz_max = 4.0 }\n")
def test_telemetry_may_be_slow_whatever_is_asked_for(station: Station) -> None:
    station.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED, 20_000)
    heard = station.fly(5.0)
    (ack,) = named(heard, "COMMAND_ACK")
    assert ack.result == mavlink.MAV_RESULT_ACCEPTED
    for name in ("LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "ATTITUDE"):
        assert len(named(heard, name)) == pytest.approx(20, abs=1)


@with_red("link = { loss = 0.5, delay_ms = 300 }\n")
def test_packets_are_lost_and_late_both_ways(station: Station) -> None:
    heard = station.fly(4.0)
    assert 70 < len(named(heard, "ATTITUDE")) < 115
    answered, delays = 0, []
    for _ in range(40):
        station.send(mavlink.MAVLink_param_request_read_message(1, 1, b"COM_OF_LOSS_T", -1))
        for tick in range(50):
            if named(station.fly(TICK_S), "PARAM_VALUE"):
                answered += 1
                delays.append(tick * TICK_S)
    assert 3 <= answered <= 20  # a quarter of the asked
    assert min(delays) == pytest.approx(0.6, abs=0.05)


@with_events('at_s = 0.5\nkind = "link"\nloss = 1.0', 'at_s = 1.5\nkind = "link"')
def test_a_link_worsens_and_mends(station: Station) -> None:
    assert station.fly(0.45)
    station.fly(0.1)
    assert station.fly(0.9) == []
    assert station.fly(0.5)


@with_events('kind = "component"', 'kind = "component"\ncomponent = 191\ntype = 18\nautopilot = 8')
def test_a_gimbal_that_fills_in_its_autopilot_field(station: Station) -> None:
    heard = station.fly(5.0)
    gimbal = named(heard, "HEARTBEAT", component=154)
    assert len(gimbal) == pytest.approx(5, abs=1)
    assert {(m.autopilot, m.type, m.custom_mode) for m in gimbal} == {(3, 26, 0)}
    assert {(m.autopilot, m.type) for m in named(heard, "HEARTBEAT", component=191)} == {(8, 18)}


@with_events('at_s = 1.0\nkind = "second_autopilot"\nsystem_id = 9')
def test_a_second_autopilot_on_the_port(station: Station) -> None:
    assert not named(station.fly(0.9), "ATTITUDE", system=9)
    heard = station.fly(2.0)
    for name in ("HEARTBEAT", "ATTITUDE", "GLOBAL_POSITION_INT"):
        assert named(heard, name, system=9) and named(heard, name)


@with_events(r'kind = "text"' + "\n" + r'text = "\u001b[2Jhello\u0007"' + "\nseverity = 2")
def test_text_with_escape_codes_goes_out_as_it_is(station: Station) -> None:
    (text,) = named(station.fly(0.5), "STATUSTEXT")
    assert (text.text, text.severity) == ("\x1b[2Jhello\x07", 2)


@with_red('battery = "unknown"\nrangefinder = true\nlink = { without = ["ODOMETRY", "EXTENDED_SYS_STATE"] }\n')
def test_what_is_unknown_or_not_there(station: Station) -> None:
    heard = station.fly(3.0)
    assert {m.battery_remaining for m in named(heard, "SYS_STATUS") + named(heard, "BATTERY_STATUS")} == {-1}
    assert named(heard, "DISTANCE_SENSOR")[-1].current_distance == pytest.approx(600, abs=10)
    assert named(heard, "HOME_POSITION")
    assert not named(heard, "ODOMETRY") and not named(heard, "EXTENDED_SYS_STATE")


@with_events('at_s = 1.0\nkind = "battery"\nlevel = 0.2', 'at_s = 2.0\nkind = "battery"\nlevel = "unknown"')
def test_the_battery_changes(station: Station) -> None:
    assert {m.battery_remaining for m in named(station.fly(0.9), "SYS_STATUS")} <= {99, 100}
    assert named(station.fly(1.0), "SYS_STATUS")[-1].battery_remaining == 20
    assert named(station.fly(1.0), "SYS_STATUS")[-1].battery_remaining == -1


@with_red("")
def test_without_any_of_it_nothing_is_new(station: Station) -> None:
    heard = station.fly(3.0)
    assert {(m.get_srcSystem(), m.get_srcComponent()) for m in heard if not current_modes([m])} == {(1, 1)}
    assert not named(heard, "DISTANCE_SENSOR")
    assert {m.reset_counter for m in named(heard, "ODOMETRY")} == {0}
    assert math.isnan(named(heard, "ODOMETRY")[-1].velocity_covariance[0])


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (event('kind = "teleport"'), "vehicles.red.events.0"),
        (event('kind = "estimate_jump"'), "ned_m: this key is required"),
        (event('kind = "estimate_jump"\nned_m = [1.0, 2.0]'), "ned_m"),
        (event('kind = "gps_lost"\nfor_s = 0.0'), "for_s"),
        (event('kind = "restart"\nlong = 1.0'), "long: there is no such key"),
        (event('kind = "mode"\nmode = "STUNT"'), "mode"),
        (event('kind = "kill"\nafter = "lunch"'), "after"),
        (event('kind = "battery"\nlevel = 2.0'), "level"),
        ("link = { loss = 1.0 }\n", "vehicles.red.link.loss"),
        ('noise = "loud"\n', "vehicles.red.noise"),
        ('battery = "full"\n', "vehicles.red.battery"),
    ],
)
def test_every_mistake_is_one_sentence(tmp_path: Path, text: str, reason: str) -> None:
    path = tmp_path / "scenario.toml"
    path.write_text(PLAIN.replace(RED_ENDS, RED_ENDS + text, 1), encoding="utf-8")
    with pytest.raises(ScenarioError) as caught:
        load_scenario(path)
    assert reason in str(caught.value) and "\n" not in str(caught.value)


def test_a_message_that_is_never_sent_cannot_be_left_out(tmp_path: Path) -> None:
    path = tmp_path / "scenario.toml"
    path.write_text(PLAIN.replace(RED_ENDS, RED_ENDS + 'link = { without = ["ODOMETER"] }\n', 1), encoding="utf-8")
    with pytest.raises(ValueError, match=r"vehicles\.red\.link\.without: ODOMETER is no message that it sends"):
        Fleet(load_scenario(path), free_udp_block(3))
