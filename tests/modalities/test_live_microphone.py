"""The real microphone path: PortAudio opens a virtual device, and speech played into it is recognised, through every mishap."""

from __future__ import annotations

import itertools
import os
import random
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
import vosk

from modalities.voice.audio import Chunk, Gap, Samples, quiet, read_audio
from modalities.voice.decoder import Recognizer
from modalities.voice.devices import MicrophoneError, choose_device, input_devices, look_again
from modalities.voice.microphone import Microphone
from modalities.voice.phrases import PhraseTable
from modalities.voice.stream import VoiceStream
from safety.vocabulary import Command, ManeuverRequest
from tests.modalities.sound_server import MICROPHONE, PACKAGES, SoundServer, missing

RECORDINGS = Path(__file__).resolve().parents[1] / "recordings"
TABLE = PhraseTable(("red", "green", "blue"))
DEADLINE_S = 20.0
SOAK = os.environ.get("M3R_SOAK") == "1"

pytestmark = pytest.mark.skipif(bool(missing()), reason=f"no virtual microphone without {missing()} (apt: {PACKAGES})")


def until(condition: Callable[[], object], what: str) -> None:
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline, what
        time.sleep(0.01)


@pytest.fixture
def server_of(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., SoundServer]]:
    servers: list[SoundServer] = []

    def make(**shape: int) -> SoundServer:
        server = SoundServer(tmp_path, **shape)
        for name, value in server.environment.items():
            monkeypatch.setenv(name, value)
        server.start()
        servers.append(server)
        look_again()
        return server

    yield make
    for server in servers:
        server.stop()


@dataclass
class Ears:
    """A microphone, the recogniser behind it, and all that came of them."""

    microphone: Microphone
    stream: VoiceStream
    requests: list[ManeuverRequest] = field(default_factory=list)
    said: list[str] = field(default_factory=list)
    partials: list[str] = field(default_factory=list)
    passed: list[Chunk | Gap] = field(default_factory=list)
    ended: list[Exception | None] = field(default_factory=list)

    @property
    def commands(self) -> list[Command]:
        return [request.command for request in self.requests]

    def heard(self, least_s: float) -> None:
        """Wait until sound has come for this long since now."""
        count = len(self.passed) + round(least_s / 0.05)
        until(lambda: len(self.passed) >= count, "no sound comes from the microphone")

    def close(self) -> None:
        self.microphone.close()
        assert self.stream.stop(5.0)
        assert self.ended == [None]


def listen(model: vosk.Model, name: str | None = MICROPHONE, **options: object) -> Ears:
    said: list[str] = []
    microphone = Microphone(name, clock=time.monotonic, say=lambda text, _change=None: said.append(text), **options)
    microphone.open()
    passed: list[Chunk | Gap] = []

    def noted() -> Iterator[Chunk | Gap]:
        for one in microphone.chunks():
            passed.append(one)
            yield one

    requests: list[ManeuverRequest] = []
    partials: list[str] = []
    ended: list[Exception | None] = []
    stream = VoiceStream(
        noted(),
        Recognizer(model, TABLE),
        clock=time.monotonic,
        began_s=0.0,
        on_request=requests.append,
        on_partial=partials.append,
        on_end=ended.append,
    )
    stream.start()
    ears = Ears(microphone, stream, requests, said, partials, passed, ended)
    until(lambda: passed, "no sound comes from the microphone")
    return ears


def clip(name: str) -> Samples:
    return np.concatenate([quiet(0.3), read_audio(RECORDINGS / name), quiet(0.8)])


def test_speech_into_a_microphone_becomes_a_request_with_its_capture_time(
    server_of: Callable[..., SoundServer], loaded: vosk.Model
) -> None:
    server = server_of()
    ears = listen(loaded)
    try:
        until(lambda: ears.microphone.level_dbfs < -60, "the empty room is not quiet")
        server.play(clip("go_left/go-left_0.ogg"))
        until(lambda: ears.microphone.level_dbfs > -40, "the level does not show the voice")
        loud_s = time.monotonic()
        until(lambda: ears.requests, "nothing was recognised")
        (request,) = ears.requests
        assert request.command is Command.GO_LEFT
        assert request.confidence >= 0.7
        assert loud_s - 0.5 <= request.captured_at_s <= request.made_at_s <= time.monotonic()
        chunks = [one for one in ears.passed if isinstance(one, Chunk)]
        assert all(a.captured_at_s <= b.captured_at_s for a, b in itertools.pairwise(chunks))
        assert "go left" in ears.partials
    finally:
        ears.close()


