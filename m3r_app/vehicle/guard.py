"""The guard, in two layers, both active only while the app holds authority (X3, X7).

MAVSDK re-sends the last setpoint from its own thread even while Python is frozen, so the autopilot does not notice a
hung app. So a thread that is not the event loop commands Hold soon after the control loop's last sign of life; and a
small process (`m3r_app.vehicle.guard_process`) kills an app whose guard thread itself falls silent, so that setpoints stop
and the autopilot's own failsafe acts. The guard keeps real time, not the app's clock: frozen is frozen.
"""

from __future__ import annotations

import io
import logging
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import cast

HOLD_AFTER_S = 0.7
"""Silence of the control loop after which the thread commands Hold; the requirement is 1 s."""
KILL_AFTER_S = 0.5
"""Silence of the guard thread after which the process ends the app."""
PULSE_S = 0.05
UNANSWERED_PULSES = 20
"""A process that has left this many pulses unanswered is hung, and is replaced."""
HOLD_TIMEOUT_S = 1.0
"""How long one Hold waits for its acknowledgement before it is commanded again."""
HOLD_AGAIN_S = 0.2

log = logging.getLogger("m3r.guard")

_BOOTTIME: int | None = getattr(time, "CLOCK_BOOTTIME", None)


def real_time_s() -> float:
    """A clock that also runs while the computer is suspended, where the system has one (Linux)."""
    return time.monotonic() if _BOOTTIME is None else time.clock_gettime(_BOOTTIME)


class Guard:
    """Watches the control loop. `start` before pairing, `arm` with authority, `beat` at every control step."""

    def __init__(
        self,
        report: Callable[[str], None],
        hold_after_s: float = HOLD_AFTER_S,
        kill_after_s: float = KILL_AFTER_S,
    ) -> None:
        """report: told in one sentence what the guard did or lost, on the guard's own threads; must not block."""
        self._tell = report
        self._hold_after_s = hold_after_s
        self._kill_after_s = kill_after_s
        self._lock = threading.Lock()
        self._hold: Callable[[float], None] | None = None
        self._stalled = False
        self._beat_at_s = 0.0
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="guard", daemon=True)
        self._process: _GuardProcess | None = None

    def start(self) -> None:
        """Start both layers. Raises OSError if the process cannot be started: then nothing may be flown."""
        self._process = _GuardProcess(self._kill_after_s)
        self._thread.start()

    def close(self) -> None:
        """Stop watching and end the process. Idempotent."""
        self.disarm()
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join(2.0)
        if self._process is not None:
            self._process.close()

    @property
    def ready(self) -> bool:
        """Whether both layers run: without them nothing may be flown (X7)."""
        return self._thread.is_alive() and self._process is not None

    @property
    def armed(self) -> bool:
        return self._hold is not None

    @property
    def stalled(self) -> bool:
        """Whether Hold was commanded since `arm`: the rest of the plan must be dropped and said so."""
        return self._stalled

    @property
    def process_id(self) -> int | None:
        """The outer guard's process; None where there is none now."""
        return None if self._process is None else self._process.pid

    def arm(self, hold: Callable[[float], None]) -> None:
        """Authority gained, or a stall dealt with. hold(timeout_s) commands Hold from any thread or raises."""
        with self._lock:
            self._beat_at_s = real_time_s()
            self._stalled = False
            self._hold = hold
        self._pulse()

    def disarm(self) -> None:
        """Authority given back or taken over: from here on the guard commands nothing and ends nobody."""
        with self._lock:
            self._hold = None
        self._pulse()

    def beat(self) -> bool:
        """The control loop's sign of life. False once Hold was commanded over its head: drop the plan, then `arm`."""
        # Whoever wakes first from a suspension sees it: the loop must not cover its own gap with a new beat.
        self._check()
        self._beat_at_s = real_time_s()
        return not self._stalled

    def _check(self) -> None:
        """Command Hold if the control loop has been silent for too long in command."""
        with self._lock:
            hold, silent_s = self._hold, real_time_s() - self._beat_at_s
            if hold is None or self._stalled or silent_s < self._hold_after_s:
                return
            self._stalled = True
        # On a thread of its own: while Hold waits for its answer, the process must go on hearing the guard thread.
        threading.Thread(target=self._command_hold, args=(hold, silent_s), name="guard-hold", daemon=True).start()

    def _pulse(self) -> bool:
        """Tell the process whether we are in command; at once when that changes, for what follows may take long."""
        process = self._process
        return process is not None and process.pulse(self.armed)

    def _watch(self) -> None:
        """The guard thread."""
        while not self._closing.wait(PULSE_S):
            if not self._pulse():
                self._replace_process()
            self._check()

    def _command_hold(self, hold: Callable[[float], None], silent_s: float) -> None:
        """Command Hold until it is acknowledged, or somebody else decides."""
        failures = 0
        # Once in any case, even if the loop has come back meanwhile and armed anew: what it was told must be true.
        while self._hold is not None and (failures == 0 or self._stalled) and not self._closing.is_set():
            try:
                hold(HOLD_TIMEOUT_S)
            except Exception as error:  # noqa: BLE001 - whatever it is, the next try must come
                failures += 1
                if failures == 1:
                    self._report(f"the control loop is silent, and the guard's Hold failed and is tried again: {error}")
                self._closing.wait(HOLD_AGAIN_S)
            else:
                self._report(f"the control loop was silent for {silent_s:.1f} s, so the guard commanded Hold")
                return

    def _report(self, text: str) -> None:
        """Tell; whoever listens may not take the guard down."""
        try:
            self._tell(text)
        except Exception:
            log.exception("nobody could be told that %s", text)

    def _replace_process(self) -> None:
        """The outer guard has died or hangs: say so and start another."""
        old, self._process = self._process, None
        ended = "was missing" if old is None else old.end()
        try:
            self._process = _GuardProcess(self._kill_after_s)
        except OSError as error:
            self._report(f"the guard process {ended} and cannot be started again ({error}): land or take over")
            self._closing.wait(1.0)
        else:
            self._pulse()
            self._report(f"the guard process {ended} and was started again")


