"""What comes out of the arbiter's step, for the shell to carry out in order. Frozen data only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from m3r_app.arbiter.announcements import Announce
from m3r_app.output import OutputEvent, fields_of
from safety.vocabulary import (
    Cause,
    Ned,
    Plan,
    ReservedVolume,
    State,
)

LetGoCommand = Literal["hold", "resume", "land", "nothing"]


@dataclass(frozen=True, slots=True)
class Report:
    """One event of the machine-readable output, also recorded."""

    told: OutputEvent

    @property
    def event(self) -> str:
        """Its name."""
        return self.told.name

    @property
    def fields(self) -> dict[str, object]:
        """Its fields by name, for who looks at any event alike."""
        return fields_of(self.told)


@dataclass(frozen=True, slots=True)
class Pair:
    """Run the checks before pairing with this drone and put it in Hold; answer with PairingAnswered."""

    colour: str


@dataclass(frozen=True, slots=True)
class CallOffPairing:
    """End those checks, and in Hold what they have set in motion; answer with PairingAnswered. Source: X4."""

    colour: str


@dataclass(frozen=True, slots=True)
class TakeOff:
    """Outside of a session, if nothing is against it; answer with GroundWorkEnded. metres: above the ground where it stands."""

    colour: str
    metres: float


@dataclass(frozen=True, slots=True)
class Land:
    """Outside of a session; answer with GroundWorkEnded."""

    colour: str


@dataclass(frozen=True, slots=True)
class CallOffGroundWork:
    """End the take-off or landing in Hold; answer with GroundWorkEnded. Source: X4."""

    colour: str


@dataclass(frozen=True, slots=True)
class GiveUp:
    """The drone is claimed for us no longer. Source: P1."""

    colour: str


@dataclass(frozen=True, slots=True)
class PlayTune:
    """The audible sign of pairing, on the drone itself. Source: paper III-A."""


@dataclass(frozen=True, slots=True)
class AnchorMoved:
    """Where the anchor is from now on; None: there is none. radius_m: of the workspace about it."""

    position: Ned | None
    radius_m: float


@dataclass(frozen=True, slots=True)
class FaceOperator:
    """Hover here, nose to this bearing at the bounded yaw rate."""

    yaw_deg: float


@dataclass(frozen=True, slots=True)
class Fly:
    """Start streaming this plan now."""

    plan: Plan


@dataclass(frozen=True, slots=True)
class Hold:
    """Stop here now, yaw too."""

    cause: str


@dataclass(frozen=True, slots=True)
class Reserve:
    """Ask the airspace authority for this volume. request_id: of this ask alone, so that a late answer is no other's."""

    request_id: str
    volume: ReservedVolume


@dataclass(frozen=True, slots=True)
class Release:
    """Give the volume of that ask back."""

    request_id: str


@dataclass(frozen=True, slots=True)
class LetGo:
    """The session is over. command: put the drone in Hold (or resume its mission, or land); not after a takeover (X3).

    vehicle_lost: there is nothing left to fly: its autopilot has started anew.
    """

    command: LetGoCommand
    vehicle_lost: bool = False


@dataclass(frozen=True, slots=True)
class ImpossibleTransition:
    """A fault in the arbiter: it wanted a transition that the mode machine does not have, and was not given it."""

    state: State
    cause: Cause


Effect = (
    ImpossibleTransition
    | Report
    | Announce
    | Pair
    | CallOffPairing
    | TakeOff
    | Land
    | CallOffGroundWork
    | GiveUp
    | PlayTune
    | AnchorMoved
    | FaceOperator
    | Fly
    | Hold
    | Reserve
    | Release
    | LetGo
)
