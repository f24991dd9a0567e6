"""A real broker with the shipped configuration, and apps in its air: what the tests of the shared airspace stand on."""

from __future__ import annotations

import asyncio
import contextlib
import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from m3r_app.airspace.credentials import load_credentials, parse_broker
from m3r_app.airspace.service import AirspaceService
from m3r_app.airspace.shared import SharedAirspace
from m3r_app.airspace.store import Store
from m3r_app.vehicle.telemetry import NEVER_HEARD
from safety.frames import LocalFrame
from safety.vocabulary import Geodetic, Ned, Neighbours

ROOT = Path(__file__).resolve().parent.parent
HERE = Geodetic(46.679, 7.863, 580.0)
FRAME = LocalFrame(HERE)
PATIENCE_S = 15.0
MOSQUITTO = shutil.which("mosquitto", path=f"{os.environ.get('PATH', '')}:/usr/sbin")
LACKING = "mosquitto is not installed (apt: mosquitto)"
NOBODY = Neighbours.none(-float("inf"))


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@dataclass
class Broker:
    """A running Mosquitto. alice flies red, green and blue, bob too; nobody flies yellow."""

    folder: Path
    port: int
    tls: bool = True
    process: subprocess.Popen[bytes] | None = None

    @property
    def url(self) -> str:
        return self.url_at(self.port)

    def url_at(self, port: int) -> str:
        return f"mqtts://localhost:{port}" if self.tls else f"mqtt://127.0.0.1:{port}"

    def credentials(self, user: str) -> Path:
        return self.folder / f"{user}.json"

    def start(self) -> None:
        self.process = subprocess.Popen(
            [str(MOSQUITTO), "-c", str(self.folder / "broker/mosquitto.conf")],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        deadline_s = time.monotonic() + PATIENCE_S
        while True:
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self.port), 1.0):
                return
            assert time.monotonic() < deadline_s and self.process.poll() is None, "mosquitto did not start"
            time.sleep(0.02)

    def stop(self, *, hard: bool = False) -> None:
        assert self.process is not None
        self.process.kill() if hard else self.process.terminate()
        self.process.wait()


@contextmanager
def broker(tmp_path: Path, *, tls: bool = True) -> Iterator[Broker]:
    """Made by the shipped script, run with the shipped configuration."""
    if MOSQUITTO is None:
        pytest.skip(LACKING)
    port, folder = free_port(), tmp_path / "air"
    command = [sys.executable, str(ROOT / "scripts/make_airspace.py"), str(folder), "--port", str(port)]
    command += ["--operator", "alice=red,green,blue", "--operator", "bob=red,green,blue", "--drone", "yellow"]
    subprocess.run(command if tls else [*command, "--no-tls"], check=True)
    one = Broker(folder, port, tls)
    one.start()
    try:
        yield one
    finally:
        one.stop(hard=True)


async def until(condition: Callable[[], bool], within_s: float = PATIENCE_S) -> float:
    """Wait for it; how long that took, s."""
    began_s = time.monotonic()
    while not condition():
        assert time.monotonic() - began_s < within_s, f"not within {within_s} s"
        await asyncio.sleep(0.01)
    return time.monotonic() - began_s


@dataclass
class App:
    """One app's part in the air, with a drone that hovers where it is put."""

    shared: SharedAirspace
    told: list[str] = field(default_factory=list)
    places: dict[str, Ned] = field(default_factory=dict)

    async def fly(self) -> None:
        while True:
            for drone, place in self.places.items():
                self.shared.publisher.tell(drone, FRAME.geodetic(place), Ned(0.0, 0.0, 0.0), 0.3, 0.01)
            await asyncio.sleep(0.02)

    def neighbours(self, own: str) -> Neighbours:
        return self.shared.neighbours(own, NOBODY, time.monotonic())

    def feed_age_s(self, own: str) -> float:
        return time.monotonic() - self.neighbours(own).feed_at_s

    def sees(self, own: str, who: str) -> bool:
        return who in self.neighbours(own).names

    async def claim(self, drone: str) -> str | None:
        """Why not, or None. An authority that a busy machine keeps from answering in time is asked again, as it says."""
        until_s = time.monotonic() + PATIENCE_S
        while True:
            reason = await self.shared.claim(drone, HERE)
            if reason is None or "did not answer" not in reason or time.monotonic() > until_s:
                return reason

    @property
    def link(self):
        return self.shared._channel.link


@asynccontextmanager
async def app(
    b: Broker,
    operator: str,
    *,
    port: int | None = None,
    ahead_s: float = 0.0,
    credentials: Path | None = None,
    **places: Ned,
) -> AsyncIterator[App]:
    """ahead_s: by how much its wall clock is wrong; places: its drones."""
    told: list[str] = []
    shared = SharedAirspace(
        parse_broker(b.url_at(port or b.port)),
        load_credentials(credentials or b.credentials(f"operator.{operator}"), "operator"),
        FRAME,
        told.append,
        wall_clock=lambda: time.time() + ahead_s,
    )
    one = App(shared, told, dict(places))
    shared.watch({drone: lambda: NEVER_HEARD for drone in places})
    flying = asyncio.create_task(one.fly())
    try:
        await shared.open()
        yield one
    finally:
        flying.cancel()
        await shared.close()


@asynccontextmanager
async def authority(b: Broker, memory: Path, *, port: int | None = None) -> AsyncIterator[asyncio.Task[None]]:
    """A running authority of the area, ready to grant."""
    ready = asyncio.Event()
    service = AirspaceService(
        parse_broker(b.url_at(port or b.port)),
        load_credentials(b.credentials("airspace.field"), "airspace"),
        Store(memory, "field"),
        lambda _: None,
    )
    task = asyncio.create_task(service.run(ready.set))
    waiting = asyncio.create_task(ready.wait())
    await asyncio.wait({task, waiting}, return_when=asyncio.FIRST_COMPLETED)
    waiting.cancel()
    try:
        yield task
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError, Exception):
            await task


class Proxy:
    """A network between an app and the broker that can be cut without anybody's connection being closed."""

    def __init__(self, port: int) -> None:
        self._to = port
        self._whole = asyncio.Event()
        self._whole.set()
        self._server: asyncio.Server | None = None
        self._tasks: set[asyncio.Task[None]] = set()
        self.port = 0

    async def __aenter__(self) -> Proxy:
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
        self.port = self._server.sockets[0].getsockname()[1]
        return self

    async def __aexit__(self, *_: object) -> None:
        assert self._server is not None
        self._server.close()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def cut(self) -> None:
        self._whole.clear()

    def heal(self) -> None:
        self._whole.set()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            there, back = await asyncio.open_connection("127.0.0.1", self._to)
        except OSError:
            writer.close()
            return
        for source, sink in ((reader, back), (there, writer)):
            task = asyncio.create_task(self._pass(source, sink))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _pass(self, source: asyncio.StreamReader, sink: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError):
            while data := await source.read(65536):
                await self._whole.wait()
                sink.write(data)
                await sink.drain()
        sink.close()
