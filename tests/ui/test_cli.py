"""The command line: options as they are meant, errors in one sentence, no traceback, strict JSON."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from m3r_app.arbiter.modes import mermaid
from m3r_app.options import RunOptions
from m3r_app.record.recorder import RecordError
from safety.vocabulary import Geodetic, Mode
from ui import cli


def m3r(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "ui.cli", *arguments],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
        env={**os.environ, **environment},
    )


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The options that `m3r run WORDS` hands to the app."""

    def ask(*words: str) -> RunOptions:
        taken: list[RunOptions] = []

        async def run(options: RunOptions, *_: object) -> int:
            taken.append(options)
            return 0

        app = ModuleType("m3r_app.run")
        app.run = run
        monkeypatch.setitem(sys.modules, "m3r_app.run", app)
        assert cli.main(["run", *words]) == 0
        return taken[0]

    return ask


def refusal(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    try:
        status = cli.main(words)
    except SystemExit as ended:
        status = ended.code
    assert status == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("m3r: ")
    assert err.count("\n") == 1
    return err


def test_without_options(asked: Any) -> None:
    assert asked() == RunOptions()


def test_every_option(asked: Any) -> None:
    words = (
        "--headless --audio a.wav --video none --script - --pair RED --vehicle red=udpin://0.0.0.0:14540 "
        "blue=serial:///dev/ttyACM0:57600 --vehicle green=udpin://0.0.0.0:14541 --scenario s.toml --config a.toml "
        "--config b.toml --set a=1 b=2 --set c=3 --operator -33.5,-98.25,-2 --takeoff 5 --apply-failsafe "
        "--record r.mcap --timeout 60"
    )
    assert asked(*words.split()) == RunOptions(
        headless=True,
        audio=Path("a.wav"),
        script=Path("-"),
        pair="red",
        vehicles={
            "red": "udpin://0.0.0.0:14540",
            "blue": "serial:///dev/ttyACM0:57600",
            "green": "udpin://0.0.0.0:14541",
        },
        scenario=Path("s.toml"),
        config=(Path("a.toml"), Path("b.toml")),
        overrides=("a=1", "b=2", "c=3"),
        operator=Geodetic(-33.5, -98.25, -2.0),
        takeoff_m=5.0,
        apply_failsafe=True,
        record=Path("r.mcap"),
        timeout_s=60.0,
    )


@pytest.mark.parametrize(("words", "spoken"), [("--quiet", False), ("--speak", True)])
def test_cues(asked: Any, words: str, spoken: bool) -> None:
    assert asked(words) == RunOptions(spoken=spoken)


def test_no_audio(asked: Any) -> None:
    assert asked("--audio", "none").audio is None


@pytest.mark.parametrize("place", ["90,180,9000", "-90,-180,-500", "0,0,0"])
def test_places_at_the_bounds(asked: Any, place: str) -> None:
    assert asked("--operator", place).operator == Geodetic(*map(float, place.split(",")))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("rnu", "no m3r rnu; did you mean run?"),
        ("run --hedless", "no option --hedless; did you mean --headless?"),
        ("run --head", "no option --head; did you mean --headless?"),
        ("run --qqqqqq", "no option --qqqqqq; m3r run --help lists"),
        ("run now", "no argument now"),
        ("--frobnicate", "no option --frobnicate"),
        ("run --record", "--record: expected one argument"),
        ("run --set", "--set: expected at least one argument"),
        ("run --operator 47,8", "--operator: '47,8' is not LAT,LON,AMSL"),
        ("run --operator 47,8,x", "--operator: '47,8,x' is not LAT,LON,AMSL"),
        ("run --operator 47,8,1,2", "is not LAT,LON,AMSL"),
        ("run --operator 90.1,8,1", "latitude 90.1 degrees is not between -90 and 90"),
        ("run --operator 47,-180.1,1", "longitude -180.1 degrees is not between -180 and 180"),
        ("run --operator 47,8,9000.1", "altitude above sea level 9000.1 m is not between -500 and 9000"),
        ("run --operator nan,8,1", "latitude nan"),
        ("run --takeoff 0.9", "take-off height 0.9 m is not between 1 and 120"),
        ("run --takeoff 120.1", "take-off height 120.1 m"),
        ("run --takeoff -5", "take-off height -5 m"),
        ("run --takeoff high", "'high' is not a number"),
        ("run --timeout 0", "timeout 0 s is not between"),
        ("run --timeout nan", "timeout nan s"),
        ("run --timeout inf", "timeout inf s"),
        ("run --pair red1", "'red1' is not a colour that can be said"),
        ("run --vehicle udpin://0.0.0.0:1", "is not COLOUR=MAVLINK-URL"),
        ("run --vehicle red=14540", "is not COLOUR=MAVLINK-URL"),
        ("run --vehicle =udpin://0.0.0.0:1", "is not a colour"),
        ("run --vehicle red=udpin://0.0.0.0:1 red=udpin://0.0.0.0:2", "names red twice"),
        ("run --vehicle red=udpin://0.0.0.0:1 blue=udpin://0.0.0.0:1", "to two drones"),
        ("run --video camera:x", "camera:x is not a camera"),
        ("run --audio mic:", "lacks the microphone's name"),
        ("check --audio x.wav", "check listens to a microphone"),
        ("check --vehicle red", "is not COLOUR=MAVLINK-URL"),
        ("models", "required"),
        ("models get", "no m3r models get"),
        ("models list hand", "no m3r models hand; did you mean hands?"),
        ("evaluate feet x", "no m3r evaluate feet"),
    ],
)
def test_a_wrong_option_is_one_sentence(capsys: pytest.CaptureFixture[str], words: str, said: str) -> None:
    assert said in refusal(capsys, *words.split())