class _GuardProcess:
    """The other end of the pipes to `guard_process.py`."""

    def __init__(self, kill_after_s: float) -> None:
        """Raises OSError."""
        pidfd = os.pidfd_open(os.getpid()) if hasattr(os, "pidfd_open") else -1
        script = Path(__file__).with_name("guard_process.py")
        command = [sys.executable, "-I", "-S", str(script), str(os.getpid()), str(pidfd), str(kill_after_s)]
        try:
            # A session of its own: Ctrl-C and Ctrl-Z in the terminal are for the app, not for who watches it.
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                bufsize=0,
                start_new_session=True,
                pass_fds=() if pidfd < 0 else (pidfd,),
            )
        finally:
            if pidfd >= 0:
                os.close(pidfd)
        # Unbuffered pipes are raw files; their read gives None where there is nothing yet.
        self._to = cast("io.RawIOBase", self._process.stdin)
        self._from = cast("io.RawIOBase", self._process.stdout)
        os.set_blocking(self._to.fileno(), False)
        os.set_blocking(self._from.fileno(), False)
        self._unanswered = 0
        self._lock = threading.Lock()

    @property
    def pid(self) -> int:
        return self._process.pid

    def pulse(self, in_command: bool) -> bool:
        """Send a pulse. False if the process is dead or has stopped answering."""
        with self._lock:
            if self._to.closed:
                return False
            try:
                self._to.write(b"+" if in_command else b"-")
                answer = self._from.read(4096)
            except OSError:
                return False
            if answer is None:
                self._unanswered += 1
            else:
                self._unanswered = 0
            return answer != b"" and self._unanswered < UNANSWERED_PULSES

    def end(self) -> str:
        """Make sure that it is gone; returns how it ended."""
        status = self._process.poll()
        if status is None:
            self._process.kill()
            self._process.wait()
        self._close_pipes()
        return "did not answer" if status is None else f"ended ({status})"

    def close(self) -> None:
        """Let it go: it ends when its input does."""
        self._close_pipes()
        try:
            self._process.wait(1.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _close_pipes(self) -> None:
        with self._lock:
            self._to.close()
            self._from.close()
