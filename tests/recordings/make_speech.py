"""Makes the recordings beside this file with espeak-ng: `python tests/recordings/make_speech.py`.

One sub-folder per command, `none` for what asks for nothing. Synthetic voices only, so that the project ships what it tests
with; how well real people are understood is measured on real recordings.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import soundfile
import soxr

HERE = Path(__file__).resolve().parent
RATE_HZ = 16_000
ROOM_NOISE = 0.0003

VOICES = (("en-us", 150, 50), ("en-gb", 140, 45), ("en-us+f2", 150, 60))
"""espeak-ng's voice, words per minute, pitch."""

PHRASES: dict[str, tuple[str, ...]] = {
    "go_left": ("go left", "fly left"),
    "go_right": ("go right", "fly right"),
    "go_forward": ("go forward", "fly forwards"),
    "go_back": ("go back", "fly backward", "go backwards"),
    "go_up": ("go up", "fly up"),
    "go_down": ("go down", "fly down"),
    "turn_left": ("turn left",),
    "turn_right": ("turn right",),
    "stop": ("stop", "please stop now"),
    "continue": ("continue",),
    "activate": ("activate red", "activate blue"),
    "disconnect": ("disconnect red", "disconnect blue"),
    "none": (
        "yes", "no", "seven", "left", "right", "go", "hello everyone", "the weather looks good this morning",
        "could you bring me a coffee with milk", "how many people live in this house", "turn around",
    ),
}  # fmt: skip


def speak(text: str, voice: str, words_per_minute: int, pitch: int) -> np.ndarray:
    """(n,) float at RATE_HZ, with a little room noise."""
    with tempfile.NamedTemporaryFile(suffix=".wav") as file:
        subprocess.run(
            ["espeak-ng", "-v", voice, "-s", str(words_per_minute), "-p", str(pitch), "-w", file.name, text], check=True
        )
        data, rate_hz = soundfile.read(file.name, dtype="float64")
    data = soxr.resample(data, rate_hz, RATE_HZ)
    data = np.concatenate([np.zeros(RATE_HZ // 10), data * (0.5 / np.abs(data).max())])
    return data + np.random.default_rng(len(data)).normal(0.0, ROOM_NOISE, len(data))


def main() -> None:
    for folder, phrases in PHRASES.items():
        shutil.rmtree(HERE / folder, ignore_errors=True)
        (HERE / folder).mkdir()
        for phrase in phrases:
            for number, voice in enumerate(VOICES):
                target = HERE / folder / f"{phrase.replace(' ', '-')}_{number}.ogg"
                soundfile.write(target, speak(phrase, *voice), RATE_HZ, format="OGG", subtype="OPUS")


if __name__ == "__main__":
    main()