def test_an_empty_file_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert "--script: an empty file name" in refusal(capsys, "run", "--script", "")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--set", "envelope.sped_m_s=1"], "did you mean envelope.speed_m_s?"),
        (["--config", "none.toml"], "settings file none.toml cannot be read"),
        (["--scenario", "none.toml"], "none.toml"),
    ],
)
def test_what_the_floors_refuse_ends_the_run_in_one_sentence(words: list[str], said: str) -> None:
    done = m3r("run", "--headless", *words)
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].startswith("m3r: ")
    assert said in done.stderr
    assert "Traceback" not in done.stderr
    objects = [json.loads(text) for text in done.stdout.splitlines()]
    assert [item["event"] for item in objects] in ([], ["end"])


@pytest.mark.parametrize(
    ("error", "status", "said"),
    [
        (RecordError("flight record x cannot\nbe written"), 2, "m3r: flight record x cannot be written\n"),
        (KeyError("left"), 1, "m3r: unexpected KeyError: 'left' (a fault in m3r; M3R_DEBUG=1 shows where)\n"),
        (ValueError("not ours"), 1, "m3r: unexpected ValueError: not ours (a fault in m3r; M3R_DEBUG=1 shows where)\n"),
        (KeyboardInterrupt(), 130, ""),
    ],
)
def test_whatever_is_raised_is_one_sentence(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    error: BaseException,
    status: int,
    said: str,
) -> None:
    def fail() -> str:
        raise error

    monkeypatch.setattr("m3r_app.arbiter.modes.mermaid", fail)
    assert cli.main(["modes"]) == status
    assert capsys.readouterr().err == said


def test_no_vehicle_is_status_3(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    from m3r_app.vehicle.interface import VehicleError

    def fail() -> str:
        raise VehicleError("red does not answer")

    monkeypatch.setattr("m3r_app.arbiter.modes.mermaid", fail)
    assert cli.main(["modes"]) == 3
    assert capsys.readouterr().err == "m3r: red does not answer\n"


def test_debug_shows_the_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> str:
        raise KeyError("left")

    monkeypatch.setattr("m3r_app.arbiter.modes.mermaid", fail)
    monkeypatch.setenv("M3R_DEBUG", "1")
    with pytest.raises(KeyError):
        cli.main(["modes"])


THREAD_FAULT = """
import logging, threading
from ui.cli import _no_tracebacks
_no_tracebacks()
thread = threading.Thread(target=lambda: 1 / 0)
thread.start()
thread.join()
class Broken:
    def __del__(self): raise KeyError("x")
Broken()
try:
    1 / 0
except ZeroDivisionError:
    logging.getLogger("asyncio").exception("Task exception was never retrieved")
"""


def test_faults_in_threads_and_logs_are_lines() -> None:
    done = subprocess.run([sys.executable, "-c", THREAD_FAULT], capture_output=True, text=True, check=True, timeout=60)
    assert done.stderr.splitlines() == [
        "m3r: unexpected ZeroDivisionError: division by zero (a fault in m3r; M3R_DEBUG=1 shows where)",
        "m3r: unexpected KeyError: 'x' (a fault in m3r; M3R_DEBUG=1 shows where)",
        "m3r: Task exception was never retrieved (ZeroDivisionError: division by zero)",
    ]


def test_version_and_modes() -> None:
    assert m3r("--version").stdout.startswith("m3r ")
    printed = m3r("modes")
    assert printed.stdout == mermaid() + "\n"
    assert printed.returncode == 0
    assert printed.stderr == ""
    assert all(mode.value in printed.stdout for mode in Mode)


def test_a_reader_that_has_seen_enough() -> None:
    with subprocess.Popen(
        [sys.executable, "-m", "ui.cli", "modes"], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as done:
        assert done.stdout is not None
        assert done.stderr is not None
        done.stdout.close()
        assert done.stderr.read() == b""


def test_options_are_understood_without_the_heavy_imports() -> None:
    code = "import sys, ui.cli; print([m for m in ('mavsdk', 'vosk', 'rasterio', 'shapely') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout == "[]\n"
