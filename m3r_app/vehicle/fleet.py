"""The fleet: the vehicles this app has links to, and what they tell of each other. Simulated or real makes no difference.

Neighbours are all vehicles but the paired one, from their own telemetry, and aircraft that their receivers hear (ADS-B). Source: R5, R11, design 10.
"""

from __future__ import annotations

import asyncio
import json
import math
import random
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from m3r_app.ports import LinkError, require_free
from m3r_app.scenario import ScenarioError
from m3r_app.vehicle.adsb import newest
from m3r_app.vehicle.mavsdk_vehicle import Vehicle, VehicleError
from safety.frames import LocalFrame
from safety.vocabulary import Neighbours

SIMULATOR_READY_S = 30.0
STOP_S = 3.0
BAD_INPUT = 2
"""The simulator's exit status for a scenario that it cannot fly."""
PORTS = (20000, 32000)
"""Below what the system hands out by itself."""
PORT_TRIES = 100


@dataclass(frozen=True, slots=True)
class Links:
    """Where the vehicles are. others: aircraft that are heard but cannot be paired with. complete: nobody else flies."""

    vehicles: dict[str, str]
    others: dict[str, str]
    complete: bool


class SimulatedFleet:
    """The built-in simulated fleet, in its own process."""

    def __init__(self, process: asyncio.subprocess.Process, links: Links) -> None:
        self._process = process
        self.links = links

    @classmethod
    async def start(cls, scenario: Path, aircraft: int, truth: Path | None = None) -> SimulatedFleet:
        """Start it on free ports and wait until it flies. Raises VehicleError with its own last words."""
        command = [sys.executable, "-m", "m3r_app.sim", "--scenario", str(scenario), "--die-with-parent"]
        command += ["--port-base", str(free_udp_block(aircraft))]
        if truth is not None:
            command += ["--truth", str(truth)]
        process = await asyncio.create_subprocess_exec(
            *command,
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            # Ctrl-C is for the app: the drones must live long enough to be told to hold.
            start_new_session=True,
        )
        fleet = cls(process, Links({}, {}, complete=True))
        try:
            assert process.stdout is not None and process.stderr is not None
            line = await asyncio.wait_for(process.stdout.readline(), SIMULATOR_READY_S)
            if not line:
                words = (await process.stderr.read()).decode(errors="replace").strip().splitlines()
                last = words[-1] if words else "it said nothing"
                if await process.wait() == BAD_INPUT:
                    raise ScenarioError(last)
                raise VehicleError(f"the simulated fleet did not start: {last}")
            ready = json.loads(line)
            fleet.links = Links(ready["vehicles"], ready["traffic"], complete=True)
        except TimeoutError:
            await fleet.stop()
            raise VehicleError(f"the simulated fleet was not ready within {SIMULATOR_READY_S:.0f} s") from None
        except BaseException:
            await fleet.stop()
            raise
        return fleet

    async def stop(self) -> None:
        """End the process."""
        if self._process.returncode is not None:
            return
        self._process.terminate()
        try:
            await asyncio.wait_for(self._process.wait(), STOP_S)
        except TimeoutError:
            self._process.kill()
            await self._process.wait()


class Fleet:
    """Connected vehicles by colour."""

    def __init__(self, vehicles: dict[str, Vehicle], others: dict[str, Vehicle], *, complete: bool) -> None:
        self.vehicles = vehicles
        self.others = others
        self._complete = complete

    @classmethod
    async def connect(cls, links: Links, clock: Callable[[], float], timeout_s: float) -> Fleet:
        """Connect to all at once. Raises VehicleError of the first that fails, with none left open."""
        urls = {**links.vehicles, **links.others}
        answers = await asyncio.gather(
            *(Vehicle.connect(name, url, clock, timeout_s) for name, url in urls.items()), return_exceptions=True
        )
        connected = {name: v for name, v in zip(urls, answers, strict=True) if isinstance(v, Vehicle)}
        failures = [a for a in answers if isinstance(a, BaseException)]
        if failures:
            await asyncio.gather(*(v.close() for v in connected.values()))
            raise failures[0]
        vehicles = {name: v for name, v in connected.items() if name in links.vehicles}
        others = {name: v for name, v in connected.items() if name in links.others}
        return cls(vehicles, others, complete=links.complete)

    async def ready(self, timeout_s: float) -> None:
        """Wait until everybody has told where they are. Raises VehicleError naming who has not."""
        everybody: Iterable[Vehicle] = (*self.vehicles.values(), *self.others.values())
        heard = "a first report of its position"
        await asyncio.gather(*(v.wait_for(lambda t: t.geodetic is not None, timeout_s, heard) for v in everybody))

    async def close(self) -> None:
        """End all links."""
        everybody: Iterable[Vehicle] = (*self.vehicles.values(), *self.others.values())
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
        everybody: Iterable[Vehicle] = (*self.vehicles.values(), *self.others.values())
        seen = newest([a for v in everybody for a in v.aircraft()])
        states = [
            (name, t.geodetic, t.velocity, float(np.maximum(t.sigma_h_m, t.sigma_v_m)), t.at_s) for name, t in told
        ]
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


def free_udp_block(count: int) -> int:
    """The first of `count` UDP ports in a row that nobody on this computer holds. Raises VehicleError."""
    for _ in range(PORT_TRIES):
        base = random.randrange(*PORTS)
        try:
            for port in range(base, base + count):
                require_free("127.0.0.1", port)
        except LinkError:
            continue
        return base
    raise VehicleError(f"there are no {count} free UDP ports in a row for the simulated fleet")
