"""How well voice is recognised on a folder of recordings: how an operator calibrates.

One sub-folder per expected command (`go_left`, `stop`, ...); what lies in `none`, or
a sub-folder that is declared to be like it, is no command.
"""

from __future__ import annotations

import time
import zlib
from collections.abc import Callable, Collection, Iterable, Sequence
from pathlib import Path

import numpy as np

from modalities.models.catalogue import VoiceModel
from modalities.models.sources import DENOISER_MODEL
from modalities.outcomes import (
    DEFAULT_THRESHOLD,
    Answer,
    Trial,
    choose_threshold,
    expected_of,
    of_commands,
    of_none,
    recordings_in,
)
from modalities.voice.audio import SAMPLE_RATE_HZ, Samples, chunks, quiet, read_audio
from modalities.voice.decoder import load_model
from modalities.voice.denoiser import Denoiser
from modalities.voice.in_noise import Listener, denoiser_here, listener
from modalities.voice.phrases import PhraseTable
from modalities.voice.rotor_noise import mixed_with
from modalities.voice.vosk_library import Model

PADDING_S = 2.0
LEAD_S = 1.0
"""Noise alone before a clip that is heard in noise: the drone flies already."""
TOLERATED_FALSE_MOVES = 0.005
"""What share of the recordings without a command may become a request at the chosen threshold."""


def hear(samples: Samples, recognizer: Listener) -> tuple[Answer, ...]:
    """Everything heard in one recording, as if it were being captured: a chunk cannot be decoded before it is there, nor
    before the decoder is done with the one before.
    """
    answers: list[Answer] = []
    done_s = 0.0
    for chunk in chunks(samples):
        began = time.perf_counter()
        heard = recognizer.accept(chunk)
        done_s = max(done_s, chunk.captured_at_s) + time.perf_counter() - began
        answers += [Answer(one, done_s - one.captured_at_s) for one in heard]
    began = time.perf_counter()
    heard = recognizer.finish(len(samples) / SAMPLE_RATE_HZ)
    done_s += time.perf_counter() - began
    return (*answers, *(Answer(one, done_s - one.captured_at_s) for one in heard))


def evaluate_voice(
    folder: Path | str,
    model: VoiceModel,
    colours: Iterable[str] = ("red", "green", "blue"),
    threshold: float = DEFAULT_THRESHOLD,
    *,
    snr_db: float | None = None,
    negatives: Collection[str] = (),
    take_trials: Callable[[Sequence[Trial]], None] = lambda _trials: None,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> dict[str, object]:
    """The contract's object for `m3r evaluate voice`: strict JSON, latencies in ms, null where there is nothing to tell.

    threshold: the confidence from which a request counts. progress: recordings done and in all. Each recording is heard
    by a fresh recogniser and followed by 2 s of quiet. snr_db: each is heard in the noise of a drone nearby (seeded by its name), so
    far below the voice, that goes on before and after it.
    negatives: more sub-folders without a command. take_trials: given
    every recording with what was made of it. Raises EvaluationError, AudioError or ModelError, which name what
    is wrong.
    """
    recordings = recordings_in(Path(folder), negatives)
    loaded = load_model(model.folder)
    table = PhraseTable(colours)
    denoiser, _ = denoiser_here()
    trials: list[Trial] = []
    for done, (name, path) in enumerate(recordings):
        progress(done, len(recordings))
        trials.append(_trial(name, path, loaded, table, denoiser, snr_db))
    progress(len(recordings), len(recordings))
    take_trials(trials)
    return {
        "commands": of_commands(trials, threshold),
        "none": of_none(trials, threshold),
        "threshold": choose_threshold(trials, TOLERATED_FALSE_MOVES),
        "model": model.name,
        "denoiser": None if denoiser is None else DENOISER_MODEL,
        "snr_db": snr_db,
    }


def _trial(
    name: str, path: Path, model: Model, table: PhraseTable, denoiser: Denoiser | None, snr_db: float | None
) -> Trial:
    samples = read_audio(path)
    if snr_db is None:
        samples = np.concatenate([samples, quiet(PADDING_S)])
    else:
        seed = zlib.crc32(path.name.encode())
        samples = mixed_with(samples, snr_db, seed, around=(quiet(LEAD_S), quiet(PADDING_S)))
    if denoiser is not None:
        denoiser.forget()
    return Trial(name, expected_of(name), hear(samples, listener(model, table, denoiser)), path.name)
