"""The arbiter: one pure step from state and event to state and effects. The one owner of the mode.

Here is what each event means; what then happens is in `requests`, `sessions`, `deciding`, `flying` and `monitoring`, each of
which uses only those before it in: `stepping`, `flying`, `deciding`, `monitoring` and `sessions`, `requests`.

Source: paper III-C (pipeline), IV-B (state machine), design "Functional core" and decisions 2-7, 13-15.
"""

from __future__ import annotations

import math
from dataclasses import replace

from m3r_app.arbiter import decisions as deciding
from m3r_app.arbiter import execution as flying
from m3r_app.arbiter import monitoring, requests, sessions
from m3r_app.arbiter.context import Step
from m3r_app.events import (
    ArbiterState,
    ClaimLost,
    Effect,
    Ended,
    Event,
    Hold,
    NeighboursHeard,
    PairingAnswered,
    PairingAsked,
    Requested,
    ReservationAnswered,
    Stalled,
    TelemetryArrived,
    Tick,
)
from m3r_app.modes import Cause, State
from safety.vocabulary import Command, Ned, VehicleState

SPEED_FILTER_S = 0.1
DISAGREEMENT_S = 2.0
"""Over this time position and velocity are compared."""


def step(state: ArbiterState, event: Event, now_s: float) -> tuple[ArbiterState, tuple[Effect, ...]]:
    """What becomes of `state` when `event` happens at now_s, and what the shell must do about it. Never raises."""
    run = Step(state, now_s)
    if state.authority and isinstance(event, Requested) and event.request.command is Command.STOP:
        run.do(Hold("stop"))  # X4: before anything else
    if state.state is State.BLOCKED:
        run.go(Cause.TOLD)
    match event:
        case Requested():
            requests.requested(run, event)
        case PairingAsked():
            sessions.activate(run, event.colour)
        case PairingAnswered():
            sessions.pairing_answered(run, event)
        case TelemetryArrived():
            telemetry(run, event.vehicle)
        case NeighboursHeard():
            run.be(neighbours=event.neighbours, reservations=event.reservations)
        case ReservationAnswered():
            deciding.reservation_answered(run, event)
        case Stalled() if state.state is State.FACING:
            run.do(Hold("stalled"))
            sessions.call_off_pairing(run, event.reason)
        case Stalled():
            flying.drop(run, event.reason)
        case ClaimLost() if state.authority:
            run.do(Hold("claim lost"))
            sessions.leave(
                run, Cause.AUTHORITY_LOST, "hold", f"{event.reason}, it is told to hold; pair again to go on"
            )
        case ClaimLost():
            sessions.call_off_pairing(run, event.reason)
        case Tick():
            tick(run)
        case Ended() if state.authority:
            run.do(Hold("ended"))
            where = "it holds where it is" if run.hears else "it is not heard, so its own failsafe has it"
            sessions.leave(run, Cause.RELEASED, "hold", f"{event.reason}, {where}")
        case Ended():
            sessions.call_off_pairing(run, event.reason)
    return run.state, tuple(run.effects)


def telemetry(run: Step, heard: VehicleState) -> None:
    """The newest state of the drone: whose it is, then what it means for what goes on."""
    last = run.state.vehicle
    vehicle = replace(heard, disagreement=disagreement(heard, last))
    run.be(vehicle=vehicle, speed_m_s=filtered_speed_m_s(vehicle, last, run.state.speed_m_s))
    if run.state.session is None or sessions.lost(run, vehicle):
        return
    trouble = flying.trouble(run, vehicle, last)
    if trouble is not None:
        flying.drop(run, trouble)
    match run.state.state:
        case State.FACING:
            sessions.face(run, vehicle)
        case State.SETTLING:
            monitoring.monitor(run)
            requests.come_to_rest(run)
        case State.EXECUTING | State.RETURN_TO_ANCHOR:
            flying.measure(run, vehicle)
            if monitoring.monitor(run):
                flying.arrive(run, vehicle)
        case State.EMERGENCY_HOLD:
            monitoring.monitor(run)
            monitoring.way_back(run)
        case State.ARMED | State.DELAYED | State.PLANNED:
            monitoring.monitor(run)
    deciding.recheck(run)


def tick(run: Step) -> None:
    """What must happen by now although nothing else has."""
    flying.overdue(run)
    sessions.overdue(run)
    requests.overdue(run)
    deciding.overdue(run)


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


def filtered_speed_m_s(vehicle: VehicleState, last: VehicleState | None, before_m_s: float) -> float:
    """The measured speed, smoothed; what was no number is forgotten."""
    speed_m_s = vehicle.velocity.norm
    if last is None or not math.isfinite(before_m_s):
        return speed_m_s
    alpha = min(1.0, max(0.0, vehicle.at_s - last.at_s) / SPEED_FILTER_S)
    return before_m_s + alpha * (speed_m_s - before_m_s)
