"""The imperative shell about the arbiter: one task takes events from one bounded queue and carries effects out."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Callable, Coroutine
from dataclasses import replace
from typing import Any, Literal, Protocol, assert_never

from m3r_app.airspace.interface import Airspace
from m3r_app.arbiter.announcements import Announce
from m3r_app.arbiter.effects import (
    Effect,
    FaceOperator,
    Fly,
    Hold,
    ImpossibleTransition,
    LetGo,
    Pair,
    Release,
    Report,
    Reserve,
)
from m3r_app.arbiter.events import (
    ClaimLost,
    Ended,
    Event,
    FrameMoved,
    NeighboursHeard,
    PairingAnswered,
    Requested,
    ReservationAnswered,
    Stalled,
    TelemetryArrived,
    Tick,
)
from m3r_app.arbiter.state import ArbiterState
from m3r_app.arbiter.step import step
from m3r_app.inbox import Inbox
from m3r_app.output import AnnounceEvent, Notice, OutputEvent, PairEvent, PairStatus
from m3r_app.snapshot import craft, margins
from m3r_app.vehicle.fleet import Fleet
from m3r_app.vehicle.guard import Guard
from m3r_app.vehicle.interface import Vehicle, VehicleError
from m3r_app.vehicle.motion_controller import MotionController
from m3r_app.vehicle.telemetry import Telemetry
from safety.frames import LocalFrame
from safety.vocabulary import Anchor, FlightMode, ManeuverRequest, Ned, Neighbours, VehicleState

TICK_S = 0.1
MARGINS_S = 0.5
NEWS_S = 0.02
"""News of neighbours are not looked at more often than this."""
MODE_LAG_S = 0.2
"""A flight mode that was reported earlier than this after we changed it may be the old one."""
JUMP_M = 0.5
"""The two forms of the vehicle's position may differ by this; more, and its local origin has moved."""


class Recording(Protocol):
    """Where everything is recorded. `m3r_app.record.recorder.Recorder` is one."""

    def record(self, topic: str, t_s: float, data: dict[str, object]) -> None: ...


