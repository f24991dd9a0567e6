"""The margins of what is granted, as signals of `safety.properties`: from the decisions that the arbiter tells. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterable

from m3r_app.output import RETURN, DecisionEvent, FindingTold
from safety.constraints import RULES
from safety.declarations import INPUT_CONFIDENCE
from safety.vocabulary import Verdict

SIGNAL_OF = {
    "authority": "authority_margin",
    "input_confidence": "input_confidence",
    "localization": "localization_m",
    "terrain_confidence": "terrain_confidence_m",
    "neighbour_age": "neighbour_age_s",
    "envelope": "envelope",
    "workspace": "workspace_m",
    "session": "session_m",
    "geofence": "geofence_m",
    "standoff": "standoff_m",
    "terrain_clearance": "terrain_clearance_m",
    "agl": "agl_m",
    "obstacle_clearance": "obstacle_clearance_m",
    "separation": "separation_m",
    "reservation": "reservation_m",
}
"""The signal of a rule's margin, with its unit where it has one; any other rule's has the rule's name."""


def approved(decisions: Iterable[DecisionEvent]) -> list[DecisionEvent]:
    """Those that grant something."""
    return [one for one in decisions if one.verdict in (Verdict.APPROVED, Verdict.REDUCED)]


def of_granted(found: DecisionEvent) -> tuple[FindingTold, ...]:
    """The findings of what it grants."""
    return found.granted_findings or found.findings


def margins(granting: list[DecisionEvent]) -> dict[str, float]:
    """The least margin of each rule over what is granted, and `least_margin` of them all; 0 where nothing is."""
    least = {rule.name: min((_margin(rule.name, one) for one in granting), default=0.0) for rule in RULES}
    signals = {SIGNAL_OF.get(rule, rule): margin for rule, margin in least.items()}
    return {**signals, "least_margin": min(least.values())}


def _margin(rule: str, decision: DecisionEvent) -> float:
    """Of one rule: infinite where there is nothing to be near to, 0 where what is broken is only mended (X13).

    Minus infinity where the rule was not asked, and where it failed without a number (X6). Nobody asks for a way back, so
    that has no input confidence.
    """
    found = [one for one in of_granted(decision) if one.constraint == rule]
    if not found:
        nobody_asks = decision.request == RETURN and rule == INPUT_CONFIDENCE.name
        return math.inf if nobody_asks else -math.inf
    return min(_of_finding(one) for one in found)


def _of_finding(found: FindingTold) -> float:
    if found.passed:
        return math.inf if found.margin is None else max(found.margin, 0.0)
    return found.margin if found.margin is not None and found.margin < 0.0 else -math.inf
