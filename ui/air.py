"""`m3r airspace` and `m3r beacon`: services that go on until they are ended. What they say goes to standard error."""

from __future__ import annotations

import asyncio
import contextlib
import signal
import time
from collections.abc import Awaitable, Callable, Mapping
from functools import partial
from pathlib import Path

import platformdirs

from m3r_app.airspace.beacon import Beacon
from m3r_app.airspace.credentials import load_credentials, parse_broker
from m3r_app.airspace.service import AirspaceService
from m3r_app.airspace.store import Store
from m3r_app.exit_status import ExitStatus
from m3r_app.ports import check_link
from m3r_app.vehicle.fleet import Fleet
from m3r_app.vehicle.interface import Links

Say = Callable[[str], None]
HEARD_S = 10.0


def be_authority(broker_url: str, credentials: Path, memory: Path | None, say: Say) -> int:
    """Grant until ended. Raises AirError."""
    broker, who = parse_broker(broker_url), load_credentials(credentials, "airspace")
    path = memory or platformdirs.user_state_path("m3r") / f"airspace-{who.area}.json"

    async def serve() -> None:
        service = AirspaceService(broker, who, Store(path, who.area), say)
        await service.run(lambda: say(f"the airspace of {who.area} is looked after at {broker}"))

    return asyncio.run(_until_ended(serve()))


def be_beacon(vehicles: Mapping[str, str], broker_url: str, credentials: Path, say: Say) -> int:
    """Tell of the drones until ended. Raises AirError, LinkError or VehicleError."""
    broker = parse_broker(broker_url)
    who = load_credentials(credentials, "drone", "operator")
    for url in vehicles.values():
        check_link(url)

    async def tell() -> None:
        beacon = Beacon(broker, who, say)
        beacon.check(vehicles)
        say(f"waiting for {', '.join(vehicles)}")
        fleet = await Fleet.connect(Links(dict(vehicles), {}, complete=False), time.monotonic, HEARD_S)
        try:
            for name, vehicle in fleet.vehicles.items():
                vehicle.on_telemetry(partial(beacon.publisher.telemetry, name))
            names = ", ".join(vehicles)
            await beacon.run(lambda: say(f"telling where {names} is at {broker}"))
        finally:
            await fleet.close()

    return asyncio.run(_until_ended(tell()))


async def _until_ended(work: Awaitable[None]) -> int:
    """130 by Ctrl-C, 0 by SIGTERM; whatever `work` raises."""
    loop = asyncio.get_running_loop()
    status: int = ExitStatus.ENDED
    task = asyncio.ensure_future(work)

    def end(code: int) -> None:
        nonlocal status
        status = code
        task.cancel()

    loop.add_signal_handler(signal.SIGINT, end, ExitStatus.INTERRUPTED)
    loop.add_signal_handler(signal.SIGTERM, end, ExitStatus.ENDED)
    with contextlib.suppress(asyncio.CancelledError):
        await task
    return status
