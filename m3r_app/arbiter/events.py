"""What goes into the arbiter's step, what comes out of it, and what it remembers in between. Frozen data only."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

from m3r_app.arbiter.fusion import Remembered
from m3r_app.arbiter.modes import MODE_OF, State
from safety.constraints import RULES, Rule
from safety.estimate import AT_FIRST, HoverSample, Motion, Noise
from safety.limits import Limits
from safety.monitor import Baseline, Breach
from safety.situation import World
from safety.supervisor import Intent
from safety.vocabulary import (
    Anchor,
    Decision,
    ManeuverRequest,
    Mode,
    Ned,
    Neighbours,
    Operator,
    Plan,
    Primitive,
    ReservedVolume,
    VehicleState,
)

# ---------------------------------------------------------------- events


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
    """The drone is claimed for us no longer: somebody else may have it by now. Source: X3."""

    reason: str


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
    | TelemetryArrived
    | NeighboursHeard
    | ReservationAnswered
    | Stalled
    | FrameMoved
    | ClaimLost
    | Tick
    | Ended
)

# ---------------------------------------------------------------- effects

LetGoCommand = Literal["hold", "resume", "land", "nothing"]


@dataclass(frozen=True, slots=True)
class Report:
    """One object of the machine-readable output, also recorded. `fields` is strict JSON but for floats (rounded later)."""

    event: str
    fields: dict[str, object]


@dataclass(frozen=True, slots=True)
class Announce:
    """What the operator is told."""

    text: str


@dataclass(frozen=True, slots=True)
class Pair:
    """Run the checks before pairing with this drone and put it in Hold; answer with PairingAnswered."""

    colour: str


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


Effect = Report | Announce | Pair | FaceOperator | Fly | Hold | Reserve | Release | LetGo

# ---------------------------------------------------------------- state


@dataclass(frozen=True, slots=True)
class Policy:
    """The choices the design leaves to the user."""

    return_to_anchor: Literal["auto", "ask", "never"] = "auto"
    on_disconnect: Literal["hold", "resume"] = "hold"
    replace: Literal["off", "offer"] = "off"
    dry_run: bool = False
    """Decide and tell as ever, but fly nothing of it."""
    position_lost: Literal["hold", "land"] = "hold"
    """What is asked of a drone that does not know where it is any more."""


@dataclass(frozen=True, slots=True)
class Session:
    """One operator and one drone, from accepted pairing to release."""

    colour: str
    operator: Operator
    world: World
    accepted_at_s: float
    anchor: Anchor | None = None
    centre: Ned | None = None
    paired_at_s: float = 0.0
    restarts: int = 0
    """How often its autopilot had started anew when it was taken."""
    hover: tuple[HoverSample, ...] = ()
    """What has been seen of its hover before pairing is confirmed."""
    configured: Limits | None = None
    """The limits of the settings, where those of this session are wider, for its estimate is noisy."""
    noise: Noise | None = None


@dataclass(frozen=True, slots=True)
class Measured:
    """What telemetry says of a maneuver so far."""

    min_clearance_m: float | None = None
    min_separation_m: float | None = None
    max_speed_m_s: float = 0.0
    yaw_deg: float = 0.0


@dataclass(frozen=True, slots=True)
class Flight:
    """What is being flown. baseline: the margins that were already negative when it began, which may only rise (X13).

    request_id: whose it is, and under which its airspace is reserved; asked_for: False: the way back, which nobody asked for.
    """

    request_id: str
    plan: Plan
    started_at_s: float
    origin: Ned
    last_yaw_deg: float
    baseline: Baseline = field(default_factory=dict)
    measured: Measured = Measured()
    asked_for: bool = True


@dataclass(frozen=True, slots=True)
class Deciding:
    """A request between detection and its final decision: waiting for airspace, or for a short hindrance to clear.

    request: None: the way back, which nobody asked for; ask_id: of the airspace asked for, None: not yet.
    """

    request: ManeuverRequest | None
    intent: Intent
    decision: Decision
    deadline_s: float
    ask_id: str | None = None


@dataclass(frozen=True, slots=True)
class Leftover:
    """What STOP left of a maneuver, or a slower one that was offered instead, for CONTINUE. Source: X12, design 7."""

    primitive: Primitive
    left: float
    """Metres, or degrees of a scan."""
    at_s: float
    slowness: float = 1.0


@dataclass(frozen=True, slots=True)
class Suspected:
    """A limit that is broken, and what was done: a violation of ours once the mode has been told since, and is still ours.

    Between a takeover and the report that tells of it, what the drone does is not ours to answer for. Source: X3.
    """

    breach: Breach
    action: str
    at_s: float


@dataclass(frozen=True, slots=True)
class Tally:
    """For the `end` event."""

    requests: int = 0
    approved: int = 0
    completed: int = 0
    aborted: int = 0
    rejected: int = 0
    violations: int = 0


@dataclass(frozen=True, slots=True)
class ArbiterState:
    """All the arbiter remembers."""

    limits: Limits
    policy: Policy
    rules: tuple[Rule, ...] = RULES
    state: State = State.IDLE
    held: bool = False
    """What is being decided was asked for in EmergencyHold: refused, it goes back there."""
    pairing: str | None = None
    """The colour that the shell is checking."""
    pairing_off: str | None = None
    """Why it is not wanted any more, whatever the shell finds."""
    session: Session | None = None
    vehicle: VehicleState | None = None
    motion: Motion = AT_FIRST
    """For rest and for the envelope."""
    neighbours: Neighbours = field(default_factory=lambda: Neighbours.none(float("-inf")))
    reservations: tuple[ReservedVolume, ...] = ()
    flight: Flight | None = None
    deciding: Deciding | None = None
    pending: ManeuverRequest | None = None
    recent: tuple[Remembered, ...] = ()
    stopped_at_s: float = float("-inf")
    """When the last STOP was captured: what was asked before it is no new request (X4)."""
    leftover: Leftover | None = None
    settling_since_s: float = 0.0
    """Also when the way back was last judged."""
    checked_at_s: float = float("-inf")
    """When the hovering drone was last monitored."""
    rechecked_at_s: float = float("-inf")
    """When the delayed request was last judged."""
    return_at_s: float | None = None
    """When the announced way back begins; None: none announced."""
    may_return: bool = False
    breached: frozenset[str] = frozenset()
    """Limits that are broken right now, so that each breach is reported once."""
    suspected: tuple[Suspected, ...] = ()
    down_since_s: float | None = None
    """Since when the paired drone says that it stands, or is disarmed."""
    unlocated_since_s: float | None = None
    """Since when the drone in EmergencyHold does not know where it is."""
    returns: int = 0
    """How often airspace has been asked for a way back: every ask has an id of its own, as every request has."""
    tally: Tally = Tally()

    @property
    def mode(self) -> Mode:
        return MODE_OF[self.state]

    @property
    def speed_m_s(self) -> float:
        return self.motion.speed_m_s(self.noise)

    @property
    def noise(self) -> Noise | None:
        """What has been learnt of the estimate of the session's drone; None: nothing unusual."""
        return self.session.noise if self.session is not None else None

    @property
    def authority(self) -> bool:
        """Whether the drone is ours to command. Source: X3."""
        return self.session is not None

    def but(self, **changes: object) -> ArbiterState:
        """The same with some fields changed."""
        return replace(self, **changes)  # type: ignore[arg-type]
