"""The whole console: a real run on the simulated fleet in a real terminal, and in a real browser."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import select
import shutil
import signal
import socket
import struct
import subprocess
import sys
import termios
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.error import HTTPError

import pytest

from tests.whole import HILLSIDE, PATIENCE_S, ROOT, Simulated, simulated
from ui.console.prompts import READ_S


class Terminal:
    """`m3r` in a terminal of its own, which a test reads and types into."""

    def __init__(self, *arguments: str, size: tuple[int, int] = (80, 24), **environment: str) -> None:
        self.process_id, self.master = pty.fork()
        if self.process_id == 0:
            os.chdir(ROOT)
            words = [sys.executable, "-m", "ui.entry", *arguments]
            os.execve(sys.executable, words, {**os.environ, "TERM": "xterm-256color", **environment})
        fcntl.ioctl(self.master, termios.TIOCSWINSZ, struct.pack("HHHH", size[1], size[0], 0, 0))
        self.shown = ""
        self.status: int | None = None

    def type(self, keys: str) -> None:
        os.write(self.master, keys.encode())

    def until(self, done: Callable[[], bool], what: str) -> None:
        """Read the screen until something is so."""
        deadline_s = time.monotonic() + PATIENCE_S
        while not done():
            assert time.monotonic() < deadline_s, f"never {what}: {self.words[-600:]}"
            self.read(0.1)

    def read(self, wait_s: float) -> None:
        if select.select([self.master], [], [], wait_s)[0]:
            try:
                self.shown += os.read(self.master, 65536).decode(errors="replace")
            except OSError:  # it has ended
                time.sleep(wait_s)

    @property
    def words(self) -> str:
        """What was drawn so far, without the control sequences."""
        return re.sub(r"\x1b\[[0-9;:?>=<$!]*[ -/]*[@-~]|\x1b[PX^_\]].*?(\x1b\\|\x07)|\x1b.", "", self.shown)

    def hang_up(self) -> None:
        os.close(self.master)

    def wait(self) -> int:
        """The exit status."""
        deadline_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline_s:
            done, status = os.waitpid(self.process_id, os.WNOHANG)
            if done:
                return os.waitstatus_to_exitcode(status)
            time.sleep(0.05)
        os.kill(self.process_id, 9)
        os.waitpid(self.process_id, 0)
        raise AssertionError("it did not end")


def moving(fleet: Simulated) -> Callable[[], bool]:
    def is_moving() -> bool:
        state = fleet.last("red")
        return bool(state["mode"] == "OFFBOARD" and sum(v * v for v in state["velocity_m_s"]) > 0.01)

    return is_moving


def test_a_flight_by_keys_and_a_terminal_that_is_lost(tmp_path: Path) -> None:
    """SIGHUP in mid-maneuver leaves the drone in Hold, and the process ends."""
    with simulated(HILLSIDE, tmp_path) as fleet:
        screen = Terminal("console", "--scenario", str(HILLSIDE), *fleet.vehicles)
        screen.until(lambda: "no drone paired" in screen.words, "a picture")
        number = 1 + list(fleet.urls).index("red")
        screen.type(str(number))
        screen.until(lambda: "ManeuverRequestArmed" in screen.words, "armed")
        screen.type("\x1b[D")  # left
        screen.until(moving(fleet), "moving")
        screen.hang_up()
        fleet.wait("red", mode="LOITER")
        assert screen.wait() == 130


@pytest.mark.soak
def test_a_terminal_that_takes_nothing_any_more_does_not_keep_the_process(tmp_path: Path) -> None:
    """The screen is full of what nobody reads when the hang-up comes: the thread that draws is stuck for ever."""
    screen = Terminal("console", "--scenario", str(HILLSIDE))
    screen.until(lambda: "no drone paired" in screen.words, "a picture")
    os.kill(screen.process_id, signal.SIGSTOP)
    for signals in (signal.SIGHUP, signal.SIGCONT):
        os.kill(screen.process_id, signals)
    screen.hang_up()
    assert screen.wait() == 130


def test_stop_of_another_modality_ends_a_take_off_from_the_console(tmp_path: Path) -> None:
    script = tmp_path / "said.txt"
    script.write_text("5.0 voice stop\n")
    with simulated(HILLSIDE, tmp_path) as fleet:
        words = [
            "console",
            "--quiet",
            "--takeoff",
            "20",
            "--apply-failsafe",
            "--script",
            str(script),
            "--scenario",
            str(HILLSIDE),
        ]
        screen = Terminal(*words, *fleet.vehicles)
        screen.until(lambda: "no drone paired" in screen.words, "a picture")
        screen.type("o")
        screen.until(lambda: "nobody is near" in screen.words, "asked")
        asked_s = time.monotonic()
        screen.until(lambda: time.monotonic() - asked_s > 2.0 * READ_S, "read")  # or nobody has read the question
        screen.type("y")
        screen.until(lambda: "taking off" in screen.words, "taking off")
        screen.until(lambda: "Blue: holding" in screen.words, "held")
        assert fleet.wait("blue", mode="LOITER")["armed"]
        climbed_m = fleet.states("blue")[0]["ned_m"][2] - fleet.last("blue")["ned_m"][2]
        assert climbed_m < 15.0
        screen.hang_up()
        assert screen.wait() == 130


@pytest.mark.parametrize("live", [[], ["--gamepad"]])
def test_leaving_is_asked_and_ends_normally(live: list[str], tmp_path: Path) -> None:
    """A live input has no end of its own; the operator's end is."""
    with simulated(HILLSIDE, tmp_path) as fleet:
        screen = Terminal("console", "--scenario", str(HILLSIDE), *live, *fleet.vehicles, LC_ALL="C")
        screen.until(lambda: "no drone paired" in screen.words, "a picture")
        screen.type("q")
        status, typed_s = None, time.monotonic()
        while status is None:
            assert time.monotonic() - typed_s < PATIENCE_S, "it did not end"
            screen.read(0.1)
            done, state = os.waitpid(screen.process_id, os.WNOHANG)
            status = os.waitstatus_to_exitcode(state) if done else None
        screen.read(0.1)
        assert status == 0
        assert "ended (inputs_played)" in screen.words
        assert all(c.isascii() for c in screen.words)


