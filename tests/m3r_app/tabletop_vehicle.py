"""A vehicle that lies on the table: what is commanded is written down and done at once, or when a test lets it be done."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace

from m3r_app.vehicle.adsb import Aircraft
from m3r_app.vehicle.interface import Vehicle, VehicleError
from m3r_app.vehicle.telemetry import NEVER_HEARD, Telemetry
from safety.vocabulary import FlightMode, Geodetic, Ned

READY = {"COM_OF_LOSS_T": 0.5, "COM_OBL_RC_ACT": 5.0, "COM_RC_OVERRIDE": 3.0}


def flying(place: Geodetic, local: Ned, at_s: float = 0.0) -> Telemetry:
    """Fit to be paired with, in Hold."""
    return replace(
        NEVER_HEARD, at_s=at_s, heard_at_s=at_s, geodetic=place, local=local, velocity=Ned(0.0, 0.0, 0.0), yaw_deg=0.0,
        yaw_rate_deg_s=0.0, sigma_h_m=0.1, sigma_v_m=0.1, flight_mode=FlightMode.HOLD, mode_at_s=at_s, armed=True,
        in_air=True, healthy=True, unhealthy=(), battery=0.9, rc_present=False, rate_hz=50.0,
    )  # fmt: skip


class TabletopVehicle:
    """`obeys`: clear it, and what is commanded from then on is not done until it is set. told: what it tells, at `clock`."""

    def __init__(self, colour: str, told: Telemetry = NEVER_HEARD, clock: Callable[[], float] = lambda: 0.0) -> None:
        self.colour = colour
        self.told = told
        self.commands: list[str] = []
        """Every command, in order."""
        self.setpoints: list[tuple[Ned, float]] = []
        self.obeys = asyncio.Event()
        self.obeys.set()
        self.refuses = ""
        """Why it refuses every command; nothing: it does not."""
        self._clock = clock
        self._listeners: list[Callable[[Telemetry], None]] = []

    async def _command(self, what: str, **becomes: object) -> None:
        self.commands.append(what)
        if self.refuses:
            raise VehicleError(f"{self.colour}: {what} was refused: {self.refuses}.")
        await self.obeys.wait()
        self.told = replace(self.told, **becomes)  # type: ignore[arg-type]

    # What is seen of it

    def telemetry(self) -> Telemetry:
        now_s = self._clock()
        return replace(self.told, at_s=now_s, heard_at_s=now_s, mode_at_s=now_s)

    def on_telemetry(self, listener: Callable[[Telemetry], None]) -> None:
        self._listeners.append(listener)

    def off_telemetry(self, listener: Callable[[Telemetry], None]) -> None:
        self._listeners.remove(listener)

    def tell(self) -> None:
        """One position."""
        for listener in tuple(self._listeners):
            listener(self.telemetry())

    def aircraft(self) -> tuple[Aircraft, ...]:
        return ()

    async def wait_for(self, condition: Callable[[Telemetry], bool], timeout_s: float, what: str) -> Telemetry:
        if not condition(self.telemetry()):
            raise VehicleError(f"{self.colour}: {what} did not happen within {timeout_s:g} s.")
        return self.telemetry()

    async def wait_ready(self, timeout_s: float = 10.0) -> Telemetry:
        return await self.wait_for(lambda t: math.isfinite(t.at_s), timeout_s, "a first report")

    async def wait_measured(self) -> None:
        return

    async def wait_settled(self, timeout_s: float) -> None:
        await self.wait_for(lambda t: t.flight_mode is FlightMode.HOLD, timeout_s, "coming to rest in Hold")

    async def play_tune(self) -> bool:
        self.commands.append("tune")
        return True

    async def parameters(self, names: Iterable[str]) -> Mapping[str, float | None]:
        return {name: READY.get(name) for name in names}

    async def set_parameter(self, name: str, value: float) -> None:
        self.commands.append(f"{name} = {value:g}")

    async def close(self) -> None:
        self._listeners.clear()

    # What it is commanded

    def here(self) -> tuple[Ned, float] | None:
        return (self.told.local, self.told.yaw_deg) if self.told.local is not None else None

    def set_position_ned(self, point: Ned, yaw_deg: float) -> None:
        self.setpoints.append((point, yaw_deg))

    async def enter_offboard(self) -> None:
        await self._command("offboard", flight_mode=FlightMode.OFFBOARD)

    async def end_setpoints(self) -> None:
        self.commands.append("end setpoints")

    async def leave_in_hold(self) -> None:
        await self._command("leave in hold", flight_mode=FlightMode.HOLD)

    async def resume_mission(self) -> None:
        await self._command("resume", flight_mode=FlightMode.MISSION)

    async def begin_landing(self) -> None:
        await self._command("begin landing", flight_mode=FlightMode.LAND)

    async def hold(self) -> None:
        await self._command("hold", flight_mode=FlightMode.HOLD)

    async def takeoff(self, metres: float) -> None:
        await self._command(f"take off {metres:g}", flight_mode=FlightMode.HOLD, in_air=True)

    async def land(self) -> None:
        await self._command("land", flight_mode=FlightMode.LAND, in_air=False)

    def hold_unless_taken_over(self, timeout_s: float) -> None:
        self.commands.append("guard's hold")


def as_vehicle(vehicle: TabletopVehicle) -> Vehicle:
    """Checked by mypy: it is one."""
    return vehicle
