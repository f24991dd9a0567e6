"""The safety decision: Safe(pi) as a conjunction of rules; shorten, delay, replace or reject what is not.

Pure: numbers in, decision out. Source: paper III-G, P2, P3, R3-R8, R11, design 7, 8.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from safety.constraints import RULES, Rule, Subject, findings, nearby
from safety.limits import Limits
from safety.planner import full_length_m, plan_return, plan_scan, plan_translation, swept
from safety.situation import Situation
from safety.vocabulary import (
    PRIMITIVE_OF,
    Decision,
    Finding,
    ManeuverRequest,
    Plan,
    Primitive,
    Verdict,
)

FULL_TURN_DEG = 360.0
PASSING = frozenset({"separation", "reservation", "neighbour_age"})
"""Constraints that may clear by themselves: somebody flies on, a lease ends, a state gets fresh."""
DELAY_STEP_S = 0.5
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
        return plan_return(vehicle.position, vehicle.yaw_deg, operator, situation.anchor.position, limits)
    if intent.primitive.is_scan:
        return plan_scan(intent.primitive, vehicle.position, vehicle.yaw_deg, operator, intent.amount, limits)
    return plan_translation(
        intent.primitive, vehicle.position, vehicle.yaw_deg, operator, intent.amount, limits, intent.slowness
    )


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
        finding = Finding("localization", ("R11", "X6"), None, "", passed=False, text=str(error))
        return Decision(request.id, intent.primitive, Verdict.REJECTED, _metres(intent), None, (finding,))
    return decide_plan(
        request.id, plan, request, situation, limits, intent, may_delay=may_delay, offer=offer, rules=rules
    )


def decide_plan(
    request_id: str,
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
    scene = nearby(situation, swept(plan, limits), limits)
    found = assess(plan, request, scene, limits, rules)
    asked_m = None if plan.primitive.is_scan else plan.length_m
    if safe(found):
        return Decision(request_id, plan.primitive, Verdict.APPROVED, asked_m, asked_m, found, found, plan)
    no = Decision(request_id, plan.primitive, Verdict.REJECTED, asked_m, None, found)
    if intent is None:
        return no
    if may_delay and clears_within(plan, found, situation, limits, rules):
        return replace(no, verdict=Verdict.DELAYED)
    shorter = shorten(plan, request, found, intent, scene, limits, rules)
    if shorter is not None:
        granted, granted_findings = shorter
        return replace(
            no, verdict=Verdict.REDUCED, granted_m=granted.length_m, granted_findings=granted_findings, plan=granted
        )
    slowness = slower(request, intent, scene, limits, rules) if offer else None
    return no if slowness is None else replace(no, verdict=Verdict.REPLACED, slowness=slowness)


def shorten(
    plan: Plan,
    request: ManeuverRequest | None,
    found: tuple[Finding, ...],
    intent: Intent,
    scene: Situation,
    limits: Limits,
    rules: tuple[Rule, ...] = RULES,
) -> tuple[Plan, tuple[Finding, ...]] | None:
    """The longest safe plan along the same line, to the bisection step; None if none of the shortest length is safe.

    Bisects on the rules that failed; what comes out is judged by all of them, and if that brings up another rule (only
    timed rules can), bisects on that one too. Scans are never shortened. Source: P3, R4, R6, design 7.
    """
    if plan.primitive.is_scan or plan.length_m <= limits.shortest_m:
        return None
    by_name = {rule.name: rule for rule in rules if rule.subject is Subject.PATH}
    failing = {f.constraint for f in found if not f.passed}
    while failing <= by_name.keys():
        bisected = [by_name[name] for name in by_name if name in failing]

        def fits(length_m: float, bisected: list[Rule] = bisected) -> bool:
            path = swept(propose(replace(intent, amount=length_m), scene, limits), limits)
            return all(rule.check(path, scene, limits).passed for rule in bisected)

        if not fits(limits.shortest_m):
            return None
        low_m, high_m = limits.shortest_m, plan.length_m
        while high_m - low_m > limits.bisection_m:
            middle_m = 0.5 * (low_m + high_m)
            low_m, high_m = (middle_m, high_m) if fits(middle_m) else (low_m, middle_m)
        shorter = propose(replace(intent, amount=low_m), scene, limits)
        judged = assess(shorter, request, scene, limits, rules)
        if safe(judged):
            return shorter, judged
        more = {f.constraint for f in judged if not f.passed} - failing
        if not more:
            return None
        failing |= more
    return None


def clears_within(
    plan: Plan, found: tuple[Finding, ...], situation: Situation, limits: Limits, rules: tuple[Rule, ...]
) -> bool:
    """Whether the one failing constraint is about to clear by itself. Source: design 7 (delayed)."""
    failing = [f.constraint for f in found if not f.passed]
    if len(failing) != 1 or failing[0] not in PASSING:
        return False
    if failing[0] == "neighbour_age":
        return situation.now_s - situation.neighbours.feed_at_s <= limits.neighbour_age_s + limits.delay_s
    rule = next(rule for rule in rules if rule.name == failing[0])
    path = swept(plan, limits)
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
    request: ManeuverRequest | None, intent: Intent, scene: Situation, limits: Limits, rules: tuple[Rule, ...]
) -> float | None:
    """How many times slower the same displacement would be safe; None if it never is. Source: design 7 (replaced)."""
    if intent.primitive.is_scan:
        return None
    for slowness in SLOWER:
        plan = propose(replace(intent, slowness=slowness), scene, limits)
        if safe(assess(plan, request, scene, limits, rules)):
            return slowness
    return None


def _metres(intent: Intent) -> float | None:
    return None if intent.primitive.is_scan else intent.amount
