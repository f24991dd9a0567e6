"""What is being flown: how it begins, is measured, is completed or dropped, and what STOP leaves of it.

Source: R8 (duration), R9 (what is measured), X7, X12, X13; paper III-C (Execute), design 2, 7.
"""

from __future__ import annotations

import math
from dataclasses import replace

from m3r_app.arbiter import reports
from m3r_app.arbiter.context import Step
from m3r_app.arbiter.effects import Fly, Hold, Release
from m3r_app.arbiter.state import Flight, Leftover, Tally
from m3r_app.output import MotionStatus, Notice
from safety.confidence import unfit_to_fly
from safety.estimate import astray, flown
from safety.frames import wrap_deg
from safety.monitor import Watch, watch
from safety.planner import full_speed_m_s
from safety.situation import Situation
from safety.supervisor import FULL_TURN_DEG
from safety.vocabulary import Cause, Finding, FlightMode, Ned, Plan, Primitive, State, VehicleState

UNHEARD = "nothing was heard from it for a moment"


def begin(
    run: Step, request_id: str, plan: Plan, situation: Situation, findings: tuple[Finding, ...], *, asked_for: bool
) -> None:
    """Fly the plan. What it breaks from the start, by its findings, it may only mend. Source: X13."""
    run.go(Cause.RETURN_APPROVED if plan.primitive is Primitive.RETURN else Cause.VOLUME_GRANTED)
    s, vehicle = run.state, situation.vehicle
    mending = {(f.constraint, of) for f in findings for of, _ in f.below}
    seen = watch(situation, plan, 0.0, s.speed_m_s, {}, s.limits, s.rules)
    baseline = {(kind, rule, of): m for (kind, rule, of), m in seen.negative.items() if (rule, of) in mending}
    flight = Flight(request_id, plan, run.now_s, vehicle.position, vehicle.yaw_deg, baseline, asked_for=asked_for)
    run.state = replace(run.state, flight=flight, return_at_s=None, may_return=False)
    run.do(Fly(plan))
    run.do(reports.motion(flight, MotionStatus.STARTED, Ned(0.0, 0.0, 0.0)))


def measure(run: Step, vehicle: VehicleState, last: VehicleState | None) -> None:
    """How far it has turned, how far it has gone by velocity, and how fast it has been."""
    flight = run.state.flight
    if flight is None or last is None:  # pragma: no cover - the state says that something is flown
        return
    measured = replace(
        flight.measured,
        yaw_deg=flight.measured.yaw_deg + wrap_deg(vehicle.yaw_deg - flight.last_yaw_deg),
        max_speed_m_s=max(flight.measured.max_speed_m_s, run.state.speed_m_s),
        by_velocity=flight.measured.by_velocity.plus(flown(vehicle, last)),
    )
    run.state = replace(run.state, flight=replace(flight, measured=measured, last_yaw_deg=vehicle.yaw_deg))


def measure_distances(run: Step, flight: Flight, seen: Watch) -> None:
    """How near it has come to what stands around and to others; what it mends, it may not make worse again (X13)."""
    measured = replace(
        flight.measured,
        min_clearance_m=_least(flight.measured.min_clearance_m, seen.clearance_m),
        min_separation_m=_least(flight.measured.min_separation_m, seen.separation_m),
    )
    run.state = replace(run.state, flight=replace(flight, measured=measured, baseline=seen.negative))


def _least(a: float | None, b: float | None) -> float | None:
    if a is None or b is None:
        return a if b is None else b
    return min(a, b)


