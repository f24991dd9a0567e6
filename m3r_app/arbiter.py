"""The arbiter: one pure step from state and event to state and effects. The one owner of the mode.

Source: paper III-C (pipeline), IV-B (state machine), design "Functional core" and decisions 2-7, 13-15.
"""

from __future__ import annotations

import math
from dataclasses import replace

from m3r_app import wording
from m3r_app.events import (
    Announce,
    ArbiterState,
    Deciding,
    Effect,
    Ended,
    Event,
    FaceOperator,
    Flight,
    Fly,
    Hold,
    Leftover,
    LetGo,
    Measured,
    NeighboursHeard,
    Pair,
    PairingAnswered,
    PairingAsked,
    Release,
    Report,
    Requested,
    ReservationAnswered,
    Reserve,
    Session,
    Stalled,
    TelemetryArrived,
    Tick,
)
from m3r_app.fusion import Relation, fused, relate, remember
from m3r_app.modes import MODE_OF, Cause, State, next_state
from safety.confidence import input_confidence, unfit_to_fly
from safety.frames import bearing_deg, enu, wrap_deg
from safety.monitor import Breach, watch
from safety.planner import full_speed_m_s, plan_return
from safety.situation import Situation
from safety.supervisor import FULL_TURN_DEG, Intent, assess, decide, decide_plan, interpret, safe
from safety.vocabulary import (
    PRIMITIVE_OF,
    Anchor,
    Command,
    Decision,
    Finding,
    ManeuverRequest,
    Modality,
    Ned,
    Plan,
    Primitive,
    VehicleState,
    Verdict,
)
from safety.volumes import swept_volume

STOPPED = "the operator said stop"
STALE_REQUEST_S = 5.0
"""What was said or shown longer ago than this is asked anew (X6)."""
ENGAGING_S = 1.0
"""So long the autopilot may take to enter Offboard and say so."""
SETTLING_TIMEOUT_S = 10.0
"""A request that waits for the drone to come to rest is refused after this."""
REST_M_S = 0.1
"""Slower than this, motion has stopped (design 2)."""
ARRIVED_M = 0.1
CLOSE_ENOUGH_M = 0.3
"""In wind a drone may rest this far off; it has arrived if it has come no nearer for LINGER_S."""
LINGER_S = 2.0
FACING_TOLERANCE_DEG = 5.0
FACING_TIMEOUT_S = 20.0
RESERVATION_TIMEOUT_S = 1.0
RECHECK_S = 0.1
SPEED_FILTER_S = 0.1
DISAGREEMENT_S = 2.0
"""Over this time position and velocity are compared."""
OURS = frozenset({"OFFBOARD", "HOLD"})
"""Flight modes in which nobody else flies the drone. Source: design 4."""
RETURN_ID = "return"
BACK = Intent(Primitive.RETURN, 0.0)


def step(state: ArbiterState, event: Event, now_s: float) -> tuple[ArbiterState, tuple[Effect, ...]]:
    """What becomes of `state` when `event` happens at now_s, and what the shell must do about it. Never raises."""
    run = _Step(state, now_s)
    if state.authority and isinstance(event, Requested) and event.request.command is Command.STOP:
        run.do(Hold("stop"))  # X4: before anything else
    if state.state is State.BLOCKED:
        run.go(Cause.TOLD)
    match event:
        case Requested():
            run.requested(event)
        case PairingAsked():
            run.activate(event.colour)
        case PairingAnswered():
            run.pairing_answered(event)
        case TelemetryArrived():
            run.telemetry(event.vehicle)
        case NeighboursHeard():
            run.be(neighbours=event.neighbours, reservations=event.reservations)
        case ReservationAnswered():
            run.reservation_answered(event)
        case Stalled():
            run.stalled(event.reason)
        case Tick():
            run.tick()
        case Ended() if state.authority:
            run.do(Hold("ended"))
            run.leave(Cause.RELEASED, "hold", f"{event.reason}, it holds where it is")
        case Ended():
            run.call_off_pairing(event.reason)
    return run.state, tuple(run.effects)


