"""What every kind of vehicle has in common: what it tells, what it does when commanded, and how it says that it cannot.

An implementation is a class with these methods (`m3r_app.vehicle.mavsdk_vehicle.MavsdkVehicle` is one) that maps its
autopilot's own modes to `safety.vocabulary.FlightMode`. Places are in the vehicle's own local NED frame (m), yaw is a compass heading (deg).
Every method but `hold_unless_taken_over` belongs to the event loop.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Protocol

from m3r_app.vehicle.adsb import Aircraft
from m3r_app.vehicle.telemetry import Telemetry
from safety.vocabulary import Ned


class VehicleError(Exception):
    """What the vehicle or its link would not do: one sentence that names the vehicle and what to do."""


@dataclass(frozen=True, slots=True)
class Links:
    """Where the vehicles are. others: aircraft that are heard but cannot be paired with. complete: nobody else flies."""

    vehicles: dict[str, str]
    others: dict[str, str]
    complete: bool


class ParameterAccess(Protocol):
    """What reads and sets a vehicle's parameters."""

    async def parameters(self, names: Iterable[str]) -> Mapping[str, float | None]:
        """None for one that the vehicle does not have. Raises VehicleError."""
        ...

    async def set_parameter(self, name: str, value: float) -> None:
        """Raises VehicleError."""
        ...


class ObservedVehicle(ParameterAccess, Protocol):
    """A vehicle as everybody sees it who does not command it. A wait raises VehicleError where nothing comes of it in time."""

    @property
    def colour(self) -> str:
        """What the operator calls it."""
        ...

    def telemetry(self) -> Telemetry:
        """The latest of everything, now. Silence is seen in its ages."""
        ...

    def on_telemetry(self, listener: Callable[[Telemetry], None]) -> None:
        """Call listener in the event loop at each new position."""
        ...

    def off_telemetry(self, listener: Callable[[Telemetry], None]) -> None:
        """Do not call listener any more."""
        ...

    def aircraft(self) -> tuple[Aircraft, ...]:
        """The aircraft with a transponder that this one hears of."""
        ...

    async def wait_for(self, condition: Callable[[Telemetry], bool], timeout_s: float, what: str) -> Telemetry:
        """The first telemetry that fulfils condition; the error names `what`."""
        ...

    async def wait_ready(self, timeout_s: float = 10.0) -> Telemetry:
        """Until all that pairing judges has been heard."""
        ...

    async def wait_measured(self) -> None:
        """A little, until the rate of its positions is known."""
        ...

    async def wait_settled(self, timeout_s: float) -> None:
        """Until it has come to rest in Hold."""
        ...

    async def play_tune(self) -> bool:
        """Two notes on the vehicle itself; whether they could be sent."""
        ...

    async def close(self) -> None:
        """End the link: setpoints stop. Idempotent."""
        ...


class Autopilot(Protocol):
    """What the motion controller needs of a vehicle. A command raises VehicleError where it is refused or not answered."""

    def here(self) -> tuple[Ned, float] | None:
        """Latest own position and yaw (deg); None: unknown."""
        ...

    def set_position_ned(self, point: Ned, yaw_deg: float) -> None:
        """Send one setpoint."""
        ...

    async def enter_offboard(self) -> None:
        """Offboard from a setpoint at the current position."""
        ...

    async def end_setpoints(self) -> None:
        """No setpoint leaves from here on."""
        ...

    async def leave_in_hold(self) -> None:
        """No setpoint leaves from here on, and the autopilot's own Hold, until it is seen."""
        ...

    async def resume_mission(self) -> None:
        """Back to the mission it flew before."""
        ...

    async def begin_landing(self) -> None:
        """Come down here, by itself."""
        ...


class Vehicle(ObservedVehicle, Autopilot, Protocol):
    """Everything that the app uses of a vehicle. Its commands are for `m3r_app.vehicle.commander` alone."""

    async def hold(self) -> None:
        """The autopilot's own Hold; returns when it reports it."""
        ...

    async def takeoff(self, metres: float) -> None:
        """Arm, take off to `metres` above here and wait there in Hold."""
        ...

    async def land(self) -> None:
        """Come down here and wait until it stands on the ground."""
        ...

    def hold_unless_taken_over(self, timeout_s: float) -> None:
        """Hold, from any thread and without the event loop; nothing where somebody else flies it (X3). For the guard."""
        ...
