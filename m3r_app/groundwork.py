"""Take-off and landing of a drone that nobody is paired with. They are no maneuvers of the model. Source: design 15."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

from m3r_app.modes import State
from m3r_app.shell import Shell
from m3r_app.vehicle import Vehicle, VehicleError

HOLD_S = 5.0


class GroundWork:
    """One take-off or landing at a time; STOP ends it in Hold. From the event loop only."""

    def __init__(self, shell: Shell, say: Callable[[str], None]) -> None:
        self._shell = shell
        self._say = say
        self._task: asyncio.Task[None] | None = None
        self._vehicle: Vehicle | None = None

    def take_off(self, colour: str, metres: float) -> None:
        """Take off to `metres` above the ground here, and hold."""
        self._begin(colour, f"taking off to {metres:g} m", lambda vehicle: vehicle.takeoff(metres))

    def land(self, colour: str) -> None:
        self._begin(colour, "landing", lambda vehicle: vehicle.land())

    def stop(self) -> None:
        """End what is under way, in Hold. Nothing is, nothing happens. Source: X4."""
        task, vehicle = self._task, self._vehicle
        if task is None or task.done() or vehicle is None:
            return
        task.cancel()
        self._task = asyncio.create_task(self._hold(vehicle))

    def _begin(self, colour: str, what: str, work: Callable[[Vehicle], Coroutine[Any, Any, None]]) -> None:
        name, vehicle = colour.capitalize(), self._shell.fleet.vehicles.get(colour)
        if vehicle is None:
            self._say(f"{name}: there is no such drone")
        elif self._shell.state.state is not State.IDLE:
            self._say(f"{name}: {what} is only for a drone in normal autonomy, disconnect first")
        elif self._task is not None and not self._task.done():
            self._say(f"{name}: not {what}, the last take-off or landing is not over")
        else:
            self._say(f"{name}: {what}")
            self._vehicle = vehicle
            self._task = asyncio.create_task(self._carry_out(name, what, work(vehicle)))

    async def _carry_out(self, name: str, what: str, work: Coroutine[Any, Any, None]) -> None:
        try:
            await work
        except VehicleError as error:
            self._say(str(error))
        else:
            self._say(f"{name}: done {what}")

    async def _hold(self, vehicle: Vehicle) -> None:
        name = vehicle.colour.capitalize()
        try:
            await asyncio.wait_for(vehicle.hold(), HOLD_S)
        except (VehicleError, TimeoutError) as error:
            self._say(str(error) or f"{name}: did not answer to Hold")
        else:
            self._say(f"{name}: holding")
