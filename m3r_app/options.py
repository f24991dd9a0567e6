"""What `m3r run` was asked to do, checked as far as that goes without opening anything."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from safety.vocabulary import Geodetic

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from modalities.hands.camera import CameraAddress

TAKEOFF_M = (1.0, 120.0)
TIMEOUT_S = (0.1, 86_400.0)
ALTITUDE_M = (-500.0, 9000.0)
PORTS = (1, 65535)
STANDARD_INPUT = Path("-")


@dataclass(frozen=True, slots=True)
class LiveMicrophone:
    """Listen to a microphone. name: a part of its name; None: the system's default."""

    name: str | None = None


class OptionError(ValueError):
    """An option that cannot be used; one sentence that names it."""


@dataclass(frozen=True, slots=True)
class RunOptions:
    """The options of `m3r run`; every default is what happens without the option."""

    headless: bool = False
    """Machine-readable output; without it, output for a person."""
    audio: Path | LiveMicrophone | None = None
    """A recording of the operator, or a microphone."""
    video: Path | CameraAddress | None = None
    """A video of the operator, or a camera."""
    live: Mapping[str, str] = field(default_factory=dict)
    """What `modalities.rooms` lists and is wanted: by name, what its option says, "" for nothing."""
    script: Path | None = None
    """Timed commands; `STANDARD_INPUT` for standard input."""
    pair: str | None = None
    """The colour of the drone to pair with at the start."""
    vehicles: Mapping[str, str] = field(default_factory=dict)
    """MAVLink address by colour; empty: the built-in simulated fleet."""
    scenario: Path | None = None
    """None: the shipped one."""
    config: tuple[Path, ...] = ()
    overrides: tuple[str, ...] = ()
    """`KEY=VALUE`, as `config.settings.load_settings` takes them."""
    operator: Geodetic | None = None
    """Where the operator stands; None: where the scenario says."""
    takeoff_m: float | None = None
    """Take off to this height first."""
    apply_failsafe: bool = False
    """Set the required failsafe parameters before pairing."""
    dry_run: bool = False
    """Decide and tell, but fly nothing of what is asked."""
    plain: bool = False
    """Every event one sentence, for screen readers and logs."""
    console: bool = False
    """Somebody sits at the console: the run goes on until they end it, played inputs or not."""
    spoken: bool | None = None
    """Whether short cues are spoken; None: unless `headless` or `plain`."""
    view_port: int | None = None
    """Show the flight in 3D on this TCP port of loopback."""
    broker: str | None = None
    """Address of the MQTT broker of a shared airspace; None: alone."""
    credentials: Path | None = None
    """Who the operator is there."""
    record: Path | None = None
    """Flight record to write."""
    record_key: Path | None = None
    """Ed25519 key (PEM) that it is signed with; None: not signed."""
    timeout_s: float | None = None

    @property
    def aloud(self) -> bool:
        """Whether cues are spoken."""
        return self.spoken if self.spoken is not None else not (self.headless or self.plain)


def parse_colour(text: str) -> str:
    """A drone's name: one plain word that can be said."""
    colour = text.strip().lower()
    if not re.fullmatch(r"[a-z]{1,31}", colour):
        raise OptionError(f"{text!r} is not a colour that can be said: use one plain word such as red")
    return colour


def parse_vehicles(texts: Sequence[str]) -> dict[str, str]:
    """COLOUR=MAVLINK-URL words as a mapping. What stands behind the URL is checked when it is opened."""
    vehicles: dict[str, str] = {}
    for text in texts:
        name, equals, url = text.partition("=")
        if not equals or not re.fullmatch(r"[a-z]+://\S+", url):
            raise OptionError(f"--vehicle {text} is not COLOUR=MAVLINK-URL, such as red=udpin://0.0.0.0:14540")
        colour = parse_colour(name)
        if colour in vehicles:
            raise OptionError(f"--vehicle names {colour} twice")
        if url in vehicles.values():
            raise OptionError(f"--vehicle gives {url} to two drones")
        vehicles[colour] = url
    return vehicles


def parse_place(text: str) -> Geodetic:
    """LAT,LON,AMSL in degrees, degrees, metres."""
    parts = text.split(",")
    try:
        lat_deg, lon_deg, amsl_m = map(float, parts)
    except ValueError:
        raise OptionError(f"{text!r} is not LAT,LON,AMSL (degrees, degrees, metres), such as 47.4,8.55,488") from None
    _within("latitude", lat_deg, (-90.0, 90.0), "degrees")
    _within("longitude", lon_deg, (-180.0, 180.0), "degrees")
    _within("altitude above sea level", amsl_m, ALTITUDE_M, "m")
    return Geodetic(lat_deg, lon_deg, amsl_m)


def parse_takeoff(text: str) -> float:
    """A height to take off to, m."""
    return _within("take-off height", _number(text), TAKEOFF_M, "m")


def parse_port(text: str) -> int:
    """A TCP port."""
    if not (text.isascii() and text.isdecimal() and PORTS[0] <= int(text) <= PORTS[1]):
        raise OptionError(f"{text!r} is no port: give a number from {PORTS[0]} to {PORTS[1]}")
    return int(text)


def parse_timeout(text: str) -> float:
    """A longest duration of the run, s."""
    return _within("timeout", _number(text), TIMEOUT_S, "s")


def parse_audio(text: str) -> Path | LiveMicrophone | None:
    """A recording, `mic` or `mic:NAME`; None for none."""
    if text == "mic":
        return LiveMicrophone()
    if text.startswith("mic:"):
        name = text.removeprefix("mic:").strip()
        if not name:
            raise OptionError("mic: lacks the microphone's name: write mic:NAME, or mic for the usual one")
        return LiveMicrophone(name)
    return None if text == "none" else _path(text)


def parse_video(text: str) -> Path | CameraAddress | None:
    """A video, a camera of this machine (`camera:0`) or of the network (its address); None for none."""
    if text == "none":
        return None
    from modalities.hands.camera import camera_address  # loads OpenCV
    from modalities.hands.video import VideoError

    try:
        return camera_address(text) or _path(text)
    except VideoError as error:
        raise OptionError(str(error)) from None


def parse_file(text: str) -> Path:
    """A path that is not empty."""
    return _path(text)


def _path(text: str) -> Path:
    if not text or "\0" in text:
        raise OptionError("an empty file name was given")
    return Path(text)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise OptionError(f"{text!r} is not a number") from None


def _within(name: str, value: float, bounds: tuple[float, float], unit: str) -> float:
    low, high = bounds
    if not (math.isfinite(value) and low <= value <= high):
        raise OptionError(f"{name} {value:g} {unit} is not between {low:g} and {high:g} {unit}")
    return value
