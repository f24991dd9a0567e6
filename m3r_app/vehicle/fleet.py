"""The fleet: the vehicles this app has links to, and what they tell of each other. Simulated or real makes no difference.

Neighbours are all vehicles but the paired one, from their own telemetry, and aircraft that their receivers hear (ADS-B). Source: R5, R11, design 10.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable, Iterable, Mapping

import numpy as np

from m3r_app.vehicle.adsb import newest
from m3r_app.vehicle.commander import Commander
from m3r_app.vehicle.interface import Links, ObservedVehicle, Vehicle
from m3r_app.vehicle.mavsdk_vehicle import MavsdkVehicle
from safety.frames import LocalFrame
from safety.vocabulary import Neighbours

Connect = Callable[[str, str, Callable[[], float], float], Awaitable[Vehicle]]
"""Of colour, address, clock and timeout_s; raises VehicleError."""
CONNECTS: dict[str, Connect] = {
    # Every other link is MAVLink's.
}
"""How a vehicle is connected to, by the scheme of its address."""


class Fleet:
    """Connected vehicles by colour. What can be paired with has a commander, and nobody else commands it."""

    def __init__(
        self,
        vehicles: Mapping[str, Vehicle],
        others: Mapping[str, Vehicle],
        clock: Callable[[], float],
        *,
        complete: bool,
    ) -> None:
        self.vehicles: Mapping[str, ObservedVehicle] = vehicles
        self.others: Mapping[str, ObservedVehicle] = others
        self.commanders = {colour: Commander(vehicle, clock) for colour, vehicle in vehicles.items()}
        self._complete = complete

    @classmethod
    async def connect(cls, links: Links, clock: Callable[[], float], timeout_s: float) -> Fleet:
        """Connect to all at once. Raises VehicleError of the first that fails, with none left open."""
        urls = {**links.vehicles, **links.others}
        asked = [asyncio.create_task(_connect(name, url, clock, timeout_s)) for name, url in urls.items()]
        try:
            answers = await asyncio.gather(*asked, return_exceptions=True)
        except asyncio.CancelledError:
            answers = await asyncio.gather(*asked, return_exceptions=True)
            await asyncio.gather(*(a.close() for a in answers if not isinstance(a, BaseException)))
            raise
        connected = {name: v for name, v in zip(urls, answers, strict=True) if not isinstance(v, BaseException)}
        failures = [a for a in answers if isinstance(a, BaseException)]
        if failures:
            await asyncio.gather(*(v.close() for v in connected.values()))
            raise failures[0]
        vehicles = {name: v for name, v in connected.items() if name in links.vehicles}
        others = {name: v for name, v in connected.items() if name in links.others}
        return cls(vehicles, others, clock, complete=links.complete)

    async def ready(self, timeout_s: float) -> None:
        """Wait until everybody has told where they are. Raises VehicleError naming who has not."""
        everybody: Iterable[ObservedVehicle] = (*self.vehicles.values(), *self.others.values())
        heard = "a first report of its position"
        await asyncio.gather(*(v.wait_for(lambda t: t.geodetic is not None, timeout_s, heard) for v in everybody))

    async def close(self) -> None:
        """End all links."""
        everybody: Iterable[ObservedVehicle] = (*self.vehicles.values(), *self.others.values())
        await asyncio.gather(*(v.close() for v in everybody))

    def neighbours(self, own: str, frame: LocalFrame, now_s: float) -> Neighbours:
        """Everybody but `own`, in the session's frame. A state that is incomplete is kept as NaN: it refuses, X6.

        Aircraft that only a transponder tells of are among them, but never make the feed look alive.
        """
        others = {**self.vehicles, **self.others}
        mine = others.pop(own, None)
        told = [(name, v.telemetry()) for name, v in others.items()]
        if told:
            feed_at_s = max(t.heard_at_s for _, t in told)
        elif self._complete and mine is not None:
            # Nobody else is in the air, and it is the same fleet that says so as long as it is heard at all.
            feed_at_s = mine.telemetry().heard_at_s
        else:
            feed_at_s = -math.inf
        everybody: Iterable[ObservedVehicle] = (*self.vehicles.values(), *self.others.values())
        seen = newest([a for v in everybody for a in v.aircraft()])
        states = [(name, t.geodetic, t.velocity, t.sigma_m, t.at_s) for name, t in told]
        states += [(a.name, a.place, a.velocity, a.sigma_m, a.at_s) for a in seen]
        nowhere = (math.nan, math.nan, math.nan)
        return Neighbours(
            tuple(name for name, *_ in states),
            np.array([frame.ned(place) if place else nowhere for _, place, *_ in states]).reshape(-1, 3),
            np.array([velocity or nowhere for _, _, velocity, *_ in states]).reshape(-1, 3),
            np.array([sigma_m for *_, sigma_m, _ in states], dtype=np.float64),
            np.array([at_s for *_, at_s in states], dtype=np.float64),
            min(feed_at_s, now_s),
        )


async def _connect(name: str, url: str, clock: Callable[[], float], timeout_s: float) -> Vehicle:
    return await CONNECTS.get(url.partition("://")[0], MavsdkVehicle.connect)(name, url, clock, timeout_s)
