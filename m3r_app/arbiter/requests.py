"""What a request does the moment it is made: it stops, pairs, confirms, contradicts, or interrupts what runs to be judged.

Source: X4, X5, X6, X14; paper III-C (request), design 2, 5, 6.
"""

from __future__ import annotations

import math
from dataclasses import replace

from m3r_app.arbiter import decisions, execution, ground_work, reports, sessions
from m3r_app.arbiter.context import Step
from m3r_app.arbiter.decisions import is_of_now, refuse
from m3r_app.arbiter.effects import Hold
from m3r_app.arbiter.events import Requested
from m3r_app.arbiter.fusion import Relation, fused, relate
from m3r_app.arbiter.state import Tally
from m3r_app.arbiter.wording import asked
from m3r_app.output import MotionStatus, Notice
from safety.confidence import input_confidence
from safety.declarations import CONTRADICTION, ENVELOPE, INPUT_CONFIDENCE, PAIRED
from safety.vocabulary import Cause, Command, Finding, ManeuverRequest, State

STOPPED = "the operator said stop"
NO_MANEUVER = frozenset({Command.STOP, Command.ACTIVATE, Command.DISCONNECT})
"""These neither confirm nor contradict."""


def requested(run: Step, event: Requested) -> None:
    """Report the request and do what it asks, or say why not. STOP's hold has been commanded before."""
    request = event.request
    relation, other = Relation.NEW, None
    late = too_late(run, request)
    limits = run.state.limits

    def sure(asked_for: ManeuverRequest) -> bool:
        return input_confidence(asked_for, limits).passed

    if request.command not in NO_MANEUVER and late is None:
        relation, other = relate(request, run.state.recent, limits.fusion_window_s, sure)
    if relation is Relation.CONFIRMS and other is not None:
        if sure(other.request) and (sure(request) or not other.refused):
            name = request.id if other.refused else other.request.id
            request = fused(request, other.request, name, lifted=sure(request))
        else:
            relation = Relation.NEW  # doubt and doubt make no certainty: each is judged alone
    run.do(reports.request(request, event.latency_ms))
    run.count(Tally(requests=1))
    match request.command:
        case Command.STOP:
            stop(run, request)
        case Command.ACTIVATE | Command.DISCONNECT:
            pair_or_part(run, request)
        case _ if run.state.session is None or run.state.session.anchor is None:
            refuse(run, request, PAIRED.unmet("no drone is paired"))
        case _ if late is not None:
            refuse(run, request, late)
        case _ if relation is Relation.CONFIRMS and other is not None and not other.refused:
            confirm(run, request)
        case _ if relation is Relation.CONTRADICTS and other is not None:
            contradict(run, request, other.request)
        case _:
            maneuver(run, request)


def too_late(run: Step, request: ManeuverRequest) -> Finding | None:
    """What was asked long ago, or before STOP, is no request of now. Source: X4, X6."""
    if not is_of_now(request, run.now_s, run.state.limits):
        age_s = run.now_s - request.captured_at_s
        old = f"{age_s:.0f} s ago" if math.isfinite(age_s) and age_s > 0.0 else "at a time that cannot be"
        return INPUT_CONFIDENCE.unmet(f"it was asked {old}; ask again", "X6")
    if request.captured_at_s < run.state.stopped_at_s:
        return CONTRADICTION.unmet("it was asked before stop", "X4")
    return None


def stop(run: Step, request: ManeuverRequest) -> None:
    """X4: the hold has been commanded; now the rest. What was asked before can neither be confirmed nor contradicted."""
    # min() keeps its first argument where the second is NaN.
    stopped_at_s = max(run.state.stopped_at_s, min(run.now_s, request.captured_at_s))
    run.state = replace(run.state, stopped_at_s=stopped_at_s, recent=())
    called_off = ground_work.call_off(run, STOPPED)
    if run.state.state in (State.PAIRING, State.FACING):
        sessions.call_off_pairing(run, STOPPED)
        return
    if not run.state.authority:
        if not called_off:
            run.tell(Notice.NOTHING_TO_HOLD)
        return
    decisions.withdraw(run, STOPPED, "X4")
    run.state = replace(run.state, leftover=execution.leftover(run), return_at_s=None, may_return=False)
    execution.end(run, MotionStatus.ABORTED)
    run.go(Cause.STOP)
    run.tell(Notice.HOLDING)


def pair_or_part(run: Step, request: ManeuverRequest) -> None:
    """ACTIVATE or DISCONNECT, which need confidence as a move does. Source: R11, G1, X6."""
    found = input_confidence(request, run.state.limits)
    doubt = found if not found.passed else too_late(run, request)
    if request.command is Command.ACTIVATE:
        sessions.activate(run, request.colour or "", doubt)
    elif doubt is not None:
        run.tell(Notice.NOT_DISCONNECTED, doubt.text)
    else:
        sessions.disconnect(run, request)


def confirm(run: Step, request: ManeuverRequest) -> None:
    """It confirms what is already decided, flying or flown; what still waits is now asked for by both. Source: X5."""
    decisions.remember(run, request)
    pending = run.state.pending
    if pending is not None and pending.id == request.id and request.confidence > pending.confidence:
        run.state = replace(run.state, pending=request)


def contradict(run: Step, request: ManeuverRequest, first: ManeuverRequest) -> None:
    """X5: what runs is aborted, both are refused."""
    why = f"{request.modality} says {asked(request)} but {first.modality} said {asked(first)}"
    if run.state.flight is not None:
        run.do(Hold("contradiction"))
    decisions.withdraw(run, why, "X5")
    run.state = replace(run.state, leftover=None, return_at_s=None, may_return=False)
    execution.end(run, MotionStatus.ABORTED)
    if run.can(Cause.CONTRADICTED):
        run.go(Cause.CONTRADICTED)
    refuse(run, request, CONTRADICTION.unmet(why, "X5"))


def maneuver(run: Step, request: ManeuverRequest) -> None:
    """A move, turn or continue: interrupt what runs (X14), then evaluate."""
    decisions.remember(run, request)
    if request.command is not Command.CONTINUE:
        run.state = replace(run.state, leftover=None)
    decisions.withdraw(run, "a newer request came first", "X14")
    if run.state.flight is not None:
        run.do(Hold("interrupted"))
        execution.end(run, MotionStatus.ABORTED)
    if run.can(Cause.INTERRUPTED):
        run.go(Cause.INTERRUPTED)
    if run.state.state in (State.ARMED, State.EMERGENCY_HOLD):
        decisions.evaluate(run, request)
        return
    run.state = replace(run.state, pending=request)
    come_to_rest(run)


def come_to_rest(run: Step) -> None:
    """Design 2: the new anchor is where the motion has stopped; then what waited is evaluated."""
    vehicle, pending = run.state.vehicle, run.state.pending
    since_s = run.state.settling_since_s
    if since_s is None or vehicle is None or not vehicle.at_s >= since_s:
        return
    if not run.at_rest(vehicle):
        return
    run.anchor_here(vehicle)
    run.go(Cause.SETTLED)
    if pending is not None:
        run.state = replace(run.state, pending=None)
        decisions.evaluate(run, pending)


def overdue(run: Step) -> None:
    """The drone does not come to rest."""
    pending, since_s, timeout_s = run.state.pending, run.state.settling_since_s, run.state.limits.settling_timeout_s
    if pending is not None and since_s is not None and run.now_s - since_s > timeout_s:
        run.state = replace(run.state, pending=None)
        refuse(run, pending, ENVELOPE.unmet(f"it has not come to rest for {timeout_s:.0f} s"))
