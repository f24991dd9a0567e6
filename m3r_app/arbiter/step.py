"""The arbiter: one pure step from state and event to state and effects. The one owner of the mode.

Here is what each event means; what then happens is in `requests`, `sessions`, `ground_work`, `decisions`, `execution` and
`monitoring`, each of which uses only those before it in: `context`, `execution`, `decisions`, `monitoring`, `sessions` and
`ground_work`, `requests` and `distrust`.

Source: paper III-C (pipeline), IV-B (state machine), design "Functional core" and decisions 2-7, 13-15.
"""

from __future__ import annotations

from dataclasses import replace
from typing import assert_never

from m3r_app.arbiter import decisions, distrust, execution, ground_work, monitoring, requests, sessions
from m3r_app.arbiter.context import Step
from m3r_app.arbiter.effects import Effect, Hold
from m3r_app.arbiter.events import (
    ClaimLost,
    Ended,
    Event,
    FrameMoved,
    GroundWorkEnded,
    LandingAsked,
    NeighboursHeard,
    PairingAnswered,
    PairingAsked,
    PropertyBroken,
    Requested,
    ReservationAnswered,
    Stalled,
    TakeOffAsked,
    TelemetryArrived,
    Tick,
)
from m3r_app.arbiter.state import ArbiterState
from m3r_app.output import Notice
from safety.estimate import disagreement, moved
from safety.vocabulary import Cause, Command, State, VehicleState


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
        case TakeOffAsked():
            ground_work.take_off(run, event)
        case LandingAsked():
            ground_work.land(run, event)
        case GroundWorkEnded():
            ground_work.ended(run, event)
        case TelemetryArrived():
            telemetry(run, event.vehicle)
        case NeighboursHeard():
            run.state = replace(run.state, neighbours=event.neighbours, reservations=event.reservations)
        case ReservationAnswered():
            decisions.reservation_answered(run, event)
        case Stalled() if state.state is State.FACING:
            run.do(Hold("stalled"))
            sessions.call_off_pairing(run, event.reason)
        case Stalled():
            execution.drop(run, event.reason)
        case FrameMoved():
            monitoring.hold_anew(run, event.reason)
        case ClaimLost() if state.authority:
            run.do(Hold("claim lost"))
            why = f"{event.reason}, it is told to hold; pair again to go on"
            notice = Notice.VEHICLE_SILENT if event.silent else Notice.LET_GO
            sessions.leave(run, Cause.AUTHORITY_LOST, "hold", why, notice=notice)
        case ClaimLost():
            sessions.call_off_pairing(run, event.reason)
        case PropertyBroken():
            distrust.property_broken(run, event)
        case Tick():
            tick(run)
        case Ended() if state.authority:
            run.do(Hold("ended"))
            where = "it holds where it is" if run.hears else "it is not heard, so its own failsafe has it"
            sessions.leave(run, Cause.RELEASED, "hold", f"{event.reason}, {where}")
        case Ended():
            sessions.call_off_pairing(run, event.reason)
        case _:
            assert_never(event)
    return run.state, tuple(run.effects)


def telemetry(run: Step, heard: VehicleState) -> None:
    """The newest state of the drone: whose it is, then what it means for what goes on."""
    last = run.state.vehicle
    vehicle = replace(heard, disagreement=disagreement(heard, last))
    run.state = replace(run.state, vehicle=vehicle, motion=moved(run.state.motion, vehicle, last))
    if run.state.session is None or sessions.lost(run, vehicle):
        return
    monitoring.confirm(run, vehicle)
    if last is not None and monitoring.jumped(run, vehicle, last):
        return
    trouble = execution.trouble(run, vehicle, last)
    if trouble is not None:
        execution.drop(run, trouble)
    if sessions.astray(run):
        return
    match run.state.state:
        case State.FACING:
            sessions.face(run, vehicle)
        case State.SETTLING:
            monitoring.monitor(run)
            requests.come_to_rest(run)
        case State.EXECUTING | State.RETURN_TO_ANCHOR:
            execution.measure(run, vehicle, last)
            if monitoring.monitor(run):
                execution.arrive(run, vehicle)
        case State.EMERGENCY_HOLD:
            monitoring.monitor(run)
            monitoring.way_back(run)
            sessions.unlocated(run)
        case State.ARMED | State.DELAYED | State.PLANNED:  # pragma: no branch - the others last no longer than a step
            monitoring.monitor(run)
    decisions.recheck(run)


def tick(run: Step) -> None:
    """What must happen by now although nothing else has."""
    execution.overdue(run)
    sessions.overdue(run)
    requests.overdue(run)
    decisions.overdue(run)