@pytest.mark.parametrize("arguments", [["console"], []])
def test_without_a_terminal_one_sentence_and_nothing_flies(arguments: list[str]) -> None:
    ended = subprocess.run(
        [sys.executable, "-m", "ui.entry", *arguments],
        cwd=ROOT,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 2
    assert ended.stdout == ""
    assert ended.stderr.count("\n") == 1
    assert "needs a terminal" in ended.stderr


def test_bad_input_is_told_after_the_screen_is_gone(tmp_path: Path) -> None:
    screen = Terminal("console", "--scenario", str(tmp_path / "none.toml"))
    screen.until(lambda: "none.toml" in screen.words, "told")
    assert screen.wait() == 2
    assert "Traceback" not in screen.words


# ---------------------------------------------------------------- in the browser


@contextmanager
def served(*arguments: str) -> Iterator[str]:
    """`m3r serve` on a free port; its address."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "ui.entry", "serve", "--port", str(port), *arguments]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        assert f"127.0.0.1:{port}" in process.stdout.readline()
        deadline_s = time.monotonic() + PATIENCE_S
        while socket.socket().connect_ex(("127.0.0.1", port)) != 0:  # it has said so a moment before
            assert time.monotonic() < deadline_s
            time.sleep(0.05)
        yield f"http://127.0.0.1:{port}"
    finally:
        process.terminate()
        process.wait(PATIENCE_S)


@pytest.mark.skipif(shutil.which("chromium") is None, reason="chromium is not installed")
def test_in_a_browser_one_operator_flies_and_a_second_tab_is_told_who(tmp_path: Path) -> None:
    from playwright.sync_api import Page, sync_playwright

    with simulated(HILLSIDE, tmp_path) as fleet, served("--scenario", str(HILLSIDE), *fleet.vehicles) as address:
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
            faults: list[str] = []

            def opened() -> tuple[Page, list[str]]:
                page, frames = browser.new_page(viewport={"width": 1200, "height": 800}), []
                page.on("console", lambda m: faults.append(m.text) if m.type == "error" else None)
                page.on("pageerror", lambda e: faults.append(str(e)))
                page.on("request", lambda r: faults.append(r.url) if not r.url.startswith(address) else None)

                def keep(payload: str | bytes) -> None:
                    frames.append(payload if isinstance(payload, str) else payload.decode(errors="replace"))

                page.on("websocket", lambda ws: ws.on("framereceived", keep))
                page.goto(address)
                return page, frames

            def until(page: Page, done: Callable[[], bool], what: str) -> None:
                deadline_s = time.monotonic() + PATIENCE_S
                while not done():
                    assert time.monotonic() < deadline_s, f"never {what}; {faults}"
                    page.wait_for_timeout(100)

            first, frames = opened()
            until(first, lambda: "no drone paired" in "".join(frames), "a picture")
            first.keyboard.press(str(1 + list(fleet.urls).index("red")))
            until(first, lambda: "ManeuverRequestArmed" in "".join(frames), "armed")
            second, told = opened()
            until(second, lambda: "flies Red" in "".join(told), "told who flies")
            second.keyboard.press("ArrowLeft")  # the second tab's keys reach no drone
            assert fleet.last("red")["mode"] in ("LOITER", "OFFBOARD")
            first.keyboard.press("ArrowLeft")
            until(first, moving(fleet), "moving")
            first.close()  # the operator is gone
            until(second, lambda: fleet.last("red")["mode"] == "LOITER", "held")
            browser.close()
        assert faults == []


def test_the_page_of_somebody_else_reaches_nothing() -> None:
    """Another page in the same browser, or a name that leads here, cannot open the console."""
    with served() as address:
        for headers in ({"Origin": "http://evil.example"}, {"Host": "evil.example"}):
            for path in ("/", "/ws"):
                asked = urllib.request.Request(address + path, headers=headers)
                with pytest.raises(HTTPError) as refused:
                    urllib.request.urlopen(asked, timeout=10)
                assert refused.value.code == 403
        socket_only = urllib.request.Request(address + "/ws")
        with pytest.raises(HTTPError) as refused:
            urllib.request.urlopen(socket_only, timeout=10)
        assert refused.value.code == 403
        with urllib.request.urlopen(address, timeout=10) as page:
            text = page.read().decode()
            policy = page.headers["Content-Security-Policy"]
        assert "https://" not in re.sub(r"<svg.*?</svg>", "", text, flags=re.DOTALL)
        assert policy.startswith("default-src 'none'")
        (style,) = re.findall(r'<link[^>]*href="([^"]*)"', text)  # without it a field to type in lies over the console
        with urllib.request.urlopen(style, timeout=10) as sheet:
            assert b"xterm-helper-textarea" in sheet.read()


def test_what_is_wrong_is_told_before_it_serves(tmp_path: Path) -> None:
    words = ["serve", "--scenario", str(tmp_path / "none.toml")]
    ended = subprocess.run(
        [sys.executable, "-m", "ui.entry", *words], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert (ended.returncode, ended.stdout, ended.stderr.count("\n")) == (2, "", 1)
    assert "none.toml" in ended.stderr


def test_a_port_in_use_is_told() -> None:
    with socket.socket() as held:
        held.bind(("127.0.0.1", 0))
        held.listen()
        port = held.getsockname()[1]
        ended = subprocess.run(
            [sys.executable, "-m", "ui.entry", "serve", "--port", str(port)],
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=False,
        )
    assert ended.returncode == 2
    assert f"port {port} is held by another program" in ended.stderr
    assert "--port" in ended.stderr
    assert ended.stderr.count("\n") == 1
