"""Shared air: what it costs one app as the fleet grows, and how long a state takes to the neighbour's supervisor.

A real Mosquitto with the shipped configuration (TLS), on loopback. Rival: a bare aiomqtt echo on the same broker.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import os
import resource
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import aiomqtt
from rich.console import Console
from rich.table import Table

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from m3r_app.airspace.credentials import load_credentials, parse_broker, tls_context  # noqa: E402
from m3r_app.airspace.messages import Place, State, Velocity, write_body  # noqa: E402
from m3r_app.airspace.shared import SharedAirspace  # noqa: E402
from m3r_app.airspace.signatures import Signer  # noqa: E402
from m3r_app.airspace.topics import StateTopic, cell_of, cells_near  # noqa: E402
from safety.frames import LocalFrame  # noqa: E402
from safety.vocabulary import Geodetic, Ned, Neighbours  # noqa: E402

MOSQUITTO = shutil.which("mosquitto", path=f"{os.environ.get('PATH', '')}:/usr/sbin")
HERE = Geodetic(46.679, 7.863, 580.0)
FRAME = LocalFrame(HERE)
NOBODY = Neighbours.none(-math.inf)
FLEETS = (10, 100, 1000)
NEAR = 10
RATE_HZ = 5.0
SETTLE_S, MEASURE_S = 4.0, 12.0
SAMPLES_S = 15.0
BAR_CORE, BAR_GROWTH, BAR_MS = 0.10, 1.5, 50.0
STEP_M = 0.01


@contextlib.contextmanager
def broker() -> Iterator[tuple[str, Path]]:
    """Its address and the folder of credentials."""
    assert MOSQUITTO is not None
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made) / "air"
        drones = ",".join(f"d{i}" for i in range(max(FLEETS)))
        command = [sys.executable, str(ROOT / "scripts/make_airspace.py"), str(folder), "--port", str(port)]
        subprocess.run([*command, "--operator", f"load={drones}", "--operator", "alice=red"], check=True)
        process = subprocess.Popen([MOSQUITTO, "-c", str(folder / "broker/mosquitto.conf")], stderr=subprocess.DEVNULL)
        try:
            until_s = time.monotonic() + 10.0
            while time.monotonic() < until_s:
                with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1.0):
                    break
                time.sleep(0.05)
            yield f"mqtts://localhost:{port}", folder
        finally:
            process.terminate()
            process.wait()


# ---------------------------------------------------------------- the app that is measured, a process of its own


async def app(url: str, credentials: Path, measure_s: float) -> None:
    """Fly red among the others, as the shell does; tell what that took."""
    shared = SharedAirspace(parse_broker(url), load_credentials(credentials, "operator"), FRAME, print_error)
    seen: dict[str, float] = {}
    first_seen: list[tuple[str, int, float]] = []

    def look() -> Neighbours:
        found = shared.neighbours("red", NOBODY, time.monotonic())
        now_s = time.monotonic()
        for name, place in zip(found.names, found.positions_ned_m, strict=True):
            down_m = float(place[2])
            if seen.get(name) != down_m:
                seen[name] = down_m
                first_seen.append((name, round((-down_m - 10.0) / STEP_M), now_s))
        return found

    async def fly() -> None:
        while True:  # telemetry at 50 Hz
            shared.publisher.tell("red", HERE, Ned(0.0, 0.0, 0.0), 0.3, 0.01)
            await asyncio.sleep(0.02)

    async def news() -> None:
        while True:
            await shared.news()
            look()
            await asyncio.sleep(0.02)

    async def tick() -> None:
        while True:
            look()
            await asyncio.sleep(0.1)

    flying = asyncio.create_task(fly())
    await shared.open()
    tasks = [flying, asyncio.create_task(news()), asyncio.create_task(tick())]
    print(json.dumps({"ready": True}), flush=True)
    await asyncio.sleep(SETTLE_S)
    first_seen.clear()
    used_s, began_s = time.process_time(), time.monotonic()
    await asyncio.sleep(measure_s)
    core = (time.process_time() - used_s) / (time.monotonic() - began_s)
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    told = {"core": core, "peak_mb": peak_mb, "near": len(look()), "seen": first_seen, "seconds": measure_s}
    print(json.dumps(told), flush=True)
    for task in tasks:
        task.cancel()
    await shared.close()


def print_error(text: str) -> None:
    print(text, file=sys.stderr)


async def start_app(url: str, folder: Path, measure_s: float) -> asyncio.subprocess.Process:
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, __file__, "--app", url, str(folder / "operator.alice.json"), str(measure_s)),
        stdout=subprocess.PIPE,
        limit=2**24,
    )
    assert process.stdout is not None
    json.loads(await process.stdout.readline())
    return process


def client(url: str, folder: Path, user: str) -> aiomqtt.Client:
    secret, at = load_credentials(folder / f"{user}.json", "operator"), parse_broker(url)
    return aiomqtt.Client(
        at.host,
        at.port,
        username=secret.user,
        password=secret.password,
        protocol=aiomqtt.ProtocolVersion.V5,
        tls_context=tls_context(secret, at),
        socket_options=[(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)],
    )


# ---------------------------------------------------------------- the others


class Others:
    """A fleet in the air: the first NEAR near red, the rest in cells far from it. Near ones are signed for real."""

    def __init__(self, folder: Path, count: int) -> None:
        secret = load_credentials(folder / "operator.load.json", "operator")
        self.signers = [Signer(f"drone.d{i}", secret.key(f"drone.d{i}") or b"") for i in range(NEAR)]
        near = cells_near(HERE)
        self.far = []
        for i in range(count - NEAR):
            place = FRAME.geodetic(Ned(8000.0 + 400.0 * (i // 30), 400.0 * (i % 30), -10.0))
            assert cell_of(place) not in near
            self.far.append(str(StateTopic(cell_of(place), f"d{NEAR + i}")))
        self.noise = self.near(0, 0)[1]
        self.sent: dict[tuple[str, int], float] = {}
        self.count = 0

    def near(self, i: int, step: int) -> tuple[str, bytes]:
        """The topic and payload of near drone i, its height telling the step."""
        place = FRAME.geodetic(Ned(15.0 + 3.0 * i, 20.0, -10.0 - STEP_M * step))
        body = State(
            place=Place.of(place), velocity=Velocity(north_m_s=0.0, east_m_s=0.0, down_m_s=0.0), sigma_m=0.3, age_s=0.0
        )
        topic = str(StateTopic(cell_of(place), f"d{i}"))
        return topic, self.signers[i].seal(topic, write_body(body))

    async def fly(self, link: aiomqtt.Client, rate_hz: float) -> None:
        """Tell everybody's state rate_hz times a second, evenly, until cancelled."""
        everybody = NEAR + len(self.far)
        slices = 20
        step, due_s = 0, time.monotonic()
        while True:
            step = (step + 1) % 400
            for part in range(slices):
                for i in range(part, everybody, slices):
                    if i < NEAR:
                        self.sent[f"d{i}", step] = time.monotonic()
                        await link.publish(*self.near(i, step), qos=0)
                    else:
                        await link.publish(self.far[i - NEAR], self.noise, qos=0)
                    self.count += 1
                due_s += 1.0 / rate_hz / slices
                await asyncio.sleep(max(0.0, due_s - time.monotonic()))


