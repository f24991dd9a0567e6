"""One run of M3R: everything heavy first, then the fleet, pairing, inputs, and an orderly end.

`run` is what the command line calls. Source: design "Command line", "Motion" (everything heavy loads before pairing).
"""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import math
import signal
import threading
import time
from collections.abc import AsyncIterator, Callable, Coroutine, Sequence
from contextlib import AsyncExitStack, ExitStack
from dataclasses import asdict, replace
from functools import partial
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, TypeVar

from m3r_app.airspace.interface import Airspace
from m3r_app.airspace.local import LocalAirspace
from m3r_app.arbiter.events import ClaimLost, Event, PairingAsked
from m3r_app.arbiter.state import ArbiterState, Policy, Tally
from m3r_app.environment.static_scene import static_scene
from m3r_app.exit_status import ExitStatus
from m3r_app.inputs import InputError, Inputs, Senses, open_inputs
from m3r_app.options import RunOptions
from m3r_app.output import AnnounceEvent, EndEvent, EndReason, Notice, OutputEvent, Told, fields_of, known
from m3r_app.pairing import Pairing
from m3r_app.record.chain import Chain, private_key
from m3r_app.record.recorder import Recorder
from m3r_app.run_setup import RunSetup, prepare
from m3r_app.runtime import Recording, Shell, request_event
from m3r_app.sim.process import SimulatedFleet
from m3r_app.snapshot import Taken
from m3r_app.step_record import START, STEP, StepWriter, provenance
from m3r_app.takeoff_landing import GroundWork
from m3r_app.vehicle.fleet import Fleet
from m3r_app.vehicle.guard import Guard
from m3r_app.vehicle.interface import Links, VehicleError
from modalities.hands.gestures import Hand
from modalities.notices import SenseChange
from modalities.voice.push_to_talk import PushToTalk
from modalities.voice.self_speech import SelfSpeech
from safety.vocabulary import ManeuverRequest, State

if TYPE_CHECKING:
    from m3r_app.record.foxglove_server import Viewer
    from modalities.voice.sound_check import Loudness

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
"""Signals after which the drone is left in Hold and the run ends."""
HELD_S = 5.0
"""So long in EmergencyHold without an approved way back, the drone rests."""
LAST_HOLD_S = 3.0
T = TypeVar("T")
Emit = Callable[[Told], None]


class NoPairing(Exception):  # noqa: N818  (it is an end, not an error)
    """The drone that the run depends on was not paired; the reasons have been said."""


class VehicleLost(Exception):  # noqa: N818
    """The paired drone fell silent."""


async def run(options: RunOptions, emit: Emit, self_speech: SelfSpeech | None = None) -> int:
    """Fly one run; returns the exit status. `emit` takes the objects of the machine-readable output.

    self_speech: when whoever speaks for us did, by `time.monotonic`; a live microphone hears it too.
    Raises what names bad input (ValueError) or a missing vehicle (VehicleError), after the `end` object.
    """
    one = Run(options, emit, self_speech)
    loop = asyncio.get_running_loop()
    for name in ENDING:
        loop.add_signal_handler(name, one.interrupted.set)
    # Suspended, it could not fly on: the guard would end it.
    loop.add_signal_handler(signal.SIGTSTP, one.refuse_to_suspend)
    try:
        return await one.whole()
    finally:
        for name in (*ENDING, signal.SIGTSTP):
            loop.remove_signal_handler(name)


