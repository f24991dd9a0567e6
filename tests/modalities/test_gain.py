"""A quiet voice is raised, a noise is not, and what is wrong with the sound is told once."""

from __future__ import annotations

import numpy as np
import pytest
import soxr

from modalities.voice.audio import SAMPLE_RATE_HZ, Chunk, Samples, chunks, quiet
from modalities.voice.capture import Block, Converter, level_dbfs
from modalities.voice.gain import CEILING_DB, NOISE_DBFS, TARGET_DBFS, SlowGain
from modalities.voice.sound_check import SoundCheck

RNG = np.random.default_rng(5)
HISS = RNG.normal(0.0, 1.0, 4 * SAMPLE_RATE_HZ)


def at(level: float, wave: np.ndarray) -> Samples:
    """`wave` scaled to a level in dB below full scale."""
    return np.rint(wave / wave.std() * 32768.0 * 10 ** (level / 20)).clip(-32768, 32767).astype(np.int16)


def voiced(level_dbfs: float, noise_dbfs: float = -85.0, seconds: float = 3.0) -> Samples:
    """Bursts of vowel and hiss, as in speech, with pauses between them, over a noise."""
    t_s = np.arange(round(seconds * SAMPLE_RATE_HZ)) / SAMPLE_RATE_HZ
    vowel = sum(np.sin(2 * np.pi * 180.0 * k * t_s) / k for k in range(1, 14))
    hiss = np.diff(HISS[: len(t_s) + 1]) * 0.7
    speaks = (t_s % 0.6 > 0.2) * (t_s > 0.3)
    wave = np.where(t_s % 0.6 > 0.45, hiss, vowel) * speaks
    return at(level_dbfs, wave) + at(noise_dbfs, HISS[: len(t_s)])


def raised(samples: Samples) -> Samples:
    gain = SlowGain()
    return np.concatenate([gain.accept(chunk.samples) for chunk in chunks(samples)])


@pytest.mark.parametrize("lower_db", [0.0, 20.0, 40.0])
def test_a_voice_is_brought_to_where_it_is_recognised(lower_db: float) -> None:
    out = raised(voiced(-30.0 - lower_db, -75.0 - lower_db))
    assert level_dbfs(out) == pytest.approx(-29.0, abs=4.0)


def test_what_is_loud_enough_is_left_as_it_is() -> None:
    samples = voiced(TARGET_DBFS + 3.0, NOISE_DBFS + 3.0)
    assert np.array_equal(raised(samples), samples)


def test_no_noise_is_raised_to_a_voice() -> None:
    assert level_dbfs(raised(at(-75.0, HISS))) <= NOISE_DBFS + 1.5
    loud = at(-50.0, HISS)
    assert np.array_equal(raised(loud), loud)
    assert not raised(quiet(1.0)).any()


def test_a_loud_voice_after_silence_is_not_clipped() -> None:
    gain = SlowGain()
    gain.accept(quiet(2.0))
    assert gain.gain_db == pytest.approx(CEILING_DB, abs=3.0)
    out = gain.accept(at(-20.0, HISS[:800]))
    assert np.abs(out[200:]).max() < 32000
    assert gain.gain_db == 0.0


def test_a_quiet_voice_and_one_through_a_telephone_are_told_once() -> None:
    def told(samples: Samples) -> list[str]:
        check = SoundCheck()
        return [sentence for chunk in chunks(samples) for sentence in check.accept(chunk.samples)]

    assert told(voiced(-25.0)) == []
    (low,) = told(voiced(-58.0))
    assert "very quiet (-" in low
    narrow = soxr.resample(soxr.resample(voiced(-25.0, -60.0).astype(np.float32), 16_000, 8_000), 8_000, 16_000)
    (band,) = told(np.rint(narrow).astype(np.int16))
    assert "through a telephone" in band
    assert told(at(-30.0, HISS)) == [], "noise is no voice"
    (noise,) = told(np.tile(at(-20.0, HISS), 4))
    assert "too noisy for voice (noise of -20 dBFS" in noise


def test_signal_to_noise_is_measured() -> None:
    check = SoundCheck()
    check.accept(voiced(-25.0, -45.0))
    assert check.hearing.snr_db == pytest.approx(22.0, abs=3.0)


def test_a_live_channel_in_opposite_phase_is_left_out() -> None:
    voice = voiced(-25.0)
    stereo = np.stack([voice, -voice], axis=1)
    converter = Converter(SAMPLE_RATE_HZ, 2)
    heard: list[Chunk] = []
    for number, start in enumerate(range(0, len(voice), 800)):
        block = Block(stereo[start : start + 800].tobytes(), (start + 800) / SAMPLE_RATE_HZ, 0.0, number, True)
        heard += converter.accept(block)
    out = np.concatenate([chunk.samples for chunk in heard])
    begun = round(0.8 * SAMPLE_RATE_HZ)
    assert level_dbfs(out[begun:]) == pytest.approx(level_dbfs(voice[begun:]), abs=0.5)
