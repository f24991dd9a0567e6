"""The simulated drones, flown by the real MAVSDK client over UDP."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager
from typing import Any

import pytest
from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync, ActionError
from mavsdk.asyncio.plugins.failure import FailureAsync, FailureError, FailureType, FailureUnit
from mavsdk.asyncio.plugins.mission import MissionAsync
from mavsdk.asyncio.plugins.offboard import OffboardAsync, OffboardError, PositionNedYaw, VelocityNedYaw
from mavsdk.asyncio.plugins.param import ParamAsync, ParamError
from mavsdk.asyncio.plugins.telemetry import FlightMode, TelemetryAsync

from m3r_app.environment.scenario import SHIPPED
from tests.m3r_app.sim.fleet_process import FleetProcess

GROUND = 'state = "ground"\nparams = { MPC_LAND_SPEED = 1.4, COM_DISARM_LAND = 0.5 }'
HOLD = 'state = "hold"\nheight_m = 6.0\nheading_deg = 180.0'
SAFE = "params = { COM_OF_LOSS_T = 0.5, COM_OBL_RC_ACT = 5 }"
MISSION = 'state = "mission"\nheight_m = 10.0\nwaypoints = [[0.0, 60.0, 10.0], [20.0, 60.0, 10.0]]'
DRONES = {
    "lifter": GROUND,
    "stepper": HOLD,
    "loser": f"{HOLD}\n{SAFE}",
    "asked": HOLD,
    "failing": HOLD,
    "patrol": MISSION,
}
"""Each test has a drone of its own in one fleet: calm, flat."""


@pytest.fixture(scope="module")
def urls(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    """Where to listen for each drone."""
    plain = (SHIPPED / "plain.toml").read_text(encoding="utf-8")
    text = plain[: plain.index("[vehicles.red]")]
    for i, (name, start) in enumerate(DRONES.items()):
        text += f"\n[vehicles.{name}]\nnorth_m = 0.0\neast_m = {20.0 * i}\n{start}\n"
    path = tmp_path_factory.mktemp("fleet") / "fleet.toml"
    path.write_text(text)
    with FleetProcess(path, len(DRONES)) as fleet:
        yield fleet.vehicles


class Client:
    """One drone's latest telemetry and its plugins."""

    def __init__(self, system: Any) -> None:
        self.action, self.offboard, self.param = ActionAsync(system), OffboardAsync(system), ParamAsync(system)
        self.failure, self.mission, self.telemetry = FailureAsync(system), MissionAsync(system), TelemetryAsync(system)
        self.latest: dict[str, Any] = {}
        self.texts: list[str] = []
        self.counts: dict[str, int] = {}
        self._tasks: list[asyncio.Task[None]] = []

    def watch(self, *names: str) -> None:
        for name in names:
            self._tasks.append(asyncio.ensure_future(self._drain(name)))

    async def _drain(self, name: str) -> None:
        async for value in getattr(self.telemetry, f"subscribe_{name}")():
            if name == "status_text":
                self.texts.append(value.text)
            self.latest[name] = value
            self.counts[name] = self.counts.get(name, 0) + 1

    async def until(self, condition: Callable[[], bool], what: str, within_s: float = 10.0) -> float:
        """Poll until the condition holds; the seconds it took."""
        loop = asyncio.get_running_loop()
        start = loop.time()
        while not condition():
            assert loop.time() < start + within_s, f"not within {within_s} s: {what}; {self.latest}, {self.texts}"
            await asyncio.sleep(0.01)
        return loop.time() - start

    async def mode(self, mode: FlightMode, within_s: float = 10.0) -> float:
        return await self.until(lambda: self.latest.get("flight_mode") == mode, mode.name, within_s)

    @property
    def place(self) -> tuple[float, float, float]:
        position = self.latest["position_velocity_ned"].position
        return position.north_m, position.east_m, position.down_m

    @property
    def speed_m_s(self) -> float:
        velocity = self.latest["position_velocity_ned"].velocity
        return math.hypot(velocity.north_m_s, velocity.east_m_s, velocity.down_m_s)

    async def close(self) -> None:
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        for plugin in (self.action, self.offboard, self.param, self.failure, self.mission, self.telemetry):
            plugin.destroy()


