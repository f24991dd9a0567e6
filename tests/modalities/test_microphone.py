"""What can go wrong with a microphone, on a stand-in for PortAudio that does as it is told."""

from __future__ import annotations

import builtins
import sys
import threading
import time
from collections.abc import Callable
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from modalities.notices import SenseChange
from modalities.voice import microphone as microphone_module
from modalities.voice.audio import Chunk, Gap
from modalities.voice.capture import FLOOR_DBFS
from modalities.voice.devices import InputDevice, MicrophoneError, choose_device, input_devices, look_again, plain
from modalities.voice.microphone import Lost, Microphone

DEADLINE_S = 5.0


def until(condition: Callable[[], object], what: str = "it does not happen") -> None:
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline, what
        time.sleep(0.002)


class StandIn(ModuleType):
    """sounddevice, its devices and streams in a test's hands. `refuse` says why a stream is not opened, None: it is."""

    class PortAudioError(Exception):
        pass

    def __init__(self, *names: str) -> None:
        super().__init__("sounddevice")
        self.names = list(names)
        self.refuse: Callable[[dict], Exception | None] = lambda _asked: None
        self.opened: list[Stream] = []
        self.looks = 0
        self.code = 0
        self._initialized = 1
        self._lib = SimpleNamespace(Pa_Initialize=lambda: self.code)

    def query_devices(self) -> list[dict]:
        speaker = {"name": "speaker", "max_input_channels": 0, "default_samplerate": 48_000.0}
        return [
            speaker,
            *({"name": n, "max_input_channels": 2, "default_samplerate": 48_000.0} for n in self.names),
        ]

    def query_hostapis(self) -> list[dict]:
        return [{"default_input_device": 1 if self.names else -1}]

    def _terminate(self) -> None:
        self.looks += 1
        self._check(-10000 if self._initialized == 0 else 0, "Error terminating PortAudio")
        self._initialized -= 1

    def _check(self, code: int, text: str) -> None:
        if code:
            raise self.PortAudioError(f"{text}: PortAudio not initialized [PaErrorCode {code}]", code)

    def RawInputStream(self, **asked) -> Stream:  # noqa: N802 as sounddevice calls it
        error = self.refuse(asked)
        if error is not None:
            raise error
        stream = Stream(asked)
        self.opened.append(stream)
        return stream


class Stream:
    def __init__(self, asked: dict) -> None:
        self.asked = asked
        self.started = threading.Event()
        self.closed = False

    def start(self) -> None:
        self.started.set()

    def close(self, ignore_errors: bool) -> None:
        self.closed = True

    def give(self, value: int = 0, *, overflow: bool = False, count: int = 1) -> None:
        """As PortAudio calls back: blocks of 50 ms of this sample."""
        assert self.started.wait(DEADLINE_S)
        frames = self.asked["blocksize"]
        data = np.full(frames * self.asked["channels"], value, np.int16).tobytes()
        for number in range(count):
            self.asked["callback"](
                memoryview(data),
                frames,
                SimpleNamespace(currentTime=0.0, inputBufferAdcTime=0.0),
                SimpleNamespace(input_overflow=overflow and number == 0),
            )

    def end(self) -> None:
        self.asked["finished_callback"]()


@pytest.fixture
def sound(monkeypatch: pytest.MonkeyPatch) -> StandIn:
    stand_in = StandIn("Headset: USB Audio (hw:1,0)", "Laptop: ALC257 (hw:0,0)")
    monkeypatch.setitem(sys.modules, "sounddevice", stand_in)
    monkeypatch.setattr(microphone_module, "BACK_OFF_S", (0.005, 0.02))
    return stand_in


class Listening:
    """A microphone whose chunks are collected by a thread."""

    def __init__(self, name: str | None = "headset", **options) -> None:
        self.said: list[str] = []
        self.changes: list[SenseChange | None] = []
        self.microphone = Microphone(name, clock=time.monotonic, say=self.hear, **options)
        self.microphone.open()
        self.passed: list[Chunk | Gap] = []
        self._thread = threading.Thread(target=lambda: self.passed.extend(self._noted()), daemon=True)
        self._thread.start()

    def hear(self, sentence: str, change: SenseChange | None = None) -> None:
        self.said.append(sentence)
        self.changes.append(change)

    def _noted(self):
        for one in self.microphone.chunks():
            self.passed.append(one)
        return ()

    @property
    def gaps(self) -> list[Gap]:
        return [one for one in self.passed if isinstance(one, Gap)]

    def close(self) -> None:
        self.microphone.close()
        self._thread.join(DEADLINE_S)
        assert not self._thread.is_alive()