class Run:
    """The life of one run, in the event loop that it is made in. `interrupted` ends it in order; `run` has signals do that."""

    def __init__(self, options: RunOptions, emit: Emit, self_speech: SelfSpeech | None = None) -> None:
        self.options = options
        self.setup: RunSetup | None = None
        """Once it is known."""
        self.talk: PushToTalk | None = None
        """What opens the microphone, where it is the console that does."""
        self.senses = Taken()
        """What the modalities take in."""
        self._self_speech = self_speech
        self.clock = time.monotonic
        self.started_s = self.clock()
        self._loop = asyncio.get_running_loop()
        self.interrupted = asyncio.Event()
        self.quitted = asyncio.Event()
        """The operator at the console has had enough: a normal end."""
        self._emit = emit
        self._sinks: list[Recorder | Viewer] = []
        self.shell: Shell | None = None

    # ------------------------------------------------------------ output

    def emit(self, event: OutputEvent) -> None:
        """One event of the output, also recorded."""
        now_s = self.clock()
        self.record(event.name, now_s, fields_of(event))
        self._emit(Told(round(now_s - self.started_s, 3), known(event)))

    def announce(self, sentence: str, notice: Notice = Notice.INFORMATION, /) -> None:
        """Tell the operator."""
        self.emit(AnnounceEvent(sentence, notice))

    def record(self, topic: str, t_s: float, data: dict[str, object]) -> None:
        for sink in self._sinks:
            sink.record(topic, t_s - self.started_s, data)

    def take(self, request: ManeuverRequest) -> None:
        """A request of any modality."""
        self.put(request_event(request))

    def put(self, event: Event) -> None:
        """What somebody asks or tells; before there is a fleet, nobody hears it."""
        if self.shell is not None:
            self.shell.inbox.put(event)

    def refuse_to_suspend(self) -> None:
        self.announce("a drone may depend on this app, so it cannot be suspended: end it with Ctrl-C")

    # ------------------------------------------------------------ the whole

    async def whole(self) -> int:
        """Everything, raced against the interrupt and the time-out; always ends with `end`."""
        reason = EndReason.ERROR
        failure: Exception | None = None
        body = asyncio.create_task(self._body())
        stop = asyncio.create_task(self.interrupted.wait())
        try:
            done, _ = await asyncio.wait(
                {body, stop}, timeout=self.options.timeout_s, return_when=asyncio.FIRST_COMPLETED
            )
            if body in done:
                reason = body.result()
            else:
                reason = EndReason.INTERRUPTED if stop in done else EndReason.TIMEOUT
        except VehicleLost:
            reason = EndReason.VEHICLE_LOST
        except NoPairing:
            reason = EndReason.ERROR
        except VehicleError as error:
            reason, failure = EndReason.VEHICLE_LOST, error
        except Exception as error:  # noqa: BLE001  (the end object must come whatever happened)
            failure = error
        finally:
            stop.cancel()
            body.cancel()
            with contextlib.suppress(asyncio.CancelledError, Exception):
                await body
        no_vehicle = reason is EndReason.VEHICLE_LOST or (reason is EndReason.ERROR and failure is None)
        return self._end(reason, failure, no_vehicle=no_vehicle)

    def _end(self, reason: EndReason, failure: Exception | None, *, no_vehicle: bool) -> int:
        """The last object, the record closed, and the highest status that applies. Raises `failure` if nothing is higher."""
        tally = self.shell.state.tally if self.shell is not None else Tally()
        self.emit(EndEvent(reason, **asdict(tally)))
        for sink in self._sinks:
            sink.close()
        if reason is EndReason.INTERRUPTED:
            return ExitStatus.INTERRUPTED
        if tally.violations:
            return ExitStatus.VIOLATED
        if failure is not None:
            raise failure
        return ExitStatus.NO_VEHICLE if no_vehicle else ExitStatus.ENDED

    async def _body(self) -> EndReason:
        async with AsyncExitStack() as stack:
            setup = self.setup = await _in_thread(lambda: prepare(self.options))
            inputs, fleet = await self._load_and_connect(setup, stack)
            guard = Guard(self._say_soon)
            guard.start()
            stack.callback(guard.close)
            airspace = await self._airspace(setup, fleet, stack)
            shell = self.shell = self._shell(setup, fleet, guard, airspace)
            stack.push_async_callback(shell.close)
            stack.push_async_callback(shell.end, LAST_HOLD_S)
            async with _together(
                shell.run(), shell.tick(), shell.listen(), self._watch_link(shell, setup.settings.pairing.silent_s)
            ) as background:
                playing = asyncio.create_task(self._play(shell, inputs))
                background.add(playing)
                done, _ = await asyncio.wait(background, return_when=asyncio.FIRST_COMPLETED)
                for task in done:
                    task.result()
                await shell.end(LAST_HOLD_S)
        return EndReason.INPUTS_PLAYED

    # ------------------------------------------------------------ before flying

    async def _load_and_connect(self, setup: RunSetup, stack: AsyncExitStack) -> tuple[Inputs, Fleet]:
        """Models load while the fleet is found, for each takes a second or more. What is wrong with an input is told first."""
        with_inputs = stack.enter_context(ExitStack())  # entered first, so that links end before devices are waited for
        connecting = asyncio.create_task(self._connect(setup, stack))
        try:
            inputs = await _in_thread(
                lambda: open_inputs(
                    self.options, setup.colours, setup.settings, self.clock, self._say_soon, self._self_speech
                )
            )
            with_inputs.callback(inputs.close)
            self.talk = inputs.talk
            for sentence in inputs.sentences:
                self.announce(sentence)
            await _in_thread(lambda: self._open_sinks(setup, inputs))
            self.record("stage", self.clock(), static_scene(setup.world, setup.operator))
            fleet = await connecting
            _return_freed_memory()
            return inputs, fleet
        finally:
            connecting.cancel()
            await asyncio.gather(connecting, return_exceptions=True)

    def _open_sinks(self, setup: RunSetup, inputs: Inputs) -> None:
        """The record and the live view, as asked for."""
        if self.options.view_port is not None:
            from m3r_app.record.foxglove_server import Viewer  # loads Foxglove's library

            viewer = Viewer(self.options.view_port)
            self._sinks.append(viewer)
            self._say_soon(f"the flight is shown at {viewer.address}: open that connection in Foxglove")
        if self.options.record is None:
            return
        metadata: dict[str, object] = {
            "app": version("m3r"),
            "settings": setup.settings.model_dump(),
            "scenario": setup.scenario.model_dump(mode="json") if setup.scenario else None,
            "operator": setup.operator,
            "origin": setup.frame.origin,
            "world": setup.world,
            "models": list(inputs.models),
            **provenance(),
        }
        steps = StepWriter()
        writers = {START: steps, STEP: steps}
        key = self.options.record_key
        chain = Chain(private_key(key) if key is not None else None)
        self._sinks.append(Recorder(self.options.record, metadata, self._say_soon, writers, chain))

    async def _connect(self, setup: RunSetup, stack: AsyncExitStack) -> Fleet:
        if self.options.vehicles:
            links = Links(dict(self.options.vehicles), {}, complete=False)
        else:
            scenario = setup.scenario
            assert scenario is not None
            simulated = await SimulatedFleet.start(scenario.path, len(scenario.vehicles) + len(scenario.traffic))
            stack.push_async_callback(simulated.stop)
            links = simulated.links
        fleet = await Fleet.connect(links, self.clock, setup.settings.pairing.answer_s)
        stack.push_async_callback(fleet.close)
        await fleet.ready(setup.settings.pairing.answer_s)
        return fleet

    async def _airspace(self, setup: RunSetup, fleet: Fleet, stack: AsyncExitStack) -> Airspace:
        """Alone, or shared over a broker. Raises AirError."""
        if setup.air is None:
            return LocalAirspace(self.clock)
        from m3r_app.airspace.shared import SharedAirspace  # loads the MQTT client

        broker, credentials = setup.air
        shared = SharedAirspace(broker, credentials, setup.frame, self._say_soon, self.clock)
        everybody = {**fleet.vehicles, **fleet.others}
        shared.watch({name: vehicle.telemetry for name, vehicle in everybody.items()})
        for name, vehicle in everybody.items():
            vehicle.on_telemetry(partial(shared.publisher.telemetry, name))
        stack.push_async_callback(shared.close)
        await shared.open()
        self.announce(f"sharing the air of {credentials.area} at {broker} as {credentials.name}")
        return shared

    def _shell(self, setup: RunSetup, fleet: Fleet, guard: Guard, airspace: Airspace) -> Shell:
        settings = setup.settings
        policy = Policy(
            settings.return_to_anchor,
            settings.on_disconnect,
            settings.replace,
            self.options.dry_run,
            settings.position_lost,
        )

        pairing = Pairing(
            setup,
            fleet,
            airspace,
            guard,
            self.clock,
            self.announce,
            self.options.takeoff_m,
            apply_failsafe=self.options.apply_failsafe,
        )
        recording: Recording = self
        return Shell(
            ArbiterState(setup.limits, policy),
            fleet,
            setup.frame,
            airspace,
            guard,
            self.clock,
            self.emit,
            recording,
            pairing,
            GroundWork(fleet.commanders, airspace, setup.frame.origin, self.announce, pairing.against),
            declared_empty=settings.neighbours == "none",
            battery_may_be_unknown=settings.battery == "unknown",
        )

    # ------------------------------------------------------------ flying

    async def _play(self, shell: Shell, inputs: Inputs) -> None:
        """Pair if asked to, play what was recorded, wait until the drone rests."""
        if self.options.pair is not None:
            shell.inbox.put(PairingAsked(self.options.pair))
            await self._until(shell, lambda: shell.state.state is not State.IDLE)
            await self._until(shell, lambda: shell.state.state not in (State.PAIRING, State.FACING))
            if shell.state.session is None and not self.options.console:
                raise NoPairing
        senses = Senses(self._heard, self._loud, self._seen, self._hands)
        playing = asyncio.create_task(inputs.play(self.clock, self.take, senses))
        try:
            if self.options.console:
                await self._stay(playing)
                return
            damage = await playing
        finally:
            playing.cancel()
            await asyncio.wait({playing})
        await self._rest(shell)
        if damage is not None:
            raise InputError(damage)

    async def _stay(self, playing: asyncio.Task[str | None]) -> None:
        """Until the operator leaves the console: a live input has no end of its own."""
        leaving = asyncio.create_task(self.quitted.wait())
        try:
            await asyncio.wait({playing, leaving}, return_when=asyncio.FIRST_COMPLETED)
            if playing.done():
                damage = playing.result()
                if damage is not None:
                    self.announce(damage, Notice.INPUT_DAMAGED)
                await leaving
        finally:
            leaving.cancel()

    def _heard(self, words: str) -> None:
        self.record("heard", self.clock(), {"modality": "voice", "words": words})
        self.senses = replace(self.senses, words=words)

    def _seen(self, shown: str) -> None:
        self.record("seen", self.clock(), {"modality": "gesture", "shown": shown})
        self.senses = replace(self.senses, shown=shown)

    def _loud(self, loudness: Loudness) -> None:
        self.senses = replace(
            self.senses, level_dbfs=loudness.level_dbfs, snr_db=loudness.snr_db, level_at_s=self.clock()
        )

    def _hands(self, hands: Sequence[Hand]) -> None:
        self.senses = replace(self.senses, hands=tuple(hands), hands_at_s=self.clock())

    async def _rest(self, shell: Shell) -> None:
        """What was played last has been put into the inbox; wait until it has been taken out and flown."""
        held_since_s = math.inf
        while True:
            if shell.inbox.empty and _rests(shell):
                return
            held = shell.state.state is State.EMERGENCY_HOLD and shell.state.return_at_s is None
            held_since_s = min(held_since_s, self.clock()) if held else math.inf
            if self.clock() - held_since_s >= HELD_S:
                return
            await asyncio.sleep(0.05)

    async def _until(self, shell: Shell, condition: Callable[[], bool]) -> None:
        while not condition():
            await shell.changed.wait()

    async def _watch_link(self, shell: Shell, silent_s: float) -> None:
        """Lets a paired drone go that has been silent for long, which ends the run unless somebody sits at the console."""
        while True:
            await asyncio.sleep(0.5)
            vehicle = shell.vehicle
            if shell.vehicle_lost and not self.options.console:
                raise VehicleLost
            if vehicle is not None and vehicle.telemetry().link_age_s(self.clock()) > silent_s:
                lost = f"lost, silent for {silent_s:.0f} s"
                if self.options.console:
                    # STOP, the other drones and whatever comes of this one must stay in reach.
                    shell.inbox.put(ClaimLost(lost, silent=True))
                    continue
                self.announce(f"{vehicle.colour.capitalize()}: {lost}", Notice.VEHICLE_SILENT)
                raise VehicleLost

    def _say_soon(self, sentence: str, change: SenseChange | None = None, /) -> None:
        """Announce, from any thread."""
        notice = Notice(change.value) if change is not None else Notice.INFORMATION
        with contextlib.suppress(RuntimeError):  # the loop has closed: there is nobody left to tell
            self._loop.call_soon_threadsafe(lambda: self.announce(sentence, notice))


