"""The paper's words as types: requests, primitives, plans, anchors, findings, decisions, modes.

Frozen data only. Positions are local NED metres about the session's origin (`safety.frames`) unless a name
says otherwise; times are seconds on the caller's monotonic clock. Source: paper section III.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class Ned(NamedTuple):
    """A local position (m) or velocity (m/s): north, east, down."""

    north: float
    east: float
    down: float

    @property
    def norm(self) -> float:
        return math.hypot(self.north, self.east, self.down)

    @property
    def horizontal(self) -> float:
        return math.hypot(self.north, self.east)

    def minus(self, other: Ned) -> Ned:
        return Ned(self.north - other.north, self.east - other.east, self.down - other.down)

    def plus(self, other: Ned) -> Ned:
        return Ned(self.north + other.north, self.east + other.east, self.down + other.down)

    @property
    def finite(self) -> bool:
        return math.isfinite(self.north) and math.isfinite(self.east) and math.isfinite(self.down)


POINT = Ned(0.0, 0.0, 0.0)
"""Half the sides of a box without extent."""


class Geodetic(NamedTuple):
    """WGS-84 latitude and longitude in degrees, altitude above mean sea level in metres."""

    lat_deg: float
    lon_deg: float
    amsl_m: float


class Command(StrEnum):
    """What an operator can ask for. Source: paper table I, design contract."""

    GO_LEFT = "go_left"
    GO_RIGHT = "go_right"
    GO_FORWARD = "go_forward"
    GO_BACK = "go_back"
    GO_UP = "go_up"
    GO_DOWN = "go_down"
    TURN_LEFT = "turn_left"
    TURN_RIGHT = "turn_right"
    STOP = "stop"
    CONTINUE = "continue"
    ACTIVATE = "activate"
    DISCONNECT = "disconnect"


class Modality(StrEnum):
    """How it was asked. FUSED: a second modality confirmed the first."""

    VOICE = "voice"
    GESTURE = "gesture"
    PANEL = "panel"
    FUSED = "fused"


class Primitive(StrEnum):
    """The bounded motion a command maps to. Source: paper table I."""

    MOVE_LEFT = "MoveLeft"
    MOVE_RIGHT = "MoveRight"
    MOVE_FORWARD = "MoveForward"
    MOVE_BACKWARD = "MoveBackward"
    ASCEND = "Ascend"
    DESCEND = "Descend"
    SCAN_LEFT = "ControlledYawScanLeft"
    SCAN_RIGHT = "ControlledYawScanRight"
    RETURN = "ReturnToAnchor"

    @property
    def is_scan(self) -> bool:
        return self in (Primitive.SCAN_LEFT, Primitive.SCAN_RIGHT)


PRIMITIVE_OF: dict[Command, Primitive] = {
    Command.GO_LEFT: Primitive.MOVE_LEFT,
    Command.GO_RIGHT: Primitive.MOVE_RIGHT,
    Command.GO_FORWARD: Primitive.MOVE_FORWARD,
    Command.GO_BACK: Primitive.MOVE_BACKWARD,
    Command.GO_UP: Primitive.ASCEND,
    Command.GO_DOWN: Primitive.DESCEND,
    Command.TURN_LEFT: Primitive.SCAN_LEFT,
    Command.TURN_RIGHT: Primitive.SCAN_RIGHT,
}


@dataclass(frozen=True, slots=True)
class ManeuverRequest:
    """One thing an operator asked for, as a modality understood it. Source: R1.

    captured_at_s: when the last of the evidence was captured (end of the voice, completing frame, key press);
    made_at_s: when the modality made the request of it; both on the caller's clock.
    """

    id: str
    command: Command
    modality: Modality
    confidence: float
    captured_at_s: float
    made_at_s: float
    evidence: str = ""
    colour: str | None = None
    """The drone named, for ACTIVATE and DISCONNECT."""


class FlightMode(StrEnum):
    """Which mode an autopilot flies in, by the names of MAVSDK; whose own name for it is what, only `vehicle.mavsdk_*` know."""

    OFFBOARD = "OFFBOARD"
    """It flies the setpoints that somebody streams."""
    HOLD = "HOLD"
    TAKEOFF = "TAKEOFF"
    LAND = "LAND"
    RETURN = "RETURN_TO_LAUNCH"
    MISSION = "MISSION"
    READY = "READY"
    FOLLOW_ME = "FOLLOW_ME"
    POSITION = "POSCTL"
    ALTITUDE = "ALTCTL"
    STABILIZED = "STABILIZED"
    MANUAL = "MANUAL"
    ACRO = "ACRO"
    RATTITUDE = "RATTITUDE"
    OTHER = "OTHER"
    """It told one that has no name here: somebody else's."""
    UNKNOWN = "UNKNOWN"
    """It tells none."""


