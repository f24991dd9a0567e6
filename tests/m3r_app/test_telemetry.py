"""Latest-value slots and their snapshot: unknown and stale are never a value (X6)."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from m3r_app.vehicle.mavsdk_telemetry import HEALTH_CHECKS, RC_RECEIVER, Reception
from m3r_app.vehicle.telemetry import ACCURACY_AGE_S, BATTERY_AGE_S, MODE_AGE_S, NEVER_HEARD, Accuracy, Health, Slots
from safety.vocabulary import FlightMode, Geodetic, Ned

PLACE = Geodetic(47.0, 8.0, 500.0)


class Plugins:
    """Stands for MAVSDK's plugins: keeps what is subscribed, by name."""

    def __init__(self) -> None:
        self.subscribed: dict[str, Any] = {}

    def subscribe_message(self, name: str, callback: Any) -> None:
        self.subscribed[name] = callback

    def __getattr__(self, name: str) -> Any:
        def subscribe(callback: Any) -> None:
            self.subscribed[name.removeprefix("subscribe_")] = callback

        return subscribe


class Heard:
    """A reception with a clock to turn, told by hand what MAVSDK would tell it."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.positions = 0
        self.texts: list[tuple[str, str]] = []
        self._plugins = Plugins()
        self.reception = Reception(
            lambda: self.now_s,
            self._plugins,
            self._plugins,
            self._plugins,
            self._position,
            lambda *text: self.texts.append(text),
        )

    def _position(self) -> None:
        self.positions += 1

    def tell(self, kind: str, value: Any = None, **fields: Any) -> None:
        self._plugins.subscribed[kind](SimpleNamespace(**fields) if fields else value, None)

    def tell_everything(self) -> None:
        self.tell("position", latitude_deg=47.0, longitude_deg=8.0, absolute_altitude_m=500.0)
        self.tell_local()
        self.tell("attitude_euler", yaw_deg=190.0)
        self.tell("attitude_angular_velocity_body", yaw_rad_s=math.pi / 18)
        self.tell("raw_gps", horizontal_uncertainty_m=0.3, vertical_uncertainty_m=0.6)
        self.tell("flight_mode", SimpleNamespace(name="OFFBOARD"))
        self.message("HEARTBEAT", autopilot=12, base_mode=0b10000001, custom_mode=6 << 16)
        self.message("EXTENDED_SYS_STATE", landed_state=2)
        self.tell("health", SimpleNamespace(**dict.fromkeys(HEALTH_CHECKS, True)))
        self.tell("battery", remaining_percent=42.0)
        self.message("ESTIMATOR_STATUS", pos_horiz_accuracy=0.5, pos_vert_accuracy=0.4)
        self.message("SYS_STATUS", onboard_control_sensors_present=RC_RECEIVER | 1)

    def message(self, kind: str, *, component: int = 1, **fields: float) -> None:
        """A MAVLink message as it is, from a component of the vehicle."""
        self.tell(kind, component_id=component, fields_json=json.dumps(fields))

    def tell_local(self, north: float = 1.0, velocity_east: float = 0.2) -> None:
        position = SimpleNamespace(north_m=north, east_m=2.0, down_m=-3.0)
        velocity = SimpleNamespace(north_m_s=0.1, east_m_s=velocity_east, down_m_s=0.3)
        self.tell("position_velocity_ned", position=position, velocity=velocity)


@pytest.mark.requirement("X6")
def test_before_anything_is_heard_everything_is_unknown() -> None:
    assert repr(Slots().snapshot(100.0)) == repr(NEVER_HEARD).replace("no telemetry", "no health report")
    assert NEVER_HEARD.age_s(0.0) == NEVER_HEARD.link_age_s(0.0) == math.inf


def test_everything_heard_is_in_the_snapshot() -> None:
    heard = Heard()
    heard.tell_everything()
    telemetry = heard.reception.slots.snapshot(heard.now_s)
    assert (telemetry.at_s, telemetry.heard_at_s, telemetry.mode_at_s) == (100.0, 100.0, 100.0)
    assert (telemetry.geodetic, telemetry.local, telemetry.velocity) == (PLACE, Ned(1, 2, -3), Ned(0.1, 0.2, 0.3))
    assert telemetry.yaw_deg == pytest.approx(-170.0)
    assert telemetry.yaw_rate_deg_s == pytest.approx(10.0)
    assert (telemetry.sigma_h_m, telemetry.sigma_v_m) == (0.5, 0.4)
    assert (telemetry.flight_mode, telemetry.armed, telemetry.in_air) == ("OFFBOARD", True, True)
    assert (telemetry.healthy, telemetry.unhealthy, telemetry.battery) == (True, (), 0.42)
    assert telemetry.rc_present is True
    assert heard.positions == 1


@pytest.mark.parametrize("oldest", ["position", "position_velocity_ned", "attitude_euler"])
def test_the_age_is_that_of_the_oldest_of_positions_and_attitude(oldest: str) -> None:
    heard = Heard()
    heard.tell_everything()
    heard.now_s = 107.0
    for kind in {"position", "position_velocity_ned", "attitude_euler"} - {oldest}:
        if kind == "position_velocity_ned":
            heard.tell_local()
        elif kind == "position":
            heard.tell(kind, latitude_deg=47.0, longitude_deg=8.0, absolute_altitude_m=500.0)
        else:
            heard.tell(kind, yaw_deg=0.0)
    telemetry = heard.reception.slots.snapshot(107.0)
    assert (telemetry.age_s(107.0), telemetry.link_age_s(107.0)) == (7.0, 0.0)


@pytest.mark.requirement("X6")
def test_what_is_stale_is_unknown_from_its_limit_on() -> None:
    heard = Heard()
    heard.tell_everything()
    slots = heard.reception.slots
    at_limit, beyond = slots.snapshot(100.0 + MODE_AGE_S), slots.snapshot(100.0 + MODE_AGE_S + 0.01)
    assert (at_limit.flight_mode, at_limit.armed, at_limit.in_air, at_limit.healthy) == ("OFFBOARD", True, True, True)
    assert (beyond.flight_mode, beyond.armed, beyond.in_air, beyond.healthy) == ("UNKNOWN", None, None, False)
    assert beyond.rc_present is None
    assert beyond.unhealthy
    assert slots.snapshot(100.0 + ACCURACY_AGE_S).sigma_h_m == 0.5
    assert math.isnan(slots.snapshot(100.0 + ACCURACY_AGE_S + 0.01).sigma_h_m)
    assert slots.snapshot(100.0 + BATTERY_AGE_S).battery == 0.42
    assert slots.snapshot(100.0 + BATTERY_AGE_S + 0.01).battery is None


@pytest.mark.requirement("X6")
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_values_that_are_not_finite_are_dropped_so_that_the_old_ones_age(bad: float) -> None:
    heard = Heard()
    heard.tell_everything()
    heard.now_s = 101.0
    heard.tell("position", latitude_deg=bad, longitude_deg=8.0, absolute_altitude_m=500.0)
    heard.tell("position", latitude_deg=47.0, longitude_deg=8.0, absolute_altitude_m=bad)
    heard.tell_local(north=bad)
    heard.tell_local(velocity_east=bad)
    heard.tell("attitude_euler", yaw_deg=bad)
    heard.tell("attitude_angular_velocity_body", yaw_rad_s=bad)
    heard.tell("battery", remaining_percent=bad)
    telemetry = heard.reception.slots.snapshot(101.0)
    assert (telemetry.geodetic, telemetry.local, telemetry.battery) == (PLACE, Ned(1, 2, -3), 0.42)
    assert telemetry.age_s(101.0) == telemetry.link_age_s(101.0) == 1.0
    assert heard.positions == 1


@pytest.mark.parametrize(
    ("estimator", "receiver", "believed"),
    [
        (0.5, 0.3, 0.5), (0.3, 0.5, 0.3), (math.nan, 0.3, 0.3), (0.5, math.nan, 0.5), (0.0, 0.3, 0.3),
        (0.29, 9.9, 0.29), (0.29, 10.0, 10.0), (0.29, 100.0, 100.0), (50.0, 0.9, 50.0),
        (0.5, 0.0, 0.5), (math.inf, 0.3, 0.3), (-1.0, 0.3, 0.3), (math.nan, math.nan, math.nan), (0.0, 0.0, math.nan),
    ],
)  # fmt: skip
def test_accuracy_is_the_estimators_else_the_receivers_and_zero_states_nothing(
    estimator: float, receiver: float, believed: float
) -> None:
    slots = Slots()
    slots.estimator.put(Accuracy(estimator, 1.0), 100.0)
    slots.receiver.put(Accuracy(receiver, 2.0), 100.0)
    telemetry = slots.snapshot(100.0)
    assert telemetry.sigma_h_m == pytest.approx(believed, nan_ok=True)
    assert telemetry.sigma_v_m == 1.0


@pytest.mark.requirement("X6")
@pytest.mark.parametrize(
    "text", ["", "{", "[]", "null", "{}", '{"pos_horiz_accuracy": "x"}', '{"pos_horiz_accuracy": null}', '{"a": nan}']
)
def test_a_message_that_cannot_be_read_states_nothing_and_raises_nothing(text: str) -> None:
    heard = Heard()
    heard.tell("ESTIMATOR_STATUS", fields_json=text)
    heard.tell("SYS_STATUS", fields_json=text)
    telemetry = heard.reception.slots.snapshot(100.0)
    assert math.isnan(telemetry.sigma_h_m)
    assert telemetry.rc_present is None


@pytest.mark.parametrize("field", HEALTH_CHECKS)
def test_each_failing_check_is_named(field: str) -> None:
    heard = Heard()
    heard.tell("health", SimpleNamespace(**(dict.fromkeys(HEALTH_CHECKS, True) | {field: False})))
    telemetry = heard.reception.slots.snapshot(100.0)
    assert not telemetry.healthy
    assert telemetry.unhealthy == (HEALTH_CHECKS[field],)


def test_healthy_needs_every_check() -> None:
    slots = Slots()
    slots.health.put(Health({"a": True, "b": False, "c": False}), 100.0)
    assert slots.snapshot(100.0).unhealthy == ("b", "c")
    slots.health.put(Health({"a": True, "b": True}), 100.0)
    assert slots.snapshot(100.0).healthy


@pytest.mark.parametrize(("percent", "fraction"), [(0.0, 0.0), (100.0, 1.0), (101.0, None), (-1.0, None)])
def test_battery_is_a_fraction_or_unknown(percent: float, fraction: float | None) -> None:
    heard = Heard()
    heard.tell("battery", remaining_percent=percent)
    assert heard.reception.slots.snapshot(100.0).battery == fraction


def test_status_texts_are_passed_on_with_their_severity() -> None:
    heard = Heard()
    heard.tell("status_text", type=SimpleNamespace(name="CRITICAL"), text="Arming denied")
    assert heard.texts == [("CRITICAL", "Arming denied")]


def test_only_the_autopilots_own_component_is_believed() -> None:
    heard = Heard()
    heard.tell_everything()
    for component in (154, 100, 0, 255):
        heard.message("HEARTBEAT", component=component, autopilot=3, base_mode=0, custom_mode=4 << 16 | 6 << 24)
        heard.message("HEARTBEAT", component=component, autopilot=12, base_mode=0, custom_mode=4 << 16 | 6 << 24)
        heard.message("CURRENT_MODE", component=component, custom_mode=4 << 16 | 6 << 24)
        heard.message("EXTENDED_SYS_STATE", component=component, landed_state=1)
        heard.message("SYSTEM_TIME", component=component, time_boot_ms=1)
    heard.message("HEARTBEAT", autopilot=8, base_mode=0, custom_mode=4 << 16 | 6 << 24)
    heard.tell("flight_mode", SimpleNamespace(name="UNKNOWN"))  # what MAVSDK makes of it
    telemetry = heard.reception.slots.snapshot(100.0)
    assert (telemetry.flight_mode, telemetry.armed, telemetry.in_air, telemetry.restarts) == ("OFFBOARD", True, True, 0)


@pytest.mark.parametrize(
    ("main", "sub", "name"),
    [
        (4, 3, "HOLD"), (4, 2, "TAKEOFF"), (4, 4, "MISSION"), (4, 5, "RETURN_TO_LAUNCH"), (4, 6, "LAND"), (4, 9, "LAND"),
        (3, 0, "POSCTL"), (2, 0, "ALTCTL"), (6, 0, "OFFBOARD"), (7, 0, "STABILIZED"), (4, 7, "OTHER"), (99, 0, "OTHER"),
    ],
)  # fmt: skip
def test_every_mode_of_px4_has_a_name(main: int, sub: int, name: str) -> None:
    """An unknown mode is somebody's; only silence is UNKNOWN."""
    for kind in ("HEARTBEAT", "CURRENT_MODE"):
        heard = Heard()
        heard.tell_everything()
        heard.message(kind, autopilot=12, base_mode=128, custom_mode=main << 16 | sub << 24)
        assert heard.reception.slots.snapshot(100.0).flight_mode == name


