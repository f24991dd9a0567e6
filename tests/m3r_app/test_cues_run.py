"""Cues are spoken aloud into the very microphone that listens: they ask for nothing, and *stop* is heard through them."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from m3r_app.record.recorder import read_record
from modalities.models.catalogue import ModelError, find_model
from modalities.voice.audio import quiet, read_audio
from modalities.voice.self_speech import TAIL_S
from tests.modalities.sound_server import MICROPHONE, PACKAGES, SoundServer, missing
from tests.whole import PATIENCE_S, PLAIN, App

RECORDINGS = Path(__file__).resolve().parents[1] / "recordings"
HELD = "Red: paired"
PROGRAM = f"""#!/bin/sh
text=$(cat)
echo "$text" | {{espeak}} "$@" || exit
echo "$text" >> {{folder}}/spoken
while [ "$text" = "{HELD}" ]; do sleep 0.05; done
"""
"""espeak-ng, of which one utterance goes on in silence until it is cut off."""


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
    def say(name: str, after_s: float = 0.3) -> None:
        server.play(np.concatenate([quiet(after_s), read_audio(RECORDINGS / name), quiet(0.6)]))

    def has_been_spoken(cue: str) -> None:
        file = tmp_path / "spoken"
        deadline_s = time.monotonic() + PATIENCE_S
        while not (file.exists() and cue in file.read_text().splitlines()):
            assert time.monotonic() < deadline_s, cue
            time.sleep(0.02)

    record = tmp_path / "flight.mcap"
    command = ["run", "--headless", "--speak", "--pair", "red", "--scenario", str(PLAIN), "--timeout", "60"]
    app = App([*command, "--audio", f"mic:{MICROPHONE}", "--record", str(record)])
    app.until("pair", status="confirmed")
    has_been_spoken(HELD)
    say("go_left/go-left_0.ogg")
    app.until("announce", text='"go left" was heard while a cue was spoken and does not count: say it again')
    say("stop/stop_0.ogg")
    app.until("request", command="stop")
    has_been_spoken("Red: holding")  # it has cut off what was being spoken
    say("go_up/go-up_0.ogg", TAIL_S + 0.6)  # what is said sooner belongs to the cue
    app.until("motion", status="started")
    app.process.terminate()
    ran = app.finish()
    assert [r["command"] for r in ran.of("request")] == ["stop", "go_up"]
    assert "cues are not spoken" not in ran.told
    heard = [data["words"] for topic, _, data in read_record(record) if topic == "heard"]
    assert "go left (heard while a cue was spoken)" in heard