class _Step:
    """One step in progress: the state so far and the effects so far."""

    def __init__(self, state: ArbiterState, now_s: float) -> None:
        self.state = state
        self.now_s = now_s
        self.effects: list[Effect] = []

    # ------------------------------------------------------------ small words

    def be(self, **changes: object) -> None:
        self.state = self.state.but(**changes)

    def do(self, effect: Effect) -> None:
        self.effects.append(effect)

    def can(self, cause: Cause) -> bool:
        return next_state(self.state.state, cause) is not None

    def go(self, cause: Cause) -> None:
        """Take the table's transition; without one, stay."""
        to = next_state(self.state.state, cause)
        if to is None:
            return
        previous = self.state.mode
        self.be(state=to)
        self.do(Report("mode", {"mode": MODE_OF[to], "previous": previous, "state": to, "cause": cause}))

    def tell(self, text: str) -> None:
        colour = self.session.colour.capitalize() if self.state.session else "No drone"
        self.do(Announce(f"{colour}: {text}"))

    def count(self, **more: int) -> None:
        tally = self.state.tally
        self.be(tally=replace(tally, **{name: getattr(tally, name) + n for name, n in more.items()}))

    @property
    def session(self) -> Session:
        if self.state.session is None:
            raise RuntimeError("no session")
        return self.state.session

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
        )

    # ------------------------------------------------------------ requests

    def requested(self, event: Requested) -> None:
        request = event.request
        relation, other = Relation.NEW, None
        late = self.too_late(request)
        if request.command not in (Command.STOP, Command.ACTIVATE, Command.DISCONNECT) and late is None:
            relation, other = relate(request, self.state.recent, self.state.limits.fusion_window_s, self.sure)
        if relation is Relation.CONFIRMS and other is not None:
            request = fused(request, other.request, request.id if other.refused else other.request.id)
        self.do(
            Report(
                "request",
                {
                    "id": request.id,
                    "command": request.command,
                    "modality": request.modality,
                    "confidence": request.confidence,
                    "evidence": request.evidence,
                    "latency_ms": event.latency_ms,
                },
            )
        )
        self.count(requests=1)
        match request.command:
            case Command.STOP:
                self.stop(request)
            case Command.ACTIVATE | Command.DISCONNECT:
                self.pairing_requested(request)
            case _ if self.state.session is None or self.state.session.anchor is None:
                self.refuse(request, _unmet("paired", ("P1", "R1"), "no drone is paired"))
            case _ if late is not None:
                self.refuse(request, late)
            case _ if relation is Relation.CONFIRMS and other is not None and not other.refused:
                self.confirm(request)
            case _ if relation is Relation.CONTRADICTS and other is not None:
                self.contradiction(request, other.request)
            case _:
                self.maneuver(request)

    def sure(self, request: ManeuverRequest) -> bool:
        """Whether its modality was. Source: G1."""
        return input_confidence(request, self.state.limits).passed

    def remember(self, request: ManeuverRequest, *, refused: bool = False) -> None:
        window_s = self.state.limits.fusion_window_s
        self.be(recent=remember(self.state.recent, request, window_s, refused=refused))

    def too_late(self, request: ManeuverRequest) -> Finding | None:
        """What was asked long ago, or before STOP, is no request of now. Source: X4, X6."""
        age_s = abs(self.now_s - request.captured_at_s)
        if not age_s <= STALE_REQUEST_S:
            old = f"{age_s:.0f} s ago" if math.isfinite(age_s) else "at an unknown time"
            return _unmet("input_confidence", ("R11", "X6"), f"it was asked {old}; ask again")
        if request.captured_at_s < self.state.stopped_at_s:
            return _unmet("contradiction", ("X4",), "it was asked before stop")
        return None

    def confirm(self, request: ManeuverRequest) -> None:
        """It confirms what is already decided, flying or flown; what still waits is now asked for by both. Source: X5."""
        self.remember(request)
        pending = self.state.pending
        if pending is not None and pending.id == request.id:
            self.be(pending=request)

    def stop(self, request: ManeuverRequest) -> None:
        """X4: the hold has been commanded; now the rest. What was asked before can neither be confirmed nor contradicted."""
        # min() keeps its first argument where the second is NaN.
        stopped_at_s = max(self.state.stopped_at_s, min(self.now_s, request.captured_at_s))
        self.be(stopped_at_s=stopped_at_s, recent=())
        if self.state.state in (State.PAIRING, State.FACING):
            self.call_off_pairing(STOPPED)
            return
        if not self.state.authority:
            self.tell("nothing to hold, this app has no authority over a drone")
            return
        self.withdraw(STOPPED, "X4")
        self.be(leftover=self.rest_of_flight(), return_at_s=None, may_return=False)
        self.end_flight("aborted")
        if self.can(Cause.STOP):
            self.settle(Cause.STOP)
        self.tell("holding")

    def pairing_requested(self, request: ManeuverRequest) -> None:
        """ACTIVATE or DISCONNECT, which need confidence as a move does. Source: R11, X6."""
        found = input_confidence(request, self.state.limits)
        doubt = found if not found.passed else self.too_late(request)
        if request.command is Command.ACTIVATE:
            self.activate(request.colour or "", doubt)
        elif doubt is not None:
            self.tell(f"not disconnected, {doubt.text}")
        else:
            self.disconnect(request)

    def activate(self, colour: str, doubt: Finding | None = None) -> None:
        """Ask the shell to pair, unless something is against it."""
        if doubt is None and self.can(Cause.PAIR_REQUESTED):
            self.be(pairing=colour, pairing_off=None)
            self.go(Cause.PAIR_REQUESTED)
            self.do(Pair(colour))
            return
        session = self.state.session
        taken = session.colour if session is not None else self.state.pairing
        if doubt is not None:
            why = doubt.text
        elif colour == taken:
            self.tell("already paired" if session is not None and session.anchor is not None else "already pairing")
            return
        else:
            why = f"{taken} is paired; disconnect it first"
        self.do(Report("pair", {"vehicle": colour, "status": "refused", "reasons": [why]}))
        self.do(Announce(f"{colour.capitalize()}: not paired, {why}"))

    def disconnect(self, request: ManeuverRequest) -> None:
        session, paired = self.state.session, self.state.pairing
        if session is not None:
            paired = session.colour
        if paired is None or request.colour not in (None, paired):
            self.tell(f"{request.colour or 'no drone'} is not paired, so there is nothing to disconnect")
            return
        if session is None or session.anchor is None:
            self.call_off_pairing("disconnected before it was paired")
            return
        self.do(Hold("disconnect"))
        resumes = self.state.policy.on_disconnect == "resume"
        why = "disconnected, it resumes its mission" if resumes else "disconnected, it holds where it is"
        self.leave(Cause.RELEASED, self.state.policy.on_disconnect, why)

    def contradiction(self, request: ManeuverRequest, first: ManeuverRequest) -> None:
        """X5: what runs is aborted, both are refused."""
        why = f"{request.modality} says {_said(request)} but {first.modality} said {_said(first)}"
        if self.state.flight is not None:
            self.do(Hold("contradiction"))
        self.withdraw(why, "X5")
        self.be(leftover=None, return_at_s=None, may_return=False)
        self.end_flight("aborted")
        if self.can(Cause.CONTRADICTED):
            self.settle(Cause.CONTRADICTED)
        self.refuse(request, _unmet("contradiction", ("X5",), why))

    def maneuver(self, request: ManeuverRequest) -> None:
        """A move, turn or continue: interrupt what runs (X14), then evaluate."""
        self.remember(request)
        if request.command is not Command.CONTINUE:
            self.be(leftover=None)
        self.withdraw("a newer request came first", "X14")
        if self.state.state in (State.ARMED, State.EMERGENCY_HOLD):
            self.evaluate(request)
            return
        if self.state.state in (State.EXECUTING, State.RETURN_TO_ANCHOR):
            self.do(Hold("interrupted"))
            self.end_flight("aborted")
        if self.can(Cause.INTERRUPTED):
            self.settle(Cause.INTERRUPTED)
        self.be(pending=request)
        self.settled_yet()

    def withdraw(self, why: str, requirement: str) -> None:
        """Whatever waits for its final decision gets it: rejected."""
        deciding, pending = self.state.deciding, self.state.pending
        self.be(deciding=None, pending=None)
        if deciding is not None:
            self.do(Release(deciding.request.id))
            if deciding.request.id != RETURN_ID:
                self.refuse(deciding.request, _unmet("contradiction", (requirement,), why))
        if pending is not None:
            self.refuse(pending, _unmet("contradiction", (requirement,), why))

    def refuse(self, request: ManeuverRequest, finding: Finding) -> None:
        primitive = PRIMITIVE_OF.get(request.command)
        self.decided(request, Decision(request.id, primitive, Verdict.REJECTED, None, None, (finding,)))

    # ------------------------------------------------------------ deciding

    def evaluate(self, request: ManeuverRequest) -> None:
        """Detected -> validated -> planned, or blocked. Source: paper III-C, III-G."""
        held = self.state.state is State.EMERGENCY_HOLD
        asked_back = held and request.command is Command.CONTINUE and self.state.policy.return_to_anchor == "ask"
        self.be(return_at_s=None, may_return=False)
        self.go(Cause.REQUEST)
        intent = self.intent(request, asked_back=asked_back)
        if isinstance(intent, Finding):
            self.go(Cause.CONFIDENCE_OK)
            self.refuse(request, intent)
            self.go(Cause.GUARDS_FAILED)
            return
        self.consider(request, intent, may_delay=True)

    def intent(self, request: ManeuverRequest, *, asked_back: bool) -> Intent | Finding:
        if request.command is not Command.CONTINUE:
            return interpret(request, self.state.limits)
        if asked_back:
            return BACK
        left, within_s = self.state.leftover, self.state.limits.continue_within_s
        if left is None:
            return _unmet("contradiction", ("X12",), "there is nothing that stop left to continue")
        if self.now_s - left.at_s > within_s:
            return _unmet("contradiction", ("X12",), f"stop was more than {within_s:.0f} s ago")
        return Intent(left.primitive, left.left, left.slowness)

    def consider(self, request: ManeuverRequest, intent: Intent, *, may_delay: bool) -> None:
        situation = self.situation()
        if situation is None:
            self.refuse(request, _unmet("localization", ("R11", "X6"), "nothing has been heard from the drone"))
            self.go(Cause.CONFIDENCE_LOW)
            return
        offer = self.state.policy.replace == "offer"
        decision = decide(
            request, intent, situation, self.state.limits, may_delay=may_delay, offer=offer, rules=self.state.rules
        )
        unsure = any(f.constraint == "input_confidence" for f in decision.failing)
        if self.state.state is State.DETECTED:
            self.go(Cause.CONFIDENCE_LOW if unsure else Cause.CONFIDENCE_OK)
        if unsure or decision.verdict in (Verdict.REJECTED, Verdict.REPLACED):
            self.decided(request, decision)
            if decision.verdict is Verdict.REPLACED:
                self.be(leftover=Leftover(intent.primitive, intent.amount, self.now_s, decision.slowness))
            self.go(Cause.GUARDS_FAILED)
        elif decision.verdict is Verdict.DELAYED:
            self.decided(request, decision)
            self.go(Cause.DELAY)
            deadline_s = self.now_s + self.state.limits.delay_s
            self.be(deciding=Deciding(request, intent, decision, deadline_s), rechecked_at_s=self.now_s)
        else:
            self.reserve(request, intent, decision)

    def reserve(self, request: ManeuverRequest, intent: Intent, decision: Decision) -> None:
        """X10: airspace first, whoever the authority is."""
        if decision.plan is None:
            raise RuntimeError("an approved decision carries its plan")
        self.go(Cause.GUARDS_OK)
        deadline_s = self.now_s + RESERVATION_TIMEOUT_S
        self.be(deciding=Deciding(request, intent, decision, deadline_s))
        volume = swept_volume(decision.plan, self.session.colour, self.vehicle.sigma_m, self.now_s, self.state.limits)
        self.do(Reserve(request.id, volume))

    def reservation_answered(self, event: ReservationAnswered) -> None:
        deciding, flight = self.state.deciding, self.state.flight
        if flight is not None and flight.request_id == event.request_id:
            if event.answer != "granted":
                self.drop(Cause.STALLED, f"the airspace it had reserved is {event.answer}")
            return
        if deciding is None or deciding.request.id != event.request_id or deciding.decision.plan is None:
            if event.answer == "granted":
                self.do(Release(event.request_id))  # nobody waits for it any more
            return
        if event.answer != "granted":
            self.deny(deciding, event.reason or f"the volume was {event.answer}")
            return
        findings = self.revalidate(deciding, deciding.decision.plan)
        if safe(findings):
            self.fly(deciding, deciding.decision.plan, findings)
            return
        self.do(Release(event.request_id))
        self.turn_down(deciding, findings, Cause.GUARDS_FAILED)

    def revalidate(self, deciding: Deciding, plan: Plan) -> tuple[Finding, ...]:
        """X10: airspace took its time; is the plan still safe, and the drone still where it starts?"""
        situation, limits = self.situation(), self.state.limits
        if situation is None:
            return (_unmet("localization", ("R11", "X6"), "nothing has been heard from the drone"),)
        request = None if deciding.request.id == RETURN_ID else deciding.request
        findings = assess(plan, request, situation, limits, self.state.rules)
        off_m = situation.vehicle.position.minus(plan.start).norm
        if off_m <= limits.tracking_m:
            return findings
        away = f"the drone is {off_m:.2f} m from where the plan starts"
        return (*findings, Finding("envelope", ("R8", "X10"), limits.tracking_m - off_m, "m", False, away))

    def fly(self, deciding: Deciding, plan: Plan, findings: tuple[Finding, ...]) -> None:
        """The volume is ours and the plan still safe: fly it."""
        request_id, s = deciding.request.id, self.state
        situation = self.situation()
        if situation is None:
            raise RuntimeError("a plan found safe has its situation")
        self.be(deciding=None, leftover=None)
        if request_id != RETURN_ID:
            self.decided(deciding.request, deciding.decision)
        self.go(Cause.RETURN_APPROVED if plan.primitive is Primitive.RETURN else Cause.VOLUME_GRANTED)
        mending = {f.constraint for f in findings if f.margin is not None and f.margin < 0.0}
        seen = watch(situation, plan, 0.0, s.speed_m_s, {}, s.limits, s.rules)
        baseline = {key: margin for key, margin in seen.negative.items() if key[1] in mending}
        vehicle = situation.vehicle
        self.be(flight=Flight(request_id, plan, self.now_s, vehicle.position, vehicle.yaw_deg, baseline))
        self.do(Fly(plan))
        self.report_motion("started")

    def deny(self, deciding: Deciding, reason: str) -> None:
        """The authority says no, or nothing."""
        denied = _unmet("reservation", ("R5", "X10"), f"the airspace is not ours: {reason}")
        others = tuple(f for f in deciding.decision.findings if f.constraint != denied.constraint)
        self.turn_down(deciding, (*others, denied), Cause.VOLUME_DENIED)

    def turn_down(self, deciding: Deciding, findings: tuple[Finding, ...], cause: Cause) -> None:
        """What had been approved is rejected after all; the way back is tried again a little later."""
        self.be(deciding=None)
        if deciding.request.id == RETURN_ID:
            self.be(return_at_s=None, settling_since_s=self.now_s + self.state.limits.delay_s)
            self.tell(f"not returning yet, {wording.reasons(findings)}")
            return
        decision = replace(
            deciding.decision,
            verdict=Verdict.REJECTED,
            granted_m=None,
            plan=None,
            findings=findings,
            granted_findings=(),
        )
        self.decided(deciding.request, decision)
        self.go(cause)

    def decided(self, request: ManeuverRequest, decision: Decision) -> None:
        """Report a decision; a final one is counted."""
        if decision.verdict is Verdict.REJECTED and decision.requested_m is None:
            decision = replace(decision, requested_m=_asked_m(request, self.state))
        self.do(Report("decision", _decision_fields(decision)))
        match decision.verdict:
            case Verdict.APPROVED | Verdict.REDUCED:
                self.count(approved=1)
            case Verdict.REJECTED | Verdict.REPLACED:
                self.count(rejected=1)
                self.remember(request, refused=True)
        colour = self.state.session.colour if self.state.session else "no drone"
        self.do(Announce(wording.decided(colour, _said(request), decision)))

    # ------------------------------------------------------------ pairing

    def pairing_answered(self, event: PairingAnswered) -> None:
        """The shell has checked: turn to the operator, or refuse. Source: X8, design 12."""
        if self.state.state is not State.PAIRING or event.colour != self.state.pairing:
            return
        vehicle, off = self.state.vehicle, self.state.pairing_off
        reasons = event.reasons if off is None else (off, *event.reasons)
        if event.operator is None or event.world is None:
            reasons = reasons or ("the operator's position or what stands around is unknown",)
        elif vehicle is None or not self.now_s - vehicle.at_s <= self.state.limits.telemetry_age_s:
            reasons = reasons or ("nothing has been heard from it",)
        elif not reasons:
            self.be(session=Session(event.colour, event.operator, event.world, self.now_s), breached=frozenset())
            self.go(Cause.PAIR_ACCEPTED)
            self.do(FaceOperator(bearing_deg(vehicle.position, event.operator.position)))
            return
        # Where the shell found nothing against it, it has taken the drone and must let it go again.
        self.refuse_pairing(event.colour, reasons, taken=not event.reasons)

    def call_off_pairing(self, why: str) -> None:
        """The operator or the end of the run wants no pairing any more: no motion comes of it. Source: X4."""
        session = self.state.session
        if self.state.state is State.PAIRING:
            self.be(pairing_off=why)
            self.tell(f"not pairing, {why}")
        elif session is not None and self.state.state is State.FACING:
            self.refuse_pairing(session.colour, (why,), taken=True)

    def refuse_pairing(self, colour: str, reasons: tuple[str, ...], *, taken: bool) -> None:
        """taken: the drone has been taken for it, and is left in Hold."""
        self.do(Report("pair", {"vehicle": colour, "status": "refused", "reasons": list(reasons)}))
        self.do(Announce(f"{colour.capitalize()}: not paired, {'; '.join(reasons)}"))
        self.be(session=None, pairing=None, pairing_off=None)
        if taken:
            self.be(vehicle=None)
            self.do(LetGo("hold"))
        self.go(Cause.PAIR_REFUSED)

    def facing(self, vehicle: VehicleState) -> None:
        """P1: Armed only after pairing, and pairing only once the nose is on the operator."""
        session = self.session
        off_deg = abs(wrap_deg(bearing_deg(vehicle.position, session.operator.position) - vehicle.yaw_deg))
        if not (off_deg <= FACING_TOLERANCE_DEG and self.at_rest(vehicle)):
            return
        anchor = Anchor(vehicle.position, vehicle.yaw_deg, self.now_s)
        self.be(session=replace(session, anchor=anchor, centre=vehicle.position, paired_at_s=self.now_s))
        self.go(Cause.FACING_OPERATOR)
        self.do(Report("pair", {"vehicle": session.colour, "status": "confirmed", "reasons": []}))
        self.tell("paired, facing you")

    def leave(self, cause: Cause, command: str, why: str) -> None:
        """The session ends: nothing of it is left to fly."""
        session = self.session
        self.withdraw(why, "X3")
        self.end_flight("aborted")
        self.tell(why)
        confirmed = session.anchor is not None
        self.go(cause)
        status = "released" if confirmed else "refused"
        self.do(Report("pair", {"vehicle": session.colour, "status": status, "reasons": [why]}))
        self.be(session=None, pairing=None, vehicle=None, leftover=None, recent=())
        self.be(return_at_s=None, may_return=False, breached=frozenset())
        self.do(LetGo(command))  # type: ignore[arg-type]

    # ------------------------------------------------------------ time and telemetry

    @property
    def vehicle(self) -> VehicleState:
        if self.state.vehicle is None:
            raise RuntimeError("no telemetry")
        return self.state.vehicle

    def telemetry(self, vehicle: VehicleState) -> None:
        """The newest state of the drone: whose it is, then what it means for what goes on."""
        last, speed_m_s = self.state.vehicle, vehicle.velocity.norm
        vehicle = replace(vehicle, disagreement=disagreement(vehicle, last))
        if last is not None and math.isfinite(self.state.speed_m_s):
            alpha = min(1.0, max(0.0, vehicle.at_s - last.at_s) / SPEED_FILTER_S)
            speed_m_s = self.state.speed_m_s + alpha * (speed_m_s - self.state.speed_m_s)
        self.be(vehicle=vehicle, speed_m_s=speed_m_s)
        if self.state.session is None:
            return
        if not vehicle.in_air:
            self.leave(Cause.AUTHORITY_LOST, "nothing", "it is no longer in the air, so it is let go")
            return
        if vehicle.flight_mode not in OURS:
            self.lose(vehicle.flight_mode)
            return
        flight, limits = self.state.flight, self.state.limits
        if flight is not None and last is not None and not vehicle.at_s - last.at_s <= limits.telemetry_age_s:
            self.drop(Cause.STALLED, "nothing was heard from it for a moment")
        elif flight is not None and vehicle.flight_mode != "OFFBOARD" and self.now_s - flight.started_at_s > ENGAGING_S:
            self.drop(Cause.STALLED, f"the autopilot left offboard for {vehicle.flight_mode}")
        elif flight is not None and (unfit := unfit_to_fly(vehicle, limits)) is not None:
            self.drop(Cause.STALLED, unfit)
        match self.state.state:
            case State.FACING:
                self.facing(vehicle)
            case State.SETTLING:
                self.monitor()
                self.settled_yet()
            case State.EXECUTING | State.RETURN_TO_ANCHOR:
                self.follow(vehicle)
            case State.EMERGENCY_HOLD:
                self.monitor()
                self.way_back()
            case State.ARMED | State.DELAYED | State.PLANNED:
                self.monitor()
        self.recheck()

    def lose(self, flight_mode: str) -> None:
        """The mode is none that we command. Where nobody is known to have taken over, the drone is held. Source: X3."""
        if flight_mode == "UNKNOWN":
            self.do(Hold("unknown mode"))
            why = "its flight mode is not told any more, so it is told to hold; pair again to go on"
            self.leave(Cause.AUTHORITY_LOST, "hold", why)
        else:
            why = f"its autopilot or somebody else flies it ({flight_mode}); pair again to go on"
            self.leave(Cause.AUTHORITY_LOST, "nothing", why)

    def tick(self) -> None:
        """What must happen by now although nothing else has."""
        vehicle, limits = self.state.vehicle, self.state.limits
        fresh = vehicle is not None and self.now_s - vehicle.at_s <= limits.telemetry_age_s
        if self.state.flight is not None and not fresh:
            self.drop(Cause.STALLED, "nothing was heard from it for a moment")
        session = self.state.session
        facing_s = self.now_s - session.accepted_at_s if session is not None else 0.0
        if self.state.state is State.FACING and session is not None and facing_s > FACING_TIMEOUT_S:
            why = f"it did not come to rest facing the operator within {FACING_TIMEOUT_S:.0f} s"
            self.refuse_pairing(session.colour, (why,), taken=True)
        pending = self.state.pending
        if pending is not None and self.now_s - self.state.settling_since_s > SETTLING_TIMEOUT_S:
            self.be(pending=None)
            self.refuse(pending, _unmet("envelope", ("R8",), f"it has not come to rest for {SETTLING_TIMEOUT_S:.0f} s"))
        deciding = self.state.deciding
        if deciding is not None and self.state.state is not State.DELAYED and self.now_s > deciding.deadline_s:
            self.do(Release(deciding.request.id))
            self.deny(deciding, "its authority did not answer")
        self.recheck()

    def recheck(self) -> None:
        """A delayed request gets its final decision when nothing hinders it any more, or at its deadline."""
        deciding = self.state.deciding
        if self.state.state is not State.DELAYED or deciding is None:
            return
        over = self.now_s >= deciding.deadline_s
        situation = self.situation()
        if situation is None or (not over and self.now_s - self.state.rechecked_at_s < RECHECK_S):
            return
        self.be(rechecked_at_s=self.now_s)
        if not over:
            again = decide(
                deciding.request,
                deciding.intent,
                situation,
                self.state.limits,
                may_delay=False,
                rules=self.state.rules,
            )
            if again.verdict is not Verdict.APPROVED:
                return
        self.be(deciding=None)
        self.go(Cause.DELAY_OVER)
        self.consider(deciding.request, deciding.intent, may_delay=False)

    def settle(self, cause: Cause) -> None:
        self.be(settling_since_s=self.now_s)
        self.go(cause)

    def settled_yet(self) -> None:
        """Design 2: the new anchor is where the motion has stopped; then what waited is evaluated."""
        vehicle = self.state.vehicle
        fresh = vehicle is not None and vehicle.at_s >= self.state.settling_since_s
        if self.state.state is not State.SETTLING or vehicle is None or not fresh:
            return
        if not (self.at_rest(vehicle) and vehicle.velocity.norm < REST_M_S):
            return
        self.anchor_here(vehicle)
        self.go(Cause.SETTLED)
        pending = self.state.pending
        if pending is not None:
            self.be(pending=None)
            self.evaluate(pending)

    def at_rest(self, vehicle: VehicleState) -> bool:
        """Whether motion has stopped at a known place (design 2)."""
        return self.state.speed_m_s < REST_M_S and vehicle.position.finite and math.isfinite(vehicle.yaw_deg)

    def anchor_here(self, vehicle: VehicleState) -> None:
        anchor = Anchor(vehicle.position, vehicle.yaw_deg, self.now_s)
        self.be(session=replace(self.session, anchor=anchor))

    # ------------------------------------------------------------ flying

    def follow(self, vehicle: VehicleState) -> None:
        """Monitor and complete what is being flown. Source: R9, R10, R8 (duration)."""
        flight = self.state.flight
        if flight is None:
            return
        turned_deg = wrap_deg(vehicle.yaw_deg - flight.last_yaw_deg)
        measured = replace(
            flight.measured,
            yaw_deg=flight.measured.yaw_deg + turned_deg,
            max_speed_m_s=max(flight.measured.max_speed_m_s, self.state.speed_m_s),
        )
        self.be(flight=replace(flight, measured=measured, last_yaw_deg=vehicle.yaw_deg))
        if not self.monitor():
            return
        flight = self.state.flight
        if flight is None:
            return
        elapsed_s = self.now_s - flight.started_at_s
        plan = flight.plan
        facing = abs(wrap_deg(vehicle.yaw_deg - plan.yaw_deg(plan.duration_s))) <= FACING_TOLERANCE_DEG
        off_m = vehicle.position.minus(plan.goal).norm
        lingers = elapsed_s >= plan.duration_s + LINGER_S and off_m <= CLOSE_ENOUGH_M
        arrived = off_m <= ARRIVED_M or lingers
        if elapsed_s >= plan.duration_s and arrived and facing and self.state.speed_m_s < REST_M_S:
            self.complete(vehicle, flight)

    def complete(self, vehicle: VehicleState, flight: Flight) -> None:
        returning = self.state.state is State.RETURN_TO_ANCHOR
        self.end_flight("completed")
        if not returning:
            self.anchor_here(vehicle)
        self.go(Cause.RETURNED if returning else Cause.COMPLETED)
        what = wording.WORD_OF[flight.plan.primitive]
        moved_m = vehicle.position.minus(flight.origin).norm
        self.tell(f"{what} done" if flight.plan.primitive.is_scan else f"{what} done, {moved_m:.2f} m")

    def monitor(self) -> bool:
        """Check everything hard on the measured state; abort if something is or will be broken. True: all well."""
        situation, flight = self.situation(), self.state.flight
        if situation is None:
            return True
        if flight is None and self.now_s - self.state.checked_at_s < RECHECK_S:
            return True
        self.be(checked_at_s=self.now_s)
        plan = flight.plan if flight else None
        elapsed_s = self.now_s - flight.started_at_s if flight else 0.0
        baseline = flight.baseline if flight else {}
        s = self.state
        seen = watch(situation, plan, elapsed_s, s.speed_m_s, baseline, s.limits, s.rules)
        if flight is not None:
            measured = replace(
                flight.measured,
                min_clearance_m=_least(flight.measured.min_clearance_m, seen.clearance_m),
                min_separation_m=_least(flight.measured.min_separation_m, seen.separation_m),
            )
            self.be(flight=replace(flight, measured=measured))
        actual = frozenset(b.constraint for b in seen.breaches if b.kind == "actual")
        news = [b for b in seen.breaches if b.kind == "actual" and b.constraint not in self.state.breached]
        self.be(breached=actual)
        aborts = [b for b in seen.breaches if flight is not None and not b.mending]
        if aborts:
            self.emergency(aborts, news)
            return False
        for breach in news:
            self.report_violation(breach, "none, the plan mends it" if flight else "hold")
            self.tell(breach.text)
        return True

    def emergency(self, aborts: list[Breach], news: list[Breach]) -> None:
        """R10: hold now, keep the anchor. One way back by itself: if that fails too, somebody must ask for the next move."""
        self.do(Hold("violation"))
        policy = self.state.policy.return_to_anchor
        outward = self.state.state is State.EXECUTING
        for breach in aborts:
            if breach.kind == "predicted" or breach in news:
                self.report_violation(breach, "abort")
        self.end_flight("aborted")
        self.go(Cause.VIOLATION)
        self.be(return_at_s=None, may_return=policy == "auto" and outward, checked_at_s=self.now_s)
        self.tell("holding, " + "; ".join(dict.fromkeys(b.text for b in aborts)))
        if policy == "ask":
            self.tell("say continue to return to the anchor")

    def way_back(self) -> None:
        """Design 14: once the supervisor approves the way back it is announced, and flown two seconds later."""
        situation = self.situation()
        if not self.state.may_return or self.state.deciding is not None or situation is None:
            return
        if not self.at_rest(situation.vehicle) or self.now_s - self.state.settling_since_s < RECHECK_S:
            return
        self.be(settling_since_s=self.now_s)
        anchor = self.session.anchor
        if anchor is None:
            return
        vehicle, limits = situation.vehicle, self.state.limits
        plan = plan_return(vehicle.position, vehicle.yaw_deg, situation.operator.position, anchor.position, limits)
        decision = decide_plan(RETURN_ID, plan, None, situation, limits, rules=self.state.rules)
        if decision.verdict is not Verdict.APPROVED:
            self.be(return_at_s=None)
        elif self.state.return_at_s is None:
            self.be(return_at_s=self.now_s + limits.return_after_s)
            self.tell(f"returning to the anchor in {limits.return_after_s:.0f} seconds")
        elif self.now_s >= self.state.return_at_s:
            # Nobody asks for it: the request only carries its id to the airspace authority and back.
            request = ManeuverRequest(RETURN_ID, Command.CONTINUE, Modality.PANEL, 1.0, self.now_s, self.now_s)
            self.be(deciding=Deciding(request, BACK, decision, self.now_s + RESERVATION_TIMEOUT_S))
            volume = swept_volume(plan, self.session.colour, vehicle.sigma_m, self.now_s, limits)
            self.do(Reserve(RETURN_ID, volume))

    def stalled(self, why: str) -> None:
        """The guard, the controller or the vehicle could not do what was ordered. Source: X7."""
        if self.state.state is State.FACING:
            self.do(Hold("stalled"))
            self.call_off_pairing(why)
        else:
            self.drop(Cause.STALLED, why)

    def drop(self, cause: Cause, why: str) -> None:
        """After any stall or link gap the rest of a plan is dropped and asked for anew. Source: X7."""
        if self.state.flight is None:
            return
        self.do(Hold("stalled"))
        self.end_flight("aborted")
        self.settle(cause)
        self.tell(f"holding, {why}; ask again")

    def rest_of_flight(self) -> Leftover | None:
        """What the plan being flown still had to go, by what was measured."""
        flight, vehicle = self.state.flight, self.state.vehicle
        if flight is None:
            return self.state.leftover
        plan, limits = flight.plan, self.state.limits
        if vehicle is None or plan.primitive is Primitive.RETURN:
            return None
        if plan.primitive.is_scan:
            turned_deg = math.copysign(flight.measured.yaw_deg, flight.measured.yaw_deg * plan.turn_deg)
            left, least = min(abs(plan.turn_deg), FULL_TURN_DEG) - turned_deg, FACING_TOLERANCE_DEG
            return Leftover(plan.primitive, min(left, FULL_TURN_DEG), self.now_s) if left > least else None
        moved, d = vehicle.position.minus(plan.start), plan.direction
        left = plan.length_m - (moved.north * d.north + moved.east * d.east + moved.down * d.down)
        if not left >= limits.shortest_m:
            return None
        slowness = full_speed_m_s(plan.primitive, limits) / plan.move.speed
        return Leftover(plan.primitive, min(left, plan.length_m), self.now_s, slowness)

    def end_flight(self, status: str) -> None:
        if self.state.flight is None:
            return
        self.report_motion(status)
        self.do(Release(self.state.flight.request_id))
        if self.state.flight.request_id != RETURN_ID:
            self.count(**{status: 1})
        self.be(flight=None)

    # ------------------------------------------------------------ reports

    def report_motion(self, status: str) -> None:
        flight = self.state.flight
        if flight is None:
            return
        measured: Measured = flight.measured
        moved = self.vehicle.position.minus(flight.origin) if status != "started" else Ned(0.0, 0.0, 0.0)
        self.do(
            Report(
                "motion",
                {
                    "request": flight.request_id,
                    "status": status,
                    "displacement_enu_m": list(enu(moved)),
                    "yaw_deg": measured.yaw_deg,
                    "min_clearance_m": measured.min_clearance_m,
                    "min_separation_m": measured.min_separation_m,
                    "max_speed_m_s": measured.max_speed_m_s,
                },
            )
        )

    def report_violation(self, breach: Breach, action: str) -> None:
        if breach.kind == "actual":
            self.count(violations=1)
        self.do(
            Report(
                "violation",
                {
                    "kind": breach.kind,
                    "requirements": list(breach.requirements),
                    "constraint": breach.constraint,
                    "margin": breach.margin,
                    "action": action,
                },
            )
        )