@dataclass(frozen=True, slots=True)
class VehicleState:
    """What the session's drone last reported, in the session's local frame."""

    at_s: float
    """When it arrived."""
    position: Ned
    velocity: Ned
    yaw_deg: float
    yaw_rate_deg_s: float = 0.0
    sigma_h_m: float = math.nan
    """1-sigma horizontal accuracy that the estimator states; NaN: unknown, which refuses moves (X6)."""
    sigma_v_m: float = math.nan
    healthy: bool = False
    in_air: bool | None = None
    """None: it does not say."""
    flight_mode: FlightMode = FlightMode.UNKNOWN
    battery: float | None = None
    """Remaining fraction, 0 to 1; NaN: unknown; None: declared to be unknown (its own health checks may still tell)."""
    disagreement: Ned = Ned(0.0, 0.0, 0.0)
    """How far the position has lately moved otherwise than the velocity says (m)."""
    armed: bool | None = None
    """None: it does not say."""
    mode_at_s: float = math.inf
    """When it last told its flight mode; inf: now."""
    unasked_hold: bool = False
    """It is in Hold although this app flies it in Offboard and has not asked for it."""
    restarts: int = 0
    """How often its autopilot has started anew since it was first heard."""

    @property
    def sigma_m(self) -> float:
        """The larger of the two accuracies: what a 3D distance may be wrong by, 1 sigma. NaN if either is unknown."""
        if math.isnan(self.sigma_h_m) or math.isnan(self.sigma_v_m):
            return math.nan
        return max(self.sigma_h_m, self.sigma_v_m)


@dataclass(frozen=True, slots=True)
class Operator:
    """Where the operator stands. Source: paper III-A, design 1."""

    position: Ned
    sigma_m: float


@dataclass(frozen=True, slots=True)
class Anchor:
    """A = (x, y, z, psi): where maneuvers start from, and when it was recorded. Source: paper III-D."""

    position: Ned
    yaw_deg: float
    at_s: float


@dataclass(frozen=True)
class Neighbours:
    """The other aircraft, k of them, as arrays; and when the feed that tells of them was last alive.

    An empty sky is k = 0 with a fresh `feed_at_s`; a dead feed is an old one. Source: R5, R11, design 10.
    """

    names: tuple[str, ...]
    positions_ned_m: Floats
    """(k, 3), as of at_s."""
    velocities_ned_m_s: Floats
    """(k, 3)"""
    sigmas_m: Floats
    """(k,)"""
    at_s: Floats
    """(k,) when each state was captured."""
    feed_at_s: float
    """-inf: never heard."""

    def __len__(self) -> int:
        return len(self.names)

    @staticmethod
    def none(feed_at_s: float) -> Neighbours:
        """An empty sky, known to be so at feed_at_s."""
        return Neighbours((), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0), feed_at_s)


@dataclass(frozen=True, slots=True)
class ReservedVolume:
    """A capsule of airspace held by somebody for a while (an air lease). Source: R5, X10."""

    holder: str
    start: Ned
    end: Ned
    radius_m: float
    from_s: float
    until_s: float


@dataclass(frozen=True)
class Path:
    """What a plan sweeps: the polyline that the rules are checked on, with the time at each point.

    points_ned_m: (n, 3), n >= 1; times_s: (n,) since the plan's start, rising; stopping distance included.
    along_track_tolerance_m: how far along it the vehicle may be from where the time says (lag, coasting).
    until_s: for how long after the plan's start airspace is reserved for it, should it be longer than its times.
    """

    points_ned_m: Floats
    times_s: Floats
    along_track_tolerance_m: float = 0.0
    until_s: float = 0.0


