"""Makes `operator.ogg` from `operator.script` with espeak-ng: one operator's voice, at the script's times.

    python config/demo/make_operator.py [--voice en-us] [--words-per-minute 140]

Every line's last word ends at the line's time, so that recording and script ask for the same thing at the same moment.
"""


from __future__ import annotations

import argparse
import re
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import soundfile
import soxr

HERE = Path(__file__).resolve().parent
RATE_HZ = 16_000
PEAK = 0.5
ROOM_NOISE = 0.0005
"""Standard deviation of the hiss under it, full scale 1: a room is never digitally silent."""
TAIL_S = 4.0
LINE = re.compile(
    r"(?:#says\s+(?P<said_s>[\d.]+)|(?P<at_s>[\d.]+)\s+\w+)\s+(?P<text>[^#=]+?)(?:\s+confidence=\S+)?\s*$"
)


def speak(text: str, voice: str, words_per_minute: int) -> np.ndarray:
    """(n,) float at RATE_HZ, without the silence around it."""
    with tempfile.NamedTemporaryFile(suffix=".wav") as file:
        subprocess.run(["espeak-ng", "-v", voice, "-s", str(words_per_minute), "-w", file.name, text], check=True)
        data, rate_hz = soundfile.read(file.name, dtype="float64")
    data = soxr.resample(data, rate_hz, RATE_HZ)
    loud = np.flatnonzero(np.abs(data) > 0.01 * np.abs(data).max())
    data = data[loud[0] : loud[-1] + 1]
    return np.asarray(data * (PEAK / np.abs(data).max()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--script", type=Path, default=HERE / "operator.script")
    parser.add_argument("--out", type=Path, default=HERE / "operator.ogg")
    parser.add_argument("--voice", default="en-us")
    parser.add_argument("--words-per-minute", type=int, default=140)
    options = parser.parse_args()
    lines = [found for raw in options.script.read_text().splitlines() if (found := LINE.match(raw))]
    ends_s = [float(line["at_s"] or line["said_s"]) for line in lines]
    story = np.random.default_rng(1).normal(0.0, ROOM_NOISE, round((max(ends_s) + TAIL_S) * RATE_HZ))
    for line, end_s in zip(lines, ends_s, strict=True):
        words = speak(line["text"], options.voice, options.words_per_minute)
        end = round(end_s * RATE_HZ)
        story[end - len(words) : end] += words
    soundfile.write(options.out, story, RATE_HZ, format="OGG", subtype="OPUS")
    print(f"{options.out}: {len(story) / RATE_HZ:.0f} s, {options.out.stat().st_size / 1024:.0f} kB")


if __name__ == "__main__":
    main()
