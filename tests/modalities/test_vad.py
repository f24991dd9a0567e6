"""Where a voice ends: tones in noise stand for voices, as only the level counts."""

from __future__ import annotations

import math

import numpy as np
import pytest

from modalities.voice.audio import SAMPLE_RATE_HZ, Samples, chunks
from modalities.voice.vad import VoiceActivityDetector


def signal(parts: list[tuple[float, float]], noise: float = 0.0, offset: float = 0.0) -> Samples:
    """Tones of (duration_s, amplitude) in a row, on noise (standard deviation) and a constant offset; full scale 1."""
    tones = [
        amplitude * np.sin(2 * np.pi * 300.0 * np.arange(round(duration_s * SAMPLE_RATE_HZ)) / SAMPLE_RATE_HZ)
        for duration_s, amplitude in parts
    ]
    whole = np.concatenate(tones)
    whole = whole + np.random.default_rng(2).normal(0.0, 1.0, len(whole)) * noise + offset
    return np.clip(whole * 32768.0, -32768, 32767).astype(np.int16)


def followed(samples: Samples, chunk_samples: int = 800) -> VoiceActivityDetector:
    ear = VoiceActivityDetector()
    for chunk in chunks(samples, chunk_samples):
        ear.accept(chunk.samples, chunk.captured_at_s)
    return ear


@pytest.mark.parametrize("noise", [0.0, 0.001, 0.003])
@pytest.mark.parametrize("amplitude", [0.03, 0.1, 0.8])
def test_the_end_is_found_within_hundredths(noise: float, amplitude: float) -> None:
    ear = followed(signal([(1.5, 0.0), (0.6, amplitude), (1.0, 0.0)], noise))
    assert ear.last_voice_s == pytest.approx(2.1, abs=0.05)
    assert not ear.speaking


@pytest.mark.parametrize("chunk_samples", [37, 160, 800, 4000, 48_000])
def test_chunk_sizes_do_not_matter(chunk_samples: int) -> None:
    samples = signal([(1.0, 0.0), (0.5, 0.2), (0.8, 0.0)], 0.001)
    assert followed(samples, chunk_samples).last_voice_s == pytest.approx(followed(samples).last_voice_s)


@pytest.mark.parametrize("offset", [0.0, 0.2])
def test_silence_and_a_constant_offset_are_no_voice(offset: float) -> None:
    assert followed(signal([(3.0, 0.0)], 0.0002, offset)).last_voice_s == -math.inf


def test_steady_noise_is_learnt() -> None:
    """A motor that starts counts as voice at first; then it is the floor, and a voice over it ends when it ends."""
    ear = followed(signal([(10.0, 0.0), (0.6, 0.4), (1.0, 0.0)], 0.02))
    assert ear.last_voice_s == pytest.approx(10.6, abs=0.05)


def test_forgetting_begins_anew_and_keeps_the_floor() -> None:
    ear = followed(signal([(10.0, 0.0), (0.6, 0.4), (1.0, 0.0)], 0.02))
    ear.forget()
    assert ear.last_voice_s == -math.inf
    ear.accept(signal([(1.0, 0.0)], 0.02), 12.6)
    assert ear.last_voice_s == -math.inf
