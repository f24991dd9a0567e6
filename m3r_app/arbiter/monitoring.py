"""The runtime monitor's part of a step: EmergencyHold when a hard limit is or will be broken, and the way back from there.

Source: R9, R10, X13, paper III-C (Monitor, Recover), design 14. The look itself is `safety.monitor`.
"""

from __future__ import annotations

from dataclasses import replace

from m3r_app.arbiter import decisions, execution, reports, wording
from m3r_app.arbiter.context import RECHECK_S, Step
from m3r_app.arbiter.effects import FaceOperator, Hold
from m3r_app.arbiter.state import Suspected
from m3r_app.output import Action, MotionStatus, Notice
from safety.estimate import jump
from safety.frames import bearing_deg
from safety.monitor import Breach, watch
from safety.planner import plan_return
from safety.supervisor import decide_plan
from safety.vocabulary import Cause, State, VehicleState, Verdict


def monitor(run: Step) -> bool:
    """Check everything hard on the measured state; abort if something is or will be broken. True: all well."""
    s, situation = run.state, run.situation()
    flight = s.flight
    if situation is None or (flight is None and run.now_s - s.checked_at_s < RECHECK_S):
        return True
    run.state = replace(run.state, checked_at_s=run.now_s)
    plan = flight.plan if flight else None
    elapsed_s = run.now_s - flight.started_at_s if flight else 0.0
    baseline = flight.baseline if flight else {}
    seen = watch(situation, plan, elapsed_s, s.speed_m_s, baseline, s.limits, s.rules)
    broken = [b for b in seen.breaches if b.kind == "actual"]
    news = [b for b in broken if b.constraint not in s.breached]
    run.state = replace(run.state, breached=frozenset(b.constraint for b in broken))
    if flight is not None:
        execution.measure_distances(run, flight, seen)
        aborts = [b for b in seen.breaches if not b.mending]
        if aborts:
            emergency(run, aborts, news)
            return False
    for breach in news:
        _report(run, breach, Action.MENDING if flight else Action.HOLD)
    if news:
        run.tell(Notice.LIMIT_BROKEN, wording.told(news))
    return True


def confirm(run: Step, vehicle: VehicleState) -> None:
    """What was suspected before the drone last told its mode was ours: the session would be over otherwise. Source: X3."""
    if run.state.down_since_s is not None:
        return  # what this is will be known in a moment
    waiting = tuple(s for s in run.state.suspected if not vehicle.mode_at_s >= s.at_s)
    for suspected in run.state.suspected:
        if suspected not in waiting:
            run.violated(suspected)
    run.state = replace(run.state, suspected=waiting)


def jumped(run: Step, vehicle: VehicleState, last: VehicleState) -> bool:
    """Whether the estimate has jumped: then the drone holds where it now believes to be, and is not moved there. Source: X6."""
    off = jump(vehicle, last)
    if not off.norm > run.state.limits.jump_m or run.now_s - last.at_s > run.state.limits.telemetry_age_s:
        return False
    session = run.session
    if session.centre is not None:
        # The places of the session are what they were; what they are called has changed.
        run.state = replace(run.state, session=replace(session, centre=session.centre.plus(off), hover=()))
    if run.state.flight is not None:
        run.state = replace(run.state, flight=replace(run.state.flight, origin=run.state.flight.origin.plus(off)))
    hold_anew(run, f"its position estimate jumped by {off.norm:.1f} m")
    return True


def hold_anew(run: Step, why: str) -> None:
    """The drone may not be drawn to a place that has moved: it holds where it is, the anchor with it."""
    s = run.state
    if s.session is None or s.vehicle is None:
        return
    run.do(Hold("estimate moved"))
    if s.state is State.FACING:
        run.state = replace(run.state, session=replace(s.session, hover=()))
        run.do(FaceOperator(bearing_deg(s.vehicle.position, s.session.operator.position)))
        return
    if s.session.anchor is not None:  # pragma: no branch - only while facing there is none yet
        run.anchor_here(s.vehicle)
    run.state = replace(run.state, return_at_s=None, may_return=False)
    if s.flight is not None:
        execution.drop(run, why)
    else:
        run.tell(Notice.HELD_ANEW, why)


def emergency(run: Step, aborts: list[Breach], news: list[Breach]) -> None:
    """R10: hold now, keep the anchor. One way back by itself: if that fails too, somebody must ask for the next move."""
    run.do(Hold("violation"))
    policy, outward = run.state.policy.return_to_anchor, run.state.state is State.EXECUTING
    for breach in aborts:
        if breach.kind == "predicted" or breach in news:
            _report(run, breach, Action.ABORT)
    execution.end(run, MotionStatus.ABORTED)
    run.go(Cause.VIOLATION)
    run.state = replace(run.state, return_at_s=None, may_return=policy == "auto" and outward)
    run.tell(Notice.ABORTED, wording.told(aborts))
    if policy == "ask":
        run.tell(Notice.ASKS_TO_RETURN)


def way_back(run: Step) -> None:
    """Design 14: once the supervisor approves the way back it is announced, and flown two seconds later."""
    s, situation = run.state, run.situation()
    if not s.may_return or s.deciding is not None or situation is None:
        return
    vehicle, limits = situation.vehicle, s.limits
    if not run.at_rest(vehicle) or run.now_s < s.return_judged_from_s:
        return
    run.state = replace(run.state, return_judged_from_s=run.now_s + RECHECK_S)
    anchor, operator = situation.anchor, situation.operator.position
    try:
        plan = plan_return(vehicle.position, vehicle.yaw_deg, operator, anchor.position, limits, anchor.yaw_deg)
    except ValueError:  # nowhere near, or unknown: there is no way that could be judged
        run.state = replace(run.state, return_at_s=None)
        return
    decision = decide_plan(None, plan, None, situation, limits, rules=s.rules)
    if decision.verdict is not Verdict.APPROVED:
        run.state = replace(run.state, return_at_s=None)
    elif s.return_at_s is None:
        run.state = replace(run.state, return_at_s=run.now_s + limits.return_after_s)
        run.tell(Notice.RETURNING_SOON, seconds=limits.return_after_s)
    elif run.now_s >= s.return_at_s:
        decisions.reserve(run, None, decisions.BACK, decision)


def _report(run: Step, breach: Breach, action: Action) -> None:
    if breach.kind == "actual":
        run.state = replace(run.state, suspected=(*run.state.suspected, Suspected(breach, action, run.now_s)))
        confirm(run, run.vehicle)
    else:
        run.do(reports.violation(breach, action))
