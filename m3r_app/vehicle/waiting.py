"""What is waited for of a vehicle, whatever kind it is: conditions of its telemetry, each with a deadline."""

from __future__ import annotations

import asyncio
import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from contextlib import suppress

from m3r_app.vehicle.interface import VehicleError
from m3r_app.vehicle.telemetry import NO_HEALTH, Telemetry
from safety.vocabulary import FlightMode, Ned

RATE_WAIT_S = 4.0
SETTLED_M_S, SETTLED_M, SETTLED_S = 0.2, 0.5, 1.0
"""It rests at less than this speed, or if it moves less than this in this time: an estimate may be noisier than it moves."""
HEALTH_WAIT_S = 3.0
"""The home position, which health needs, comes every two seconds."""


class Waiting(ABC):
    """The waits of `interface.ObservedVehicle`. Whoever is one says what it tells, why it refused, and whether it is alone."""

    colour: str

    @abstractmethod
    def telemetry(self) -> Telemetry:
        """The latest of everything, now."""

    @abstractmethod
    def now_s(self) -> float:
        """The clock by which telemetry is stamped."""

    @abstractmethod
    def reason(self, since_s: float) -> str:
        """What the autopilot said in words since then, to be appended."""

    @abstractmethod
    def check_alone(self) -> None:
        """Raises VehicleError where it could be taken for another."""

    async def wait_for(self, condition: Callable[[Telemetry], bool], timeout_s: float, what: str) -> Telemetry:
        """The first telemetry that fulfils condition. Raises VehicleError naming `what` if none does in time."""
        deadline_s = asyncio.get_running_loop().time() + timeout_s
        asked_at_s = self.now_s()
        while not condition(telemetry := self.telemetry()):
            if asyncio.get_running_loop().time() > deadline_s:
                raise VehicleError(
                    f"{self.colour}: {what} did not happen within {timeout_s:g} s{self.reason(asked_at_s)}."
                )
            await asyncio.sleep(0.02)
        return telemetry

    async def wait_ready(self, timeout_s: float = 10.0) -> Telemetry:
        """Wait until position, attitude, flight mode and health have been heard, and a little for health to be good.

        Health that stays bad is returned, not raised: its reasons are for whoever pairs (X8). Raises VehicleError, also
        where a second vehicle answers on the same link.
        """
        await self.wait_for(
            lambda t: math.isfinite(t.at_s) and t.flight_mode != FlightMode.UNKNOWN and t.unhealthy != NO_HEALTH,
            timeout_s,
            "a first report of position, attitude, flight mode and health",
        )
        self.check_alone()
        with suppress(VehicleError):
            await self.wait_for(lambda t: t.healthy, HEALTH_WAIT_S, "good health")
        return self.telemetry()

    async def wait_measured(self) -> None:
        """Wait a little until the rate of its positions is known; an unknown one is for whoever pairs (X8)."""
        with suppress(VehicleError):
            await self.wait_for(lambda t: math.isfinite(t.rate_hz), RATE_WAIT_S, "a rate of positions")

    async def wait_settled(self, timeout_s: float) -> None:
        """Wait until it has come to rest in Hold: by its velocity, or where that is noisy by its position. Raises VehicleError."""
        places: deque[tuple[float, Ned]] = deque()

        def settled(t: Telemetry) -> bool:
            if t.flight_mode != FlightMode.HOLD or t.velocity is None or t.local is None:
                return False
            if not places or t.at_s > places[-1][0]:
                places.append((t.at_s, t.local))
            while places[-1][0] - places[0][0] > SETTLED_S:
                places.popleft()
            stays = places[-1][0] - places[0][0] > 0.8 * SETTLED_S and t.local.minus(places[0][1]).norm < SETTLED_M
            return t.velocity.norm < SETTLED_M_S or stays

        await self.wait_for(settled, timeout_s, "coming to rest in Hold")
