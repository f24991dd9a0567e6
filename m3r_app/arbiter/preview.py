"""What a request would become if it were asked now: the arbiter's own step, on a copy, and nothing is flown. Pure.

Source: design "Functional core": `step(state, event, now) -> (state, effects)` changes nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from m3r_app.arbiter.announcements import Announce
from m3r_app.arbiter.effects import Hold, Report
from m3r_app.arbiter.events import Requested
from m3r_app.arbiter.state import ArbiterState
from m3r_app.arbiter.step import step
from m3r_app.output import DecisionEvent, known
from safety.vocabulary import ManeuverRequest

WAITS = "it would be judged where the drone has come to rest"


@dataclass(frozen=True, slots=True)
class Preview:
    """decision: the `decision` event, None where there would be none yet; text: what the operator would hear."""

    decision: DecisionEvent | None
    text: str
    interrupts: bool
    """What is being flown would end first."""


def preview(state: ArbiterState, request: ManeuverRequest, now_s: float) -> Preview:
    """The answer that `request` would get at `now_s`."""
    dry = replace(state, policy=replace(state.policy, dry_run=True))
    after, effects = step(dry, Requested(request, 0.0), now_s)
    decisions = [known(e.told) for e in effects if isinstance(e, Report) and isinstance(e.told, DecisionEvent)]
    told = [replace(e, dry_run=False).text for e in effects if isinstance(e, Announce)]
    interrupts = any(isinstance(e, Hold) for e in effects)
    if after.pending is not None:
        told.append(WAITS)
    return Preview(decisions[-1] if decisions else None, "; ".join(told), interrupts)
