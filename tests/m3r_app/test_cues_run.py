"""Cues are spoken aloud into the very microphone that listens: they ask for nothing, and *stop* is heard through them."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from m3r_app.recorder import read_record
from modalities.audio import quiet, read_audio
from modalities.models import ModelError, find_model
from modalities.own_voice import TAIL_S
from tests.modalities.sound_server import MICROPHONE, PACKAGES, SoundServer, missing
from tests.whole import PATIENCE_S, PLAIN, App

RECORDINGS = Path(__file__).resolve().parents[1] / "recordings"
PROGRAM = """#!/bin/sh
{espeak} "$@" || exit
touch {folder}/spoken
while [ -e {folder}/hold ]; do sleep 0.02; done
"""
"""espeak-ng, whose utterances last until they may end."""


def until(condition: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline_s
        time.sleep(0.02)


@pytest.fixture
def server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[SoundServer]:
    espeak = shutil.which("espeak-ng")
    lacking = ", ".join(one for one in (missing(), "" if espeak else "espeak-ng") if one)
    if lacking:
        pytest.skip(f"no virtual microphone and voice without {lacking} (apt: {PACKAGES} espeak-ng)")
    try:
        find_model()
    except ModelError as error:
        pytest.skip(f"no voice model: {error}")
    programs = tmp_path / "bin"
    programs.mkdir()
    program = programs / "espeak-ng"
    program.write_text(PROGRAM.format(espeak=espeak, folder=tmp_path))
    program.chmod(0o755)
    server = SoundServer(tmp_path)
    for name, value in {**server.environment, "PATH": f"{programs}:{os.environ['PATH']}"}.items():
        monkeypatch.setenv(name, value)
    server.start()
    yield server
    server.stop()


def test_while_a_cue_is_spoken_only_stop_is_heard(server: SoundServer, tmp_path: Path) -> None:
    def say(name: str, after_s: float = 0.4) -> None:
        server.play(np.concatenate([quiet(after_s), read_audio(RECORDINGS / name), quiet(0.6)]))

    hold, spoken, record = tmp_path / "hold", tmp_path / "spoken", tmp_path / "flight.mcap"
    command = ["run", "--headless", "--speak", "--pair", "red", "--scenario", str(PLAIN), "--timeout", "60"]
    app = App([*command, "--audio", f"mic:{MICROPHONE}", "--record", str(record)])
    app.until("pair", status="requested")
    hold.touch()
    app.until("pair", status="confirmed")  # "Red: paired" is being spoken, for as long as it is held
    say("go_left/go-left_0.ogg")
    app.until("announce", text='"go left" was heard while a cue was spoken and does not count: say it again')
    spoken.unlink()
    say("stop/stop_0.ogg")
    app.until("request", command="stop")
    until(spoken.exists)  # "Red: holding", which cut off what was being spoken
    hold.unlink()
    spoken.unlink()
    say("go_up/go-up_0.ogg", after_s=TAIL_S + 0.6)  # what is said sooner belongs to the cue
    app.until("motion", status="started")
    until(spoken.exists)  # "Red: up, fifty centimetres"
    app.process.terminate()
    ran = app.finish()
    assert [r["command"] for r in ran.of("request")] == ["stop", "go_up"]
    assert "cues are not spoken" not in ran.told
    heard = [data["words"] for topic, _, data in read_record(record) if topic == "heard"]
    assert "go left (heard while a cue was spoken)" in heard