async def cost(url: str, folder: Path, count: int) -> dict[str, float]:
    """What the app takes while `count` others fly."""
    others = Others(folder, count)
    async with client(url, folder, "operator.load") as link:
        flying = asyncio.create_task(others.fly(link, RATE_HZ))
        process = await start_app(url, folder, MEASURE_S)
        assert process.stdout is not None
        before, began_s = others.count, time.monotonic()
        told = json.loads(await process.stdout.readline())
        rate_hz = (others.count - before) / (time.monotonic() - began_s) / count
        await over(flying)
        await process.wait()
    expected = NEAR * RATE_HZ * MEASURE_S
    heard = len(told["seen"]) / expected
    return {"core": told["core"], "peak_mb": told["peak_mb"], "near": told["near"], "heard": heard, "rate_hz": rate_hz}


async def over(task: asyncio.Task[None]) -> None:
    """End it, however often its client swallows that."""
    while not task.done():
        task.cancel()
        await asyncio.wait({task}, timeout=0.1)


async def latency(url: str, folder: Path) -> list[float]:
    """From the moment that a state is known to when the neighbour's supervisor has it, ms."""
    others = Others(folder, NEAR)
    async with client(url, folder, "operator.load") as link:
        flying = asyncio.create_task(others.fly(link, 10.0))
        process = await start_app(url, folder, SAMPLES_S)
        assert process.stdout is not None
        told = json.loads(await process.stdout.readline())
        await over(flying)
        await process.wait()
    return [
        1000.0 * (at_s - others.sent[name, step]) for name, step, at_s in told["seen"] if (name, step) in others.sent
    ]


