"""The simulated fleet as a process of its own, for the app that flies it."""

from __future__ import annotations

import asyncio
import json
import sys
from pathlib import Path

from m3r_app.environment.scenario import ScenarioError
from m3r_app.exit_status import ExitStatus
from m3r_app.ports import LinkError, free_udp_block
from m3r_app.vehicle.interface import Links, VehicleError

SIMULATOR_READY_S = 30.0
STOP_S = 3.0


class SimulatedFleet:
    """The built-in simulated fleet, in its own process."""

    def __init__(self, process: asyncio.subprocess.Process, links: Links) -> None:
        self._process = process
        self.links = links

    @classmethod
    async def start(cls, scenario: Path, aircraft: int, truth: Path | None = None) -> SimulatedFleet:
        """Start it on free ports and wait until it flies. Raises VehicleError with its own last words."""
        try:
            port = free_udp_block(aircraft)
        except LinkError as error:
            raise VehicleError(f"{error} for the simulated fleet") from None
        command = [sys.executable, "-m", "m3r_app.sim", "--scenario", str(scenario), "--die-with-parent"]
        command += ["--port-base", str(port)]
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
                if await process.wait() == ExitStatus.BAD_INPUT:
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
