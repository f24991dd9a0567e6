"""What a request would become if it were asked now: the arbiter's own step, on a copy, and nothing is flown. Pure.

Source: design "Functional core": `step(state, event, now) -> (state, effects)` changes nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from m3r_app.arbiter.effects import Announce, Hold, Report
from m3r_app.arbiter.events import Requested
from m3r_app.arbiter.state import ArbiterState
from m3r_app.arbiter.step import step
from m3r_app.plain import plain
from safety.vocabulary import ManeuverRequest

WAITS = "it would be judged where the drone has come to rest"


@dataclass(frozen=True, slots=True)
class Preview:
    """decision: the fields of the `decision` event, None where there would be none yet; text: what the operator would hear."""

    decision: dict[str, Any] | None
    text: str
    interrupts: bool
    """What is being flown would end first."""


def preview(state: ArbiterState, request: ManeuverRequest, now_s: float) -> Preview:
    """The answer that `request` would get at `now_s`."""
    dry = replace(state, policy=replace(state.policy, dry_run=True))
    after, effects = step(dry, Requested(request, 0.0), now_s)
    decisions = [e.fields for e in effects if isinstance(e, Report) and e.event == "decision"]
    told = [e.text.replace("dry run, ", "") for e in effects if isinstance(e, Announce)]
    interrupts = any(isinstance(e, Hold) for e in effects)
    if after.pending is not None:
        told.append(WAITS)
    decision = plain(decisions[-1], lossless=False) if decisions else None
    return Preview(decision, "; ".join(told), interrupts)
