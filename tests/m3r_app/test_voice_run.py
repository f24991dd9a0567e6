"""A recorded operator flies the simulated drone through the whole app: real VOSK, real MAVSDK, real UDP."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import soundfile

from modalities.models.catalogue import ModelError, find_model
from modalities.voice.audio import SAMPLE_RATE_HZ, quiet, read_audio
from tests.whole import PLAIN, Ran, m3r

ROOT = Path(__file__).resolve().parents[2]
SPEECH = ROOT.parent / "shared/data/speech"
OWN = ROOT / "tests/recordings"


@pytest.fixture(autouse=True)
def _model() -> None:
    try:
        find_model()
    except ModelError as error:
        pytest.skip(f"no voice model: {error}")


def fly(recordings: list[tuple[float, Path]], folder: Path) -> Ran:
    """One recording of these clips, each after so much quiet, flown by red from pairing on."""
    parts = []
    for pause_s, clip in recordings:
        parts += [quiet(pause_s), read_audio(clip)]
    audio = folder / "operator.wav"
    soundfile.write(audio, np.concatenate([*parts, quiet(2.0)]), SAMPLE_RATE_HZ, subtype="PCM_16")
    return m3r("run", "--headless", "--pair", "red", "--audio", str(audio), "--scenario", str(PLAIN))


def check(ran: Ran, commands: list[str]) -> None:
    assert ran.status == 0, ran.told
    requests = ran.of("request")
    assert [r["command"] for r in requests] == commands
    assert {r["modality"] for r in requests} == {"voice"}
    assert all(0.0 <= r["latency_ms"] < 1500.0 for r in requests)
    assert ran.events[-1]["violations"] == 0


@pytest.mark.soak
def test_real_people_fly_the_drone(tmp_path: Path) -> None:
    """Three people: up, then left and stop in mid-move; somebody's other word asks for nothing."""
    if not SPEECH.is_dir():
        pytest.skip("../shared/data/speech (real people's recordings) is not here")
    first = {name: min((SPEECH / name).glob("*.wav")) for name in ("go_up", "go_left", "stop")}
    other = next(p for p in sorted((SPEECH / "none").glob("*.wav")) if p.name.startswith("unknown"))
    ran = fly(
        [(0.5, first["go_up"]), (4.0, other), (1.5, first["go_left"]), (0.8, first["stop"])],
        tmp_path,
    )
    check(ran, ["go_up", "go_left", "stop"])
    motions = [(m["request"], m["status"]) for m in ran.of("motion")]
    assert motions == [
        ("voice-1", "started"), ("voice-1", "completed"), ("voice-2", "started"), ("voice-2", "aborted"),
    ]  # fmt: skip


def test_the_projects_own_recordings_fly_the_drone(tmp_path: Path) -> None:
    """The same on any machine that has a voice model: synthetic voices, a chatter that asks for nothing."""
    clip = {name: min((OWN / name).iterdir()) for name in ("go_down", "stop", "none")}
    ran = fly([(0.5, clip["none"]), (1.5, clip["go_down"]), (0.8, clip["stop"])], tmp_path)
    check(ran, ["go_down", "stop"])
    assert ran.of("motion", request="voice-1", status="aborted")