def arrive(run: Step, vehicle: VehicleState) -> None:
    """Completed once its time is over and it rests at the goal, facing as planned: the new anchor is there."""
    flight = run.state.flight
    if flight is None:  # pragma: no cover - the state says that something is flown
        return
    plan, limits, elapsed_s = flight.plan, run.state.limits, run.now_s - flight.started_at_s
    facing = abs(wrap_deg(vehicle.yaw_deg - plan.yaw_deg(plan.duration_s))) <= limits.facing_tolerance_deg
    off_m = vehicle.position.minus(plan.goal).norm
    lingers = elapsed_s >= plan.duration_s + limits.linger_s and off_m <= limits.tracking_m
    there = off_m <= limits.arrived_m or lingers
    if not (elapsed_s >= plan.duration_s and there and facing and run.at_rest(vehicle)):
        return
    returning = run.state.state is State.RETURN_TO_ANCHOR
    end(run, MotionStatus.COMPLETED)
    if not returning:
        run.anchor_here(vehicle)
    run.go(Cause.RETURNED if returning else Cause.COMPLETED)
    moved_m = vehicle.position.minus(flight.origin).norm
    run.tell(Notice.DONE, metres=() if plan.primitive.is_scan else (moved_m,), primitive=plan.primitive)


def end(run: Step, status: MotionStatus) -> None:
    """Nothing is flown any more; the airspace is given back."""
    flight = run.state.flight
    if flight is None:
        return
    moved = run.vehicle.position.minus(flight.origin)
    run.do(reports.motion(flight, status, moved))
    run.do(Release(flight.request_id))
    if not flight.plan.primitive.is_scan:
        missed = astray(run.session.astray, moved, flight.measured.by_velocity)
        run.state = replace(run.state, session=replace(run.session, astray=missed))
    if flight.asked_for:
        run.count(Tally(completed=1) if status is MotionStatus.COMPLETED else Tally(aborted=1))
    run.state = replace(run.state, flight=None)


def trouble(run: Step, vehicle: VehicleState, last: VehicleState | None) -> str | None:
    """Why what is being flown must be dropped, although no limit is broken; None: it need not. Source: X7, X8, design 4."""
    flight, limits = run.state.flight, run.state.limits
    if flight is None:
        return None
    if last is not None and not vehicle.at_s - last.at_s <= limits.telemetry_age_s:
        return UNHEARD
    if vehicle.flight_mode != FlightMode.OFFBOARD and run.now_s - flight.started_at_s > limits.engaging_s:
        return f"the autopilot left offboard for {vehicle.flight_mode}"
    return unfit_to_fly(vehicle, limits)


def drop(run: Step, why: str) -> None:
    """After any stall or link gap the rest of a plan is dropped and asked for anew. Source: X7."""
    if run.state.flight is None:
        return
    run.do(Hold("stalled"))
    end(run, MotionStatus.ABORTED)
    run.go(Cause.STALLED)
    run.tell(Notice.DROPPED, why)


def overdue(run: Step) -> None:
    """No telemetry comes that could tell it."""
    if not run.hears:
        drop(run, UNHEARD)


def leftover(run: Step) -> Leftover | None:
    """What the plan being flown still had to go, by what was measured. Source: X12."""
    flight, vehicle, limits = run.state.flight, run.state.vehicle, run.state.limits
    if flight is None:
        return run.state.leftover
    plan = flight.plan
    if vehicle is None or plan.primitive is Primitive.RETURN:
        return None
    if plan.primitive.is_scan:
        turned_deg = math.copysign(flight.measured.yaw_deg, flight.measured.yaw_deg * plan.turn_deg)
        left_deg = min(abs(plan.turn_deg), FULL_TURN_DEG) - turned_deg
        if not left_deg > limits.facing_tolerance_deg:
            return None
        return Leftover(plan.primitive, min(left_deg, FULL_TURN_DEG), run.now_s)
    moved, d = vehicle.position.minus(plan.start), plan.direction
    left_m = plan.length_m - (moved.north * d.north + moved.east * d.east + moved.down * d.down)
    if not left_m >= limits.shortest_m:
        return None
    slowness = full_speed_m_s(plan.primitive, limits) / plan.move.speed
    return Leftover(plan.primitive, min(left_m, plan.length_m), run.now_s, slowness)
