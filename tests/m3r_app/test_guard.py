"""The guard against real stalls, in real processes (X7, X3)."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import pytest

from m3r_app.vehicle.guard import HOLD_AFTER_S, KILL_AFTER_S, Guard

ROOT = Path(__file__).resolve().parents[2]
RUNS = range(25 if os.environ.get("M3R_SOAK") else 1)

APP = """
    import asyncio, ctypes, os, sys, time
    from m3r_app.vehicle.guard import Guard

    def say(*words):
        os.write(1, (" ".join(map(str, words)) + "\\n").encode())

    def stick():
        kind = sys.argv[1]
        say("stuck")
        if kind == "block":
            time.sleep(1.5)
        elif kind == "gil":
            ctypes.PyDLL(None).usleep(1_500_000)

    async def main():
        guard = Guard(lambda text: say("report", text))
        guard.start()
        last_beat_s = time.monotonic()
        hold = lambda timeout_s: say("hold", time.monotonic() - last_beat_s)
        if "unarmed" not in sys.argv:
            guard.arm(hold)
        say("guarded", guard.process_id)
        for step in range(sys.maxsize):
            last_beat_s = time.monotonic()
            if not guard.beat():
                say("dropped")
                guard.arm(hold)
            if step == 10:
                stick()
                last_beat_s = time.monotonic()
            if step == 60:
                say("running")
                if "leave" in sys.argv:
                    guard.close()
                    say("left")
                    return
            await asyncio.sleep(0.02)

    asyncio.run(main())
"""


class App:
    """A process whose event loop beats at 50 Hz under the guard, and what it says."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process = process
        assert process.stdout is not None
        self.stdout: IO[str] = process.stdout

    def hear(self, word: str, within_s: float = 10.0) -> list[str]:
        """The next line that begins with word."""
        found: list[list[str]] = []

        def read() -> None:
            for line in self.stdout:
                if line.split()[0] == word:
                    found.append(line.split())
                    return

        reader = threading.Thread(target=read, daemon=True)
        reader.start()
        reader.join(within_s)
        assert found, f"the app never said {word!r}"
        return found[0]

    def ended_within(self, within_s: float) -> int:
        return self.process.wait(within_s)


@contextmanager
def app(*arguments: str) -> Iterator[App]:
    process = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(APP), *arguments],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield App(process)
    finally:
        process.kill()
        process.communicate()


