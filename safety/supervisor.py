"""The safety decision: Safe(pi) as a conjunction of rules; shorten, delay, replace or reject what is not.

Pure: numbers in, decision out. Source: paper III-G, P2, P3, R3-R8, R11, design 7, 8.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from safety.constraints import RULES, PathRule, Rule, findings, nearby
from safety.declarations import LOCALIZATION, NEIGHBOUR_AGE
from safety.length_search import Tried, longest_passing
from safety.limits import Limits
from safety.planner import full_length_m, length_reaching_m, plan_return, plan_scan, plan_translation, stopping_m, swept
from safety.situation import Situation
from safety.vocabulary import (
    PRIMITIVE_OF,
    Decision,
    Finding,
    ManeuverRequest,
    Path,
    Plan,
    Primitive,
    Profile,
    Verdict,
)

FULL_TURN_DEG = 360.0
DELAY_STEP_S = 0.5
BEFORE_LEASE_S = 0.05
SLOWER = (2.0, 4.0)
"""What a replacement divides the speed by."""


@dataclass(frozen=True, slots=True)
class Intent:
    """What a request means: a primitive and how much of it (m; degrees for a scan). Source: R1."""

    primitive: Primitive
    amount: float
    slowness: float = 1.0


def interpret(request: ManeuverRequest, limits: Limits) -> Intent:
    """intent = Interpret(g). Raises KeyError for commands that are no maneuver."""
    primitive = PRIMITIVE_OF[request.command]
    return Intent(primitive, FULL_TURN_DEG if primitive.is_scan else full_length_m(primitive, limits))


def propose(intent: Intent, situation: Situation, limits: Limits) -> Plan:
    """pi_cand = Plan(intent, x). Raises ValueError where the operator's frame has no such direction."""
    vehicle, operator = situation.vehicle, situation.operator.position
    if intent.primitive is Primitive.RETURN:
        anchor = situation.anchor
        return plan_return(vehicle.position, vehicle.yaw_deg, operator, anchor.position, limits, anchor.yaw_deg)
    if intent.primitive.is_scan:
        return plan_scan(intent.primitive, vehicle.position, vehicle.yaw_deg, operator, intent.amount, limits)
    return plan_translation(
        intent.primitive, vehicle.position, vehicle.yaw_deg, operator, intent.amount, limits, intent.slowness
    )


def over_in_time(plan: Plan, situation: Situation, limits: Limits) -> Plan:
    """The plan with a maximum duration that ends before the next lease of somebody else begins. Source: R5, X10.

    Only a lease that begins when the plan should long be over shortens it; one that begins before stands in its way.
    """
    begins_s = max(plan.duration_s + limits.lag_s, limits.horizon_s)
    starts_s = (volume.from_s - situation.now_s for volume in situation.reservations)
    later_s = min((s for s in starts_s if begins_s < s <= plan.max_duration_s), default=math.inf)
    return replace(plan, max_duration_s=later_s - BEFORE_LEASE_S) if later_s < math.inf else plan


def assess(
    plan: Plan, request: ManeuverRequest | None, situation: Situation, limits: Limits, rules: tuple[Rule, ...] = RULES
) -> tuple[Finding, ...]:
    """Every rule's finding on the plan; all are reported, not the first. request None: nobody asked (return)."""
    return findings(swept(plan, limits), situation, limits, plan, request, rules)


def safe(found: Iterable[Finding]) -> bool:
    """Safe := the conjunction."""
    return all(f.passed for f in found)


def decide(
    request: ManeuverRequest,
    intent: Intent,
    situation: Situation,
    limits: Limits,
    *,
    may_delay: bool = True,
    offer: bool = False,
    rules: tuple[Rule, ...] = RULES,
) -> Decision:
    """What becomes of a request in this situation. Never raises for bad data: what cannot be judged is rejected."""
    try:
        plan = propose(intent, situation, limits)
    except ValueError as error:
        finding = LOCALIZATION.unmet(str(error))
        return Decision(request.id, intent.primitive, Verdict.REJECTED, _metres(intent), None, (finding,))
    return decide_plan(
        request.id, plan, request, situation, limits, intent, may_delay=may_delay, offer=offer, rules=rules
    )


def decide_plan(
    request_id: str | None,
    plan: Plan,
    request: ManeuverRequest | None,
    situation: Situation,
    limits: Limits,
    intent: Intent | None = None,
    *,
    may_delay: bool = False,
    offer: bool = False,
    rules: tuple[Rule, ...] = RULES,
) -> Decision:
    """Filter(pi_cand, T, D, C): approve, delay, shorten, offer a slower one, or reject.

    intent None: the plan is all or nothing.
    """
    plan = over_in_time(plan, situation, limits)
    path = swept(plan, limits)
    scene = nearby(situation, path, limits)
    found = findings(path, scene, limits, plan, request, rules)
    asked_m = None if plan.primitive.is_scan else plan.length_m
    if safe(found):
        return Decision(request_id, plan.primitive, Verdict.APPROVED, asked_m, asked_m, found, found, plan)
    no = Decision(request_id, plan.primitive, Verdict.REJECTED, asked_m, None, found)
    if intent is None:
        return no
    if may_delay and clears_within(path, found, situation, limits, rules):
        return replace(no, verdict=Verdict.DELAYED)
    shorter = shorten(plan, request, found, intent, situation, limits, rules, Cut(scene, path))
    if shorter is not None:
        granted, granted_findings = shorter
        return replace(
            no, verdict=Verdict.REDUCED, granted_m=granted.length_m, granted_findings=granted_findings, plan=granted
        )
    slowness = slower(request, intent, situation, limits, rules) if offer else None
    return no if slowness is None else replace(no, verdict=Verdict.REPLACED, slowness=slowness)


