"""A real PX4 SITL (SIH quadcopter) on loopback, its ground truth and a second ground station, none of it from the product.

M3R_PX4 names a built px4 binary, its `px4-*` aliases beside it; its etc folder is the one next to bin, or M3R_PX4_ETC.
M3R_PX4_QUIET names one built with the noise of its simulator (`Sih::reconstruct_sensors_signals`) set to zero.
PX4 SIH sends its true state as HIL_STATE_QUATERNION to UDP 19410 + instance.
"""

from __future__ import annotations

import math
import os
import select
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

HOME = (47.3977432, 8.5455942, 489.4)
"""Where PX4 SIH starts by default: latitude, longitude, altitude."""
M_PER_DEG = 111_194.9
PARAMETERS = {"COM_OF_LOSS_T": 0.5, "COM_OBL_RC_ACT": 5, "COM_RC_OVERRIDE": 3}
"""What pairing requires of the failsafe, with a stick and without."""
BOOT_S = 60.0
MODES = {"HOLD": (4, 3), "RTL": (4, 5), "LAND": (4, 6), "POSCTL": (3, 0), "ALTCTL": (2, 0), "OFFBOARD": (6, 0)}
ARMED = 128
FORCE = 21196.0


def binary(variable: str = "M3R_PX4") -> Path | None:
    """The px4 that the environment names."""
    named = os.environ.get(variable)
    return Path(named).resolve() if named else None


def etc_of(px4: Path) -> Path:
    named = os.environ.get("M3R_PX4_ETC")
    return Path(named) if named and px4 == binary() else px4.parent.parent / "etc"


def place(north_m: float, east_m: float, up_m: float = 0.0) -> str:
    """LAT,LON,ALT as the command line takes it, from HOME."""
    lat = HOME[0] + north_m / M_PER_DEG
    return f"{lat:.8f},{HOME[1] + east_m / M_PER_DEG / math.cos(math.radians(HOME[0])):.8f},{HOME[2] + up_m:.2f}"


@dataclass(frozen=True)
class Witnessed:
    """The true state at one moment: metres and m/s, NED from HOME."""

    at_s: float
    ned_m: tuple[float, float, float]
    velocity_m_s: tuple[float, float, float]


def _bound(port: int) -> socket.socket | None:
    one = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        one.bind(("127.0.0.1", port))
    except OSError:
        one.close()
        return None
    return one


def _free_instance() -> tuple[int, socket.socket]:
    """An instance whose ports nobody has, and the bound socket of its truth."""
    for number in range(1, 10):
        held = [_bound(base + number) for base in (19410, 14540, 14580, 18570, 14280, 13030, 19450)]
        for one in held[1:]:
            if one is not None:
                one.close()
        if None not in held:
            assert held[0] is not None
            return number, held[0]
        if held[0] is not None:
            held[0].close()
    raise AssertionError("no free instance of PX4: the ports of 1 to 9 are taken")