def disagreement(vehicle: VehicleState, last: VehicleState | None) -> Ned:
    """How far the position has lately moved otherwise than the velocity says (m): a frozen or jumping estimate. Source: X6."""
    if last is None:
        return Ned(0.0, 0.0, 0.0)
    dt_s = max(0.0, vehicle.at_s - last.at_s)
    keep = math.exp(-dt_s / DISAGREEMENT_S)
    moved = vehicle.position.minus(last.position)
    return Ned(
        *(
            keep * d + m - 0.5 * dt_s * (v + w)
            for d, m, v, w in zip(last.disagreement, moved, vehicle.velocity, last.velocity, strict=True)
        )
    )


def _said(request: ManeuverRequest) -> str:
    return request.command.value.replace("go_", "").replace("_", " ")


def _asked_m(request: ManeuverRequest, state: ArbiterState) -> float | None:
    if request.command is Command.CONTINUE:
        return None
    intent = interpret(request, state.limits)
    return None if intent.primitive.is_scan else intent.amount


def _unmet(constraint: str, requirements: tuple[str, ...], text: str) -> Finding:
    """A refusal that is a fact, not a distance."""
    return Finding(constraint, requirements, None, "", False, text)


def _least(a: float | None, b: float | None) -> float | None:
    if a is None or b is None:
        return a if b is None else b
    return min(a, b)


def _decision_fields(decision: Decision) -> dict[str, object]:
    return {
        "request": decision.request_id,
        "verdict": decision.verdict,
        "requested_m": decision.requested_m,
        "granted_m": decision.granted_m,
        "findings": [_finding_fields(f) for f in decision.findings],
        "granted_findings": [_finding_fields(f) for f in decision.granted_findings],
    }


def _finding_fields(finding: Finding) -> dict[str, object]:
    return {
        "requirements": list(finding.requirements),
        "constraint": finding.constraint,
        "margin": finding.margin,
        "unit": finding.unit,
        "passed": finding.passed,
        "text": finding.text,
    }
