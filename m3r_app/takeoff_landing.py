"""Take-off and landing of a drone that nobody is paired with. They are no maneuvers of the model. Source: design 15.

What is asked, called off and over is the arbiter's; here is what becomes of a drone meanwhile, and what the operator is told.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping

from m3r_app.airspace.interface import Airspace
from m3r_app.arbiter.events import GroundWorkEnded
from m3r_app.output import Announcing, Notice
from m3r_app.vehicle.commander import Commander
from m3r_app.vehicle.interface import ObservedVehicle, VehicleError
from safety.vocabulary import Geodetic


class GroundWork:
    """What the effects TakeOff, Land and CallOffGroundWork mean. From the event loop only."""

    def __init__(
        self,
        commanders: Mapping[str, Commander],
        airspace: Airspace,
        operator: Geodetic,
        say: Announcing,
        against: Callable[[ObservedVehicle, float], Awaitable[tuple[str, ...]]],
    ) -> None:
        """against: everything that can be known on the ground against a take-off of a drone to so many metres. Source: X8."""
        self._commanders = commanders
        self._airspace = airspace
        self._operator = operator
        self._say = say
        self._against = against

    async def take_off(self, colour: str, metres: float) -> GroundWorkEnded:
        """Take off to `metres` above the ground here, and hold."""

        async def work(commander: Commander) -> None:
            reasons = await self._against(commander.vehicle, metres)
            if reasons:
                raise VehicleError(f"{colour.capitalize()}: not taking off, {'; '.join(reasons)}")
            await commander.take_off(metres)

        return await self._carry_out(colour, f"taking off to {metres:g} m", Notice.TAKING_OFF, work)

    async def land(self, colour: str) -> GroundWorkEnded:
        """Come down where it is."""
        return await self._carry_out(colour, "landing", Notice.LANDING, Commander.land)

    async def call_off(self, colour: str) -> GroundWorkEnded:
        """What was cancelled ends in Hold. Source: X4."""
        name, commander = colour.capitalize(), self._commanders.get(colour)
        try:
            if commander is not None and await commander.stop():
                self._say(f"{name}: holding")
        except VehicleError as error:
            self._say(str(error))
        return GroundWorkEnded(colour)

    async def _carry_out(
        self, colour: str, what: str, notice: Notice, work: Callable[[Commander], Awaitable[None]]
    ) -> GroundWorkEnded:
        """In shared air only with a drone that nobody else holds. Source: P1."""
        name, commander = colour.capitalize(), self._commanders.get(colour)
        ended = GroundWorkEnded(colour)
        if commander is None:
            self._say(f"{name}: there is no such drone")
            return ended
        self._say(f"{name}: {what}", notice)
        held = await self._airspace.claim(colour, self._operator)
        if held is not None:
            self._say(f"{name}: not {what}, {held}")
            return ended
        try:
            await work(commander)
        except VehicleError as error:
            self._say(str(error))
        else:
            self._say(f"{name}: done {what}")
        return ended