class Shell:
    """Owns the arbiter's state, the motion controller and the guard of one app."""

    def __init__(
        self,
        state: ArbiterState,
        fleet: Fleet,
        frame: LocalFrame,
        airspace: Airspace,
        guard: Guard,
        clock: Callable[[], float],
        emit: Callable[[OutputEvent], None],
        recording: Recording,
        pair: Callable[[Shell, str], Coroutine[Any, Any, None]],
        declared_empty: bool,
        battery_may_be_unknown: bool = False,
    ) -> None:
        """pair: the procedure that answers a Pair effect; declared_empty: fly without neighbour data, as declared.

        battery_may_be_unknown: likewise.
        """
        self.state = state
        self.inbox = Inbox()
        self.fleet = fleet
        self.frame = frame
        self.clock = clock
        self.guard = guard
        self.controller: MotionController | None = None
        self.vehicle: Vehicle | None = None
        self.changed = asyncio.Event()
        """Set after every step."""
        self.airspace = airspace
        self.vehicle_lost = False
        """The paired drone's autopilot has started anew: there is nothing left to fly."""
        self._emit = emit
        self._recording = recording
        self._pair = pair
        self._declared_empty = declared_empty
        self._battery_may_be_unknown = battery_may_be_unknown
        self._shift: Ned | None = None
        self._commanded_at_s = -math.inf
        self._margins_at_s = -math.inf
        self._anchor: Anchor | None = None
        self._tasks: set[asyncio.Task[None]] = set()
        self._streaming: asyncio.Task[None] | None = None
        self._pairing: asyncio.Task[None] | None = None
        self._letting_go: asyncio.Task[None] | None = None

    # ------------------------------------------------------------ running

    async def run(self) -> None:
        """Take events until cancelled."""
        while True:
            event = await self.inbox.get()
            self.take(event)

    def take(self, event: Event) -> None:
        """One step, its effects, its record."""
        now_s = self.clock()
        self.state, effects = step(self.state, event, now_s)
        if not isinstance(event, TelemetryArrived | Tick | NeighboursHeard):
            self._recording.record("input", now_s, {"kind": type(event).__name__, "event": _recordable(event)})
        for effect in effects:
            self._carry_out(effect, now_s)
        anchor = self.state.session.anchor if self.state.session is not None else None
        if anchor is not self._anchor:
            self._anchor = anchor
            radius_m = self.state.limits.workspace_m
            self._recording.record(
                "anchor", now_s, {"position": anchor.position if anchor else None, "radius_m": radius_m}
            )
        if self.state.pairing_off is not None:
            self._call_off_pairing()
        self.changed.set()
        self.changed.clear()

    async def tick(self) -> None:
        """Time, neighbours and reservations, ten times a second, until cancelled."""
        while True:
            await asyncio.sleep(TICK_S)
            now_s = self.clock()
            if self.vehicle is not None:
                lost = self.airspace.lost(self.vehicle.colour)
                if lost is not None:
                    self.inbox.put(ClaimLost(lost))
                self.inbox.put(self.surroundings(now_s))
                self._record_margins(self.vehicle, now_s)
            self.inbox.put(Tick())

    async def listen(self) -> None:
        """Judge what others tell as soon as they tell it, until cancelled."""
        while True:
            await self.airspace.news()
            if self.vehicle is not None:
                self.inbox.put(self.surroundings(self.clock()))
            await asyncio.sleep(NEWS_S)

    def _record_margins(self, vehicle: Vehicle, now_s: float) -> None:
        """How far every limit is, twice a second, for who reads the record."""
        if now_s - self._margins_at_s < MARGINS_S:
            return
        self._margins_at_s = now_s
        drone = craft(vehicle.colour, vehicle.telemetry(), self.frame, now_s, ours=True)
        found = margins(self.state, drone, now_s)
        self._recording.record("margins", now_s, {"margins": {m.name: m.value for m in found}})

    def surroundings(self, now_s: float) -> NeighboursHeard:
        """The latest of everybody else."""
        assert self.vehicle is not None
        own = self.vehicle.colour
        linked = Neighbours.none(math.inf) if self._declared_empty else self.fleet.neighbours(own, self.frame, now_s)
        neighbours = self.airspace.neighbours(own, linked, now_s)
        self._recording.record("neighbours", now_s, {"neighbours": neighbours})
        return NeighboursHeard(neighbours, self.airspace.held_by_others(own))

    async def close(self) -> None:
        """End what runs in the background."""
        self.guard.disarm()
        if self._streaming is not None:
            self._streaming.cancel()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, *([self._streaming] if self._streaming else []), return_exceptions=True)

    async def leave_in_hold(self, within_s: float) -> None:
        """The last thing: a drone that is ours is told to hold, whatever else went wrong. Source: contract, X3."""
        vehicle, ours = self.vehicle, self.state.authority
        try:
            self.take(Ended("the run is over"))
        finally:
            await self.settled(within_s)
            if (
                ours
                and vehicle is not None
                and vehicle.telemetry().flight_mode == FlightMode.OFFBOARD
                and self.controller
            ):
                with contextlib.suppress(TimeoutError):  # only where the step above broke
                    await asyncio.wait_for(vehicle.hold(), within_s)

    async def let_go(self) -> None:
        """Wait until a drone that was let go is really free."""
        if self._letting_go is not None:
            await asyncio.wait({self._letting_go})

    async def settled(self, within_s: float) -> None:
        """Wait until the orders given so far have been carried out, at most within_s."""
        if self._tasks:
            await asyncio.wait(self._tasks, timeout=within_s)

    # ------------------------------------------------------------ effects

    def _carry_out(self, effect: Effect, now_s: float) -> None:
        match effect:
            case ImpossibleTransition():
                fault = (
                    f"a transition that the mode machine does not have was refused: {effect.cause} in {effect.state}"
                )
                self._recording.record("fault", now_s, {"text": fault})
                self._emit(AnnounceEvent(f"{fault} (a fault in m3r)", Notice.FAULT))
            case Report():
                self._emit(self._with_places(effect.told))
                confirmed = isinstance(effect.told, PairEvent) and effect.told.status is PairStatus.CONFIRMED
                if confirmed and self.vehicle is not None:
                    self._start(self._sound(self.vehicle))
            case Announce():
                self._emit(AnnounceEvent(effect.text, effect.notice))
            case Pair():
                self._emit(self._with_places(PairEvent(effect.colour, PairStatus.REQUESTED)))
                self._pairing = self._start(self._pair(self, effect.colour))
            case FaceOperator():
                self._watch_over()
                self._order(lambda c: c.face(effect.yaw_deg))
            case Fly():
                plan, shift = effect.plan, self._shift
                self._recording.record("plan", now_s, _plan_fields(effect))
                if shift is not None:
                    self._order(lambda c: c.fly(plan, shift))
            case Hold():
                if self.controller is not None:
                    self.controller.hold()
            case Reserve():
                self._reserve(effect)
            case Release():
                if self.vehicle is not None:
                    self.airspace.free(self.vehicle.colour, effect.request_id)
            case LetGo():
                self.vehicle_lost = self.vehicle_lost or effect.vehicle_lost
                self._let_go(effect.command)
            case _:
                assert_never(effect)

    async def _sound(self, vehicle: Vehicle) -> None:
        """The audible sign of pairing, on the drone itself; that it was given is recorded. Source: paper III-A."""
        sent = await vehicle.play_tune()
        self._recording.record("tune", self.clock(), {"vehicle": vehicle.colour, "sent": sent})

    def _reserve(self, effect: Reserve) -> None:
        """The answer is an event, whoever gives it and however late. Source: X10."""

        def answered(answer: Literal["granted", "denied"], reason: str) -> None:
            self.inbox.put(ReservationAnswered(effect.request_id, answer, reason))

        self.airspace.reserve(effect.volume.holder, effect.request_id, effect.volume, answered)

    def _start(self, work: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    def _call_off_pairing(self) -> None:
        """STOP or the end came before pairing was through: a take-off that it had begun ends in Hold. Source: X4."""
        pairing, colour = self._pairing, self.state.pairing or ""
        self._pairing = None
        if pairing is None:
            return
        pairing.cancel()

        async def hold() -> None:
            vehicle = self.fleet.vehicles.get(colour)
            if vehicle is not None and vehicle.telemetry().flight_mode == FlightMode.TAKEOFF:
                try:
                    await vehicle.hold()
                except VehicleError as error:
                    self._emit(AnnounceEvent(str(error), Notice.VEHICLE_ERROR))
            self.inbox.put(PairingAnswered(colour, ()))  # the arbiter knows why it is off

        self._start(hold())

    def _order(self, order: Callable[[MotionController], Coroutine[Any, Any, None]]) -> None:
        """Give the controller an order; if the vehicle refuses, what was to be flown is dropped."""
        controller = self.controller
        if controller is None:
            return

        async def carry_out() -> None:
            self._commanded_at_s = self.clock()
            try:
                await order(controller)
            except VehicleError as error:
                self.inbox.put(Stalled(str(error)))
            finally:
                self._commanded_at_s = self.clock()

        self._start(carry_out())

    # ------------------------------------------------------------ the paired vehicle

    def take_vehicle(self, vehicle: Vehicle) -> None:
        """From now on this vehicle's telemetry is the arbiter's, and setpoints go to it."""
        limits = self.state.limits
        self.vehicle = vehicle
        self._shift = None
        vehicle.on_telemetry(self._telemetry)
        self.controller = MotionController(
            vehicle,
            self.clock,
            limits.yaw_rate_deg_s,
            limits.yaw_acceleration_deg_s2,
            self._beat,
            lambda why: self.inbox.put(Stalled(why)),
            self._sent,
            limits.lag_s,
        )
        self._stream()

    def _watch_over(self) -> None:
        """We have authority: from now on the guard watches. Source: X3, X7."""
        if self.vehicle is not None and not self.guard.armed:
            self.guard.arm(self.vehicle.hold_unless_taken_over)

    def _stream(self) -> None:
        """Send setpoints until let go. What breaks the sending drops what is flown; then it goes on."""
        controller = self.controller
        assert controller is not None
        self._streaming = asyncio.create_task(controller.run())

        def broken(task: asyncio.Task[None]) -> None:
            error = None if task.cancelled() else task.exception()
            if error is None or self.controller is not controller:
                return
            controller.disengaged()
            self.inbox.put(Stalled(f"setpoints could not be sent ({error})"))
            self._stream()

        self._streaming.add_done_callback(broken)

    def _let_go(self, command: str) -> None:
        self.guard.disarm()
        controller, streaming = self.controller, self._streaming
        self.controller = self._streaming = None
        if self.vehicle is not None:
            self.vehicle.off_telemetry(self._telemetry)
        let_go, self.vehicle = self.vehicle, None

        async def carry_out() -> None:
            try:
                if streaming is not None:
                    streaming.cancel()
                if controller is not None:
                    await controller.let_go(command)
            except VehicleError as error:
                self._emit(AnnounceEvent(str(error), Notice.VEHICLE_ERROR))
            finally:
                if let_go is not None:
                    self.airspace.give_up(let_go.colour)  # not before we have stopped flying it

        self._letting_go = self._start(carry_out())

    def _beat(self) -> None:
        if self.guard.beat() or self.controller is None or self.vehicle is None:
            return
        # The guard has commanded Hold over our head: drop the plan, then let it watch again.
        self.controller.disengaged()
        self.inbox.put(Stalled("the guard commanded Hold"))
        self.guard.arm(self.vehicle.hold_unless_taken_over)

    def _sent(self, t_s: float, point: Ned, yaw_deg: float) -> None:
        if self._shift is not None:
            self._recording.record("setpoint", t_s, {"position": point.minus(self._shift), "yaw_deg": yaw_deg})

    def _telemetry(self, telemetry: Telemetry) -> None:
        """The vehicle's telemetry in the session's frame, to the arbiter."""
        now_s = self.clock()
        if telemetry.local is None or telemetry.geodetic is None or telemetry.velocity is None:
            return
        place = self.frame.ned(telemetry.geodetic)
        if self._shift is None:
            self._shift = telemetry.local.minus(place)
        position = telemetry.local.minus(self._shift)
        if not position.minus(place).norm <= JUMP_M:
            self._shift = telemetry.local.minus(place)
            position = place
            self.inbox.put(FrameMoved("its estimator moved its own origin"))
        state = VehicleState(
            telemetry.at_s,
            position,
            telemetry.velocity,
            telemetry.yaw_deg,
            telemetry.yaw_rate_deg_s,
            telemetry.sigma_h_m,
            telemetry.sigma_v_m,
            telemetry.healthy,
            telemetry.in_air,
            self._flight_mode(telemetry),
            math.nan if telemetry.battery is None and not self._battery_may_be_unknown else telemetry.battery,
            armed=telemetry.armed,
            mode_at_s=telemetry.mode_at_s,
            unasked_hold=self._unasked_hold(telemetry),
            restarts=telemetry.restarts,
        )
        self._recording.record(
            "telemetry",
            now_s,
            {
                **_recordable(state),
                "vehicle": self.vehicle.colour if self.vehicle else "",
                "geodetic": telemetry.geodetic,
            },
        )
        self.inbox.put(TelemetryArrived(state))

    def _flight_mode(self, telemetry: Telemetry) -> FlightMode:
        """The mode as reported, or as commanded while the report is still the old one (it comes once a second)."""
        controller = self.controller
        if controller is None:
            return telemetry.flight_mode
        if self._mode_is_old(telemetry) and telemetry.flight_mode != FlightMode.UNKNOWN:
            return FlightMode.OFFBOARD if controller.engaged else FlightMode.HOLD
        return telemetry.flight_mode

    def _mode_is_old(self, telemetry: Telemetry) -> bool:
        """Whether the mode may have been told before it was changed by us."""
        return telemetry.mode_at_s < self._commanded_at_s + MODE_LAG_S

    def _unasked_hold(self, telemetry: Telemetry) -> bool:
        """Whether it left Offboard for Hold and it was not us: not the guard either, which says so itself. Source: X3."""
        engaged = self.controller is not None and self.controller.engaged
        in_hold = telemetry.flight_mode == FlightMode.HOLD and not self._mode_is_old(telemetry)
        return engaged and in_hold and not self.guard.stalled

    # ------------------------------------------------------------ reports

    def _with_places(self, event: OutputEvent) -> OutputEvent:
        """`pair` events also say where operator and drone are."""
        if not isinstance(event, PairEvent):
            return event
        vehicle = self.fleet.vehicles.get(event.vehicle)
        place = vehicle.telemetry().geodetic if vehicle is not None else None
        return replace(event, operator=self.frame.origin, vehicle_position=place)


def request_event(request: ManeuverRequest) -> Requested:
    """A modality's request as an event."""
    return Requested(request, 1000.0 * max(0.0, request.made_at_s - request.captured_at_s))


def _recordable(value: Any) -> dict[str, object]:
    return {name: getattr(value, name) for name in value.__slots__} if hasattr(value, "__slots__") else {"value": value}


def _plan_fields(effect: Fly) -> dict[str, object]:
    plan = effect.plan
    n = max(2, math.ceil(plan.duration_s / 0.1) + 1)
    times_s = [plan.duration_s * i / (n - 1) for i in range(n)]
    return {
        "primitive": plan.primitive,
        "times_s": times_s,
        "points_ned_m": [plan.position(t) for t in times_s],
        "yaws_deg": [plan.yaw_deg(t) for t in times_s],
        "plan": plan,
    }
