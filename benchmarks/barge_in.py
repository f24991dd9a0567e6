"""*Stop* said while a cue is spoken: how often it is heard through the cue, beside recognition that is not told of the cue.

    python benchmarks/barge_in.py [FOLDER]

FOLDER holds recordings of the word; without it `../shared/data/speech/stop` where it exists, else the project's own. Each
begins in the middle of a cue that espeak-ng speaks into the same microphone, so much louder than the cue. Below: how many
cues, by themselves, become a (safe) stop, and how many a move that would count.
"""

from __future__ import annotations

import random
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import vosk
from numpy.typing import NDArray

from modalities.models.catalogue import ModelError, find_model
from modalities.voice.audio import SAMPLE_RATE_HZ, AudioError, chunks, read_audio
from modalities.voice.decoder import Heard, Recognizer, load_model
from modalities.voice.phrases import PhraseTable
from safety.vocabulary import Command
from tests.ui.all_cues import all_cues
from ui.speaker import PROGRAM, WORDS

ROOT = Path(__file__).resolve().parent.parent
CUES = (
    "Red: left, one metre", "Red: right, forty centimetres, wall ahead", "Red: up refused, ground too near",
    "Red: holding, Blue too near", "Red: going on, fifteen centimetres",
)  # fmt: skip
LOUDER_DB = (0, 6, 12)
BEGINS_S, SAID_S, AFTER_S = 0.5, 1.0, 1.0
LOUDEST = 26_000.0
ALONE = 150
COUNTS = 0.7
"""The confidence that a move needs."""

Sound = NDArray[np.float64]


def spoken(text: str) -> Sound:
    with tempfile.NamedTemporaryFile(suffix=".wav") as file:
        subprocess.run([PROGRAM, *WORDS, "-w", file.name], input=text.encode(), check=True)
        return read_audio(file.name).astype(np.float64)


def mixed(cue: Sound, voice: Sound | None, louder_db: float) -> Sound:
    """The cue from BEGINS_S on, the voice from SAID_S on."""
    said = 0 if voice is None else len(voice)
    sound = np.zeros(round((max(BEGINS_S + len(cue) / SAMPLE_RATE_HZ, SAID_S) + AFTER_S) * SAMPLE_RATE_HZ) + said)
    begins, speaks = round(BEGINS_S * SAMPLE_RATE_HZ), round(SAID_S * SAMPLE_RATE_HZ)
    sound[begins : begins + len(cue)] += cue / np.abs(cue).max()
    if voice is not None:
        sound[speaks : speaks + said] += voice / np.abs(voice).max() * 10.0 ** (louder_db / 20.0)
    return np.asarray(sound / np.abs(sound).max() * LOUDEST)


def heard(sound: Sound, cue: Sound, model: vosk.Model, *, told: bool) -> list[Heard]:
    """told: the recogniser knows when the cue is spoken."""
    recognizer = Recognizer(model, PhraseTable(("red", "green", "blue")))
    ends_s = BEGINS_S + len(cue) / SAMPLE_RATE_HZ
    found: list[Heard] = []
    for chunk in chunks(sound.astype(np.int16)):
        found += recognizer.accept(chunk, self_speech=told and BEGINS_S <= chunk.captured_at_s <= ends_s + 0.3)
    return found


def main(arguments: list[str]) -> int:
    shared = ROOT.parent / "shared" / "data" / "speech" / "stop"
    folder = Path(arguments[0]) if arguments else shared if shared.is_dir() else ROOT / "tests/recordings/stop"
    if shutil.which(PROGRAM) is None:
        print(f"{PROGRAM} is not here: install it", file=sys.stderr)
        return 2
    try:
        found = find_model()
        model = load_model(found.folder)
        voices = [read_audio(path).astype(np.float64) for path in sorted(folder.iterdir())]
    except (AudioError, ModelError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    print(f"{found.sentence}; {len(voices)} recordings of stop from {folder}")
    cues = [spoken(text) for text in CUES]
    for louder_db in LOUDER_DB:
        counts = [
            sum(
                any(
                    one.command is Command.STOP
                    for one in heard(
                        mixed(cues[i % len(cues)], voice, louder_db), cues[i % len(cues)], model, told=told
                    )
                )
                for i, voice in enumerate(voices)
            )
            for told in (True, False)
        ]
        shares = [f"{100.0 * count / len(voices):.0f} %" for count in counts]
        print(f"stop {louder_db} dB louder than the cue: {shares[0]} heard, {shares[1]} untold")
    texts = random.Random(1).sample(all_cues(), ALONE)
    alone = [heard(mixed(cue, None, 0.0), cue, model, told=True) for cue in map(spoken, texts)]
    stops = sum(any(one.command is Command.STOP for one in found) for found in alone)
    moves = sum(any(one.command is not Command.STOP and one.confidence >= COUNTS for one in found) for found in alone)
    print(f"{ALONE} cues by themselves: {stops} became a stop, {moves} a move that would count")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