@asynccontextmanager
async def client(url: str) -> AsyncIterator[Client]:
    configuration = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
    async with Mavsdk(configuration) as mavsdk:
        await mavsdk.add_any_connection(url)
        system = await mavsdk.first_autopilot(10.0)
        assert system is not None
        one = Client(system)
        try:
            one.watch("position_velocity_ned", "flight_mode", "armed", "in_air", "health_all_ok", "status_text")
            await one.until(lambda: "position_velocity_ned" in one.latest, "position")
            await one.until(lambda: "flight_mode" in one.latest, "flight mode")
            yield one
        finally:
            await one.close()


async def test_takes_off_holds_and_lands(urls: dict[str, str]) -> None:
    async with client(urls["lifter"]) as green:
        await green.until(lambda: bool(green.latest.get("health_all_ok")), "healthy")
        assert not green.latest["in_air"]
        ground_down = green.place[2]
        await green.action.set_takeoff_altitude(3.0)
        await green.action.arm()
        await green.action.takeoff()
        await green.mode(FlightMode.TAKEOFF)
        await green.mode(FlightMode.HOLD)
        assert green.latest["in_air"] and green.latest["armed"]
        await green.until(lambda: abs(ground_down - green.place[2] - 3.0) < 0.5 and green.speed_m_s < 0.1, "3 m up")
        with pytest.raises(ActionError):
            await green.action.disarm()
        await green.until(lambda: "Disarming denied: not landed" in green.texts, "the reason")
        await green.action.land()
        await green.mode(FlightMode.LAND)
        await green.until(lambda: not green.latest["in_air"], "landed", 20.0)
        await green.until(lambda: not green.latest["armed"], "disarmed by itself", 5.0)


async def test_flies_a_step_of_one_metre_in_offboard_like_px4_and_stops_in_hold(urls: dict[str, str]) -> None:
    async with client(urls["stepper"]) as red:
        await red.mode(FlightMode.HOLD)
        with pytest.raises(OffboardError):
            await red.offboard.start()
        start = red.place
        await red.offboard.set_position_ned(PositionNedYaw(*start, 180.0))
        # MAVSDK sends its setpoints at 20 Hz; the autopilot wants to have seen one.
        for _ in range(100):
            try:
                await red.offboard.start()
                break
            except OffboardError:
                await asyncio.sleep(0.02)
        await red.mode(FlightMode.OFFBOARD)
        await red.until(lambda: red.speed_m_s < 0.05, "still")
        start = red.place
        loop = asyncio.get_running_loop()
        before_s = loop.time()
        await red.offboard.set_position_ned(PositionNedYaw(start[0] + 1.0, start[1], start[2], 180.0))
        await red.until(lambda: red.place[0] - start[0] > 0.05, "0.05 m")
        early_s = loop.time() - before_s
        await red.until(lambda: red.place[0] - start[0] > 0.9, "0.9 m")
        late_s = loop.time() - before_s
        assert 0.2 < early_s < 0.8, early_s
        assert 1.4 < late_s < 3.5, late_s
        await red.until(lambda: abs(red.place[0] - start[0] - 1.0) < 0.1 and red.speed_m_s < 0.05, "arrived")
        await red.offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.5, 0.0, 180.0))
        await red.until(lambda: red.speed_m_s > 0.36, "0.36 m/s")
        await red.action.hold()
        told = red.place
        await red.mode(FlightMode.HOLD)
        await red.until(lambda: red.speed_m_s < 0.05, "stopped", 4.0)
        assert 0.1 < math.dist(red.place, told) < 0.5


async def test_lost_offboard_acts_as_its_parameter_says(urls: dict[str, str]) -> None:
    """COM_OBL_RC_ACT 5: Hold after COM_OF_LOSS_T; 0, PX4's default: return home, as there is no pilot."""
    async with client(urls["loser"]) as red:
        await enter_offboard(red)
    async with client(urls["loser"]) as red:
        await red.mode(FlightMode.HOLD)
        assert red.latest["in_air"]
        await red.param.set_param_int("COM_OBL_RC_ACT", 0)
        assert await red.param.get_param_int("COM_OBL_RC_ACT") == 0
        assert await red.param.get_param_float("COM_OF_LOSS_T") == 0.5
        await enter_offboard(red)
    async with client(urls["loser"]) as red:
        await red.mode(FlightMode.RETURN_TO_LAUNCH)