@pytest.mark.parametrize(("named", "mode"), [("LAND", "LAND"), ("UNKNOWN", "UNKNOWN"), ("THROW", "OTHER")])
def test_the_modes_of_other_autopilots_are_those_that_mavsdk_takes_them_for(named: str, mode: str) -> None:
    """One that has no name here is somebody's, too."""
    heard = Heard()
    heard.message("HEARTBEAT", autopilot=3, base_mode=128, custom_mode=18)
    heard.tell("flight_mode", SimpleNamespace(name=named))
    assert heard.reception.slots.snapshot(100.0).flight_mode is FlightMode(mode)


@pytest.mark.parametrize(("state", "in_air"), [(0, None), (1, False), (2, True), (3, True), (4, True), (9, None)])
def test_only_a_stated_landing_is_one(state: int, in_air: bool | None) -> None:
    heard = Heard()
    heard.message("EXTENDED_SYS_STATE", landed_state=state)
    assert heard.reception.slots.snapshot(100.0).in_air is in_air


@pytest.mark.parametrize(
    ("before", "after", "restarts"), [(5000, 5500, 0), (5000, 4500, 0), (5000, 300, 1), (5000, 0, 1)]
)
def test_the_time_since_boot_tells_a_restart(before: int, after: int, restarts: int) -> None:
    heard = Heard()
    for since_boot_ms in (before, after, after + 500):
        heard.message("SYSTEM_TIME", time_boot_ms=since_boot_ms)
    assert heard.reception.slots.snapshot(100.0).restarts == restarts


@pytest.mark.requirement("X6")
@pytest.mark.parametrize(
    ("level_m", "height_m", "larger_m"),
    [(0.3, 0.5, 0.5), (0.5, 0.3, 0.5), (math.nan, 0.3, math.nan), (0.3, math.nan, math.nan)],
)
def test_the_larger_accuracy_is_unknown_where_either_is(level_m: float, height_m: float, larger_m: float) -> None:
    told = replace(NEVER_HEARD, sigma_h_m=level_m, sigma_v_m=height_m)
    assert told.sigma_m == pytest.approx(larger_m, nan_ok=True)
