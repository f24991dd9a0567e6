"""A run in a thread of its own beside a console in the main thread: asked from outside, shown as snapshots, ended in
order.

The control loop never waits for the console: a snapshot is made ten times a second and replaced whole, and asking only
posts.
Source: design "The flow, one way": a console is one more modality.
"""

from __future__ import annotations

import asyncio
import contextlib
import gc
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import replace

from m3r_app.arbiter.events import LandingAsked, TakeOffAsked
from m3r_app.options import RunOptions
from m3r_app.run import Emit, Run
from m3r_app.snapshot import Snapshot, craft, heard_of
from modalities.voice.self_speech import SelfSpeech
from safety.vocabulary import Command, ManeuverRequest, Modality

PICTURE_S = 0.1
SWITCH_S = 0.0005
"""How long a thread that draws may keep the interpreter from the control loop; Python's default is 5 ms."""
END_S = 30.0
"""Longer than every step of an orderly end together."""


class Live:
    """Start it, ask it, look at it, end it. Every method may be called from any thread."""

    def __init__(self, options: RunOptions, emit: Emit, self_speech: SelfSpeech | None = None) -> None:
        """emit: takes the objects of the machine-readable output, in the run's own thread; it may not block.

        self_speech: when whoever speaks for us did, by `time.monotonic`.
        """
        self.clock = time.monotonic
        self.snapshot: Snapshot | None = None
        """The latest; None until the fleet is connected."""
        self._options = replace(options, console=True)
        self._emit = emit
        self._self_speech = self_speech
        self._loop: asyncio.AbstractEventLoop | None = None
        self._run: Run | None = None
        self._asked = 0
        self._wanted_end = threading.Event()
        self._ended = threading.Event()
        self._status: int | None = None
        self._failure: BaseException | None = None
        self._thread = threading.Thread(target=self._live, name="m3r", daemon=True)

    def start(self) -> None:
        sys.setswitchinterval(SWITCH_S)
        self._thread.start()

    @property
    def ended(self) -> bool:
        """The run is over: `result` has it."""
        return self._ended.is_set()

    # ------------------------------------------------------------ asking

    def ask(self, command: Command, colour: str | None = None, evidence: str = "") -> ManeuverRequest:
        """A request of the panel, stamped now. colour: the drone to activate."""
        request = self.request(command, colour, evidence)
        self._post(lambda run: run.take(request))
        return request

    def request(self, command: Command, colour: str | None = None, evidence: str = "") -> ManeuverRequest:
        """What `ask` would ask."""
        self._asked += 1
        now_s = self.clock()
        return ManeuverRequest(
            f"panel-{self._asked}", command, Modality.PANEL, 1.0, now_s, now_s, evidence=evidence, colour=colour
        )

    def take_off(self, colour: str, metres: float) -> None:
        """Take off to `metres` and hold there. Confirmed by whoever calls; only in NormalAutonomy (design 15)."""
        self._post(lambda run: run.put(TakeOffAsked(colour, metres)))

    def land(self, colour: str) -> None:
        """Land where it is. Confirmed by whoever calls; only in NormalAutonomy (design 15)."""
        self._post(lambda run: run.put(LandingAsked(colour)))

    def talk(self) -> None:
        """Open or close a push-to-talk microphone; without one, nothing."""
        self._post(lambda run: run.talk.toggle() if run.talk is not None else None)

    def quit(self) -> None:
        """The operator leaves: the drone is left in Hold, and that is a normal end. Returns at once."""
        if self.snapshot is None:
            self.interrupt()
        self._post(lambda run: run.quitted.set())

    def interrupt(self) -> None:
        """End in order: the drone is left in Hold. Returns at once."""
        self._wanted_end.set()
        self._post(lambda run: run.interrupted.set())

    def result(self, timeout_s: float = END_S) -> int:
        """Wait for the end; the exit status. Raises what ended it, and TimeoutError."""
        if not self._ended.wait(timeout_s):
            raise TimeoutError("the run did not end")
        self._thread.join(timeout_s)
        if self._failure is not None:
            raise self._failure
        assert self._status is not None
        return self._status

    # ------------------------------------------------------------ in the run's thread

    def _post(self, work: Callable[[Run], None]) -> None:
        loop, run = self._loop, self._run
        if loop is not None and run is not None:
            with contextlib.suppress(RuntimeError):  # the loop has closed: there is nothing left to ask
                loop.call_soon_threadsafe(work, run)

    def _live(self) -> None:
        try:
            self._status = asyncio.run(self._whole())
        except BaseException as failure:  # noqa: BLE001  (it belongs to whoever waits for the result)
            self._failure = failure
        finally:
            gc.collect()
            self._ended.set()

    async def _whole(self) -> int:
        run = Run(self._options, self._emit, self._self_speech)
        self._loop = asyncio.get_running_loop()
        self._run = run
        if self._wanted_end.is_set():
            run.interrupted.set()
        watching = asyncio.create_task(self._watch(run))
        try:
            return await run.whole()
        finally:
            watching.cancel()
            # MAVSDK's objects end here, where they began, and not when the interpreter does.
            self._run = None

    async def _watch(self, run: Run) -> None:
        while True:
            await asyncio.sleep(PICTURE_S)
            if run.shell is None or run.setup is None:
                continue
            now_s, fleet, frame = run.clock(), run.shell.fleet, run.setup.frame
            told = (
                *(craft(name, v.telemetry(), frame, now_s, ours=True) for name, v in fleet.vehicles.items()),
                *(craft(name, v.telemetry(), frame, now_s, ours=False) for name, v in fleet.others.items()),
            )
            shell = run.shell
            told += heard_of(shell.state, frozenset(c.name for c in told), now_s)
            self.snapshot = Snapshot(now_s, shell.state, run.setup, told, run.senses, shell.airspace.trouble)