async def echo(url: str, folder: Path, size: int) -> list[float]:
    """A bare aiomqtt client that hears itself, ms."""
    found: list[float] = []
    async with client(url, folder, "operator.alice") as link:
        topic = str(StateTopic(cell_of(HERE), "red"))
        await link.subscribe(topic, qos=0)

        async def send() -> None:
            while True:
                await link.publish(topic, f"{time.monotonic()!r} ".ljust(size), qos=0)
                await asyncio.sleep(0.01)

        sending = asyncio.create_task(send())
        until_s = time.monotonic() + SAMPLES_S
        async for message in link.messages:
            payload = message.payload
            assert isinstance(payload, bytes)
            found.append(1000.0 * (time.monotonic() - float(payload.split()[0])))
            if time.monotonic() > until_s:
                break
        await over(sending)
    return found


def percentile(values: list[float], share: float) -> float:
    return sorted(values)[min(len(values) - 1, math.ceil(share * len(values)) - 1)]


async def main() -> None:
    console = Console()
    if MOSQUITTO is None:
        console.print("not measured: mosquitto is not installed (apt: mosquitto)")
        return
    with broker() as (url, folder):
        costs = {count: await cost(url, folder, count) for count in FLEETS}
        ours = await latency(url, folder)
        bare = await echo(url, folder, len(Others(folder, NEAR).noise))
    table = Table(title=f"one app in shared air: {NEAR} vehicles near, all at {RATE_HZ:g} Hz")
    for column in ("vehicles", "of a core", "peak memory, MB", "near ones seen", "of their states", "each told, Hz"):
        table.add_column(column, justify="right")
    for count, one in costs.items():
        table.add_row(
            str(count),
            f"{one['core']:.1%}",
            f"{one['peak_mb']:.0f}",
            f"{one['near']:.0f}",
            f"{one['heard']:.0%}",
            f"{one['rate_hz']:.1f}",
        )
    console.print(table)
    most, least = costs[max(FLEETS)], costs[min(FLEETS)]
    growth = most["core"] / least["core"]
    console.print(
        f"bars: at most {BAR_CORE:.0%} of a core at {max(FLEETS):,}: {met(most['core'] <= BAR_CORE)}; "
        f"at most {BAR_GROWTH} x of that at {min(FLEETS)}: {growth:.2f} x, {met(growth <= BAR_GROWTH)}"
    )
    table = Table(title="from a known state to the neighbour's supervisor, ms")
    for column in ("", "n", "p50", "p99", "p99 beside bare"):
        table.add_column(column, justify="right")
    bare99, ours99 = percentile(bare, 0.99), percentile(ours, 0.99)
    table.add_row("a bare aiomqtt echo", str(len(bare)), f"{percentile(bare, 0.5):.1f}", f"{bare99:.1f}", "1.0 x")
    table.add_row("ours", str(len(ours)), f"{percentile(ours, 0.5):.1f}", f"{ours99:.1f}", f"{ours99 / bare99:.1f} x")
    console.print(table)
    console.print(f"bar: p99 at most {BAR_MS:.0f} ms: {met(ours99 <= BAR_MS)}")


def met(yes: bool) -> str:
    return "met" if yes else "MISSED"


if __name__ == "__main__":
    if sys.argv[1:2] == ["--app"]:
        asyncio.run(app(sys.argv[2], Path(sys.argv[3]), float(sys.argv[4])))
    else:
        asyncio.run(main())