def gone(pid: int) -> bool:
    """Whether a process has ended (a zombie has)."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] in "ZX"
    except OSError:
        return True


def eventually(condition: Callable[[], bool], within_s: float = 5.0) -> bool:
    deadline_s = time.monotonic() + within_s
    while time.monotonic() < deadline_s:
        if condition():
            return True
        time.sleep(0.01)
    return condition()


@pytest.mark.requirement("X7")
@pytest.mark.parametrize("run", RUNS)
def test_a_blocked_event_loop_is_held_by_the_thread_within_a_second_and_learns_of_it(run: int) -> None:
    with app("block") as stalled:
        stalled.hear("stuck")
        silent_s = float(stalled.hear("hold")[1])
        assert HOLD_AFTER_S <= silent_s < 1.0
        assert stalled.hear("report")
        assert stalled.hear("dropped")
        assert stalled.hear("running"), "a blocked loop is no reason to kill: the thread was alive"
        assert stalled.process.poll() is None


@pytest.mark.requirement("X7")
@pytest.mark.parametrize("run", RUNS)
def test_a_held_interpreter_is_killed_by_the_process_and_the_operator_is_told(run: int) -> None:
    with app("gil") as stuck:
        stuck.hear("stuck")
        began_s = time.monotonic()
        assert stuck.ended_within(2.0) == -signal.SIGKILL
        assert KILL_AFTER_S * 0.8 <= time.monotonic() - began_s < 1.5
        assert stuck.process.stderr is not None
        assert "did not respond" in stuck.process.stderr.read()


@pytest.mark.requirement("X3")
def test_a_held_interpreter_without_authority_lives() -> None:
    with app("gil", "unarmed") as stuck:
        stuck.hear("stuck")
        stuck.hear("running")
        assert stuck.process.poll() is None


@pytest.mark.requirement("X7")
@pytest.mark.parametrize("run", RUNS)
def test_a_stopped_app_is_killed(run: int) -> None:
    with app("nothing") as running:
        running.hear("running")
        running.process.send_signal(signal.SIGSTOP)
        assert running.ended_within(2.0) == -signal.SIGKILL


@pytest.mark.requirement("X7")
@pytest.mark.parametrize("run", RUNS)
def test_app_and_process_stopped_together_wake_to_a_hold_not_to_a_kill(run: int) -> None:
    with app("nothing") as both:
        guard_pid = int(both.hear("guarded")[1])
        both.hear("running")
        os.kill(guard_pid, signal.SIGSTOP)
        both.process.send_signal(signal.SIGSTOP)
        time.sleep(1.2)  # the suspension itself
        os.kill(guard_pid, signal.SIGCONT)
        both.process.send_signal(signal.SIGCONT)
        both.hear("hold")
        assert "the guard commanded Hold" in " ".join(both.hear("report"))
        assert not gone(guard_pid)
        assert both.process.poll() is None


@pytest.mark.requirement("X7")
def test_the_guard_process_is_missed_and_replaced_and_the_new_one_still_kills() -> None:
    with app("nothing") as running:
        first = int(running.hear("guarded")[1])
        running.hear("running")
        os.kill(first, signal.SIGKILL)
        assert "started again" in " ".join(running.hear("report"))
        running.process.send_signal(signal.SIGSTOP)
        assert running.ended_within(2.0) == -signal.SIGKILL


@pytest.mark.parametrize("how", ["left", "killed"])
def test_the_guard_process_ends_with_the_app(how: str) -> None:
    with app("nothing", "leave" if how == "left" else "stay") as ending:
        guard_pid = int(ending.hear("guarded")[1])
        ending.hear("running")
        if how == "killed":
            ending.process.kill()
        assert ending.ended_within(5.0) == (0 if how == "left" else -signal.SIGKILL)
        assert eventually(lambda: gone(guard_pid))


@pytest.fixture
def guarded() -> Iterator[tuple[Guard, list[str]]]:
    reports: list[str] = []
    guard = Guard(reports.append, hold_after_s=0.3)
    guard.start()
    yield guard, reports
    guard.close()
    assert guard.process_id is None or gone(guard.process_id)


@pytest.mark.requirement("X3")
def test_silence_without_authority_holds_nothing(guarded: tuple[Guard, list[str]]) -> None:
    guard, _ = guarded
    held = threading.Event()
    guard.arm(lambda _: held.set())
    guard.disarm()
    assert not held.wait(0.5)
    assert not guard.stalled
    guard.arm(lambda _: held.set())
    assert held.wait(1.0), "the same silence with authority must hold, or this test proves nothing"


@pytest.mark.requirement("X7")
def test_a_hold_that_fails_is_tried_again_and_reported_once(guarded: tuple[Guard, list[str]]) -> None:
    guard, reports = guarded
    tries: list[float] = []
    done = threading.Event()

    def hold(timeout_s: float) -> None:
        tries.append(timeout_s)
        if len(tries) < 3:
            raise OSError("no answer")
        done.set()

    guard.arm(hold)
    assert done.wait(3.0)
    assert eventually(lambda: len(reports) == 2)
    assert "no answer" in reports[0] and "commanded Hold" in reports[1]


@pytest.mark.requirement("X3", "X7")
def test_a_stall_that_ended_just_now_is_held_all_the_same_but_not_once_authority_is_gone() -> None:
    guard = Guard(lambda _: None)
    held: list[float] = []
    guard.arm(held.append)  # the loop is back and has armed anew before Hold was on its way
    guard._command_hold(held.append, 0.8)
    assert len(held) == 1
    guard.disarm()
    guard._command_hold(held.append, 0.8)
    assert len(held) == 1


@pytest.mark.requirement("X7")
def test_a_listener_that_raises_does_not_take_the_guard_down() -> None:
    def report(_: str) -> None:
        raise RuntimeError("the loop is closed")

    guard = Guard(report, hold_after_s=0.3)
    guard.start()
    held = threading.Event()
    try:
        guard.arm(lambda _: held.set())
        assert held.wait(1.0)
        held.clear()
        guard.arm(lambda _: held.set())
        assert held.wait(1.0)
    finally:
        guard.close()


def test_beat_says_no_until_armed_anew(guarded: tuple[Guard, list[str]]) -> None:
    guard, _ = guarded
    guard.arm(lambda _: None)
    assert guard.beat()
    assert eventually(lambda: guard.stalled)
    assert not guard.beat()
    guard.arm(lambda _: None)
    assert guard.beat()


@pytest.mark.requirement("X7")
def test_a_hung_guard_process_is_replaced(guarded: tuple[Guard, list[str]]) -> None:
    guard, reports = guarded
    first = guard.process_id
    assert first is not None
    os.kill(first, signal.SIGSTOP)
    assert eventually(lambda: bool(reports))
    assert "did not answer" in reports[0]
    assert guard.ready
    assert guard.process_id not in (None, first)
    assert gone(first)
