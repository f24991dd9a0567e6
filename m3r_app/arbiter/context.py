"""A step of the arbiter in progress: the state so far, the effects so far, and the few words by which they change.

Source: design "Functional core", 2 (motion has stopped, the anchor is there); the transitions are the table in `modes`.
"""

from __future__ import annotations

import math
from dataclasses import replace

from m3r_app.arbiter import reports
from m3r_app.arbiter.announcements import Announce
from m3r_app.arbiter.effects import AnchorMoved, Effect, ImpossibleTransition
from m3r_app.arbiter.modes import DECIDING, next_state
from m3r_app.arbiter.state import ArbiterState, Session, Suspected, Tally
from m3r_app.output import Notice
from safety.situation import Situation
from safety.vocabulary import Anchor, Cause, Primitive, State, VehicleState

RECHECK_S = 0.1
"""What is judged again and again while the drone hovers is judged this often."""


def impossible(state: State, cause: Cause) -> ImpossibleTransition:
    """What is made of a transition that the table does not have. The tests put an exception in its place."""
    return ImpossibleTransition(state, cause)


class Step:
    """What the modules of the arbiter hand to one another: they read `state`, and change it by these words only."""

    def __init__(self, state: ArbiterState, now_s: float) -> None:
        self.state = state
        self.now_s = now_s
        self.effects: list[Effect] = []

    # ------------------------------------------------------------ what changes

    def do(self, effect: Effect) -> None:
        """Have the shell do this, after all that came before."""
        self.effects.append(effect)

    def can(self, cause: Cause) -> bool:
        return next_state(self.state.state, cause, held=self.state.held) is not None

    def go(self, cause: Cause) -> None:
        """Take the table's transition. One that it does not have is a fault in the arbiter: told, and not taken."""
        previous, held = self.state.state, self.state.held
        to = next_state(previous, cause, held=held)
        if to is None:
            self.do(impossible(previous, cause))
            return
        self.state = replace(
            self.state,
            state=to,
            held=previous is State.EMERGENCY_HOLD if to is State.DETECTED else held and to in DECIDING,
            settling_since_s=self.now_s if to is State.SETTLING else None,
        )
        self.do(reports.mode(previous, to, cause))

    def anchor_here(self, vehicle: VehicleState) -> None:
        anchor = Anchor(vehicle.position, vehicle.yaw_deg, self.now_s)
        self.state = replace(self.state, session=replace(self.session, anchor=anchor))
        self.do(AnchorMoved(anchor.position, self.state.limits.workspace_m))

    def tell(
        self,
        notice: Notice,
        *because: str,
        metres: tuple[float, ...] = (),
        seconds: float = 0.0,
        primitive: Primitive | None = None,
        asked: str = "",
    ) -> None:
        """Tell the operator, in the name of the session's drone."""
        colour = self.state.session.colour if self.state.session is not None else ""
        self.do(Announce(notice, colour, because, metres, seconds, primitive, asked=asked))

    def violated(self, suspected: Suspected) -> None:
        """A limit was broken, and it was ours to keep."""
        self.count(Tally(violations=1))
        self.do(reports.violation(suspected.breach, suspected.action))

    def count(self, more: Tally) -> None:
        """Add to the tally."""
        self.state = replace(self.state, tally=self.state.tally.plus(more))

    # ------------------------------------------------------------ what is known

    @property
    def session(self) -> Session:
        if self.state.session is None:
            raise RuntimeError("no session")
        return self.state.session

    @property
    def vehicle(self) -> VehicleState:
        if self.state.vehicle is None:
            raise RuntimeError("no telemetry")
        return self.state.vehicle

    @property
    def hears(self) -> bool:
        """Whether telemetry is fresh. Source: X6."""
        vehicle = self.state.vehicle
        return vehicle is not None and self.now_s - vehicle.at_s <= self.state.limits.telemetry_age_s

    def at_rest(self, vehicle: VehicleState) -> bool:
        """Whether motion has stopped at a known place (design 2)."""
        rests = self.state.motion.rests(self.state.noise, self.state.limits)
        return rests and vehicle.position.finite and math.isfinite(vehicle.yaw_deg)

    def situation(self) -> Situation | None:
        """What is known now; None before the first anchor or telemetry."""
        s, session = self.state, self.state.session
        if session is None or session.anchor is None or session.centre is None or s.vehicle is None:
            return None
        return Situation(
            self.now_s,
            s.vehicle,
            session.operator,
            session.anchor,
            session.centre,
            session.paired_at_s,
            s.neighbours,
            s.reservations,
            session.world,
            s.authority,
            session.astray,
        )