class Cut(NamedTuple):
    """A situation without what cannot matter on this path, nor on shorter ones that end no later (`nearby`)."""

    scene: Situation
    path: Path


class Attempt(NamedTuple):
    """A shorter plan that was tried, and what the rules searched with said of it."""

    plan: Plan
    path: Path
    scene: Situation
    said: list[Finding]


def shorten(
    plan: Plan,
    request: ManeuverRequest | None,
    found: tuple[Finding, ...],
    intent: Intent,
    situation: Situation,
    limits: Limits,
    rules: tuple[Rule, ...],
    cut: Cut,
) -> tuple[Plan, tuple[Finding, ...]] | None:
    """The longest safe plan along the same line, to the bisection step; None if none of the shortest length is safe.

    Searches with the rules that failed; what comes out is judged by all of them, and if that brings up another rule (only
    timed rules can), searches with that one too. Scans are never shortened. Source: P3, R4, R6, design 7.
    """
    if plan.primitive.is_scan or plan.length_m <= limits.shortest_m:
        return None
    failed = [f for f in found if not f.passed]
    by_name = {rule.name: rule for rule in rules if isinstance(rule, PathRule)}
    until_s = cut.path.times_s[-1]
    slowest_m_s = Profile(limits.shortest_m, plan.move.speed, plan.move.acceleration).peak
    while {f.constraint for f in failed} <= by_name.keys():
        searched = [by_name[f.constraint] for f in failed]
        tried: dict[float, Attempt] = {}

        def attempt(reach_m: float, searched: list[PathRule] = searched, tried: dict[float, Attempt] = tried) -> Tried:
            length_m = max(length_reaching_m(reach_m, plan.move.speed, limits), limits.shortest_m)
            shorter = over_in_time(propose(replace(intent, amount=length_m), situation, limits), situation, limits)
            path = swept(shorter, limits)
            # A nose that turns farther for the shorter move may make it last longer: then others fly on for longer.
            scene = cut.scene if path.times_s[-1] <= until_s else nearby(situation, path, limits)
            said = [rule.check(path, scene, limits) for rule in searched]
            tried[reach_m] = Attempt(shorter, path, scene, said)
            return outcome(said)

        # Margins are even in how far the path reaches, which grows faster than its length: the coasting grows too.
        granted = longest_passing(
            attempt,
            limits.shortest_m + stopping_m(slowest_m_s, limits),
            plan.length_m + plan.stop_m,
            outcome(failed),
            limits.bisection_m,
        )
        if granted is None:
            return None
        shorter, path, scene, said = tried[granted]
        others = tuple(rule for rule in rules if rule not in searched)
        by_rule = {f.constraint: f for f in (*said, *findings(path, scene, limits, shorter, request, others))}
        judged = tuple(by_rule[rule.name] for rule in rules if rule.name in by_rule)
        if safe(judged):
            return shorter, judged
        # Those that were searched with all pass here, so every one that fails is new.
        failed += [f for f in judged if not f.passed]
    return None


def outcome(found: Sequence[Finding]) -> Tried:
    """Whether all pass, and the smallest margin of them; -inf if one has none."""
    return safe(found), min(f.margin if f.margin is not None else -math.inf for f in found)


def clears_within(
    path: Path, found: tuple[Finding, ...], situation: Situation, limits: Limits, rules: tuple[Rule, ...]
) -> bool:
    """Whether the one failing constraint is about to clear by itself. Source: design 7 (delayed)."""
    failing = {f.constraint for f in found if not f.passed}
    (rule,) = [rule for rule in rules if rule.name in failing] if len(failing) == 1 else [None]
    if not isinstance(rule, PathRule) or not rule.constraint.clears:
        return False
    if rule.constraint is NEIGHBOUR_AGE:
        return situation.now_s - situation.neighbours.feed_at_s <= limits.neighbour_age_s + limits.delay_s
    steps = int(limits.delay_s / DELAY_STEP_S)
    # Seen from later on, the same states have aged by nothing but the waiting: what is fresh now stays fresh.
    return any(rule.check(path, later(situation, (i + 1) * DELAY_STEP_S), limits).passed for i in range(steps))


def later(situation: Situation, wait_s: float) -> Situation:
    """The situation wait_s from now if everybody flies straight on and keeps being heard."""
    neighbours = situation.neighbours
    moved = replace(
        neighbours,
        positions_ned_m=neighbours.positions_ned_m + wait_s * neighbours.velocities_ned_m_s,
        at_s=neighbours.at_s + wait_s,
        feed_at_s=neighbours.feed_at_s + wait_s,
    )
    return replace(situation, now_s=situation.now_s + wait_s, neighbours=moved)


def slower(
    request: ManeuverRequest | None, intent: Intent, situation: Situation, limits: Limits, rules: tuple[Rule, ...]
) -> float | None:
    """How many times slower the same displacement would be safe; None if it never is. Source: design 7 (replaced)."""
    if intent.primitive.is_scan:
        return None
    for slowness in SLOWER:
        plan = over_in_time(propose(replace(intent, slowness=slowness), situation, limits), situation, limits)
        path = swept(plan, limits)
        # It lasts longer and reaches others, so what was left out for the faster one may matter.
        scene = nearby(situation, path, limits)
        if safe(findings(path, scene, limits, plan, request, rules)):
            return slowness
    return None


def _metres(intent: Intent) -> float | None:
    return None if intent.primitive.is_scan else intent.amount