def test_without_portaudio_the_remedy_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "sounddevice", raising=False)
    real = builtins.__import__

    def refusing(error: Exception):
        def load(name, *rest, **named):
            if name == "sounddevice":
                raise error
            return real(name, *rest, **named)

        return load

    monkeypatch.setattr(builtins, "__import__", refusing(OSError("PortAudio library not found")))
    with pytest.raises(
        MicrophoneError, match="no PortAudio library for microphones: install the system package libportaudio2"
    ):
        Microphone(clock=time.monotonic).open()
    monkeypatch.setattr(builtins, "__import__", refusing(ModuleNotFoundError("sounddevice")))
    with pytest.raises(MicrophoneError, match="package sounddevice is missing"):
        Microphone(clock=time.monotonic).open()


def test_no_device_is_said(sound: StandIn) -> None:
    sound.names.clear()
    with pytest.raises(MicrophoneError, match="there is no microphone: plug a microphone in"):
        Microphone(clock=time.monotonic).open()
    assert input_devices() == ()


@pytest.mark.parametrize(
    ("name", "number"),
    [(None, 1), ("HEADSET", 1), ("laptop", 2), ("Laptop: ALC257", 2), ("Laptop: ALC257 (hw:0,0)", 2), (" usb ", 1)],
)
def test_a_device_is_chosen_by_name(sound: StandIn, name: str | None, number: int) -> None:
    assert choose_device(name, input_devices()).number == number


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("hw", "could be any of Headset: USB Audio (hw:1,0), Laptop: ALC257 (hw:0,0): give more of its name"),
        ("Headset: USB Autio (hw:1,0)", "did you mean 'Headset: USB Audio (hw:1,0)'? there are Headset"),
        ("zzz", "there is no microphone 'zzz': there are Headset: USB Audio (hw:1,0), Laptop"),
        ("speaker", "there is no microphone 'speaker'"),
        ("", "there is no microphone ''"),
    ],
)
def test_a_name_that_names_none_or_many_is_refused(sound: StandIn, name: str, sentence: str) -> None:
    with pytest.raises(MicrophoneError) as raised:
        choose_device(name, input_devices())
    assert sentence in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_name_that_is_whole_beats_one_that_contains_it() -> None:
    devices = tuple(InputDevice(n, name, 2, 48_000.0, default=False) for n, name in enumerate(("pulse mic", "mic")))
    assert choose_device("mic", devices).number == 1


def test_rates_and_channels_are_tried_until_one_is_taken(sound: StandIn) -> None:
    sound.refuse = lambda asked: (
        None
        if (asked["samplerate"], asked["channels"]) == (48_000, 2)
        else sound.PortAudioError("Invalid sample rate", -9997 if asked["channels"] == 2 else -9998)
    )
    microphone = Microphone("laptop", clock=time.monotonic)
    microphone.open()
    assert microphone.sentence == ("microphone Laptop: ALC257 (hw:0,0) (2 channels, 48 kHz, resampled to 16 kHz)")
    microphone.close()
    assert sound.opened[0].closed


def test_a_device_in_use_is_said_at_once(sound: StandIn) -> None:
    tried = []

    def refuse(asked: dict) -> Exception:
        tried.append(asked)
        return sound.PortAudioError("Error opening RawInputStream: Device unavailable [PaErrorCode -9985]", -9985)

    sound.refuse = refuse
    with pytest.raises(MicrophoneError) as raised:
        Microphone("laptop", clock=time.monotonic).open()
    assert "ALC257 (hw:0,0) cannot be opened (Error opening RawInputStream: Device unavailable): close" in str(
        raised.value
    )
    assert len(tried) == 1


