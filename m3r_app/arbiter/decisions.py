"""From a request to its final decision: judged, perhaps delayed, airspace reserved, judged again, then flown or refused.

Source: paper III-C (Evaluate, Plan), III-G; P2, X10, X12; design 7. The judgement itself is `safety.supervisor`.
"""

from __future__ import annotations

from dataclasses import replace

from m3r_app.arbiter import execution, fusion, reports, wording
from m3r_app.arbiter.announcements import Announce
from m3r_app.arbiter.context import RECHECK_S, Step
from m3r_app.arbiter.effects import Release, Reserve
from m3r_app.arbiter.events import ReservationAnswered
from m3r_app.arbiter.state import Deciding, Leftover, Tally
from m3r_app.output import Notice
from safety.declarations import CONTRADICTION, ENVELOPE, INPUT_CONFIDENCE, LOCALIZATION, RESERVATION
from safety.limits import Limits
from safety.situation import Situation
from safety.supervisor import Intent, assess, decide, interpret, safe
from safety.vocabulary import (
    PRIMITIVE_OF,
    Cause,
    Command,
    Decision,
    Finding,
    ManeuverRequest,
    Plan,
    Primitive,
    State,
    Verdict,
)
from safety.volumes import swept_volume

BACK = Intent(Primitive.RETURN, 0.0)


def is_of_now(request: ManeuverRequest, now_s: float, limits: Limits) -> bool:
    """Whether it was asked a moment ago, at a time that can be. Source: X6."""
    return -limits.request_ahead_s <= now_s - request.captured_at_s <= limits.request_age_s


UNHEARD = LOCALIZATION.unmet("nothing has been heard from the drone")

# ---------------------------------------------------------------- judged


def evaluate(run: Step, request: ManeuverRequest) -> None:
    """Detected -> validated -> planned, or blocked. Source: paper III-C, III-G."""
    intent = intended(run, request)
    run.state = replace(run.state, return_at_s=None)  # if it is refused, the way back is announced anew
    run.go(Cause.REQUEST)
    if isinstance(intent, Finding):
        run.go(Cause.CONFIDENCE_OK)
        refuse(run, request, intent)
        run.go(Cause.GUARDS_FAILED)
        return
    consider(run, request, intent, may_delay=True)


def intended(run: Step, request: ManeuverRequest) -> Intent | Finding:
    """What is asked for. CONTINUE: the way back out of EmergencyHold where it must be asked for, else what is left (X12)."""
    s = run.state
    if request.command is not Command.CONTINUE:
        return interpret(request, s.limits)
    if s.state is State.EMERGENCY_HOLD and s.policy.return_to_anchor == "ask":
        return BACK
    left, within_s = s.leftover, s.limits.continue_within_s
    if left is None:
        return CONTRADICTION.unmet("there is nothing that stop left to continue", "X12")
    if run.now_s - left.at_s > within_s:
        return CONTRADICTION.unmet(f"stop was more than {within_s:.0f} s ago", "X12")
    return Intent(left.primitive, left.left, left.slowness)


def consider(run: Step, request: ManeuverRequest, intent: Intent, *, may_delay: bool) -> None:
    """The supervisor's verdict, and what follows from it."""
    s, situation = run.state, run.situation()
    if situation is None:
        refuse(run, request, UNHEARD)
        run.go(Cause.CONFIDENCE_LOW if s.state is State.DETECTED else Cause.GUARDS_FAILED)
        return
    offer = s.policy.replace == "offer"
    decision = decide(request, intent, situation, s.limits, may_delay=may_delay, offer=offer, rules=s.rules)
    unsure = any(f.constraint == INPUT_CONFIDENCE.name for f in decision.failing)
    if s.state is State.DETECTED:
        run.go(Cause.CONFIDENCE_LOW if unsure else Cause.CONFIDENCE_OK)
    if unsure or decision.verdict in (Verdict.REJECTED, Verdict.REPLACED):
        decided(run, request, decision)
        if decision.verdict is Verdict.REPLACED:
            run.state = replace(
                run.state, leftover=Leftover(intent.primitive, intent.amount, run.now_s, decision.slowness)
            )
        if run.state.state is not State.BLOCKED:
            run.go(Cause.GUARDS_FAILED)
    elif decision.verdict is Verdict.DELAYED:
        decided(run, request, decision)
        run.go(Cause.DELAY)
        deadline_s = run.now_s + s.limits.delay_s
        run.state = replace(
            run.state, deciding=Deciding(request, intent, decision, deadline_s), rechecked_at_s=run.now_s
        )
    else:
        run.go(Cause.GUARDS_OK)
        if s.policy.dry_run:
            decided(run, request, decision)
            run.go(Cause.DRY_RUN)
        else:
            reserve(run, request, intent, decision)


