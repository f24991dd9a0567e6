"""`m3r check`: what is on this machine for flying by voice and hands, and what to do about what is not.

Each part of the machine has a function that looks and finds; a new part is one more of them in `PARTS`. What is looked at is
used for real: a model is loaded, a microphone listened to, a vehicle waited for.
"""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import importlib
import importlib.util
import os
import platform
import shutil
import sys
import textwrap
import threading
import time
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from modalities.audio import CHUNK_SAMPLES, SAMPLE_RATE_HZ, Chunk
from modalities.audio_devices import MicrophoneError, choose_device, input_devices
from modalities.models import ModelError, find_model

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
    from types import ModuleType

LISTEN_S = 1.0
CHUNK_S = CHUNK_SAMPLES / SAMPLE_RATE_HZ
WATCH_S = 1.0
CAMERA_TIMEOUT_S = 5.0
VEHICLE_TIMEOUT_S = 5.0
SLOWEST_CAMERA_HZ = 10.0
QUIETEST_DBFS = -60.0
"""Below this nothing counts as a voice (see `modalities.voice_end`)."""
LOUDEST_ROOM_DBFS = -30.0
"""A room louder than this hides a voice, or nobody was silent."""
LEAST_CORES = 2


class State(StrEnum):
    """WORKS: seen to work. WEAK: works, but not well enough. MISSING: what needs it cannot be used. NOT_BUILT: no part of
    this M3R.
    """

    WORKS = "works"
    WEAK = "weak"
    MISSING = "missing"
    NOT_BUILT = "not built"


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was looked at. remedy: one sentence, what to do; None where nothing is to be done."""

    part: str
    state: State
    text: str
    remedy: str | None = None


@dataclass(frozen=True, slots=True)
class Wanted:
    """What to look at beyond what every machine has. vehicles: MAVLink address by colour; microphone: as --audio mic:NAME."""

    vehicles: Mapping[str, str] = field(default_factory=dict)
    microphone: str | None = None


def check(wanted: Wanted) -> Iterator[Finding]:
    """Look at everything, one part after the other; a fault while looking is a finding too."""
    for name, look in PARTS:
        try:
            yield from look(wanted)
        except ImportError as error:
            remedy = "install m3r again with its dependencies"
            yield Finding(name, State.MISSING, f"a Python package is missing: {error}", remedy)
        except Exception as error:  # noqa: BLE001 one part's fault hides no other part
            yield Finding(
                name, State.MISSING, f"cannot be looked at: {type(error).__name__}: {error}", "report this fault"
            )


def shown(finding: Finding, width: int = 100) -> str:
    """The finding as lines of a table, its remedy below it."""
    head = f"{finding.state:<10}{finding.part:<16}"
    lines = textwrap.wrap(finding.text, width, initial_indent=head, subsequent_indent=" " * len(head))
    if finding.remedy is not None:
        indent = " " * (len(head) - 2)
        lines += textwrap.wrap(finding.remedy, width, initial_indent=f"{indent}> ", subsequent_indent=f"{indent}  ")
    return "\n".join(lines)


def show(wanted: Wanted) -> int:
    """Print what is found, as it is found. Returns the exit status: 0, whatever was found."""
    width = max(60, min(120, shutil.get_terminal_size((100, 24)).columns))
    for finding in check(wanted):
        print(shown(finding, width), flush=True)
    return 0


def _machine(_wanted: Wanted) -> Iterator[Finding]:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    yield Finding("Python", State.WORKS, f"{platform.python_version()} on {platform.system()} {platform.machine()}")
    few = cores < LEAST_CORES
    yield Finding(
        "processor",
        State.WEAK if few else State.WORKS,
        f"{cores} core{'s'[: cores > 1]}",
        f"use a machine with {LEAST_CORES} cores or more for voice and hands together" if few else None,
    )


LIBRARIES = (
    ("libportaudio.so.2", "libportaudio2", "microphones"),
    ("libEGL.so.1", "libegl1", "hands"),
    ("libGLESv2.so.2", "libgles2", "hands"),
)


def _libraries(_wanted: Wanted) -> Iterator[Finding]:
    for library, package, use in LIBRARIES:
        try:
            ctypes.CDLL(library)
        except OSError:
            yield Finding(package, State.MISSING, f"no {library}, which {use} need", f"run: sudo apt install {package}")
        else:
            yield Finding(package, State.WORKS, f"{library}, for {use}")


def _fetching(_wanted: Wanted) -> Iterator[Finding]:
    have = [name for name in ("npm", "uv", "pip") if shutil.which(name) or shutil.which(name, path=_own_programs())]
    if importlib.util.find_spec("pip") is not None and "pip" not in have:
        have.append("pip")
    if have:
        yield Finding("fetching", State.WORKS, f"models can be fetched with {', '.join(have)}")
    else:
        yield Finding(
            "fetching", State.WEAK, "no npm, uv or pip: models come from the web alone", "run: sudo apt install npm"
        )


def _own_programs() -> str:
    return str(Path(sys.executable).parent)


def _voice_model(_wanted: Wanted) -> Iterator[Finding]:
    from modalities.phrases import PhraseTable
    from modalities.voice import Recognizer, load_model

    try:
        model = find_model()
        began_s = time.monotonic()
        missing = Recognizer(load_model(model.folder), PhraseTable(("red", "green", "blue"))).missing_words
    except ModelError as error:
        yield Finding("voice model", State.MISSING, *_split(str(error)))
        return
    text = f"{model.sentence}, loaded in {time.monotonic() - began_s:.1f} s"
    if missing:
        remedy = "fetch another with `m3r models fetch`, or do without these words"
        yield Finding("voice model", State.WEAK, f"{text}; it does not know {', '.join(missing)}", remedy)
    else:
        yield Finding("voice model", State.WORKS, text)


def _hand_model(_wanted: Wanted) -> Iterator[Finding]:
    hands, models = _module("modalities.hands"), importlib.import_module("modalities.models")
    if hands is None:
        yield Finding("hand model", State.NOT_BUILT, "this M3R does not recognise hands")
        return
    try:
        model = models.find_hand_model()
        began_s = time.monotonic()
        with _silence():  # MediaPipe reports on its graphics at length
            hands.HandDetector(model).close()
    except ModelError as error:
        yield Finding("hand model", State.MISSING, *_split(str(error)))
        return
    yield Finding("hand model", State.WORKS, f"{model.sentence}, loaded in {time.monotonic() - began_s:.1f} s")


def _microphones(wanted: Wanted) -> Iterator[Finding]:
    try:
        with _silence():
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
    from modalities.capture import FLOOR_DBFS, level_dbfs
    from modalities.microphone import Microphone

    microphone = Microphone(name, clock=time.monotonic)
    levels: list[float] = []
    try:
        with _silence():
            microphone.open()
            sentence = microphone.sentence
            heard = microphone.chunks()
            giving_up = threading.Timer(LISTEN_S + 4.0, microphone.close)
            giving_up.start()
            try:
                while len(levels) * CHUNK_S < LISTEN_S and isinstance(one := next(heard, None), Chunk):
                    levels.append(level_dbfs(one.samples))
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
    if loudest <= FLOOR_DBFS:
        return Finding(
            "microphone", State.WEAK, f"{text}: digital silence", "unmute it, or choose another with --audio mic:NAME"
        )
    if loudest < QUIETEST_DBFS:
        remedy = "say something while this runs; if it stays below -60 dBFS, turn the input level up"
        return Finding("microphone", State.WEAK, f"{text}: too quiet for a voice", remedy)
    if quietest > LOUDEST_ROOM_DBFS:
        remedy = "be silent for a moment while this runs; if it stays as loud, turn the input level down or find a quieter place"
        return Finding("microphone", State.WEAK, f"{text}: never quiet", remedy)
    return Finding("microphone", State.WORKS, text)


def _cameras(_wanted: Wanted) -> Iterator[Finding]:
    camera = _module("modalities.camera")
    numbers = _camera_numbers()
    if camera is None:
        yield Finding("camera", State.NOT_BUILT, f"this M3R does not watch cameras ({len(numbers)} here)")
    elif not numbers:
        yield Finding(
            "camera",
            State.MISSING,
            "no /dev/video* here",
            "plug a camera in, or watch one in the network: --video rtsp://…",
        )
    else:
        looked = [finding for number in numbers for finding in _watched(camera, number)]
        # A camera has more than one device file, and only one of them gives pictures.
        yield from [finding for finding in looked if finding.state is not State.MISSING] or looked


def _camera_numbers() -> list[int]:
    return sorted(int(path.name[5:]) for path in Path("/dev").glob("video*") if path.name[5:].isdecimal())


def _watched(camera: ModuleType, number: int) -> Iterator[Finding]:
    """One camera, opened as a run opens it and watched for WATCH_S."""
    name = f"camera:{number}"
    if not os.access(f"/dev/video{number}", os.R_OK | os.W_OK):
        yield Finding(name, State.MISSING, f"/dev/video{number} may not be opened", "add yourself to the group video")
        return
    video_error: type[Exception] = camera.VideoError
    stopping = threading.Event()
    times_s: list[float] = []
    giving_up = threading.Timer(WATCH_S + CAMERA_TIMEOUT_S, stopping.set)
    try:
        with _silence():
            source: Any = camera.Camera(camera.camera_address(name), clock=time.monotonic)
            giving_up.start()
            for frame in source.frames(stopping):
                times_s.append(frame.captured_at_s)
                if times_s[-1] - times_s[0] >= WATCH_S:
                    stopping.set()
    except video_error as error:
        yield Finding(name, State.MISSING, *_split(str(error)))
        return
    finally:
        giving_up.cancel()
    span_s = times_s[-1] - times_s[0] if times_s else 0.0
    if span_s < WATCH_S / 2:
        yield Finding(name, State.MISSING, "it opens but gives no moving picture", "uncover it, or plug it in again")
        return
    rate_hz = (len(times_s) - 1) / span_s
    if rate_hz < SLOWEST_CAMERA_HZ:
        remedy = "give it more light, or a port of its own: few pictures make gestures slow"
        yield Finding(name, State.WEAK, f"{rate_hz:.0f} pictures a second", remedy)
    else:
        yield Finding(name, State.WORKS, f"{rate_hz:.0f} pictures a second")


def _ports(wanted: Wanted) -> Iterator[Finding]:
    from m3r_app.fleet import PORTS, free_udp_block
    from m3r_app.vehicle import VehicleError

    if wanted.vehicles:
        return  # the simulated fleet is not flown beside real ones
    try:
        port = free_udp_block(3)
    except VehicleError as error:
        yield Finding("UDP ports", State.MISSING, *_split(str(error)))
    else:
        yield Finding(
            "UDP ports", State.WORKS, f"free for the simulated fleet, such as {port} (of {PORTS[0]} to {PORTS[1]})"
        )


def _vehicles(wanted: Wanted) -> Iterator[Finding]:
    for colour, url in wanted.vehicles.items():
        yield asyncio.run(_answer(colour, url))


async def _answer(colour: str, url: str) -> Finding:
    """Whether a vehicle answers, and what it says of itself. Nothing is commanded."""
    from m3r_app.vehicle import Vehicle, VehicleError

    part = f"vehicle {colour}"
    try:
        vehicle = await Vehicle.connect(colour, url, time.monotonic, VEHICLE_TIMEOUT_S)
        try:
            telemetry = await vehicle.wait_ready(VEHICLE_TIMEOUT_S)
        finally:
            await vehicle.close()
    except VehicleError as error:
        return Finding(part, State.MISSING, *_split(str(error).removeprefix(f"{colour}: ")))
    text = f"answers on {url}, flight mode {telemetry.flight_mode}"
    if not telemetry.healthy:
        reasons = ", ".join(telemetry.unhealthy)
        return Finding(
            part, State.WEAK, f"{text}; not healthy: {reasons}", "wait for it to be ready, or see its ground station"
        )
    return Finding(part, State.WORKS, text)


PARTS: tuple[tuple[str, Callable[[Wanted], Iterable[Finding]]], ...] = (
    ("machine", _machine),
    ("libraries", _libraries),
    ("fetching", _fetching),
    ("voice model", _voice_model),
    ("hand model", _hand_model),
    ("microphone", _microphones),
    ("camera", _cameras),
    ("UDP ports", _ports),
    ("vehicle", _vehicles),
)


def _split(sentence: str) -> Sequence[str]:
    """Our errors say what is wrong, then, after a colon, what to do."""
    wrong, colon, remedy = sentence.rstrip(".").rpartition(": ")
    return (wrong, remedy) if colon else (remedy,)


def _module(name: str) -> ModuleType | None:
    """One of our modules; None where this M3R does not have it. A library that it lacks is an error as elsewhere."""
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name == name:
            return None
        raise


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """Native libraries write to standard error on their own; what matters comes back to us. Nothing else runs meanwhile."""
    sys.stderr.flush()
    kept = os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
