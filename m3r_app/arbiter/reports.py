"""The arbiter's share of the machine-readable output: one object for each kind of event. Pure.

Source: design "JSON contract". Lengths in m, angles in deg, speeds in m/s; places are east, north, up.
"""

from __future__ import annotations

from typing import Literal

from m3r_app.arbiter.effects import Report
from m3r_app.arbiter.modes import MODE_OF, Cause, State
from m3r_app.arbiter.state import Flight
from safety.frames import enu
from safety.monitor import Breach
from safety.vocabulary import Decision, Finding, ManeuverRequest, Ned


def request(asked: ManeuverRequest, latency_ms: float) -> Report:
    """What a modality has understood."""
    return Report(
        "request",
        {
            "id": asked.id,
            "command": asked.command,
            "modality": asked.modality,
            "confidence": asked.confidence,
            "evidence": asked.evidence,
            "latency_ms": latency_ms,
        },
    )


def mode(previous: State, state: State, cause: Cause) -> Report:
    """A transition of the mode machine."""
    return Report("mode", {"mode": MODE_OF[state], "previous": MODE_OF[previous], "state": state, "cause": cause})


def pair(colour: str, status: Literal["confirmed", "refused", "released"], *reasons: str) -> Report:
    """What has become of a pairing."""
    return Report("pair", {"vehicle": colour, "status": status, "reasons": list(reasons)})


def decision(made: Decision) -> Report:
    """A decision with every finding behind it, not only those that failed."""
    return Report(
        "decision",
        {
            "request": made.request_id,
            "verdict": made.verdict,
            "requested_m": made.requested_m,
            "granted_m": made.granted_m,
            "findings": [_finding(f) for f in made.findings],
            "granted_findings": [_finding(f) for f in made.granted_findings],
        },
    )


def _finding(found: Finding) -> dict[str, object]:
    return {
        "requirements": list(found.requirements),
        "constraint": found.constraint,
        "margin": found.margin,
        "unit": found.unit,
        "passed": found.passed,
        "text": found.text,
    }


def motion(flight: Flight, status: Literal["started", "completed", "aborted"], moved: Ned) -> Report:
    """A maneuver begins or ends; moved: so far, by telemetry."""
    measured = flight.measured
    return Report(
        "motion",
        {
            "request": flight.request_id if flight.asked_for else "return",
            "status": status,
            "displacement_enu_m": list(enu(moved)),
            "yaw_deg": measured.yaw_deg,
            "min_clearance_m": measured.min_clearance_m,
            "min_separation_m": measured.min_separation_m,
            "max_speed_m_s": measured.max_speed_m_s,
        },
    )


def violation(breach: Breach, action: str) -> Report:
    """A hard limit is broken or about to be, and what is done about it."""
    return Report(
        "violation",
        {
            "kind": breach.kind,
            "requirements": list(breach.requirements),
            "constraint": breach.constraint,
            "margin": breach.margin,
            "action": action,
            "text": breach.text,
        },
    )
