"""A live microphone flies the simulated drone through the whole app, and is unplugged in mid-flight."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from config.settings import load_settings
from m3r_app.inputs import open_inputs
from m3r_app.options import LiveMicrophone, RunOptions
from modalities.models.catalogue import ModelError, find_model
from modalities.voice.audio import quiet, read_audio
from modalities.voice.devices import look_again
from tests.modalities.sound_server import MICROPHONE, PACKAGES, SoundServer, missing
from tests.whole import PLAIN, App

RECORDINGS = Path(__file__).resolve().parents[1] / "recordings"
RUN = ("run", "--headless", "--pair", "red", "--scenario", str(PLAIN), "--timeout", "60")


@pytest.fixture
def server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[SoundServer]:
    if missing():
        pytest.skip(f"no virtual microphone without {missing()} (apt: {PACKAGES})")
    try:
        find_model()
    except ModelError as error:
        pytest.skip(f"no voice model: {error}")
    server = SoundServer(tmp_path)
    for name, value in server.environment.items():
        monkeypatch.setenv(name, value)
    server.start()
    yield server
    server.stop()


@pytest.mark.soak
def test_a_microphone_unplugged_in_mid_flight(server: SoundServer) -> None:
    def say(name: str) -> None:
        server.play(np.concatenate([quiet(0.5), read_audio(RECORDINGS / name), quiet(1.0)]))

    app = App([*RUN, "--audio", f"mic:{MICROPHONE}"])
    app.until("pair", status="confirmed")
    say("go_left/go-left_0.ogg")
    app.until("motion", status="started")
    server.unplug()
    app.until(
        "announce",
        text=f"the microphone {MICROPHONE} is gone: you are not heard until it is back, so use another way to say stop",
    )
    app.until("motion", status="completed")  # what was asked for goes on
    server.plug()
    app.until("announce", text=f"the microphone {MICROPHONE} is back: you are heard again")
    say("go_up/go-up_0.ogg")
    app.until("motion", status="started")
    say("stop/stop_0.ogg")
    app.until("motion", status="aborted")
    app.process.terminate()
    ran = app.finish()
    assert [(r["command"], r["modality"]) for r in ran.of("request")] == [
        ("go_left", "voice"), ("go_up", "voice"), ("stop", "voice"),
    ]  # fmt: skip
    assert all(0.0 <= r["latency_ms"] < 1500.0 for r in ran.of("request"))
    assert ran.events[-1]["violations"] == 0


@pytest.mark.soak
def test_push_to_talk_in_a_terminal(server: SoundServer) -> None:
    """Only what is said between one Enter and the next is asked for."""

    def say(name: str) -> None:
        server.play(np.concatenate([quiet(0.5), read_audio(RECORDINGS / name), quiet(1.0)])).wait(20.0)

    keyboard, terminal = os.openpty()
    app = App([*RUN, "--audio", f"mic:{MICROPHONE}", "--set", "voice.push_to_talk=true"], terminal=terminal)
    app.until("pair", status="confirmed")
    say("go_up/go-up_0.ogg")
    os.write(keyboard, b"\n")
    app.until("announce", text="the microphone is open: press Enter when you have spoken")
    say("go_left/go-left_0.ogg")
    app.until("motion", status="started")
    os.write(keyboard, b"\n")
    app.until("announce", text="the microphone is closed, a spoken stop too is not heard: press Enter to speak")
    say("go_up/go-up_0.ogg")
    app.process.terminate()
    ran = app.finish()
    os.close(keyboard)
    os.close(terminal)
    assert [r["command"] for r in ran.of("request")] == ["go_left"]


def test_push_to_talk_without_a_key_stays_closed_and_says_so(server: SoundServer) -> None:
    look_again()
    settings = load_settings([], ["voice.push_to_talk=true"])
    options = RunOptions(audio=LiveMicrophone(MICROPHONE))
    inputs = open_inputs(options, ("red",), settings, time.monotonic, lambda _sentence: None)
    try:
        assert inputs.sentences[-1] == (
            "push-to-talk has no key, since standard input is no terminal: the microphone stays closed"
        )
        assert inputs.voice is not None
        microphone = inputs.voice._microphone
        assert microphone is not None and microphone._talking is not None
        assert not microphone._talking()
    finally:
        inputs.close()
