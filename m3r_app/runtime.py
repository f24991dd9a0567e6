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
    AnchorMoved,
    CallOffGroundWork,
    CallOffPairing,
    Effect,
    FaceOperator,
    Fly,
    GiveUp,
    Hold,
    ImpossibleTransition,
    Land,
    LetGo,
    Pair,
    PlayTune,
    Release,
    Report,
    Reserve,
    TakeOff,
)
from m3r_app.arbiter.events import (
    ClaimLost,
    Ended,
    Event,
    FrameMoved,
    NeighboursHeard,
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
from m3r_app.pairing import Pairing
from m3r_app.property_watch import PropertyWatch
from m3r_app.session_frame import in_session_frame
from m3r_app.snapshot import craft, margins
from m3r_app.takeoff_landing import GroundWork
from m3r_app.vehicle.commander import Commander
from m3r_app.vehicle.fleet import Fleet
from m3r_app.vehicle.guard import Guard
from m3r_app.vehicle.interface import ObservedVehicle, VehicleError
from m3r_app.vehicle.telemetry import Telemetry
from safety.frames import LocalFrame
from safety.vocabulary import FlightMode, ManeuverRequest, Ned, Neighbours

TICK_S = 0.1
MARGINS_S = 0.5
TELEMETRY_S = 0.1
"""The record tells telemetry for readers this often; the arbiter's steps hold every sample."""
NEWS_S = 0.02
"""News of neighbours are not looked at more often than this."""
FRESH_S = 10.0
"""So long a drone that has been taken may take to be heard."""


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
        pairing: Pairing,
        ground_work: GroundWork,
        declared_empty: bool,
        battery_may_be_unknown: bool = False,
    ) -> None:
        """declared_empty: fly without neighbour data, as declared; battery_may_be_unknown: likewise."""
        self.state = state
        self.inbox = Inbox()
        self.fleet = fleet
        self.frame = frame
        self.clock = clock
        self.guard = guard
        self.commander: Commander | None = None
        """Of the drone whose telemetry is the arbiter's."""
        self.changed = asyncio.Event()
        """Set after every step."""
        self.airspace = airspace
        self.vehicle_lost = False
        """The paired drone's autopilot has started anew: there is nothing left to fly."""
        self._emit = emit
        self._recording = recording
        recording.record("start", clock(), {"state": state})
        self._pairing = pairing
        self._ground_work = ground_work
        self._declared_empty = declared_empty
        self._battery_may_be_unknown = battery_may_be_unknown
        self._properties = PropertyWatch(state.limits)
        self._shift: Ned | None = None
        self._heard = asyncio.Event()
        """The drone that has been taken has told where it is."""
        self._margins_at_s = -math.inf
        self._told_s = -math.inf
        self._tasks: set[asyncio.Task[None]] = set()
        self._pairing_task: asyncio.Task[None] | None = None
        self._ground_task: asyncio.Task[None] | None = None
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
        self._recording.record("step", now_s, {"now_s": now_s, "event": event, "effects": effects, "state": self.state})
        if not isinstance(event, TelemetryArrived | Tick | NeighboursHeard):
            self._recording.record("input", now_s, {"kind": type(event).__name__, "event": _recordable(event)})
        for effect in effects:
            self._carry_out(effect, now_s)
        for broken in self._properties.after(event, effects, now_s):
            self.inbox.put(broken)
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

    def _record_margins(self, vehicle: ObservedVehicle, now_s: float) -> None:
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
        if self.commander is not None:
            await self.commander.close()
        tasks = {*self._tasks, *({self._ground_task} if self._ground_task is not None else ())}
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def end(self, within_s: float) -> None:
        """The last thing: a drone that is ours is told to hold, whatever else went wrong. Source: contract, X3."""
        commander, ours = self.commander, self.state.authority
        try:
            self.take(Ended("the run is over"))
        finally:
            await self.settled(within_s)
            kept = commander if ours and commander is self.commander else None  # only where the step above broke
            if kept is not None and kept.vehicle.telemetry().flight_mode is FlightMode.OFFBOARD:
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(kept.hold(), within_s)

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
            case Announce():
                self._emit(AnnounceEvent(effect.text, effect.notice))
            case Pair():
                self._emit(self._with_places(PairEvent(effect.colour, PairStatus.REQUESTED)))
                self._pairing_task = self._start(self._pair(effect.colour))
            case CallOffPairing():
                if self._pairing_task is not None and not self._pairing_task.done():  # else it has answered
                    self._pairing_task.cancel()
                    self._start(self._answer(self._pairing.call_off(effect.colour)))
            case TakeOff():
                self._ground_task = asyncio.create_task(
                    self._answer(self._ground_work.take_off(effect.colour, effect.metres))
                )
            case Land():
                self._ground_task = asyncio.create_task(self._answer(self._ground_work.land(effect.colour)))
            case CallOffGroundWork():
                if self._ground_task is not None:
                    self._ground_task.cancel()
                self._start(self._answer(self._ground_work.call_off(effect.colour)))
            case GiveUp():
                self.airspace.give_up(effect.colour)
            case PlayTune():
                if self.vehicle is not None:
                    self._start(self._sound(self.vehicle))
            case AnchorMoved():
                self._recording.record("anchor", now_s, {"position": effect.position, "radius_m": effect.radius_m})
            case FaceOperator():
                self._watch_over()
                self._order(lambda commander: commander.face(effect.yaw_deg))
            case Fly():
                plan, shift = effect.plan, self._shift
                self._recording.record("plan", now_s, _plan_fields(effect))
                if shift is not None:
                    self._order(lambda commander: commander.fly(plan, shift))
            case Hold():
                if self.commander is not None:
                    self.commander.hover()
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

    async def _sound(self, vehicle: ObservedVehicle) -> None:
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

    async def _answer(self, procedure: Coroutine[Any, Any, Event]) -> None:
        """What the procedure answers goes to the arbiter."""
        self.inbox.put(await procedure)

    def _order(self, order: Callable[[Commander], Coroutine[Any, Any, None]]) -> None:
        """Give an order; if the vehicle refuses, what was to be flown is dropped."""
        commander = self.commander
        if commander is None:
            return

        async def carry_out() -> None:
            try:
                await order(commander)
            except VehicleError as error:
                self.inbox.put(Stalled(str(error)))

        self._start(carry_out())

    # ------------------------------------------------------------ the paired vehicle

    @property
    def vehicle(self) -> ObservedVehicle | None:
        """Whose telemetry is the arbiter's."""
        return self.commander.vehicle if self.commander is not None else None

    async def _pair(self, colour: str) -> None:
        """Once a drone that was let go is really free: the procedure, then the drone is taken and heard, then the answer."""
        if self._letting_go is not None:
            await asyncio.wait({self._letting_go})
        answer = await self._pairing.pair(colour)
        if not answer.reasons:
            try:
                await self._take_vehicle(self.fleet.commanders[colour])
            except VehicleError as error:
                self._let_go("hold")
                answer = replace(answer, reasons=(str(error),))
        self.inbox.put(answer)

    async def _take_vehicle(self, commander: Commander) -> None:
        """From now on this vehicle's telemetry is the arbiter's, and orders go to it. Raises VehicleError."""
        self.commander = commander
        self._shift = None
        self._heard.clear()
        commander.vehicle.on_telemetry(self._telemetry)
        commander.engage(self.state.limits, self._beat, lambda why: self.inbox.put(Stalled(why)), self._sent)
        try:
            async with asyncio.timeout(FRESH_S):
                await self._heard.wait()
        except TimeoutError:
            raise VehicleError(f"{commander.vehicle.colour}: nothing was heard from it for {FRESH_S:g} s.") from None
        self.inbox.put(self.surroundings(self.clock()))

    def _watch_over(self) -> None:
        """We have authority: from now on the guard watches. Source: X3, X7."""
        if self.commander is not None and not self.guard.armed:
            self.guard.arm(self.commander.hold_unless_taken_over)

    def _let_go(self, command: str) -> None:
        self.guard.disarm()
        commander, self.commander = self.commander, None
        if commander is None:
            return
        commander.vehicle.off_telemetry(self._telemetry)
        freed = commander.let_go(command)

        async def carry_out() -> None:
            try:
                await freed
            except VehicleError as error:
                self._emit(AnnounceEvent(str(error), Notice.VEHICLE_ERROR))
            finally:
                self.airspace.give_up(commander.vehicle.colour)  # not before we have stopped flying it

        self._letting_go = self._start(carry_out())

    def _beat(self) -> None:
        if self.guard.beat() or self.commander is None:
            return
        # The guard has commanded Hold over our head: drop the plan, then let it watch again.
        self.commander.disengaged()
        self.inbox.put(Stalled("the guard commanded Hold"))
        self.guard.arm(self.commander.hold_unless_taken_over)

    def _sent(self, t_s: float, point: Ned, yaw_deg: float) -> None:
        if self._shift is not None:
            self._recording.record("setpoint", t_s, {"position": point.minus(self._shift), "yaw_deg": yaw_deg})

    def _telemetry(self, telemetry: Telemetry) -> None:
        """The vehicle's telemetry in the session's frame, to the arbiter."""
        now_s, commander = self.clock(), self.commander
        if commander is None:
            return
        found = in_session_frame(
            telemetry,
            self.frame,
            self._shift,
            commander.flight_mode(telemetry),
            unasked_hold=commander.unasked_hold(telemetry) and not self.guard.stalled,
            battery_may_be_unknown=self._battery_may_be_unknown,
        )
        if found is None:
            return
        self._shift = found.shift
        if found.moved:
            self.inbox.put(FrameMoved("its estimator moved its own origin"))
        if now_s - self._told_s >= TELEMETRY_S:
            self._told_s = now_s
            told = {**_recordable(found.state), "vehicle": commander.vehicle.colour, "geodetic": telemetry.geodetic}
            self._recording.record("telemetry", now_s, told)
        self.inbox.put(TelemetryArrived(found.state))
        self._heard.set()

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
