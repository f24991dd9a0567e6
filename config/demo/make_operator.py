"""Makes `operator.ogg` and `operator.mp4` from `operator.script`: one operator's voice (espeak-ng) and hand (drawn).

    python config/demo/make_operator.py [--voice en-us] [--words-per-minute 140]

Every line's last word ends at the line's time, and every gesture has then been held long enough, so that recordings and script
ask for the same thing at the same moment.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
import soundfile
import soxr

from config.demo.drawn_hand import GESTURES, MOVING_S, NO_GESTURES, Film

HERE = Path(__file__).resolve().parent
RATE_HZ = 16_000
PEAK = 0.5
ROOM_NOISE = 0.0005
"""Standard deviation of the hiss under it, full scale 1: a room is never digitally silent."""
TAIL_S = 4.0
FRAME_RATE_HZ = 10.0
HELD_S, HELD_ON_S = 0.6, 0.4
"""A gesture is held this long before the line's time, and so long after it."""
LINE = re.compile(
    r"(?:#(?P<only>says|shows)\s+(?P<only_at_s>[\d.]+)|(?P<at_s>[\d.]+)\s+(?P<modality>\w+))"
    r"\s+(?P<text>[^#=]+?)(?:\s+confidence=\S+)?\s*$"
)


class Line(NamedTuple):
    """at_s: when the last word has been said, or the hand held long enough."""

    at_s: float
    by_hand: bool
    text: str


def read(script: Path) -> list[Line]:
    """What is said and shown, in time."""
    lines = []
    for raw in script.read_text().splitlines():
        if found := LINE.match(raw):
            by_hand = found["only"] == "shows" or found["modality"] == "gesture"
            lines.append(Line(float(found["at_s"] or found["only_at_s"]), by_hand, found["text"]))
    return lines


def speak(text: str, voice: str, words_per_minute: int) -> np.ndarray:
    """(n,) float at RATE_HZ, without the silence around it."""
    with tempfile.NamedTemporaryFile(suffix=".wav") as file:
        subprocess.run(["espeak-ng", "-v", voice, "-s", str(words_per_minute), "-w", file.name, text], check=True)
        data, rate_hz = soundfile.read(file.name, dtype="float64")
    data = soxr.resample(data, rate_hz, RATE_HZ)
    loud = np.flatnonzero(np.abs(data) > 0.01 * np.abs(data).max())
    data = data[loud[0] : loud[-1] + 1]
    return np.asarray(data * (PEAK / np.abs(data).max()))


def say(lines: list[Line], out: Path, voice: str, words_per_minute: int) -> float:
    """The operator's voice. Returns its length, s."""
    length_s = max(line.at_s for line in lines) + TAIL_S
    story = np.random.default_rng(1).normal(0.0, ROOM_NOISE, round(length_s * RATE_HZ))
    for line in lines:
        if not line.by_hand:
            words = speak(line.text, voice, words_per_minute)
            end = round(line.at_s * RATE_HZ)
            story[end - len(words) : end] += words
    soundfile.write(out, story, RATE_HZ, format="OGG", subtype="OPUS")
    return length_s


def show(lines: list[Line], out: Path, length_s: float) -> None:
    """The operator's hand."""
    with Film(out, FRAME_RATE_HZ) as film:
        for line in lines:
            if line.by_hand:
                film.nothing(line.at_s - HELD_S - MOVING_S - film.length_s)
                film.shows(GESTURES.get(line.text.replace(" ", "_")) or NO_GESTURES[line.text], HELD_S + HELD_ON_S)
        film.nothing(length_s - film.length_s)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--script", type=Path, default=HERE / "operator.script")
    parser.add_argument("--out", type=Path, default=HERE / "operator", help="without .ogg and .mp4")
    parser.add_argument("--voice", default="en-us")
    parser.add_argument("--words-per-minute", type=int, default=140)
    options = parser.parse_args()
    lines = read(options.script)
    voice, hand = options.out.with_suffix(".ogg"), options.out.with_suffix(".mp4")
    length_s = say(lines, voice, options.voice, options.words_per_minute)
    show(lines, hand, length_s)
    for made in (voice, hand):
        print(f"{made}: {length_s:.0f} s, {made.stat().st_size / 1024:.0f} kB")


if __name__ == "__main__":
    main()