@dataclass(frozen=True)
class Profile:
    """Rest to rest over `distance` with bounded speed and acceleration: a trapezoid, or a triangle when short."""

    distance: float
    speed: float
    acceleration: float

    @cached_property
    def peak(self) -> float:
        """The highest speed reached."""
        return min(self.speed, math.sqrt(self.distance * self.acceleration))

    @cached_property
    def duration_s(self) -> float:
        if self.distance <= 0.0:
            return 0.0
        return self.distance / self.peak + self.peak / self.acceleration

    def at(self, t_s: float) -> float:
        """Distance covered after t_s, clamped to [0, distance]."""
        if t_s <= 0.0 or self.distance <= 0.0:
            return 0.0
        duration_s, peak = self.duration_s, self.peak
        if t_s >= duration_s:
            return self.distance
        ramp_s = peak / self.acceleration
        if t_s < ramp_s:
            return 0.5 * self.acceleration * t_s * t_s
        if t_s <= duration_s - ramp_s:
            return peak * (t_s - 0.5 * ramp_s)
        return self.distance - 0.5 * self.acceleration * (duration_s - t_s) ** 2

    def speed_at(self, t_s: float) -> float:
        """How fast after t_s; 0 before and after."""
        if not 0.0 < t_s < self.duration_s:
            return 0.0
        return min(self.peak, self.acceleration * t_s, self.acceleration * (self.duration_s - t_s))

    def time_at(self, covered: float) -> float:
        """When `covered` has been covered: the inverse of `at`."""
        if covered <= 0.0 or self.distance <= 0.0:
            return 0.0
        if covered >= self.distance:
            return self.duration_s
        peak = self.peak
        ramp_s = peak / self.acceleration
        ramp = 0.5 * peak * ramp_s
        if covered < ramp:
            return math.sqrt(2.0 * covered / self.acceleration)
        if covered <= self.distance - ramp:
            return covered / peak + 0.5 * ramp_s
        return self.duration_s - math.sqrt(2.0 * (self.distance - covered) / self.acceleration)


@dataclass(frozen=True)
class Plan:
    """pi: a timed, bounded candidate maneuver, in closed form: first a yaw towards the operator if the nose is away, then
    one straight move, or one full rotation. Source: R2, R8, paper III-B (primitive attributes), design 13.

    goal_yaw_deg: where the nose points at the end; the turn is unwrapped, positive clockwise from above.
    """

    primitive: Primitive
    start: Ned
    direction: Ned
    """Unit vector; zeros for a scan."""
    move: Profile
    """Metres, m/s, m/s^2."""
    start_yaw_deg: float
    turn_deg: float
    """Signed yaw from start to end."""
    turn: Profile
    """Degrees, deg/s, deg/s^2, of |turn_deg|."""
    face_first: bool
    """The turn precedes the move; otherwise they run together."""
    max_duration_s: float
    """Longer than this and it is aborted."""
    stop_m: float
    """How far beyond any point of it the vehicle may coast when told to hold there."""

    @property
    def length_m(self) -> float:
        return self.move.distance

    @property
    def peak_speed_m_s(self) -> float:
        return self.move.peak

    @property
    def peak_yaw_rate_deg_s(self) -> float:
        return self.turn.peak

    @property
    def move_from_s(self) -> float:
        """When the move begins."""
        return self.turn.duration_s if self.face_first else 0.0

    @property
    def duration_s(self) -> float:
        return max(self.move_from_s + self.move.duration_s, self.turn.duration_s)

    @property
    def goal(self) -> Ned:
        return self.position(self.duration_s)

    def position(self, t_s: float) -> Ned:
        """Setpoint t_s after the start, local NED metres."""
        covered = self.move.at(t_s - self.move_from_s)
        d = self.direction
        return Ned(
            self.start.north + d.north * covered, self.start.east + d.east * covered, self.start.down + d.down * covered
        )

    def led(self, t_s: float, lead_s: float) -> Ned:
        """Where to point a vehicle that is lead_s behind its setpoint, so that it is where the plan says: on the line, ahead,
        never beyond the goal, so that a setpoint that is sent no more is a hover within the path that was judged.
        """
        moved_s = t_s - self.move_from_s
        covered = min(self.move.at(moved_s) + lead_s * self.move.speed_at(moved_s), self.move.distance)
        return Ned(*(s + d * covered for s, d in zip(self.start, self.direction, strict=True)))

    def yaw_deg(self, t_s: float) -> float:
        """Yaw setpoint t_s after the start, unwrapped."""
        return self.start_yaw_deg + math.copysign(self.turn.at(t_s), self.turn_deg)


