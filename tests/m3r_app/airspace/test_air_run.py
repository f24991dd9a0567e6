"""The whole app in shared air: real processes, real UDP, real Mosquitto, judged on the true state. P1, X3, X8, X10, R5, R11."""

from __future__ import annotations

import asyncio
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from safety.vocabulary import Ned, ReservedVolume
from tests.air import PATIENCE_S, ROOT, Broker, app, broker, until
from tests.air import App as AirApp
from tests.ui.test_console_run import Terminal
from tests.warm import Program
from tests.whole import HILLSIDE, PLAIN, App, Simulated, m3r, simulated

pytestmark = pytest.mark.xdist_group("air")


@pytest.fixture
def air(tmp_path: Path) -> Iterator[Broker]:
    with broker(tmp_path) as one:
        yield one


@contextmanager
def service(*words: str, ready: str) -> Iterator[Program]:
    """A running `m3r airspace` or `m3r beacon`, from when it says that it is ready."""
    process = Program("ui.entry", words, stderr=subprocess.PIPE)
    assert process.stderr is not None
    try:
        for line in process.stderr:
            if ready in line.decode():
                break
        else:
            raise AssertionError(f"{words[0]} ended with {process.wait()}")
        yield process
    finally:
        process.terminate()
        process.stderr.close()
        process.wait(10)


def authority(air: Broker, tmp_path: Path) -> object:
    words = ("airspace", "--broker", air.url, "--credentials", str(air.credentials("airspace.field")))
    return service(*words, "--memory", str(tmp_path / "memory"), ready="is looked after")


def flight(air: Broker, fleet: Simulated, operator: str, drone: str, script: Path) -> list[str]:
    return [
        *("run", "--headless", "--scenario", str(PLAIN), "--vehicle", f"{drone}={fleet.urls[drone]}", "--pair", drone),
        *("--script", str(script), "--broker", air.url, "--credentials", str(air.credentials(f"operator.{operator}"))),
    ]