def recheck(run: Step) -> None:
    """A delayed request gets its final decision when nothing hinders it any more, or at its deadline."""
    s, situation = run.state, run.situation()
    deciding = s.deciding
    if s.state is not State.DELAYED or deciding is None or deciding.request is None or situation is None:
        return
    request, intent, over = deciding.request, deciding.intent, run.now_s >= deciding.deadline_s
    if not over and run.now_s - s.rechecked_at_s < RECHECK_S:
        return
    run.state = replace(run.state, rechecked_at_s=run.now_s)
    if not over:
        again = decide(request, intent, situation, s.limits, may_delay=False, rules=s.rules)
        if again.verdict is not Verdict.APPROVED:
            return
    run.state = replace(run.state, deciding=None)
    run.go(Cause.DELAY_OVER)
    consider(run, request, intent, may_delay=False)


# ---------------------------------------------------------------- reserved


def reserve(run: Step, request: ManeuverRequest | None, intent: Intent, decision: Decision) -> None:
    """X10: airspace first, whoever the authority is. The decision's plan is approved. request None: the way back."""
    if decision.plan is None:
        raise RuntimeError("an approved decision carries its plan")
    returns = run.state.returns + (request is None)
    ask_id = request.id if request is not None else f"return-{returns}"
    deadline_s = run.now_s + run.state.limits.reservation_timeout_s
    run.state = replace(run.state, deciding=Deciding(request, intent, decision, deadline_s, ask_id), returns=returns)
    sigma_m, limits = run.vehicle.sigma_m, run.state.limits
    run.do(Reserve(ask_id, swept_volume(decision.plan, run.session.colour, sigma_m, run.now_s, limits)))


def reservation_answered(run: Step, event: ReservationAnswered) -> None:
    """A grant is flown if the plan is still safe; whatever else is said of a volume of ours ends what it was for."""
    deciding, flight, granted = run.state.deciding, run.state.flight, event.answer == "granted"
    if flight is not None and flight.request_id == event.request_id:
        if not granted:
            execution.drop(run, f"the airspace it had reserved is {event.answer}")
        return
    if deciding is None or deciding.ask_id != event.request_id or deciding.decision.plan is None:
        if granted:
            run.do(Release(event.request_id))  # nobody waits for it any more
        return
    if not granted:
        deny(run, deciding, event.reason or f"the volume was {event.answer}")
        return
    plan, situation = deciding.decision.plan, run.situation()
    findings = (UNHEARD,) if situation is None else revalidate(run, deciding, plan, situation)
    if situation is None or not safe(findings):
        run.do(Release(event.request_id))
        turn_down(run, deciding, findings, Cause.GUARDS_FAILED)
        return
    run.state = replace(run.state, deciding=None, leftover=None)
    if deciding.request is not None:
        decided(run, deciding.request, deciding.decision)
    execution.begin(run, event.request_id, plan, situation, findings, asked_for=deciding.request is not None)


def revalidate(run: Step, deciding: Deciding, plan: Plan, situation: Situation) -> tuple[Finding, ...]:
    """X10: airspace took its time; is the plan still safe, and the drone still where it starts?"""
    limits = run.state.limits
    findings = assess(plan, deciding.request, situation, limits, run.state.rules)
    off_m = situation.vehicle.position.minus(plan.start).norm
    if off_m <= limits.tracking_m:
        return findings
    away = f"the drone is {off_m:.2f} m from where the plan starts"
    return (*findings, ENVELOPE.finding(limits.tracking_m - off_m, "m", passed=False, text=away))


