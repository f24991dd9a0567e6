"""From options to a console on the screen and back: the run starts first and ends last."""

from __future__ import annotations

import os
import select
import signal
import termios
import threading
import time
from collections import deque
from typing import TYPE_CHECKING

from m3r_app.output import AnnounceEvent, EndEvent, Told
from m3r_app.run_thread import Live
from modalities.voice.self_speech import SelfSpeech
from ui.console.app import KEPT_EVENTS, Console
from ui.console.seat import Occupied, Seat
from ui.console.terminal import log_path, own_screen, require_terminal
from ui.narrator import sentence
from ui.output import discard_stdout
from ui.speaker import speaking

if TYPE_CHECKING:
    from pathlib import Path

    from m3r_app.options import RunOptions

LOOK_MS = 500
LEAVE_S = 5.0
"""How long the screen may take to close after the run has ended."""
GONE = 1
ENDING = (signal.SIGHUP, signal.SIGTERM, signal.SIGINT, signal.SIGQUIT)
"""The terminal is gone, or the process is told to end: the drone is left in Hold first."""


def show(options: RunOptions, seat_path: Path | None = None) -> int:
    """Fly one run from the console; returns the exit status. seat_path: only one console may sit there at a time.

    Raises what names bad input or a missing vehicle.
    """
    require_terminal(os.environ)
    if seat_path is None:
        return _fly(options, None)
    with Seat(seat_path) as seat:
        if seat.taken:
            return _fly(options, seat)
        with own_screen(log_path()):
            Occupied(seat).run()
    return 0


def _watch(live: Live) -> None:
    """End the run when the terminal is gone, and the process where a screen that is gone would keep it from ending.

    Textual's writing thread dies of a terminal that is lost, and what draws then waits for it for ever.
    """
    terminal = select.poll()
    terminal.register(0, 0)  # only a hang-up or an error
    while not live.ended:
        if terminal.poll(LOOK_MS):
            live.interrupt()
            break
    try:
        status = live.result()
    except Exception:  # noqa: BLE001  (whoever is not stuck tells of it)
        status = GONE
    time.sleep(LEAVE_S)
    os._exit(status)


def _fly(options: RunOptions, seat: Seat | None) -> int:
    events: deque[Told] = deque(maxlen=KEPT_EVENTS)
    ended: list[str] = []

    def take(told: Told) -> None:
        events.append(told)
        if isinstance(told.event, EndEvent):
            ended.append(sentence(told.event) or "")

    def trouble(text: str) -> None:
        take(Told(time.monotonic() - began_s, AnnounceEvent(text)))

    self_speech, began_s = SelfSpeech(), time.monotonic()
    with speaking(options, self_speech, trouble, take) as emit:
        status = _shown(options, Live(options, emit, self_speech), events, seat)
    try:
        print("\n".join(ended), flush=True)
    except OSError:  # nobody is there any more to read it
        discard_stdout()
    return status


def _shown(options: RunOptions, live: Live, events: deque[Told], seat: Seat | None) -> int:
    """The run with its screen, to the end of both."""
    for name in ENDING:
        signal.signal(name, lambda *_: live.interrupt())
    threading.Thread(target=_watch, args=(live,), name="terminal", daemon=True).start()
    with own_screen(log_path()):
        live.start()
        try:
            Console(live, events, dry_run=options.dry_run, takeoff_m=options.takeoff_m, seat=seat).run()
        except (OSError, termios.error):
            live.interrupt()  # the terminal is gone
        finally:
            # Whatever became of the screen, the drone is left in Hold.
            live.interrupt()
            status = live.result()
    return status
