"""Audio from a file as a microphone would give it: small chunks of 16 kHz mono 16-bit, each with its capture time.

Time is counted from the data, never from a clock, so a recording behaves like a live microphone; a live microphone
(`modalities.voice.microphone`) is another iterator of `Chunk`s, with `Gap`s where sound is missing.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import soundfile
import soxr
from numpy.typing import NDArray

SAMPLE_RATE_HZ = 16_000
CHUNK_SAMPLES = 800
"""50 ms: how often partial results are looked at."""
LOWEST_RATE_HZ = 8000
LONGEST_FILE_S = 4 * 3600.0

Samples = NDArray[np.int16]


class AudioError(ValueError):
    """An audio file that cannot be used; one sentence that names it and says what to do."""


@dataclass(frozen=True, slots=True)
class Chunk:
    """Samples in a row. captured_at_s: time of the last of them, from the start of the recording."""

    samples: Samples
    captured_at_s: float


@dataclass(frozen=True, slots=True)
class Gap:
    """Sound is missing here: what was being said is only half known. captured_at_s: up to when it is missing, as in Chunk.

    ended: the source went away, so that nothing more will complete the utterance; otherwise it goes on with a hole in it.
    """

    captured_at_s: float
    ended: bool


def read_audio(path: Path | str) -> Samples:
    """The whole file as 16 kHz mono 16-bit, its channels mixed. Any format that libsndfile reads, any rate.

    Raises AudioError if it is missing, empty, longer than LONGEST_FILE_S, or no audio.
    """
    path = Path(path)
    if path.is_dir():
        raise AudioError(f"{path} is a folder: name one audio file")
    if not path.is_file():
        raise AudioError(f"audio file {path} does not exist: check its name")
    try:
        with soundfile.SoundFile(path) as file:
            if file.frames > LONGEST_FILE_S * file.samplerate:
                raise AudioError(f"audio file {path} is longer than {LONGEST_FILE_S / 3600:.0f} hours: cut it")
            rate_hz = int(file.samplerate)
            if rate_hz < LOWEST_RATE_HZ:
                raise AudioError(
                    f"audio file {path} has {rate_hz} samples a second, too few for speech: record it again"
                )
            data = file.read(dtype="float32", always_2d=True)
    except (soundfile.SoundFileError, OSError, RuntimeError) as error:
        raise AudioError(f"audio file {path} cannot be read as audio: give a wav, flac, ogg or mp3 file") from error
    mono = data.mean(axis=1, dtype=np.float32)
    if mono.size == 0:
        raise AudioError(f"audio file {path} is empty: give a recording that contains sound")
    if not np.isfinite(mono).all():
        raise AudioError(f"audio file {path} holds samples that are not numbers: record or convert it again")
    if rate_hz != SAMPLE_RATE_HZ:
        mono = soxr.resample(mono, rate_hz, SAMPLE_RATE_HZ)
    samples: Samples = np.clip(np.rint(mono * 32768.0), -32768, 32767).astype(np.int16)
    return samples


def chunks(samples: Samples, chunk_samples: int = CHUNK_SAMPLES) -> Iterator[Chunk]:
    """The samples in chunks, the last one shorter if need be."""
    for start in range(0, len(samples), chunk_samples):
        part = samples[start : start + chunk_samples]
        yield Chunk(part, (start + len(part)) / SAMPLE_RATE_HZ)


def quiet(duration_s: float) -> Samples:
    """Digital silence."""
    return np.zeros(round(duration_s * SAMPLE_RATE_HZ), np.int16)
