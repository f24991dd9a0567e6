"""Audio from a file as a microphone would give it: small chunks of 16 kHz mono 16-bit, each with its capture time.

Time is counted from the data, never from a clock, so a recording behaves like a live microphone; a live microphone
(`modalities.voice.microphone`) is another iterator of `Chunk`s, with `Gap`s where sound is missing.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import soxr
from numpy.typing import NDArray

from modalities.voice.audio_file import AudioError, decoded
from modalities.voice.channels import mixed

__all__ = ["CHUNK_SAMPLES", "SAMPLE_RATE_HZ", "AudioError", "Chunk", "Gap", "Samples", "chunks", "quiet", "read_audio"]

SAMPLE_RATE_HZ = 16_000
CHUNK_SAMPLES = 800
"""50 ms: how often partial results are looked at."""

Samples = NDArray[np.int16]


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
    """The whole file as 16 kHz mono 16-bit, the better of its channels or their mix. Any format that libsndfile or FFmpeg
    reads, any rate.

    Raises AudioError if it is missing, empty, longer than LONGEST_FILE_S, or no audio.
    """
    sound = decoded(Path(path))
    mono = mixed(sound.data, sound.rate_hz)
    if sound.rate_hz != SAMPLE_RATE_HZ:
        mono = soxr.resample(mono, sound.rate_hz, SAMPLE_RATE_HZ)
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
