"""Which microphones there are, and which one a person means. The only place that loads PortAudio (through sounddevice)."""

from __future__ import annotations

import contextlib
import ctypes
import difflib
import functools
import re
from dataclasses import dataclass
from typing import Any

LIBRARY_REMEDY = "install the system package libportaudio2"


class MicrophoneError(ValueError):
    """A microphone that cannot be used; one sentence that names it and says what to do: `wrong`, a colon, `remedy`."""

    def __init__(self, wrong: str, remedy: str) -> None:
        super().__init__(f"{wrong}: {remedy}")
        self.wrong = wrong
        self.remedy = remedy


@dataclass(frozen=True, slots=True)
class InputDevice:
    """A device that can record. number: its place in PortAudio's list, which lasts until `look_again` only."""

    number: int
    name: str
    channels: int
    rate_hz: float
    """Its own rate, as PortAudio states it."""
    default: bool

    @property
    def lasting_name(self) -> str:
        """Its name without the card number, which may be another one after it was unplugged."""
        return re.sub(r"\s*\(hw:\d+,\d+\)", "", self.name).strip()


def portaudio() -> Any:
    """The sounddevice module. Raises MicrophoneError where it or the PortAudio library is missing."""
    try:
        import sounddevice
    except ImportError as error:
        raise MicrophoneError(
            "the Python package sounddevice is missing", "install m3r again with its dependencies"
        ) from error
    except OSError as error:
        raise MicrophoneError("there is no PortAudio library for microphones", LIBRARY_REMEDY) from error
    _hush()
    return sounddevice


@functools.cache
def _hush() -> None:
    """ALSA and JACK write what they miss straight to standard error, at every look for devices; what matters comes back
    to us as an error. As their handler serves a C function that does nothing.
    """
    with contextlib.suppress(OSError, AttributeError):  # no such library: nothing to silence
        nothing = ctypes.cast(ctypes.CDLL(None).getpid, ctypes.c_void_p)
        ctypes.CDLL("libasound.so.2").snd_lib_error_set_handler(nothing)
        jack = ctypes.CDLL("libjack.so.0")
        jack.jack_set_error_function(nothing)
        jack.jack_set_info_function(nothing)


def look_again() -> None:
    """Have PortAudio look for devices again. It does so only when initialised, which closes every stream of the process."""
    sounddevice = portaudio()
    with contextlib.suppress(sounddevice.PortAudioError):  # it was not initialised, because that failed the last time
        sounddevice._terminate()
    try:
        # Not sounddevice._initialize: that turns standard error off for all threads meanwhile.
        sounddevice._check(sounddevice._lib.Pa_Initialize(), "Error initializing PortAudio")
        sounddevice._initialized += 1
    except sounddevice.PortAudioError as error:
        raise MicrophoneError(f"the sound system cannot be opened ({plain(error)})", NO_DEVICE_REMEDY) from error


NO_DEVICE_REMEDY = "plug a microphone in and see that this user may record (group audio, or a running sound server)"


def input_devices() -> tuple[InputDevice, ...]:
    """Every device that can record. Raises MicrophoneError if PortAudio is missing or fails."""
    sounddevice = portaudio()
    try:
        devices: list[dict[str, Any]] = list(sounddevice.query_devices())
        host_apis: list[dict[str, Any]] = list(sounddevice.query_hostapis())
    except sounddevice.PortAudioError as error:
        raise MicrophoneError(f"the sound system cannot be asked ({plain(error)})", NO_DEVICE_REMEDY) from error
    default = next((api["default_input_device"] for api in host_apis if api["default_input_device"] >= 0), -1)
    return tuple(
        InputDevice(
            number=number,
            name=str(device["name"]),
            channels=int(device["max_input_channels"]),
            rate_hz=float(device["default_samplerate"]),
            default=number == default,
        )
        for number, device in enumerate(devices)
        if device["max_input_channels"] > 0
    )


def choose_device(name: str | None, devices: tuple[InputDevice, ...]) -> InputDevice:
    """The device that a person means: None is the system's default; otherwise the one of that name, or the only one whose
    name contains it, in any case. Raises MicrophoneError: none, unknown (with the names there are), or more than one.
    """
    if not devices:
        raise MicrophoneError("there is no microphone", NO_DEVICE_REMEDY)
    if name is None:
        return next((device for device in devices if device.default), devices[0])
    wanted = name.strip().casefold()
    exact = [d for d in devices if wanted in {d.name.casefold(), d.lasting_name.casefold()}]
    containing = [d for d in devices if wanted and wanted in d.name.casefold()]
    found = exact or containing
    names = ", ".join(device.name for device in devices)
    if len(found) == 1 or (exact and len({d.name for d in exact}) == 1):
        return found[0]
    if found:
        raise MicrophoneError(
            f"microphone {name!r} could be any of {', '.join(d.name for d in found)}", "give more of its name"
        )
    by_folded = {d.name.casefold(): d.name for d in devices}
    near = difflib.get_close_matches(wanted, by_folded, n=1, cutoff=0.5)
    meant = f"did you mean {by_folded[near[0]]!r}? " if near else ""
    raise MicrophoneError(f"there is no microphone {name!r}", f"{meant}there are {names}")


def plain(error: Exception) -> str:
    """What PortAudio says, on one line without its error numbers."""
    words = " ".join(str(part) for part in error.args[:1]) or type(error).__name__
    return (
        re.sub(r"\s*\[(PaErrorCode|ALSA error)[^]]*\]", "", " ".join(words.split())).strip("'\" ") or "no reason given"
    )