def test_a_stereo_48_khz_microphone_is_mixed_and_resampled(
    server_of: Callable[..., SoundServer], loaded: vosk.Model
) -> None:
    server = server_of(rate_hz=48_000, channels=2)
    ears = listen(loaded, shapes=((48_000, 2),))
    try:
        assert "2 channels, 48 kHz, resampled to 16 kHz" in ears.microphone.sentence
        server.play(clip("go_up/go-up_0.ogg"))
        until(lambda: ears.requests, "nothing was recognised")
        assert ears.commands == [Command.GO_UP]
    finally:
        ears.close()


@pytest.mark.parametrize("how", ["unplug", "kill"])
def test_a_device_that_vanishes_mid_phrase_asks_for_nothing_and_is_taken_again(
    server_of: Callable[..., SoundServer], loaded: vosk.Model, how: str
) -> None:
    server = server_of()
    ears = listen(loaded)
    try:
        server.play(clip("go_left/go-left_0.ogg"))
        until(lambda: "go left" in ears.partials or "go" in ears.partials, "the voice is not heard")
        getattr(server, how)()
        until(lambda: ears.said, "the loss is not announced")
        (gone,) = ears.said
        assert (
            gone
            == f"the microphone {MICROPHONE} is gone: you are not heard until it is back, so use another way to say stop"
        )
        until(lambda: any(isinstance(one, Gap) and one.ended for one in ears.passed), "no gap")
        until(lambda: ears.partials[-1] == "", "half a phrase is still shown")
        assert ears.microphone.lost.unplugged == 1
        assert ears.stream.alive
        server.plug() if how == "unplug" else server.start()
        until(lambda: len(ears.said) == 2, "the return is not announced")
        assert ears.said[1] == f"the microphone {MICROPHONE} is back: you are heard again"
        assert ears.requests == []  # neither of the half that was said, nor of it and what follows
        ears.heard(0.5)
        server.play(clip("go_right/go-right_0.ogg"))
        until(lambda: ears.requests, "nothing is recognised after the return")
        assert ears.commands == [Command.GO_RIGHT]
    finally:
        ears.close()


def test_a_loose_plug_asks_for_nothing_that_was_not_said(
    server_of: Callable[..., SoundServer], loaded: vosk.Model
) -> None:
    server = server_of()
    ears = listen(loaded)
    rng = random.Random(1)
    losses = 20 if SOAK else 1
    try:
        for number in range(1, losses + 1):
            server.play(clip("go_left/go-left_0.ogg"))
            ears.heard(rng.uniform(0.1, 1.6))
            whole = rng.random() < 0.5
            server.kill() if whole else server.unplug()
            until(lambda number=number: ears.microphone.lost.unplugged == number, "the loss is not noticed")
            server.start() if whole else server.plug()
            until(lambda number=number: len(ears.said) == 2 * number, "the return is not announced")
        assert set(ears.commands) <= {Command.GO_LEFT}
        assert len(ears.commands) <= losses
        asked = len(ears.commands)
        ears.heard(0.6)
        server.play(clip("go_right/go-right_0.ogg"))
        until(lambda: len(ears.commands) > asked, "nothing is recognised any more")
        assert ears.commands[asked:] == [Command.GO_RIGHT]
    finally:
        ears.close()


def test_push_to_talk_hears_only_what_is_said_while_it_is_held(
    server_of: Callable[..., SoundServer], loaded: vosk.Model
) -> None:
    server = server_of()
    held = threading.Event()
    ears = listen(loaded, talking=held.is_set)
    try:
        server.play(clip("go_left/go-left_0.ogg")).wait(DEADLINE_S)
        ears.heard(1.0)
        assert ears.partials == []
        held.set()
        server.play(clip("go_right/go-right_0.ogg"))
        until(lambda: ears.requests, "nothing was recognised")
        assert ears.commands == [Command.GO_RIGHT]
    finally:
        ears.close()


def test_closing_in_mid_phrase_asks_for_nothing(server_of: Callable[..., SoundServer], loaded: vosk.Model) -> None:
    server = server_of()
    ears = listen(loaded)
    server.play(clip("go_left/go-left_0.ogg"))
    until(lambda: "go left" in ears.partials, "the voice is not heard")
    ears.close()
    assert ears.requests == []


def test_microphones_are_listed_and_chosen_by_name(server_of: Callable[..., SoundServer]) -> None:
    server_of()
    assert MICROPHONE in [device.name for device in input_devices()]
    assert choose_device("TEST-MIC", input_devices()).name == MICROPHONE
    with pytest.raises(MicrophoneError, match=f"did you mean '{MICROPHONE}'"):
        choose_device("m3r-tost-mic", input_devices())


def test_the_default_microphone_is_taken_without_a_name(
    server_of: Callable[..., SoundServer], loaded: vosk.Model
) -> None:
    server = server_of()
    ears = listen(loaded, name=None)
    try:
        server.play(clip("go_down/go-down_0.ogg"))
        until(lambda: ears.requests, "nothing was recognised")
        assert ears.commands == [Command.GO_DOWN]
    finally:
        ears.close()