@dataclass(frozen=True, slots=True)
class Finding:
    """What one rule says of one plan: margin >= 0 passes; so does a broken limit that the plan only mends (design 8).

    margin: signed, in `unit`; None where it does not exist (no neighbours). text: for the operator, with the number.
    below: the margins below zero, each with the name of its object where a rule holds for each of several (aircraft,
    obstacles, volumes): what is broken already is compared object by object (X13).
    """

    constraint: str
    requirements: tuple[str, ...]
    margin: float | None
    unit: str
    passed: bool
    text: str
    below: tuple[tuple[str, float], ...] = ()
    subject: str = ""
    """The aircraft, obstacle or holder that it is about; empty: none."""


class Verdict(StrEnum):
    APPROVED = "approved"
    REDUCED = "reduced"
    DELAYED = "delayed"
    REPLACED = "replaced"
    REJECTED = "rejected"


@dataclass(frozen=True)
class Decision:
    """What became of a request and why. Source: paper III-G.

    request_id: None: the way back to the anchor, which nobody asked for. requested_m, granted_m: None for scans. findings: of what was asked; granted_findings: of what was granted.
    """

    request_id: str | None
    primitive: Primitive | None
    verdict: Verdict
    requested_m: float | None
    granted_m: float | None
    findings: tuple[Finding, ...]
    granted_findings: tuple[Finding, ...] = ()
    plan: Plan | None = None
    """What may be flown; None unless approved or reduced."""
    slowness: float = 1.0
    """Where a replacement is offered: how many times slower the same displacement would be safe (design 7)."""

    @property
    def failing(self) -> tuple[Finding, ...]:
        return tuple(f for f in self.findings if not f.passed)


class Mode(StrEnum):
    """The paper's six modes (III)."""

    NORMAL_AUTONOMY = "NormalAutonomy"
    ARMED = "ManeuverResponseArmed"
    ACTIVE = "ManeuverResponseActive"
    BLOCKED = "Blocked"
    EMERGENCY_HOLD = "EmergencyHold"
    RETURN_TO_ANCHOR = "ReturnToAnchor"


class State(StrEnum):
    """The fine states of the mode machine. Source: paper IV-B; those of pairing, settling and delay are the design's."""

    IDLE = "Idle"
    PAIRING = "Pairing"
    FACING = "FacingOperator"
    ARMED = "ManeuverRequestArmed"
    SETTLING = "Settling"
    DETECTED = "ManeuverRequestDetected"
    VALIDATED = "ManeuverRequestValidated"
    DELAYED = "ManeuverDelayed"
    PLANNED = "ManeuverPlanned"
    EXECUTING = "ExecutingBoundedMotion"
    BLOCKED = "Blocked"
    EMERGENCY_HOLD = "EmergencyHold"
    RETURN_TO_ANCHOR = "ReturnToAnchor"


class Cause(StrEnum):
    """Why the mode machine leaves a state."""

    PAIR_REQUESTED = "pair_requested"
    PAIR_ACCEPTED = "pair_accepted"
    PAIR_REFUSED = "pair_refused"
    FACING_OPERATOR = "facing_operator"
    RELEASED = "released"
    AUTHORITY_LOST = "authority_lost"
    REQUEST = "request"
    CONFIDENCE_OK = "confidence_ok"
    CONFIDENCE_LOW = "confidence_low"
    GUARDS_OK = "guards_ok"
    GUARDS_FAILED = "guards_failed"
    DELAY = "delay"
    DELAY_OVER = "delay_over"
    VOLUME_GRANTED = "volume_granted"
    VOLUME_DENIED = "volume_denied"
    DRY_RUN = "dry_run"
    CONTRADICTED = "contradicted"
    TOLD = "told"
    COMPLETED = "completed"
    STOP = "stop"
    INTERRUPTED = "interrupted"
    STALLED = "stalled"
    SETTLED = "settled"
    VIOLATION = "violation"
    RETURN_APPROVED = "return_approved"
    RETURNED = "returned"
