"""What is done when a temporal property of the arbiter's own steps does not hold: it is not trusted to go on by itself.

The drone holds: in EmergencyHold where something was flown, without a way back that nobody asks for; elsewhere where it is, and
nothing of what was asked for before is flown. Source: R10, X3; `safety.properties`.
"""

from __future__ import annotations

from dataclasses import replace

from m3r_app.arbiter import decisions, execution, reports, sessions
from m3r_app.arbiter.context import Step
from m3r_app.arbiter.effects import Hold
from m3r_app.arbiter.events import PropertyBroken
from m3r_app.arbiter.state import Tally
from m3r_app.output import Action, MotionStatus, Notice
from safety.declarations import PROPERTY
from safety.monitor import Breach
from safety.vocabulary import Cause


def property_broken(run: Step, event: PropertyBroken) -> None:
    """Hold before anything else, then tell, then drop what was to come."""
    text = f"a check of M3R's own steps failed: it is not so that {event.says}"
    flown, ours = run.state.flight is not None, run.state.authority
    if ours:
        run.do(Hold("property"))
    run.count(Tally(violations=1))
    breach = Breach("actual", PROPERTY.name, (event.requirement,), None, "", text)
    run.do(reports.violation(breach, Action.ABORT if flown else Action.HOLD))
    run.state = replace(run.state, leftover=None, return_at_s=None, may_return=False)
    session = run.state.session
    if session is None or session.anchor is None:
        sessions.call_off_pairing(run, text)
        return
    decisions.withdraw(run, text, event.requirement)
    if flown:
        execution.end(run, MotionStatus.ABORTED)
        run.go(Cause.VIOLATION)
    elif run.can(Cause.INTERRUPTED):
        run.go(Cause.INTERRUPTED)
    run.tell(Notice.ABORTED if flown else Notice.LIMIT_BROKEN, text)
