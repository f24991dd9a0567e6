"""Take-off and landing of a drone that nobody is paired with. They are no maneuvers of the model. Source: design 15."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any

from m3r_app.output import Announcing, Notice
from m3r_app.runtime import Shell
from m3r_app.vehicle.interface import Vehicle, VehicleError
from safety.vocabulary import State

HOLD_S = 5.0


class GroundWork:
    """One take-off or landing at a time; STOP ends it in Hold. From the event loop only."""

    def __init__(
        self,
        shell: Shell,
        say: Announcing,
        against: Callable[[Vehicle, float], Awaitable[tuple[str, ...]]],
    ) -> None:
        """against: everything that can be known on the ground against a take-off of a drone to so many metres. Source: X8."""
        self._shell = shell
        self._say = say
        self._against = against
        self._task: asyncio.Task[None] | None = None
        self._vehicle: Vehicle | None = None

    def take_off(self, colour: str, metres: float) -> None:
        """Take off to `metres` above the ground here, and hold."""
        self._begin(
            colour, f"taking off to {metres:g} m", Notice.TAKING_OFF, lambda vehicle: self._take_off(vehicle, metres)
        )

    async def _take_off(self, vehicle: Vehicle, metres: float) -> None:
        reasons = await self._against(vehicle, metres)
        if reasons:
            raise VehicleError(f"{vehicle.colour.capitalize()}: not taking off, {'; '.join(reasons)}")
        await vehicle.takeoff(metres)

    def land(self, colour: str) -> None:
        self._begin(colour, "landing", Notice.LANDING, lambda vehicle: vehicle.land())

    def stop(self) -> None:
        """End what is under way, in Hold. Nothing is, nothing happens. Source: X4."""
        task, vehicle = self._task, self._vehicle
        if task is None or task.done() or vehicle is None:
            return
        task.cancel()
        self._task = asyncio.create_task(self._hold(vehicle))

    def _begin(
        self, colour: str, what: str, notice: Notice, work: Callable[[Vehicle], Coroutine[Any, Any, None]]
    ) -> None:
        name, vehicle = colour.capitalize(), self._shell.fleet.vehicles.get(colour)
        if vehicle is None:
            self._say(f"{name}: there is no such drone")
        elif self._shell.state.state is not State.IDLE:
            self._say(f"{name}: {what} is only for a drone in normal autonomy, disconnect first")
        elif self._task is not None and not self._task.done():
            self._say(f"{name}: not {what}, the last take-off or landing is not over")
        else:
            self._say(f"{name}: {what}", notice)
            self._vehicle = vehicle
            self._task = asyncio.create_task(self._carry_out(vehicle, what, work))

    async def _carry_out(
        self, vehicle: Vehicle, what: str, work: Callable[[Vehicle], Coroutine[Any, Any, None]]
    ) -> None:
        """In shared air only with a drone that nobody else holds. Source: P1."""
        name, airspace = vehicle.colour.capitalize(), self._shell.airspace
        held = await airspace.claim(vehicle.colour, self._shell.frame.origin)
        if held is not None:
            self._say(f"{name}: not {what}, {held}")
            return
        try:
            await work(vehicle)
        except VehicleError as error:
            self._say(str(error))
        else:
            self._say(f"{name}: done {what}")
        finally:
            if self._shell.state.state is State.IDLE:  # else it has been paired meanwhile
                airspace.give_up(vehicle.colour)

    async def _hold(self, vehicle: Vehicle) -> None:
        name = vehicle.colour.capitalize()
        try:
            await asyncio.wait_for(vehicle.hold(), HOLD_S)
        except (VehicleError, TimeoutError) as error:
            self._say(str(error) or f"{name}: did not answer to Hold")
        else:
            self._say(f"{name}: holding")
