"""Events of the output for tests, told by the fields that matter to them; the rest is what it usually is."""

from __future__ import annotations

from typing import Any

from m3r_app.output import Told, known
from m3r_app.output_schema import event_of

FINDING: dict[str, Any] = {
    "requirements": ["R3"],
    "constraint": "obstacle_clearance",
    "margin": -0.1,
    "unit": "m",
    "passed": False,
    "text": "0.1 m too close to the wall",
}
USUAL: dict[str, dict[str, Any]] = {
    "request": {
        "id": "r1",
        "command": "go_left",
        "modality": "voice",
        "confidence": 0.9,
        "evidence": "",
        "latency_ms": 5.0,
    },
    "pair": {"vehicle": "red", "status": "confirmed"},
    "decision": {"request": "r1", "verdict": "approved", "requested_m": 1.0, "granted_m": None, "findings": []},
    "mode": {"mode": "Blocked", "previous": "ManeuverResponseArmed", "state": "Blocked", "cause": "guards_failed"},
    "motion": {
        "request": "r1",
        "status": "completed",
        "displacement_enu_m": [1.0, 0.0, 0.0],
        "yaw_deg": 0.0,
        "min_clearance_m": None,
        "min_separation_m": None,
        "max_speed_m_s": 0.5,
    },
    "violation": {
        **{k: v for k, v in FINDING.items() if k not in ("passed", "unit")},
        "kind": "actual",
        "action": "abort",
    },
    "announce": {"text": "moved 1 m left"},
    "end": {
        "reason": "inputs_played",
        "requests": 0,
        "approved": 0,
        "completed": 0,
        "aborted": 0,
        "rejected": 0,
        "violations": 0,
    },
}


def told(event: str, t_s: float = 1.0, **fields: Any) -> Told:
    """The event of that name with these fields."""
    values = {**USUAL[event], **fields}
    for findings in ("findings", "granted_findings"):
        if findings in values:
            values[findings] = [{**FINDING, **found} for found in values[findings]]
    return Told(t_s, known(event_of(event, values)))