@pytest.mark.parametrize("how", ["ends", "falls silent", "cannot be started"])
def test_a_device_that_goes_is_told_and_taken_again(sound: StandIn, monkeypatch: pytest.MonkeyPatch, how: str) -> None:
    monkeypatch.setattr(microphone_module, "SILENT_S", 0.05)
    ears = Listening()
    first = sound.opened[0]
    first.give(1000)
    until(lambda: ears.passed)
    sound.names.remove("Headset: USB Audio (hw:1,0)")
    if how == "ends":
        first.end()
    until(lambda: ears.said)
    assert ears.said == [
        "the microphone Headset: USB Audio is gone: you are not heard until it is back, so use another way to say stop"
    ]
    until(lambda: sound.looks > 3)
    assert first.closed
    assert len(sound.opened) == 1  # the laptop's own microphone is not taken in its place
    assert ears.microphone.level_dbfs == FLOOR_DBFS
    if how == "cannot be started":

        def fail(self: Stream) -> None:
            raise sound.PortAudioError("no")

        with monkeypatch.context() as failing:
            failing.setattr(Stream, "start", fail)
            sound.names.append("Headset: USB Audio (hw:3,0)")
            until(lambda: len(sound.opened) > 3)
            assert len(ears.said) == 1
    else:
        sound.names.append("Headset: USB Audio (hw:3,0)")
    until(lambda: sound.opened[-1] is not first and not sound.opened[-1].closed and sound.opened[-1].started.is_set())
    assert len(ears.said) == 1  # not back before sound comes
    monkeypatch.setattr(microphone_module, "SILENT_S", 5.0)
    before = len(ears.passed)
    sound.opened[-1].give(1000, count=3)
    until(lambda: len(ears.passed) >= before + 3)
    assert ears.said[1:] == ["the microphone Headset: USB Audio is back: you are heard again"]
    assert ears.changes == [SenseChange.VOICE_GONE, SenseChange.VOICE_BACK]
    assert ears.gaps[0].ended
    assert ears.microphone.lost == Lost(0, 0, 1)
    ears.close()


def test_a_sound_system_that_comes_up_late_is_looked_for_again(sound: StandIn) -> None:
    sound.code = -9999
    for _ in range(2):
        with pytest.raises(MicrophoneError, match=r"the sound system cannot be opened \(Error initializing PortAudio"):
            look_again()
    sound.code = 0
    look_again()
    assert sound._initialized == 1


def test_lost_sound_is_a_gap_and_told_now_and_then(sound: StandIn) -> None:
    ears = Listening()
    stream = sound.opened[0]
    stream.give(500)
    stream.give(500, overflow=True)
    stream.give(500)
    stream.give(500, overflow=True)
    until(lambda: len(ears.passed) == 6)
    assert [isinstance(one, Gap) for one in ears.passed] == [False, True, False, False, True, False]
    assert not any(gap.ended for gap in ears.gaps)
    (said,) = ears.said  # the second is too soon after the first
    assert said.startswith("the microphone Headset: USB Audio lost some sound (the device overflowed, ")
    assert said.endswith(" so far): what was just said does not count, say it again")
    assert ears.microphone.lost == Lost(2, 0, 0)
    ears.close()


def test_the_device_is_never_waited_for_and_old_sound_is_dropped(sound: StandIn) -> None:
    """Nobody takes the blocks: the callback returns all the same, and what is kept is the newest two seconds."""
    microphone = Microphone("headset", clock=time.monotonic)
    microphone.open()
    heard = microphone.chunks()
    stream = sound.opened[0]
    stream.started.set()
    stream.give(1)
    assert isinstance(next(heard), Chunk)
    began_s = time.monotonic()
    stream.give(2, count=100)
    assert time.monotonic() - began_s < 0.5
    assert microphone.lost == Lost(0, 60, 0)
    gap = next(heard)
    assert isinstance(gap, Gap)
    assert not gap.ended
    assert sum(isinstance(next(heard), Chunk) for _ in range(40)) == 40
    microphone.close()
    assert [type(one) for one in heard] == [Gap]
    assert stream.closed


def test_closing_while_the_device_is_away_ends_at_once(sound: StandIn, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(microphone_module, "BACK_OFF_S", (100.0, 100.0))
    ears = Listening()
    sound.names.clear()
    sound.opened[0].give()
    sound.opened[0].end()
    until(lambda: ears.said)
    ears.close()
    assert len(ears.said) == 1


def test_push_to_talk_is_asked_at_capture_and_has_a_tail(sound: StandIn) -> None:
    held = threading.Event()
    now = [10.0]
    microphone = Microphone("headset", clock=lambda: now[0], talking=held.is_set)
    microphone.open()
    heard = microphone.chunks()
    stream = sound.opened[0]
    stream.started.set()
    loud = []
    for number, talking in enumerate([False, True, True, *[False] * 8]):
        (held.set if talking else held.clear)()
        now[0] = 10.0 + 0.05 * number
        stream.give(700 + number)
        chunk = next(heard)
        loud.append(bool(chunk.samples.any()))
    assert loud == [False, *[True] * 7, *[False] * 3]
    microphone.close()


def test_what_portaudio_says_becomes_plain() -> None:
    error = Exception(
        "Error opening: Unanticipated host error [PaErrorCode -9999]: 'Input/output error' [ALSA error -5]"
    )
    assert plain(error) == "Error opening: Unanticipated host error: 'Input/output error"
