"""Microphones and cameras for `m3r check`: opened as a run opens them, listened to and watched for a second."""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING

from config.settings import load_settings
from modalities.native_output import discarded_stderr
from modalities.rooms import LIVE
from modalities.voice.audio import CHUNK_SAMPLES, SAMPLE_RATE_HZ, Chunk
from modalities.voice.capture import FLOOR_DBFS, level_dbfs
from modalities.voice.devices import MicrophoneError, choose_device, input_devices
from modalities.voice.microphone import Microphone
from modalities.voice.sound_check import SoundCheck
from modalities.voice.vad import QUIETEST_DBFS
from ui.check.findings import Finding, State, Wanted, parts_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from modalities.hands.camera import CameraAddress

LISTEN_S = 1.0
CHUNK_S = CHUNK_SAMPLES / SAMPLE_RATE_HZ
WATCH_S = 1.0
CAMERA_TIMEOUT_S = 5.0
SLOWEST_CAMERA_HZ = 10.0
LOUDEST_ROOM_DBFS = -30.0
"""A room louder than this hides a voice, or nobody was silent."""


def microphones(wanted: Wanted) -> Iterator[Finding]:
    try:
        with discarded_stderr():
            devices = input_devices()
            chosen = choose_device(wanted.microphone, devices)
    except MicrophoneError as error:
        yield Finding("microphone", State.MISSING, error.wrong, error.remedy)
        return
    others = [device.name for device in devices if device != chosen]
    if others:
        yield Finding("microphones", State.WORKS, f"also here: {', '.join(others)} (choose with --audio mic:NAME)")
    yield _listened(wanted.microphone)


def _listened(name: str | None) -> Finding:
    """The microphone in question, opened as a run opens it and listened to for LISTEN_S."""
    microphone = Microphone(name, clock=time.monotonic)
    levels: list[float] = []
    check = SoundCheck()
    try:
        with discarded_stderr():
            microphone.open()
            sentence = microphone.sentence
            heard = microphone.chunks()
            giving_up = threading.Timer(LISTEN_S + 4.0, microphone.close)
            giving_up.start()
            try:
                while len(levels) * CHUNK_S < LISTEN_S and isinstance(one := next(heard, None), Chunk):
                    levels.append(level_dbfs(one.samples))
                    check.accept(one.samples)
            finally:
                giving_up.cancel()
                microphone.close()
                for _ in heard:  # to its end, so that the device is let go
                    pass
    except MicrophoneError as error:
        return Finding("microphone", State.MISSING, error.wrong, error.remedy)
    if not levels:
        return Finding("microphone", State.MISSING, f"{sentence} gives no sound", "plug it in again, or choose another")
    loudest, quietest = max(levels), min(levels)
    text = f"{sentence}, level {quietest:.0f} to {loudest:.0f} dBFS in {len(levels) * CHUNK_S:.1f} s"
    if (snr_db := check.hearing.snr_db) is not None:
        text += f", the voice {snr_db:.0f} dB above the noise"
    if loudest <= FLOOR_DBFS:
        return Finding(
            "microphone", State.WEAK, f"{text}: digital silence", "unmute it, or choose another with --audio mic:NAME"
        )
    if loudest < QUIETEST_DBFS:
        remedy = f"say something while this runs; if it stays below {QUIETEST_DBFS:.0f} dBFS, turn the input level up"
        return Finding("microphone", State.WEAK, f"{text}: too quiet for a voice", remedy)
    if quietest > LOUDEST_ROOM_DBFS:
        remedy = "be silent for a moment while this runs; if it stays as loud, turn the input level down or find a quieter place"
        return Finding("microphone", State.WEAK, f"{text}: never quiet", remedy)
    return Finding("microphone", State.WORKS, text)


def cameras(wanted: Wanted) -> Iterator[Finding]:
    numbers = camera_numbers()
    if wanted.camera is not None:
        yield _watched(wanted.camera)
    elif not numbers:
        yield Finding(
            "camera",
            State.MISSING,
            "no /dev/video* here",
            "plug a camera in, or watch one in the network: --video rtsp://…",
        )
    else:
        looked = [_permitted(number) for number in numbers]
        # A camera has more than one device file, and only one of them gives pictures.
        yield from [finding for finding in looked if finding.state is not State.MISSING] or looked


def live_modalities(wanted: Wanted) -> Iterator[Finding]:
    settings = wanted.settings or load_settings()
    for modality in LIVE:
        for seen in modality.look(wanted.live.get(modality.name, ""), settings):
            works = State.WORKS if seen.remedy is None else State.MISSING if seen.missing else State.WEAK
            yield Finding(seen.part, works, seen.text, seen.remedy)


def camera_numbers() -> list[int]:
    return sorted(int(path.name[5:]) for path in Path("/dev").glob("video*") if path.name[5:].isdecimal())


def _permitted(number: int) -> Finding:
    """A camera of this machine, if it may be opened."""
    from modalities.hands.camera import camera_address

    name = f"camera:{number}"
    if not os.access(f"/dev/video{number}", os.R_OK | os.W_OK):
        return Finding(name, State.MISSING, f"/dev/video{number} may not be opened", "add yourself to the group video")
    address = camera_address(name)
    assert address is not None
    return _watched(address, name)


def _watched(address: CameraAddress, name: str = "camera") -> Finding:
    """One camera, opened as a run opens it and watched for WATCH_S."""
    from modalities.hands.camera import Camera
    from modalities.hands.video import VideoError

    stopping = threading.Event()
    times_s: list[float] = []
    giving_up = threading.Timer(WATCH_S + CAMERA_TIMEOUT_S, stopping.set)
    try:
        with discarded_stderr():
            source = Camera(address, clock=time.monotonic)
            giving_up.start()
            for frame in source.frames(stopping):
                times_s.append(frame.captured_at_s)
                if times_s[-1] - times_s[0] >= WATCH_S:
                    stopping.set()
    except VideoError as error:
        return Finding(name, State.MISSING, *parts_of(str(error)))
    finally:
        giving_up.cancel()
    span_s = times_s[-1] - times_s[0] if times_s else 0.0
    if span_s < WATCH_S / 2:
        return Finding(name, State.MISSING, "it opens but gives no moving picture", "uncover it, or plug it in again")
    rate_hz = (len(times_s) - 1) / span_s
    if rate_hz < SLOWEST_CAMERA_HZ:
        remedy = "give it more light, or a port of its own: few pictures make gestures slow"
        return Finding(name, State.WEAK, f"{rate_hz:.0f} pictures a second", remedy)
    return Finding(name, State.WORKS, f"{rate_hz:.0f} pictures a second")
