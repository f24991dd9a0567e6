"""The simulated fleet tells the shared air where its drones are, as a beacon on each would. Source: R5, R11.

A thread of its own with its own event loop: flying never waits for the broker.
"""

from __future__ import annotations

import asyncio
import sys
import threading
import time
from pathlib import Path

import numpy as np

from m3r_app.airspace.beacon import Beacon
from m3r_app.airspace.credentials import AirError, load_credentials, parse_broker
from m3r_app.sim.fleet import Fleet

LOOK_S = 0.02


def start_telling(fleet: Fleet, broker_url: str, credentials: Path) -> None:
    """Tell of all drones that the credentials allow, as long as the process lives. Raises AirError before anything is told."""
    broker = parse_broker(broker_url)
    who = load_credentials(credentials, "operator", "drone")
    names = [name for name in fleet.links if name in who.flies]
    if not names:
        raise AirError(
            f"the credentials of {who.user} are for none of {', '.join(fleet.links)}: use ones made for them"
        )

    async def look(beacon: Beacon) -> None:
        while True:
            for name in names:
                pilot = fleet.links[name].autopilot
                sigma_m = float(np.max(pilot.sigmas_m))  # which keeps a NaN; max() may not
                beacon.publisher.tell(name, fleet.frame.geodetic(pilot.position), pilot.velocity, sigma_m, 0.0)
            await asyncio.sleep(LOOK_S)

    async def tell() -> None:
        beacon = Beacon(broker, who, _say, time.monotonic)
        beacon.check(dict.fromkeys(names))
        looking = asyncio.create_task(look(beacon))
        try:
            await beacon.run(lambda: _say(f"telling where {', '.join(names)} is at {broker}"))
        except AirError as error:
            _say(str(error))
        finally:
            looking.cancel()

    threading.Thread(target=lambda: asyncio.run(tell()), name="telling", daemon=True).start()


def _say(text: str) -> None:
    print(f"m3r: {text}", file=sys.stderr, flush=True)
