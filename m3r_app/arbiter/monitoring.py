"""The runtime monitor's part of a step: EmergencyHold when a hard limit is or will be broken, and the way back from there.

Source: R9, R10, X13, paper III-C (Monitor, Recover), design 14. The look itself is `safety.monitor`.
"""

from __future__ import annotations

from m3r_app.arbiter import decisions as deciding
from m3r_app.arbiter import execution as flying
from m3r_app.arbiter import reports
from m3r_app.arbiter.context import RECHECK_S, Step
from m3r_app.arbiter.execution import RETURN_ID
from m3r_app.events import Hold
from m3r_app.modes import Cause, State
from safety.monitor import Breach, watch
from safety.planner import plan_return
from safety.supervisor import decide_plan
from safety.vocabulary import Command, ManeuverRequest, Modality, Verdict


def monitor(run: Step) -> bool:
    """Check everything hard on the measured state; abort if something is or will be broken. True: all well."""
    s, situation = run.state, run.situation()
    flight = s.flight
    if situation is None or (flight is None and run.now_s - s.checked_at_s < RECHECK_S):
        return True
    run.be(checked_at_s=run.now_s)
    plan = flight.plan if flight else None
    elapsed_s = run.now_s - flight.started_at_s if flight else 0.0
    baseline = flight.baseline if flight else {}
    seen = watch(situation, plan, elapsed_s, s.speed_m_s, baseline, s.limits, s.rules)
    broken = [b for b in seen.breaches if b.kind == "actual"]
    news = [b for b in broken if b.constraint not in s.breached]
    run.be(breached=frozenset(b.constraint for b in broken))
    if flight is not None:
        flying.measure_distances(run, flight, seen)
        aborts = [b for b in seen.breaches if not b.mending]
        if aborts:
            emergency(run, aborts, news)
            return False
    for breach in news:
        _report(run, breach, "none, the plan mends it" if flight else "hold")
        run.tell(breach.text)
    return True


def emergency(run: Step, aborts: list[Breach], news: list[Breach]) -> None:
    """R10: hold now, keep the anchor. One way back by itself: if that fails too, somebody must ask for the next move."""
    run.do(Hold("violation"))
    policy, outward = run.state.policy.return_to_anchor, run.state.state is State.EXECUTING
    for breach in aborts:
        if breach.kind == "predicted" or breach in news:
            _report(run, breach, "abort")
    flying.end(run, "aborted")
    run.go(Cause.VIOLATION)
    run.be(return_at_s=None, may_return=policy == "auto" and outward)
    run.tell("holding, " + "; ".join(dict.fromkeys(b.text for b in aborts)))
    if policy == "ask":
        run.tell("say continue to return to the anchor")


def way_back(run: Step) -> None:
    """Design 14: once the supervisor approves the way back it is announced, and flown two seconds later."""
    s, situation = run.state, run.situation()
    if not s.may_return or s.deciding is not None or situation is None:
        return
    vehicle, limits = situation.vehicle, s.limits
    if not run.at_rest(vehicle) or run.now_s - s.settling_since_s < RECHECK_S:
        return
    run.be(settling_since_s=run.now_s)
    anchor, operator = situation.anchor.position, situation.operator.position
    plan = plan_return(vehicle.position, vehicle.yaw_deg, operator, anchor, limits)
    decision = decide_plan(RETURN_ID, plan, None, situation, limits, rules=s.rules)
    if decision.verdict is not Verdict.APPROVED:
        run.be(return_at_s=None)
    elif s.return_at_s is None:
        run.be(return_at_s=run.now_s + limits.return_after_s)
        run.tell(f"returning to the anchor in {limits.return_after_s:.0f} seconds")
    elif run.now_s >= s.return_at_s:
        # Nobody asks for it: the request only carries its id to the airspace authority and back.
        request = ManeuverRequest(RETURN_ID, Command.CONTINUE, Modality.PANEL, 1.0, run.now_s, run.now_s)
        deciding.reserve(run, request, deciding.BACK, decision)


def _report(run: Step, breach: Breach, action: str) -> None:
    if breach.kind == "actual":
        run.count("violations")
    run.do(reports.violation(breach, action))
