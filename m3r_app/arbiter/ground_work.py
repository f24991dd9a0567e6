"""Take-off and landing from the console: no maneuvers of the model, but commanded and stopped as everything is.

Only in NormalAutonomy, and one at a time. Source: X4, P1, design 15.
"""

from __future__ import annotations

from dataclasses import replace

from m3r_app.arbiter.announcements import Announce
from m3r_app.arbiter.context import Step
from m3r_app.arbiter.effects import CallOffGroundWork, GiveUp, Land, TakeOff
from m3r_app.arbiter.events import GroundWorkEnded, LandingAsked, TakeOffAsked
from m3r_app.output import Notice
from safety.vocabulary import State


def take_off(run: Step, event: TakeOffAsked) -> None:
    """Take off to so many metres above the ground there, and hold."""
    if _may_begin(run, event.colour, f"taking off to {event.metres:g} m"):
        run.do(TakeOff(event.colour, event.metres))


def land(run: Step, event: LandingAsked) -> None:
    """Come down where it is."""
    if _may_begin(run, event.colour, "landing"):
        run.do(Land(event.colour))


def call_off(run: Step, why: str) -> bool:
    """STOP: what is under way ends in Hold. Whether anything was. Source: X4."""
    colour = run.state.ground_work
    if colour is None:
        return False
    run.do(CallOffGroundWork(colour))
    run.do(Announce(Notice.INFORMATION, colour, (f"take-off or landing called off, {why}",)))
    return True


def ended(run: Step, event: GroundWorkEnded) -> None:
    """The drone is nobody's again, unless it is being paired or has been meanwhile."""
    if event.colour != run.state.ground_work:
        return
    run.state = replace(run.state, ground_work=None)
    session = run.state.session
    if event.colour not in (run.state.pairing, session.colour if session is not None else None):
        run.do(GiveUp(event.colour))


def _may_begin(run: Step, colour: str, what: str) -> bool:
    if run.state.state is not State.IDLE:
        against = f"{what} is only for a drone in normal autonomy, disconnect first"
    elif run.state.ground_work is not None:
        against = f"not {what}, the last take-off or landing is not over"
    else:
        run.state = replace(run.state, ground_work=colour)
        return True
    run.do(Announce(Notice.INFORMATION, colour, (against,)))
    return False
