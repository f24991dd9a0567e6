"""From the request to pair until the drone is let go: who is paired, and whose drone it is.

Source: P1, X3, X4, X8; design 4, 12, 15. What is checked before pairing is `pairing`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from m3r_app.arbiter import decisions, execution, reports
from m3r_app.arbiter.announcements import Announce
from m3r_app.arbiter.context import Step
from m3r_app.arbiter.effects import (
    AnchorMoved,
    CallOffPairing,
    FaceOperator,
    Hold,
    LetGo,
    LetGoCommand,
    Pair,
    PlayTune,
)
from m3r_app.arbiter.events import PairingAnswered
from m3r_app.arbiter.state import Session
from m3r_app.output import MotionStatus, Notice, PairStatus
from safety.confidence import localization
from safety.estimate import HOVER_SAMPLE_S, adapted, is_astray, observed, spans_s, too_noisy, with_hover
from safety.frames import bearing_deg, wrap_deg
from safety.vocabulary import Cause, Finding, FlightMode, ManeuverRequest, Path, State, VehicleState

TOLD_WHOLE_S = 1.2
"""That it is disarmed, stands and has started anew comes in messages of their own, one of them only once a second."""
OURS = frozenset({FlightMode.OFFBOARD, FlightMode.HOLD})
"""Flight modes in which nobody else flies the drone. Source: design 4."""

# ---------------------------------------------------------------- it begins


def activate(run: Step, colour: str, doubt: Finding | None = None) -> None:
    """Ask the shell to pair, unless something is against it."""
    if doubt is None and run.can(Cause.PAIR_REQUESTED):
        run.state = replace(run.state, pairing=colour, pairing_off=None)
        run.go(Cause.PAIR_REQUESTED)
        run.do(Pair(colour))
        return
    session = run.state.session
    taken = session.colour if session is not None else run.state.pairing
    if doubt is not None:
        _say_not_paired(run, colour, doubt.text)
    elif colour == taken:
        paired = session is not None and session.anchor is not None
        run.tell(Notice.ALREADY_PAIRED if paired else Notice.ALREADY_PAIRING)
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
        session = Session(event.colour, event.operator, event.world, run.now_s, restarts=run.vehicle.restarts)
        run.state = replace(run.state, session=session, breached=frozenset(), suspected=(), down_since_s=None)
        run.go(Cause.PAIR_ACCEPTED)
        run.do(FaceOperator(bearing_deg(run.vehicle.position, event.operator.position)))
        return
    # Where the shell found nothing against it, it has taken the drone and must let it go again.
    refuse_pairing(run, event.colour, reasons, taken=not event.reasons)


def face(run: Step, vehicle: VehicleState) -> None:
    """P1: Armed only after pairing, and pairing only once the nose is on the operator.

    Meanwhile its hover is watched: an estimate that is noisier than the limits are made for is learnt, and widens the
    limits of this session; one that is too noisy is not flown with. Source: X6, X11.
    """
    limits = run.state.limits
    session = replace(run.session, hover=with_hover(run.session.hover, vehicle, run.state.motion, limits.learn_s))
    run.state = replace(run.state, session=session)
    off_deg = abs(wrap_deg(bearing_deg(vehicle.position, session.operator.position) - vehicle.yaw_deg))
    seen_s = spans_s(session.hover)
    if not (off_deg <= limits.facing_tolerance_deg and seen_s >= limits.hover_s):
        return
    lately = tuple(s for s in session.hover if vehicle.at_s - s.at_s <= limits.hover_s)
    if spans_s(lately) < 0.5 * limits.hover_s:
        return  # what was watched before a gap says nothing of now
    told: tuple[float, ...] = ()
    if adapted(limits, observed(lately)) != limits or not run.at_rest(vehicle):
        if seen_s < limits.learn_s - 2.0 * HOVER_SAMPLE_S:
            return
        noise = observed(session.hover)
        why = too_noisy(noise, limits)
        if why is not None:
            refuse_pairing(run, session.colour, (why,), taken=True)
            return
        wider = adapted(limits, noise)
        if not run.state.motion.rests(
            noise, wider
        ):  # pragma: no cover - seen on PX4 in gusts: the next look judges anew
            return
        session = replace(session, configured=limits, noise=noise)
        run.state = replace(run.state, limits=wider)
        told = (noise.position_m, wider.tracking_m - limits.tracking_m)
    run.state = replace(run.state, session=replace(session, centre=vehicle.position, paired_at_s=run.now_s, hover=()))
    run.anchor_here(vehicle)
    run.go(Cause.FACING_OPERATOR)
    run.do(reports.pair(session.colour, PairStatus.CONFIRMED))
    run.do(PlayTune())
    run.tell(Notice.PAIRED, metres=told)


# ---------------------------------------------------------------- it does not come about


def call_off_pairing(run: Step, why: str) -> None:
    """The operator or the end of the run wants no pairing any more: no motion comes of it. Source: X4."""
    colour = run.state.pairing
    if run.state.state is State.PAIRING and colour is not None:
        if run.state.pairing_off is None:
            run.do(CallOffPairing(colour))
        run.state = replace(run.state, pairing_off=why)
        run.tell(Notice.NOT_PAIRING, why)
    elif run.state.state is State.FACING:
        refuse_pairing(run, run.session.colour, (why,), taken=True)


def overdue(run: Step) -> None:
    """The drone does not come to face the operator."""
    timeout_s = run.state.limits.facing_timeout_s
    if run.state.state is State.FACING and run.now_s - run.session.accepted_at_s > timeout_s:
        call_off_pairing(run, f"it did not come to rest facing the operator within {timeout_s:.0f} s")


def refuse_pairing(run: Step, colour: str, reasons: tuple[str, ...], *, taken: bool) -> None:
    """taken: the drone has been taken for it, and is left in Hold."""
    _say_not_paired(run, colour, *reasons)
    run.state = replace(run.state, session=None, pairing=None, pairing_off=None)
    if taken:
        run.state = replace(run.state, vehicle=None)
        run.do(LetGo("hold"))
    run.go(Cause.PAIR_REFUSED)


def _say_not_paired(run: Step, colour: str, *reasons: str) -> None:
    run.do(reports.pair(colour, PairStatus.REFUSED, *reasons))
    run.do(Announce(Notice.NOT_PAIRED, colour, reasons))


# ---------------------------------------------------------------- it ends


def disconnect(run: Step, request: ManeuverRequest) -> None:
    """The operator lets the drone go, or wants no pairing after all. Source: design 15."""
    session, paired = run.state.session, run.state.pairing
    if session is not None:
        paired = session.colour
    if paired is None or request.colour not in (None, paired):
        run.tell(Notice.NOTHING_TO_DISCONNECT, asked=request.colour or "")
        return
    if session is None or session.anchor is None:
        call_off_pairing(run, "disconnected before it was paired")
        return
    run.do(Hold("disconnect"))
    then = run.state.policy.on_disconnect
    why = "disconnected, it resumes its mission" if then == "resume" else "disconnected, it holds where it is"
    leave(run, Cause.RELEASED, then, why)


def lost(run: Step, vehicle: VehicleState) -> bool:
    """Whether the drone is ours no longer; then the session is over. Source: X3.

    A Hold that this app did not ask for is somebody's STOP, or the autopilot's own: only a new pairing goes on (design 4).
    """
    down = vehicle.in_air is False or vehicle.armed is False
    run.state = replace(
        run.state,
        down_since_s=(run.now_s if run.state.down_since_s is None else run.state.down_since_s) if down else None,
    )
    if vehicle.restarts > run.session.restarts:
        leave(run, Cause.AUTHORITY_LOST, "nothing", "its autopilot restarted in flight", vehicle_lost=True)
    elif run.state.down_since_s is not None and run.now_s - run.state.down_since_s < TOLD_WHOLE_S:
        return False
    elif vehicle.armed is False and vehicle.flight_mode in (*OURS, FlightMode.UNKNOWN):
        # PX4 calls it landed at once. Nothing that is flown in a session comes down to the ground.
        leave(run, Cause.AUTHORITY_LOST, "nothing", "it was disarmed in the air by somebody else: it falls")
    elif vehicle.in_air is False:
        leave(run, Cause.AUTHORITY_LOST, "nothing", "it is no longer in the air, so it is let go")
    elif vehicle.flight_mode == FlightMode.UNKNOWN or vehicle.in_air is None:
        # Nobody is known to have taken over, so the drone is not left with the last setpoint.
        run.do(Hold("unknown mode"))
        what = "its flight mode is" if vehicle.flight_mode == FlightMode.UNKNOWN else "whether it flies is"
        why = f"{what} not told any more, so it is told to hold; pair again to go on"
        leave(run, Cause.AUTHORITY_LOST, "hold", why)
    elif vehicle.unasked_hold:
        why = "somebody else or its own failsafe put it in Hold, which counts as stop; pair again to go on"
        leave(run, Cause.AUTHORITY_LOST, "hold", why)
    elif vehicle.flight_mode not in OURS:
        why = f"its autopilot or somebody else flies it ({vehicle.flight_mode}); pair again to go on"
        leave(run, Cause.AUTHORITY_LOST, "nothing", why)
    else:
        return False
    return True


def unlocated(run: Step) -> None:
    """A drone in EmergencyHold that does not know where it is gets the best that its autopilot offers, if so chosen."""
    s, situation = run.state, run.situation()
    if situation is None or s.policy.position_lost == "hold":
        return
    here = Path(np.array([situation.vehicle.position]), np.zeros(1))
    if localization(here, situation, s.limits).passed:
        run.state = replace(run.state, unlocated_since_s=None)
    elif s.unlocated_since_s is None:
        run.state = replace(run.state, unlocated_since_s=run.now_s)
    elif run.now_s - s.unlocated_since_s >= s.limits.position_lost_s:
        why = "it does not know where it is any more, so it is told to land"
        leave(run, Cause.AUTHORITY_LOST, "land", why)


def astray(run: Step) -> bool:
    """Whether it has been flown further from where it believes to be than one aborted maneuver explains; then it is over.

    At rest a stuck position is as good as any other, so each next move would be granted from the same place. Source: X6, X11.
    """
    if run.state.flight is not None or not is_astray(run.session.astray, run.state.limits):
        return False
    if not run.at_rest(run.vehicle):
        return False  # an autopilot's own Hold would fly on to where it brakes to, which a stuck position never reaches
    off_m = run.session.astray.norm
    why = f"its position has missed {off_m:.1f} m that its velocity says it flew, so it holds; look after its GPS, then pair again"
    leave(run, Cause.AUTHORITY_LOST, "hold", why)
    return True


def leave(
    run: Step,
    cause: Cause,
    command: LetGoCommand,
    why: str,
    *,
    vehicle_lost: bool = False,
    notice: Notice = Notice.LET_GO,
) -> None:
    """The session ends: nothing of it is left to fly. command: what becomes of the drone.

    What is suspected was ours if we end it, and is not where somebody else had taken over meanwhile.
    """
    session = run.session
    if cause is Cause.RELEASED:
        for suspected in run.state.suspected:
            run.violated(suspected)
    decisions.withdraw(run, why, "X3")
    execution.end(run, MotionStatus.ABORTED)
    run.tell(notice, why)
    run.go(cause)
    run.do(reports.pair(session.colour, PairStatus.RELEASED if session.anchor is not None else PairStatus.REFUSED, why))
    run.state = replace(
        run.state,
        session=None,
        pairing=None,
        vehicle=None,
        leftover=None,
        recent=(),
        limits=session.configured or run.state.limits,
    )
    run.state = replace(run.state, return_at_s=None, may_return=False, breached=frozenset(), suspected=())
    run.state = replace(run.state, down_since_s=None, unlocated_since_s=None)
    if session.anchor is not None:
        run.do(AnchorMoved(None, run.state.limits.workspace_m))
    run.do(LetGo(command, vehicle_lost))
