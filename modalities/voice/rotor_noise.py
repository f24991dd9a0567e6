"""The noise of a drone that flies nearby, made from nothing, for tests, benchmarks and `m3r evaluate voice --snr`. Pure, seeded.

Four rotors, each a row of harmonics of its slowly wandering blade-pass frequency, plus the broadband wash of their air, which
beats with the blades, plus gusts of wind on the microphone. Shape after published spectra of small multirotors.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modalities.voice.audio import SAMPLE_RATE_HZ, Samples

ROTORS = 4
BLADE_PASS_HZ = (150.0, 240.0)
WANDER = 0.04
"""How far a rotor's speed goes from its mean (standard deviation, as a share): attitude control never rests."""
WANDER_HZ = 1.5
"""How fast it does so."""
HIGHEST_HZ = 6500.0
HARMONIC_ROLL_OFF = 0.9
"""Amplitude of harmonic k: k to the power of minus this, times a seeded factor."""
WASH_SHARE = 0.35
"""Of the power of rotors and wash together."""
WIND_SHARE = 0.3
"""Of all power, where there is wind."""
GUST_HZ = 0.4
WIND_BELOW_HZ = 120.0
FRAME_SAMPLES = 320
VOICE_RANGE_DB = 30.0
"""Frames of a clip this far below its loudest are pauses, which do not count as its level."""

Floats = NDArray[np.float64]


def rotor_noise(samples: int, seed: int, *, wind: bool = True) -> Floats:
    """`samples` values at 16 kHz of root mean square 1. The same seed gives the same noise."""
    random = np.random.default_rng(seed)
    rotors = np.zeros(samples)
    beat = np.zeros(samples)
    for _ in range(ROTORS):
        mean_hz = random.uniform(*BLADE_PASS_HZ)
        hz = mean_hz * (1.0 + WANDER * _slow(samples, WANDER_HZ, random))
        phase = 2.0 * np.pi * np.cumsum(hz) / SAMPLE_RATE_HZ
        for k in range(1, int(HIGHEST_HZ / mean_hz) + 1):
            amplitude = k**-HARMONIC_ROLL_OFF * random.lognormal(0.0, 0.5)
            rotors += amplitude * np.sin(k * phase + random.uniform(0.0, 2.0 * np.pi))
        beat += np.cos(phase)
    wash = _shaped(samples, random, lambda hz: 1.0 / np.sqrt(1.0 + (hz / 1200.0) ** 2)) * (1.0 + 0.3 * beat / ROTORS)
    noise = np.sqrt(1.0 - WASH_SHARE) * _unit(rotors) + np.sqrt(WASH_SHARE) * _unit(wash)
    if wind:
        gusts = np.exp(0.8 * _slow(samples, GUST_HZ, random))
        rumble = _shaped(samples, random, lambda hz: 1.0 / (1.0 + (hz / WIND_BELOW_HZ) ** 2)) * gusts
        noise = np.sqrt(1.0 - WIND_SHARE) * _unit(noise) + np.sqrt(WIND_SHARE) * _unit(rumble)
    return _unit(noise)


def mixed_with(
    voice: Samples, snr_db: float, seed: int, *, around: tuple[Samples, Samples], wind: bool = True
) -> Samples:
    """A clip in noise, which also fills the pauses `around` it (before, after): full-band SNR, against the clip's voice alone."""
    before, after = around
    clip = np.concatenate([before, voice, after]).astype(np.float64)
    level = voice_rms(voice) * 10.0 ** (-snr_db / 20.0)
    mix = clip + level * rotor_noise(len(clip), seed, wind=wind)
    peak = float(np.abs(mix).max())
    if peak > 32767.0:  # as an operator would turn the level down; clipping would be another fault than noise
        mix *= 32767.0 / peak
    mixed: Samples = np.rint(mix).astype(np.int16)
    return mixed


def voice_rms(voice: Samples) -> float:
    """Root mean square (of 32768) of the frames of a clip that are not pauses."""
    count = max(1, len(voice) // FRAME_SAMPLES)
    power = voice[: count * FRAME_SAMPLES].reshape(count, -1).astype(np.float64).var(axis=1)
    return float(np.sqrt(power[power >= power.max() * 10.0 ** (-VOICE_RANGE_DB / 10.0)].mean()))


def _slow(samples: int, hz: float, random: np.random.Generator) -> Floats:
    """A random course of standard deviation 1 that changes at about `hz`."""
    knots = max(4, int(samples / SAMPLE_RATE_HZ * hz * 2.0) + 3)
    return np.interp(np.linspace(0.0, knots - 1.0, samples), np.arange(knots), random.normal(0.0, 1.0, knots))


def _shaped(samples: int, random: np.random.Generator, gain: Callable[[NDArray[Any]], NDArray[Any]]) -> Floats:
    """Noise whose spectrum is `gain` of the frequency in Hz."""
    spectrum = np.fft.rfft(random.normal(0.0, 1.0, samples))
    shaped: Floats = np.fft.irfft(spectrum * gain(np.fft.rfftfreq(samples, 1.0 / SAMPLE_RATE_HZ)), samples)
    return shaped


def _unit(values: Floats) -> Floats:
    rms = float(np.sqrt(np.mean(values**2)))
    return values / rms if rms > 0.0 else values