def written(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


@pytest.mark.requirement("R5", "P1", "X3")
def test_two_operators_fly_side_by_side_and_no_drone_has_two(air: Broker, tmp_path: Path) -> None:
    """Each app knows the other's drone over the broker alone; the second one who wants red is told who holds it."""
    left = written(tmp_path / "left", "0.5 panel go left\n")
    long = written(tmp_path / "long", "0.5 panel go up\n16 panel go down\n")
    with authority(air, tmp_path), simulated(PLAIN, tmp_path) as fleet:
        alice = App(flight(air, fleet, "alice", "red", long))
        try:
            alice.until("pair", status="confirmed")
            second = [w.replace(fleet.urls["red"], fleet.urls["green"]) for w in flight(air, fleet, "bob", "red", left)]
            refused = m3r(*second)
            assert refused.status == 3
            assert refused.of("pair", status="refused")[0]["reasons"] == ["alice holds it"]
            bob = m3r(*flight(air, fleet, "bob", "blue", left), "--apply-failsafe")
            assert bob.status == 0 and bob.verdicts() == {"script-1": "approved"}
            separation = [f for f in bob.of("decision")[0]["findings"] if f["constraint"] == "separation"]
            assert separation[0]["text"].startswith("red: ")
            assert bob.of("motion", status="completed")[0]["min_separation_m"] is not None
        finally:
            ran = alice.finish()
        assert ran.status == 0
        assert "Red: bob asks for it; disconnect to hand it over" in [e["text"] for e in ran.of("announce")]


@pytest.mark.requirement("R10", "R11", "X4")
def test_the_broker_dies_in_flight(air: Broker, tmp_path: Path) -> None:
    """It is said within 2 s, what flies is aborted, moves are refused, STOP is not, and the claim ends honestly, in Hold."""
    script = written(tmp_path / "script", "0.5 panel go left\n3.5 panel go up\n4 panel stop\n9 panel go up\n")
    with authority(air, tmp_path), simulated(PLAIN, tmp_path) as fleet:
        slowly = [
            "--set",
            "envelope.speed_m_s=0.25",
        ]  # so that it still flies when the news have come, on a busy machine too
        alice = App([*flight(air, fleet, "alice", "red", script), *slowly])
        alice.until("motion", status="started")
        air.stop(hard=True)
        died_s = alice.events[-1]["t"]
        ran = alice.finish()
        said = next(e for e in ran.of("announce") if air.url in e["text"] and e["t"] > died_s)
        assert said["t"] - died_s < 2.0
        (aborted,) = ran.of("motion", request="script-1", status="aborted")
        assert aborted["t"] - died_s < 2.0
        verdicts = ran.verdicts()
        assert verdicts["script-2"] == "rejected"
        failing = {f["constraint"] for f in ran.of("decision", request="script-2")[0]["findings"] if not f["passed"]}
        assert failing & {"neighbour_age", "reservation"}
        (released,) = ran.of("pair", status="released")
        assert "its claim could not be renewed for 4 s" in released["reasons"][0]
        assert verdicts["script-4"] == "rejected", "not ours any more"
        assert fleet.wait("red", mode="LOITER")
        assert ran.status == 0 and ran.of("end")[0]["violations"] == 0


@pytest.mark.requirement("R5", "X10")
async def test_a_volume_that_another_laptop_holds_delays_or_shortens(air: Broker, tmp_path: Path) -> None:
    """Bob's volume stands 3 m left of red: at first for a moment, which is waited for, then for long. Source: R5, X10."""
    script = written(tmp_path / "script", "2 panel go left\n13 panel go left\n")

    def beside_red(lasts_s: float) -> ReservedVolume:
        now_s = time.monotonic()
        return ReservedVolume("blue", Ned(14.0, -4.6, -6.2), Ned(14.0, -4.5, -6.2), 2.0, now_s, now_s + lasts_s)

    def read(alice: App, status: str) -> None:
        alice.until("pair", status=status)

    with authority(air, tmp_path), simulated(HILLSIDE, tmp_path) as fleet:
        words = [w.replace(str(PLAIN), str(HILLSIDE)) for w in flight(air, fleet, "alice", "red", script)]
        alice = App(words)
        async with app(air, "bob", blue=Ned(-20.0, -20.0, -10.0)) as bob:
            await until(lambda: bob.shared.trouble is None)
            assert await bob.claim("blue") is None
            await asyncio.to_thread(read, alice, "confirmed")
            assert (await reserved(bob, "short", beside_red(3.5)))[0] == "granted"
            await asyncio.to_thread(alice.until, "motion", request="script-1", status="completed")
            # Alice gives back what she flew through a moment after it is flown.
            async with asyncio.timeout(PATIENCE_S):
                while (await reserved(bob, "long", beside_red(20.0)))[0] != "granted":
                    pass
            ran = await asyncio.to_thread(alice.finish)
    assert [d["verdict"] for d in ran.of("decision", request="script-1")] == ["delayed", "approved"]
    (second,) = ran.of("decision", request="script-2")
    failing = [f["text"] for f in second["findings"] if f["constraint"] == "reservation" and not f["passed"]]
    assert second["verdict"] in ("reduced", "rejected") and "volume that blue holds" in failing[0]
    assert second["granted_m"] is None or second["granted_m"] < 1.0


async def reserved(one: AirApp, lease: str, volume: ReservedVolume) -> tuple[str, str]:
    answered: asyncio.Future[tuple[str, str]] = asyncio.get_running_loop().create_future()
    one.shared.reserve(volume.holder, lease, volume, lambda *answer: answered.set_result(answer))
    return await asyncio.wait_for(answered, 2.0)


@pytest.mark.soak
def test_fifty_broker_restarts_in_flight(air: Broker, tmp_path: Path) -> None:
    """Moves are flown, aborted or blocked as it happens; the session and the drone stay in the same hands throughout."""
    moves = "".join(f"{1 + 4 * n} panel go {'up' if n % 2 else 'down'}\n" for n in range(32))
    with authority(air, tmp_path), simulated(PLAIN, tmp_path) as fleet:
        alice = App(flight(air, fleet, "alice", "red", written(tmp_path / "script", moves)))
        alice.until("pair", status="confirmed")
        for n in range(50):
            time.sleep(1.5 if n % 5 else 6.0)  # that long the air is whole
            air.stop(hard=n % 2 == 0)
            air.start()
        ran = alice.finish()
    assert ran.status == 0 and ran.of("end")[0]["violations"] == 0
    (released,) = ran.of("pair", status="released")
    assert "the run is over" in released["reasons"][0]
    assert len(ran.verdicts()) == 32
    assert ran.of("end")[0]["completed"] >= 3


@pytest.mark.soak
def test_a_beacon_tells_of_a_drone_that_nobody_flies(air: Broker, tmp_path: Path) -> None:
    script = written(tmp_path / "script", "0.5 panel go left\n")
    with authority(air, tmp_path), simulated(PLAIN, tmp_path) as fleet:
        words = ("beacon", "--vehicle", f"yellow={fleet.urls['blue']}", "--broker", air.url)
        with service(*words, "--credentials", str(air.credentials("drone.yellow")), ready="telling where yellow is"):
            ran = m3r(*flight(air, fleet, "alice", "red", script))
        assert ran.verdicts() == {"script-1": "approved"}
        (found,) = [f for f in ran.of("decision")[0]["findings"] if f["constraint"] == "separation"]
        assert found["text"].startswith("yellow: ")


@pytest.mark.parametrize(
    ("how", "status"), [(signal.SIGINT, 130), pytest.param(signal.SIGTERM, 0, marks=pytest.mark.soak)]
)
def test_services_end_as_they_are_told(air: Broker, tmp_path: Path, how: signal.Signals, status: int) -> None:
    with authority(air, tmp_path) as process:
        process.send_signal(how)
        assert process.wait(10) == status


@pytest.mark.parametrize(("words", "told"), [
    (["--broker", "mqtts://localhost"], "--broker is given without --credentials FILE"),
    (["--credentials", "nowhere.json"], "--credentials is given without --broker"),
    (["--broker", "mqtts://localhost", "--credentials", "nowhere.json"], "credentials nowhere.json cannot be read"),
    (["--broker", "http://localhost", "--credentials", "nowhere.json"], "is no broker's address"),
    (["--broker", "mqtt://example.org", "--credentials", "nowhere.json"], "would send the password unprotected"),
    (["--broker", "mqtts://a:b@localhost", "--credentials", "nowhere.json"], "can be seen by everybody"),
])  # fmt: skip
def test_bad_options_are_one_sentence(words: list[str], told: str) -> None:
    ran = m3r("run", "--headless", *words)
    assert ran.status == 2
    assert told in ran.told and "Traceback" not in ran.told
    assert sum(line.startswith("m3r: ") for line in ran.told.splitlines()) == 1


async def test_the_simulated_fleet_tells_of_itself(air: Broker, tmp_path: Path) -> None:
    words = ["--broker", air.url, "--credentials", str(air.credentials("operator.alice"))]
    with authority(air, tmp_path), simulated(HILLSIDE, tmp_path, *words):
        async with app(air, "bob", white=Ned(0.0, 0.0, -10.0)) as bob:
            await until(lambda: all(bob.sees("white", name) for name in ("red", "green", "blue")))
            assert bob.neighbours("white").sigmas_m == pytest.approx(0.3, abs=1.0)


def test_check_tells_whether_the_air_can_be_shared(air: Broker, tmp_path: Path) -> None:
    words = ("check", "--broker", air.url, "--credentials")
    alice = str(air.credentials("operator.alice"))
    with authority(air, tmp_path):
        told = said(*words, alice)
    assert "lets operator.alice in" in told and "the airspace authority of field is heard" in told
    told = said(*words, alice)
    assert "is not heard" in told and "start m3r airspace" in told
    air.stop()
    assert "nobody answers at" in said(*words, alice)
    air.start()


def said(*words: str) -> str:
    command = [
        sys.executable,
        "-c",
        "from ui.check.air import air; from ui.check.command import *; import ui.check.command as c; ",
    ]
    command[-1] += "c.PARTS = (('broker', air),); import sys; from ui.cli import main; sys.exit(main(sys.argv[1:]))"
    done = subprocess.run([*command, *words], cwd=ROOT, capture_output=True, text=True, check=True)
    return " ".join(done.stdout.split())


@pytest.mark.requirement("R11", "X4")
@pytest.mark.soak
def test_the_console_says_within_two_seconds_that_the_broker_is_gone(air: Broker, tmp_path: Path) -> None:
    """And STOP is taken all the same; when the broker is back, so is the air."""
    with authority(air, tmp_path), simulated(HILLSIDE, tmp_path) as fleet:
        words = ["--scenario", str(HILLSIDE), "--vehicle", f"red={fleet.urls['red']}", "--broker", air.url]
        terminal = Terminal("console", *words, "--credentials", str(air.credentials("operator.alice")), size=(120, 40))
        terminal.until(lambda: "no drone paired" in terminal.words, "a picture")
        terminal.type("1")
        terminal.until(lambda: "ManeuverRequestArmed" in terminal.words, "paired")
        terminal.shown = ""
        air.stop(hard=True)
        died_s = time.monotonic()
        terminal.until(lambda: "no broker" in terminal.words, "no broker")
        assert time.monotonic() - died_s < 2.0
        terminal.type(" ")
        terminal.until(lambda: "Red: holding" in terminal.words, "STOP")
        air.start()
        terminal.until(lambda: f"connected to {air.url} again" in terminal.words, "connected again")
        terminal.type("\x03")
        assert terminal.wait() == 130
        fleet.wait("red", mode="LOITER")
