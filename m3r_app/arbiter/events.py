"""What goes into the arbiter's step. Frozen data only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from safety.situation import World
from safety.vocabulary import (
    ManeuverRequest,
    Neighbours,
    Operator,
    ReservedVolume,
    VehicleState,
)


@dataclass(frozen=True, slots=True)
class Requested:
    """A modality made a request. latency_ms: end of the evidence to request."""

    request: ManeuverRequest
    latency_ms: float


@dataclass(frozen=True, slots=True)
class PairingAsked:
    """The command line (not a modality) asks to pair."""

    colour: str


@dataclass(frozen=True, slots=True)
class PairingAnswered:
    """The shell's checks before pairing are done. reasons empty: accepted, and authority is ours. Source: X8."""

    colour: str
    reasons: tuple[str, ...]
    operator: Operator | None = None
    world: World | None = None


@dataclass(frozen=True, slots=True)
class TakeOffAsked:
    """The console (not a modality) asks for a take-off of a drone that nobody is paired with. Source: design 15."""

    colour: str
    metres: float


@dataclass(frozen=True, slots=True)
class LandingAsked:
    """The console (not a modality) asks for a landing of a drone that nobody is paired with. Source: design 15."""

    colour: str


@dataclass(frozen=True, slots=True)
class GroundWorkEnded:
    """The take-off or landing is over, however it went."""

    colour: str


@dataclass(frozen=True, slots=True)
class TelemetryArrived:
    """A new state of the session's drone."""

    vehicle: VehicleState


@dataclass(frozen=True, slots=True)
class NeighboursHeard:
    """The latest of all other aircraft, with the volumes that others have reserved."""

    neighbours: Neighbours
    reservations: tuple[ReservedVolume, ...] = ()


@dataclass(frozen=True, slots=True)
class ReservationAnswered:
    """The authority's word on a volume. request_id: which ask it answers, as `Reserve` named it. Source: X10."""

    request_id: str
    answer: Literal["granted", "denied", "expired"]
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Stalled:
    """The guard or the controller dropped what was being flown. Source: X7."""

    reason: str


@dataclass(frozen=True, slots=True)
class FrameMoved:
    """The vehicle's local frame has moved against the session's: what it hovers at is elsewhere now. Source: X6."""

    reason: str


@dataclass(frozen=True, slots=True)
class ClaimLost:
    """The drone is claimed for us no longer: somebody else may have it by now. silent: nothing is heard of it. Source: X3."""

    reason: str
    silent: bool = False


@dataclass(frozen=True, slots=True)
class PropertyBroken:
    """A temporal property of the arbiter's own steps does not hold. says: what should. Source: `safety.properties`."""

    requirement: str
    formula: str
    says: str


@dataclass(frozen=True, slots=True)
class Tick:
    """Time passes, 10 times a second, whether or not anything else happens."""


@dataclass(frozen=True, slots=True)
class Ended:
    """The run is over: the drone is left in Hold."""

    reason: str


Event = (
    Requested
    | PairingAsked
    | PairingAnswered
    | TakeOffAsked
    | LandingAsked
    | GroundWorkEnded
    | TelemetryArrived
    | NeighboursHeard
    | ReservationAnswered
    | Stalled
    | FrameMoved
    | ClaimLost
    | PropertyBroken
    | Tick
    | Ended
)