async def enter_offboard(one: Client) -> None:
    await one.offboard.set_position_ned(PositionNedYaw(*one.place, 180.0))
    for _ in range(100):
        try:
            await one.offboard.start()
            break
        except OffboardError:
            await asyncio.sleep(0.02)
    await one.mode(FlightMode.OFFBOARD)


async def test_parameters(urls: dict[str, str]) -> None:
    async with client(urls["asked"]) as blue:
        assert await blue.param.get_param_int("COM_OBL_RC_ACT") == 0
        assert await blue.param.get_param_float("COM_OF_LOSS_T") == 1.0
        everything = await blue.param.get_all_params()
        assert {p.name for p in everything.int_params} >= {"COM_RC_OVERRIDE", "NAV_DLL_ACT"}
        await blue.param.set_param_float("COM_OF_LOSS_T", 0.7)
        assert await blue.param.get_param_float("COM_OF_LOSS_T") == pytest.approx(0.7)
        await blue.param.set_param_int("NAV_DLL_ACT", -1)
        assert await blue.param.get_param_int("NAV_DLL_ACT") == -1
        with pytest.raises(ParamError):
            await blue.param.set_param_float("NO_SUCH_PARAM", 1.0)


async def test_resumes_its_mission_after_a_hold(urls: dict[str, str]) -> None:
    async with client(urls["patrol"]) as blue:
        await blue.mode(FlightMode.MISSION)
        await blue.until(lambda: blue.speed_m_s > 0.5, "flying")
        await blue.action.hold()
        await blue.mode(FlightMode.HOLD)
        await blue.until(lambda: blue.speed_m_s < 0.1, "stopped")
        await blue.mission.start_mission()
        await blue.mode(FlightMode.MISSION)
        await blue.until(lambda: blue.speed_m_s > 0.5, "flying again")


async def test_failures_are_injected_only_when_allowed(urls: dict[str, str]) -> None:
    async with client(urls["failing"]) as red:
        with pytest.raises(FailureError):
            await red.failure.inject(FailureUnit.SENSOR_GPS, FailureType.OFF, 0)
        await red.param.set_param_int("SYS_FAILURE_EN", 1)
    # MAVSDK reads the permission once, when its plugin is made.
    async with client(urls["failing"]) as red:
        await red.until(lambda: bool(red.latest.get("health_all_ok")), "healthy")
        before = red.place
        await red.failure.inject(FailureUnit.SENSOR_GPS, FailureType.WRONG, 0)
        await red.until(lambda: red.place[0] - before[0] > 4.0, "a jump", 1.0)
        await red.failure.inject(FailureUnit.SENSOR_GPS, FailureType.OK, 0)
        await red.failure.inject(FailureUnit.SENSOR_GPS, FailureType.OFF, 0)
        await red.until(lambda: not red.latest["health_all_ok"], "unhealthy")
        await red.mode(FlightMode.LAND, 15.0)
        assert any("position lost" in text for text in red.texts)
        heard: list[float] = []
        loop = asyncio.get_running_loop()
        await red.failure.inject(FailureUnit.SYSTEM_MAVLINK_SIGNAL, FailureType.OFF, 0)

        def silent() -> bool:
            now = loop.time()
            if red.counts or not heard:
                heard.append(now)
                red.counts.clear()
            return now - heard[-1] > 0.5

        await red.until(silent, "half a second without telemetry", 3.0)


async def test_telemetry_keeps_50_hz(urls: dict[str, str]) -> None:
    async with client(urls["stepper"]) as one:
        one.counts.clear()
        took_s = await one.until(lambda: one.counts.get("position_velocity_ned", 0) >= 100, "100 positions")
        assert took_s == pytest.approx(2.0, abs=0.4)
