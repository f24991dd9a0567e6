"""From the request to pair until the drone is let go: who is paired, and whose drone it is.

Source: P1, X3, X4, X8; design 4, 12, 15. What is checked before pairing is `pairing`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

from m3r_app.arbiter import decisions as deciding
from m3r_app.arbiter import execution as flying
from m3r_app.arbiter import reports
from m3r_app.arbiter.context import FACING_TOLERANCE_DEG, Step
from m3r_app.events import Announce, FaceOperator, Hold, LetGo, Pair, PairingAnswered, Session
from m3r_app.modes import Cause, State
from safety.frames import bearing_deg, wrap_deg
from safety.vocabulary import Finding, ManeuverRequest, VehicleState

FACING_TIMEOUT_S = 20.0
OURS = frozenset({"OFFBOARD", "HOLD"})
"""Flight modes in which nobody else flies the drone. Source: design 4."""

# ---------------------------------------------------------------- it begins


def activate(run: Step, colour: str, doubt: Finding | None = None) -> None:
    """Ask the shell to pair, unless something is against it."""
    if doubt is None and run.can(Cause.PAIR_REQUESTED):
        run.be(pairing=colour, pairing_off=None)
        run.go(Cause.PAIR_REQUESTED)
        run.do(Pair(colour))
        return
    session = run.state.session
    taken = session.colour if session is not None else run.state.pairing
    if doubt is not None:
        _say_not_paired(run, colour, doubt.text)
    elif colour == taken:
        run.tell("already paired" if session is not None and session.anchor is not None else "already pairing")
    else:
        _say_not_paired(run, colour, f"{taken} is paired; disconnect it first")


def pairing_answered(run: Step, event: PairingAnswered) -> None:
    """The shell has checked: turn to the operator, or refuse. Source: X8, design 12."""
    s = run.state
    if s.state is not State.PAIRING or event.colour != s.pairing:
        return
    reasons = event.reasons if s.pairing_off is None else (s.pairing_off, *event.reasons)
    if event.operator is None or event.world is None:
        reasons = reasons or ("the operator's position or what stands around is unknown",)
    elif not run.hears:
        reasons = reasons or ("nothing has been heard from it",)
    elif not reasons:
        run.be(session=Session(event.colour, event.operator, event.world, run.now_s), breached=frozenset())
        run.go(Cause.PAIR_ACCEPTED)
        run.do(FaceOperator(bearing_deg(run.vehicle.position, event.operator.position)))
        return
    # Where the shell found nothing against it, it has taken the drone and must let it go again.
    refuse_pairing(run, event.colour, reasons, taken=not event.reasons)


def face(run: Step, vehicle: VehicleState) -> None:
    """P1: Armed only after pairing, and pairing only once the nose is on the operator."""
    session = run.session
    off_deg = abs(wrap_deg(bearing_deg(vehicle.position, session.operator.position) - vehicle.yaw_deg))
    if not (off_deg <= FACING_TOLERANCE_DEG and run.at_rest(vehicle)):
        return
    run.be(session=replace(session, centre=vehicle.position, paired_at_s=run.now_s))
    run.anchor_here(vehicle)
    run.go(Cause.FACING_OPERATOR)
    run.do(reports.pair(session.colour, "confirmed"))
    run.tell("paired, facing you")


# ---------------------------------------------------------------- it does not come about


def call_off_pairing(run: Step, why: str) -> None:
    """The operator or the end of the run wants no pairing any more: no motion comes of it. Source: X4."""
    if run.state.state is State.PAIRING:
        run.be(pairing_off=why)
        run.tell(f"not pairing, {why}")
    elif run.state.state is State.FACING:
        refuse_pairing(run, run.session.colour, (why,), taken=True)


def overdue(run: Step) -> None:
    """The drone does not come to face the operator."""
    if run.state.state is State.FACING and run.now_s - run.session.accepted_at_s > FACING_TIMEOUT_S:
        call_off_pairing(run, f"it did not come to rest facing the operator within {FACING_TIMEOUT_S:.0f} s")


def refuse_pairing(run: Step, colour: str, reasons: tuple[str, ...], *, taken: bool) -> None:
    """taken: the drone has been taken for it, and is left in Hold."""
    _say_not_paired(run, colour, *reasons)
    run.be(session=None, pairing=None, pairing_off=None)
    if taken:
        run.be(vehicle=None)
        run.do(LetGo("hold"))
    run.go(Cause.PAIR_REFUSED)


def _say_not_paired(run: Step, colour: str, *reasons: str) -> None:
    run.do(reports.pair(colour, "refused", *reasons))
    run.do(Announce(f"{colour.capitalize()}: not paired, {'; '.join(reasons)}"))


# ---------------------------------------------------------------- it ends


def disconnect(run: Step, request: ManeuverRequest) -> None:
    """The operator lets the drone go, or wants no pairing after all. Source: design 15."""
    session, paired = run.state.session, run.state.pairing
    if session is not None:
        paired = session.colour
    if paired is None or request.colour not in (None, paired):
        run.tell(f"{request.colour or 'no drone'} is not paired, so there is nothing to disconnect")
        return
    if session is None or session.anchor is None:
        call_off_pairing(run, "disconnected before it was paired")
        return
    run.do(Hold("disconnect"))
    then = run.state.policy.on_disconnect
    why = "disconnected, it resumes its mission" if then == "resume" else "disconnected, it holds where it is"
    leave(run, Cause.RELEASED, then, why)


def lost(run: Step, vehicle: VehicleState) -> bool:
    """Whether the drone is ours no longer; then the session is over. Source: X3."""
    if not vehicle.in_air:
        leave(run, Cause.AUTHORITY_LOST, "nothing", "it is no longer in the air, so it is let go")
    elif vehicle.flight_mode == "UNKNOWN":
        # Nobody is known to have taken over, so the drone is not left with the last setpoint.
        run.do(Hold("unknown mode"))
        why = "its flight mode is not told any more, so it is told to hold; pair again to go on"
        leave(run, Cause.AUTHORITY_LOST, "hold", why)
    elif vehicle.flight_mode not in OURS:
        why = f"its autopilot or somebody else flies it ({vehicle.flight_mode}); pair again to go on"
        leave(run, Cause.AUTHORITY_LOST, "nothing", why)
    else:
        return False
    return True


def leave(run: Step, cause: Cause, command: Literal["hold", "resume", "nothing"], why: str) -> None:
    """The session ends: nothing of it is left to fly. command: what becomes of the drone."""
    session = run.session
    deciding.withdraw(run, why, "X3")
    flying.end(run, "aborted")
    run.tell(why)
    run.go(cause)
    run.do(reports.pair(session.colour, "released" if session.anchor is not None else "refused", why))
    run.be(session=None, pairing=None, vehicle=None, leftover=None, recent=())
    run.be(return_at_s=None, may_return=False, breached=frozenset())
    run.do(LetGo(command))