class Px4:
    """A running PX4 until the block ends. Times are of time.monotonic()."""

    def __init__(self, px4: Path, folder: Path, **parameters: float) -> None:
        self._px4, self._folder = px4, folder
        self._parameters = PARAMETERS | parameters
        self.instance, self._truth_socket = _free_instance()
        self._station = _bound(0)
        assert self._station is not None
        self._station_peer = ("127.0.0.1", 14780 + self.instance)
        self._out = mavlink.MAVLink(None, 255, 190)
        self.truth: list[Witnessed] = []
        self.modes: list[tuple[float, int, bool]] = []
        """Every change of custom mode and of being armed, as its heartbeats tell."""
        self.texts: list[str] = []
        self._sticks = False
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._process: subprocess.Popen[bytes] | None = None

    # The process

    def __enter__(self) -> Px4:
        self._thread.start()
        try:
            self.start()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._done.set()
        self._thread.join()
        self.kill()
        for one in (self._truth_socket, self._station):
            assert one is not None
            one.close()

    def start(self) -> None:
        """Boot it, with a link for the second station."""
        environment = {**os.environ, "PX4_SIM_MODEL": "sihsim_quadx", "HEADLESS": "1"}
        environment["PATH"] = f"{self._px4.parent}:{environment['PATH']}"
        environment |= {f"PX4_PARAM_{name}": f"{value:g}" for name, value in self._parameters.items()}
        command = [str(self._px4), "-i", str(self.instance), "-d", str(etc_of(self._px4)), "-w", str(self._folder)]
        with (self._folder / "px4.log").open("ab") as log:
            self._process = subprocess.Popen(
                command, cwd=self._folder, env=environment, stdin=subprocess.DEVNULL, stdout=log, stderr=log
            )
        ready = b"Ready for takeoff"
        already = len((self._folder / "px4.log").read_bytes())
        self.until(lambda: ready in (self._folder / "px4.log").read_bytes()[already:], "not ready for take-off", BOOT_S)
        assert self._station is not None
        # It has six links at most; nobody listens to the ones for a camera and a gimbal.
        for unused in (14280, 13030):
            self.shell("mavlink", "stop", "-u", str(unused + self.instance))
        port = self._station.getsockname()[1]
        self.link(self._station_peer[1], port)
        self.until(lambda: bool(self.modes), "its station link is silent")

    def link(self, local: int, remote: int) -> None:
        """One more onboard link: it sends to the UDP port `remote` from `local`."""
        self.shell("mavlink", "start", "-x", "-u", str(local), "-r", "400000", "-m", "onboard", "-o", str(remote))
        self.shell("mavlink", "stream", "-u", str(local), "-s", "HEARTBEAT", "-r", "10")

    def kill(self) -> None:
        """At once, as a power cut does."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    def shell(self, command: str, *words: str) -> str:
        """A command of its own shell."""
        alias = self._px4.parent / f"px4-{command}"
        ran = subprocess.run(
            [str(alias), "--instance", str(self.instance), *words],
            cwd=self._folder, capture_output=True, text=True, timeout=20.0, check=False,
        )  # fmt: skip
        return ran.stdout + ran.stderr

    def until(self, condition: Callable[[], bool], why: str, within_s: float = 30.0) -> None:
        deadline_s = time.monotonic() + within_s
        while not condition():
            assert self._process is None or self._process.poll() is None, (
                "PX4: it has ended, by itself or by somebody else"
            )
            assert time.monotonic() < deadline_s, f"PX4: {why} after {within_s:g} s; {self.texts[-5:]}"
            self._done.wait(0.02)

    # What it tells

    def _listen(self) -> None:
        parsers = {one: mavlink.MAVLink(None) for one in (self._truth_socket, self._station)}
        for parser in parsers.values():
            parser.robust_parsing = True
        stick_s = 0.0
        while not self._done.is_set():
            for one in select.select(list(parsers), [], [], 0.02)[0]:
                for message in parsers[one].parse_buffer(one.recv(65535)) or []:
                    self._take(message)
            if self._sticks and time.monotonic() >= stick_s:
                stick_s = time.monotonic() + 0.05
                self._send(mavlink.MAVLink_manual_control_message(self.instance + 1, 0, 0, 500, 0, 0))

    def _take(self, message: Any) -> None:
        now_s = time.monotonic()
        match message.get_type():
            case "HIL_STATE_QUATERNION" if message.lat:
                north = (message.lat / 1e7 - HOME[0]) * M_PER_DEG
                east = (message.lon / 1e7 - HOME[1]) * M_PER_DEG * math.cos(math.radians(HOME[0]))
                velocity = (message.vx / 100.0, message.vy / 100.0, message.vz / 100.0)
                self.truth.append(Witnessed(now_s, (north, east, HOME[2] - message.alt / 1e3), velocity))
            case "HEARTBEAT" if message.get_srcComponent() == 1 and message.get_srcSystem() == self.instance + 1:
                told = (message.custom_mode, bool(message.base_mode & ARMED))
                if not self.modes or self.modes[-1][1:] != told:
                    self.modes.append((now_s, *told))
            case "STATUSTEXT":
                self.texts.append(message.text)

    @property
    def here_m(self) -> tuple[float, float, float]:
        return self.truth[-1].ned_m

    def at(self, at_s: float) -> tuple[float, float, float]:
        """Where it truly was."""
        return min(self.truth, key=lambda row: abs(row.at_s - at_s)).ned_m

    def farthest_m(self, from_s: float, until_s: float) -> float:
        """How far it truly came from where it was at from_s."""
        start = self.at(from_s)
        return max(math.dist(row.ned_m, start) for row in self.truth if from_s <= row.at_s <= until_s)

    def mode_since(self, at_s: float) -> list[str]:
        """The modes that it was armed in from then on. Landed and disarmed PX4 goes back to Offboard by itself, and stays there."""
        names = {main << 16 | sub << 24: name for name, (main, sub) in MODES.items()}
        before = [told for told in self.modes if told[0] <= at_s][-1:]
        since = [*before, *(told for told in self.modes if told[0] > at_s)]
        return [names.get(mode, hex(mode)) for _, mode, armed in since if armed]

    # A second ground station

    def _send(self, message: Any) -> None:
        assert self._station is not None
        self._station.sendto(message.pack(self._out), self._station_peer)

    def command(self, number: int, *values: float) -> None:
        filled = (*values, *[0.0] * (7 - len(values)))
        self._send(mavlink.MAVLink_command_long_message(self.instance + 1, 1, number, 0, *filled))

    def order(self, mode: str) -> float:
        """Another station commands a mode; when it did. The manual ones need a stick, which then is at rest."""
        if mode in ("POSCTL", "ALTCTL"):
            assert self._sticks, "a manual mode without a stick"
        self.command(mavlink.MAV_CMD_DO_SET_MODE, 1.0, *map(float, MODES[mode]))
        return time.monotonic()

    def hold_sticks(self) -> None:
        """From now on a stick at rest is heard."""
        self._sticks = True

    def disarm(self) -> float:
        self.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0.0, FORCE)
        return time.monotonic()

    @property
    def app_port(self) -> int:
        """Where an app listens for it."""
        return 14540 + self.instance


class Relay:
    """A bad link between PX4 and the app: delay, loss and cuts both ways; setpoints of the app are counted."""

    def __init__(self, listens: int, *, delay_s: float = 0.0, loss: Sequence[int] = ()) -> None:
        """listens: where PX4 sends to. loss: of every ten datagrams, the numbers of those that are lost."""
        down, up, app = _bound(listens), _bound(0), _bound(0)
        assert down is not None and up is not None and app is not None
        self._down, self._up = down, up
        self._app = ("127.0.0.1", app.getsockname()[1])
        app.close()
        self.app_port = self._app[1]
        self._px4: tuple[str, int] | None = None
        self._delay_s, self._loss, self._count = delay_s, frozenset(loss), 0
        self._queue: list[tuple[float, bool, bytes]] = []
        self._cut_until_s = 0.0
        self.setpoints_s: list[float] = []
        """When SET_POSITION_TARGET_LOCAL_NED left the app."""
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Relay:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._done.set()
        self._thread.join()
        self._down.close()
        self._up.close()

    def cut(self, seconds: float) -> float:
        self._cut_until_s = time.monotonic() + seconds
        return time.monotonic()

    def _run(self) -> None:
        parser = mavlink.MAVLink(None)
        parser.robust_parsing = True
        while not self._done.is_set():
            for one in select.select([self._down, self._up], [], [], 0.01)[0]:
                try:
                    data, address = one.recvfrom(65535)
                except OSError:
                    continue
                now_s = time.monotonic()
                if one is self._down:
                    self._px4 = address
                elif any(m.get_type() == "SET_POSITION_TARGET_LOCAL_NED" for m in parser.parse_buffer(data) or []):
                    self.setpoints_s.append(now_s)
                self._count += 1
                if now_s >= self._cut_until_s and self._count % 10 not in self._loss:
                    self._queue.append((now_s + self._delay_s, one is self._down, data))
            while self._queue and self._queue[0][0] <= time.monotonic():
                _, downwards, data = self._queue.pop(0)
                try:
                    if downwards:
                        self._up.sendto(data, self._app)
                    elif self._px4 is not None:
                        self._down.sendto(data, self._px4)
                except OSError:
                    continue
