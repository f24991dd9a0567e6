"""What the arbiter remembers between two steps. Frozen data only."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Literal

from m3r_app.arbiter.fusion import Remembered
from m3r_app.arbiter.modes import MODE_OF
from m3r_app.output import Action
from safety.constraints import RULES, Rule
from safety.estimate import AT_FIRST, HoverSample, Motion, Noise
from safety.limits import Limits
from safety.monitor import Baseline, Breach
from safety.situation import World
from safety.supervisor import Intent
from safety.vocabulary import (
    POINT,
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
    State,
    VehicleState,
)


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
    astray: Ned = POINT
    """What its velocity says that it has flown and its position does not, over all its maneuvers. Source: X6."""


@dataclass(frozen=True, slots=True)
class Measured:
    """What telemetry says of a maneuver so far."""

    min_clearance_m: float | None = None
    min_separation_m: float | None = None
    max_speed_m_s: float = 0.0
    yaw_deg: float = 0.0
    by_velocity: Ned = POINT
    """How far it has gone by what velocity says (m)."""


@dataclass(frozen=True, slots=True)
class Flight:
    """What is being flown. baseline: the margins that were already negative when it began, which may only rise (X13).

    request_id: of the request, or of this way back alone; its airspace is reserved under it. asked_for: False: the way
    back, which nobody asked for.
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
    action: Action
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

    def plus(self, more: Tally) -> Tally:
        """Both together."""
        return Tally(*(getattr(self, f.name) + getattr(more, f.name) for f in fields(Tally)))


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
    ground_work: str | None = None
    """The colour of the drone that takes off or lands for the console."""
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
    settling_since_s: float | None = None
    """Since when the end of the motion is waited for; None: it is not."""
    return_judged_from_s: float = float("-inf")
    """The way back is not judged again before this."""
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
