"""The arbiter's share of the machine-readable output. Pure."""

from __future__ import annotations

from m3r_app.arbiter.effects import Report
from m3r_app.arbiter.modes import MODE_OF
from m3r_app.arbiter.state import Flight
from m3r_app.output import (
    RETURN,
    Action,
    DecisionEvent,
    FindingTold,
    ModeEvent,
    MotionEvent,
    MotionStatus,
    PairEvent,
    PairStatus,
    RequestEvent,
    ViolationEvent,
)
from safety.frames import enu
from safety.monitor import Breach
from safety.vocabulary import Cause, Decision, Finding, ManeuverRequest, Ned, State


def request(asked: ManeuverRequest, latency_ms: float) -> Report:
    """What a modality has understood."""
    return Report(
        RequestEvent(asked.id, asked.command, asked.modality, asked.confidence, asked.evidence, latency_ms),
    )


def mode(previous: State, state: State, cause: Cause) -> Report:
    """A transition of the mode machine."""
    return Report(ModeEvent(MODE_OF[state], MODE_OF[previous], state, cause))


def pair(colour: str, status: PairStatus, *reasons: str) -> Report:
    """What has become of a pairing."""
    return Report(PairEvent(colour, status, reasons))


def decision(made: Decision) -> Report:
    """A decision with every finding behind it, not only those that failed."""
    return Report(
        DecisionEvent(
            made.request_id or RETURN,
            made.verdict,
            made.requested_m,
            made.granted_m,
            tuple(_told(f) for f in made.findings),
            tuple(_told(f) for f in made.granted_findings),
        )
    )


def _told(found: Finding) -> FindingTold:
    return FindingTold(
        found.requirements, found.constraint, found.margin, found.unit, found.passed, found.text, found.subject
    )


def motion(flight: Flight, status: MotionStatus, moved: Ned) -> Report:
    """A maneuver begins or ends; moved: so far, by telemetry."""
    measured = flight.measured
    return Report(
        MotionEvent(
            flight.request_id if flight.asked_for else RETURN,
            status,
            enu(moved),
            measured.yaw_deg,
            measured.min_clearance_m,
            measured.min_separation_m,
            measured.max_speed_m_s,
        )
    )


def violation(breach: Breach, action: Action) -> Report:
    """A hard limit is broken or about to be, and what is done about it."""
    return Report(
        ViolationEvent(
            breach.kind,
            breach.requirements,
            breach.constraint,
            breach.margin,
            action,
            breach.text,
            breach.subject,
        )
    )