async def _in_thread(work: Callable[[], T]) -> T:
    """The result of blocking work. Its thread dies with the process: a pipe that never ends must not keep us (Ctrl-C)."""
    loop = asyncio.get_running_loop()
    done: asyncio.Future[T] = loop.create_future()

    def post(settle: Callable[[], None]) -> None:
        with contextlib.suppress(RuntimeError):  # the loop has closed: nobody waits any more
            loop.call_soon_threadsafe(lambda: None if done.done() else settle())

    def run_it() -> None:
        try:
            result = work()
        except Exception as error:  # noqa: BLE001  (it belongs to whoever waits)
            raised = error
            post(lambda: done.set_exception(raised))
        else:
            post(lambda: done.set_result(result))

    threading.Thread(target=run_it, name="loading", daemon=True).start()
    return await done


def _return_freed_memory() -> None:
    """What loading needed for a moment goes back to the system (about 6 MB); only glibc would keep it."""
    with contextlib.suppress(AttributeError):
        ctypes.CDLL(None).malloc_trim(0)


@contextlib.asynccontextmanager
async def _together(*work: Coroutine[Any, Any, None]) -> AsyncIterator[set[asyncio.Task[None]]]:
    """Tasks that end with the block."""
    tasks = {asyncio.create_task(one) for one in work}
    try:
        yield tasks
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


def _rests(shell: Shell) -> bool:
    """The drone rests: Armed or NormalAutonomy, and nothing is on its way to be decided."""
    return shell.state.state in (State.ARMED, State.IDLE) and shell.state.pending is None
