"""The machine-readable output: a frozen type for each event, and its JSON. docs/output.md and its schema are made from here.

Lengths in m, angles in deg, speeds in m/s. A number that does not exist is null. What stands beside a field in `Annotated` is
what the documentation says of it. Source: design "JSON contract".
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from typing import Annotated, Any, ClassVar, Literal, Protocol, TypeVar

from m3r_app.plain import plain
from safety.vocabulary import Cause, Command, Geodetic, Modality, Mode, State, Verdict

DECIMALS = 7
"""A centimetre of latitude, a tenth of a microsecond."""


RETURN = "return"
"""How the output calls the way back to the anchor that nobody asked for."""


class PairStatus(StrEnum):
    """How far a pairing is."""

    REQUESTED = "requested"
    CONFIRMED = "confirmed"
    REFUSED = "refused"
    RELEASED = "released"


class MotionStatus(StrEnum):
    """What a maneuver does."""

    STARTED = "started"
    COMPLETED = "completed"
    ABORTED = "aborted"


class Action(StrEnum):
    """What is done about a broken limit."""

    ABORT = "abort"
    HOLD = "hold"
    MENDING = "none, the plan mends it"


class EndReason(StrEnum):
    """Why a run is over."""

    INPUTS_PLAYED = "inputs_played"
    INTERRUPTED = "interrupted"
    TIMEOUT = "timeout"
    VEHICLE_LOST = "vehicle_lost"
    ERROR = "error"


class Notice(StrEnum):
    """What an announcement tells. Whoever acts on one looks at this; the sentence is for people alone."""

    # The arbiter's
    DECIDED = "decided"
    DONE = "done"
    HOLDING = "holding"
    NOTHING_TO_HOLD = "nothing_to_hold"
    DROPPED = "dropped"
    ABORTED = "aborted"
    LIMIT_BROKEN = "limit_broken"
    HELD_ANEW = "held_anew"
    RETURNING_SOON = "returning_soon"
    NOT_RETURNING_YET = "not_returning_yet"
    ASKS_TO_RETURN = "asks_to_return"
    PAIRED = "paired"
    ALREADY_PAIRED = "already_paired"
    ALREADY_PAIRING = "already_pairing"
    NOT_PAIRED = "not_paired"
    NOT_PAIRING = "not_pairing"
    NOTHING_TO_DISCONNECT = "nothing_to_disconnect"
    NOT_DISCONNECTED = "not_disconnected"
    LET_GO = "let_go"
    # The run's
    TAKING_OFF = "taking_off"
    LANDING = "landing"
    VEHICLE_SILENT = "vehicle_silent"
    VEHICLE_ERROR = "vehicle_error"
    FAULT = "fault"
    INPUT_DAMAGED = "input_damaged"
    INFORMATION = "information"
    # The senses': as `modalities.notices.SenseChange` names them
    VOICE_GONE = "voice_gone"
    VOICE_BACK = "voice_back"
    VOICE_OFF = "voice_off"
    HANDS_NOT_SEEN = "hands_not_seen"
    HANDS_SEEN_AGAIN = "hands_seen_again"
    HANDS_OFF = "hands_off"


class Announcing(Protocol):
    """Tell the operator one sentence."""

    def __call__(self, sentence: str, notice: Notice = Notice.INFORMATION, /) -> None: ...


Enu = tuple[float | None, float | None, float | None]
Metres = float | None


@dataclass(frozen=True, slots=True)
class FindingTold:
    """What one rule says of one plan. Source: paper III-G."""

    requirements: Annotated[tuple[str, ...], "ids of `safety/requirements.py`"]
    constraint: Annotated[str, "the rule"]
    margin: Annotated[float | None, "how far from the limit, negative: broken; null: there is no such distance"]
    unit: Annotated[str, "of the margin; empty: none"]
    passed: Annotated[bool, "whether it permits the plan; so does a broken limit that the plan only mends"]
    text: Annotated[str, "one sentence for people; its wording may change"]
    subject: Annotated[str, "the aircraft, obstacle or holder that it is about; empty: none"] = ""


@dataclass(frozen=True, slots=True)
class RequestEvent:
    """A modality has understood a request, or a second one has confirmed it (same id)."""

    name: ClassVar[str] = "request"

    id: Annotated[str, "of this request"]
    command: Command
    modality: Modality
    confidence: Annotated[float | None, "0 to 1"]
    evidence: Annotated[str, "the words or the gesture"]
    latency_ms: Annotated[float | None, "from the end of the evidence to the request"]


@dataclass(frozen=True, slots=True)
class PairEvent:
    """What becomes of a pairing."""

    name: ClassVar[str] = "pair"

    vehicle: Annotated[str, "the drone's colour"]
    status: PairStatus
    reasons: Annotated[tuple[str, ...], "sentences: why it was refused or released"] = ()
    operator: Annotated[Geodetic | None, "where the operator is: degrees north, degrees east, m AMSL"] = None
    vehicle_position: Annotated[Geodetic | None, "where the drone is, likewise; null: unknown"] = None


@dataclass(frozen=True, slots=True)
class DecisionEvent:
    """A decision with every finding behind it, not only those that failed. `delayed` is followed by a final one."""

    name: ClassVar[str] = "decision"

    request: Annotated[str, "id of the request"]
    verdict: Verdict
    requested_m: Annotated[Metres, "length that was asked for; null: a turn, or none"]
    granted_m: Annotated[Metres, "length that is flown; null: a turn, or nothing"]
    findings: Annotated[tuple[FindingTold, ...], "of what was asked for"]
    granted_findings: Annotated[tuple[FindingTold, ...], "of what was granted"] = ()

    @property
    def failing(self) -> tuple[FindingTold, ...]:
        return tuple(f for f in self.findings if not f.passed)


@dataclass(frozen=True, slots=True)
class ModeEvent:
    """A transition of the mode machine. Source: paper IV-B."""

    name: ClassVar[str] = "mode"

    mode: Mode
    previous: Mode
    state: Annotated[State, "the fine state that is entered"]
    cause: Cause


@dataclass(frozen=True, slots=True)
class MotionEvent:
    """A maneuver begins or ends; what is measured is so far, by telemetry."""

    name: ClassVar[str] = "motion"

    request: Annotated[str, 'id of the request; "return": the way back to the anchor, which nobody asked for']
    status: MotionStatus
    displacement_enu_m: Annotated[Enu, "east, north, up"]
    yaw_deg: Annotated[float | None, "turned clockwise"]
    min_clearance_m: Annotated[Metres, "least, to terrain and obstacles"]
    min_separation_m: Annotated[Metres, "least, to another aircraft"]
    max_speed_m_s: float | None


@dataclass(frozen=True, slots=True)
class ViolationEvent:
    """A hard limit is broken, or will be unless the maneuver is aborted."""

    name: ClassVar[str] = "violation"

    kind: Annotated[Literal["actual", "predicted"], "whether it is broken, or about to be"]
    requirements: Annotated[tuple[str, ...], "ids of `safety/requirements.py`"]
    constraint: Annotated[str, "the rule"]
    margin: Annotated[float | None, "how far from the limit; negative: broken"]
    action: Annotated[Action, "what is done about it"]
    text: Annotated[str, "one sentence for people; its wording may change"]
    subject: Annotated[str, "the aircraft, obstacle or holder that it is about; empty: none"] = ""


@dataclass(frozen=True, slots=True)
class AnnounceEvent:
    """What the operator is told."""

    name: ClassVar[str] = "announce"

    text: Annotated[str, "one sentence for people; its wording may change"]
    notice: Annotated[Notice, "what it tells: for programs"] = Notice.INFORMATION


@dataclass(frozen=True, slots=True)
class EndEvent:
    """The last event of every run."""

    name: ClassVar[str] = "end"

    reason: EndReason
    requests: int
    approved: Annotated[int, "requests approved or reduced"]
    completed: Annotated[int, "motions that somebody asked for"]
    aborted: Annotated[int, "motions that somebody asked for"]
    rejected: Annotated[int, "requests rejected or replaced"]
    violations: Annotated[int, "of a hard limit, actual, that were ours to keep"]


OutputEvent = (
    RequestEvent | PairEvent | DecisionEvent | ModeEvent | MotionEvent | ViolationEvent | AnnounceEvent | EndEvent
)
EVENT_TYPES: tuple[type[OutputEvent], ...] = (
    RequestEvent,
    PairEvent,
    DecisionEvent,
    ModeEvent,
    MotionEvent,
    ViolationEvent,
    AnnounceEvent,
    EndEvent,
)


@dataclass(frozen=True, slots=True)
class Told:
    """An event of the output, t_s seconds after the run began."""

    t_s: float
    event: OutputEvent


Event = TypeVar("Event", bound=OutputEvent)


def known(event: Event) -> Event:
    """The same, but numbers that do not exist (NaN, infinite) are None."""
    return replace(event, **{field.name: _known(getattr(event, field.name)) for field in fields(event)})


def _known(value: Any) -> Any:
    match value:
        case float():
            return value if math.isfinite(value) else None
        case FindingTold():
            return value if value.margin is None else replace(value, margin=_known(value.margin))
        case tuple() if not hasattr(value, "_fields"):
            return tuple(_known(item) for item in value)
    return value


def fields_of(event: OutputEvent) -> dict[str, object]:
    """Its fields by name, in the order in which they are told; enums and floats as they are."""
    return {field.name: _value(getattr(event, field.name)) for field in fields(event)}


def _value(value: object) -> object:
    match value:
        case FindingTold():
            return {field.name: _value(getattr(value, field.name)) for field in fields(value)}
        case tuple():
            return [_value(item) for item in value]
    return value


def line(told: Told) -> str:
    """One line of strict JSON, `t` and `event` first. Numbers that do not exist are null; only ASCII, whatever was said."""
    values = {"t": told.t_s, "event": told.event.name, **fields_of(told.event)}
    return json.dumps(_rounded(plain(values, lossless=False)), allow_nan=False)


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return round(value, DECIMALS) + 0.0  # no -0.0
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    return value