def overdue(run: Step) -> None:
    """The authority has not answered in time, or a delay is over."""
    deciding = run.state.deciding
    if deciding is not None and run.state.state is not State.DELAYED and run.now_s > deciding.deadline_s:
        give_back(run, deciding)
        deny(run, deciding, "its authority did not answer")
    recheck(run)


# ---------------------------------------------------------------- decided


def deny(run: Step, deciding: Deciding, reason: str) -> None:
    """The authority says no, or nothing."""
    denied = RESERVATION.unmet(f"the airspace is not ours: {reason}")
    others = tuple(f for f in deciding.decision.findings if f.constraint != denied.constraint)
    turn_down(run, deciding, (*others, denied), Cause.VOLUME_DENIED)


def turn_down(run: Step, deciding: Deciding, findings: tuple[Finding, ...], cause: Cause) -> None:
    """What had been approved is rejected after all; the way back is tried again a little later."""
    run.state = replace(run.state, deciding=None)
    if deciding.request is None:
        run.state = replace(
            run.state, return_at_s=None, return_judged_from_s=run.now_s + run.state.limits.delay_s + RECHECK_S
        )
        run.tell(Notice.NOT_RETURNING_YET, wording.reasons(findings))
        return
    decision = replace(
        deciding.decision,
        verdict=Verdict.REJECTED,
        granted_m=None,
        plan=None,
        findings=findings,
        granted_findings=(),
    )
    decided(run, deciding.request, decision)
    run.go(cause)


def withdraw(run: Step, why: str, requirement: str) -> None:
    """Whatever waits for its final decision gets it: rejected."""
    deciding, pending = run.state.deciding, run.state.pending
    run.state = replace(run.state, deciding=None, pending=None)
    if deciding is not None:
        give_back(run, deciding)
        if deciding.request is not None:
            refuse(run, deciding.request, CONTRADICTION.unmet(why, requirement))
    if pending is not None:
        refuse(run, pending, CONTRADICTION.unmet(why, requirement))


def give_back(run: Step, deciding: Deciding) -> None:
    """The airspace that was asked for, if any was, is not wanted any more."""
    if deciding.ask_id is not None:
        run.do(Release(deciding.ask_id))


def refuse(run: Step, request: ManeuverRequest, finding: Finding) -> None:
    """Rejected without having been judged, for this one reason."""
    primitive = PRIMITIVE_OF.get(request.command)
    decided(run, request, Decision(request.id, primitive, Verdict.REJECTED, None, None, (finding,)))


def decided(run: Step, request: ManeuverRequest, decision: Decision) -> None:
    """Report a decision; a final one is counted."""
    if decision.verdict is Verdict.REJECTED and decision.requested_m is None:
        decision = replace(decision, requested_m=_asked_m(run, request))
    run.do(reports.decision(decision))
    match decision.verdict:
        case Verdict.APPROVED | Verdict.REDUCED:
            run.count(Tally(approved=1))
        case Verdict.REJECTED | Verdict.REPLACED:
            run.count(Tally(rejected=1))
            if is_of_now(request, run.now_s, run.state.limits):
                remember(run, request, refused=True)
    colour = run.state.session.colour if run.state.session is not None else ""
    dry_run = run.state.policy.dry_run
    run.do(Announce(Notice.DECIDED, colour, decision=decision, asked=wording.asked(request), dry_run=dry_run))


def remember(run: Step, request: ManeuverRequest, *, refused: bool = False) -> None:
    """For what the next request of another modality has to do with it. Source: X5."""
    limits = run.state.limits
    kept_s = 2.0 * limits.fusion_window_s + limits.request_age_s
    run.state = replace(
        run.state, recent=fusion.remember(run.state.recent, request, run.now_s - kept_s, refused=refused)
    )


def _asked_m(run: Step, request: ManeuverRequest) -> float | None:
    if request.command is Command.CONTINUE:
        return None
    intent = interpret(request, run.state.limits)
    return None if intent.primitive.is_scan else intent.amount
