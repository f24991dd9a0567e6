"""How well a voice can be heard at all: its level, how far it stands above the noise, and whether half of it is missing.

Fed with what is captured, as it is captured. Every figure is of the last WITHIN_S; a warning is given once.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from modalities.voice.audio import SAMPLE_RATE_HZ, Samples

FRAME_SAMPLES = 512
"""32 ms."""
WITHIN_S = 12.0
VOICED_FRAMES = 12
"""Fewer frames of voice than this (0.4 s) say nothing."""
VOICE_ABOVE_NOISE_DB = 9.0
LOW_LEVEL_DBFS = -46.0
"""The loud frames of a voice that was recorded with the level turned up lie at -35 dBFS and above."""
TOO_NOISY_DBFS = -27.0
"""With the noise above this for NOISE_FOR_S a usual voice (-21 dBFS) stands 5 dB above it: four requests in five are then recognised."""
NOISE_FOR_S = 5.0
NARROW_DB = -58.0
"""How much weaker everything above 4 kHz is than the voice below, in the sharpest of its frames: a voice that came through a telephone."""
_LOW_HZ, _HIGH_HZ = (300.0, 3400.0), (4600.0, 7400.0)
_SHARPEST_PERCENT = 95.0
_TINY = 1e-12


@dataclass(frozen=True, slots=True)
class Hearing:
    """noise_dbfs, voice_dbfs: of the quiet frames and of the loud ones; None: no voice yet."""

    noise_dbfs: float
    voice_dbfs: float | None

    @property
    def snr_db(self) -> float | None:
        """How far the voice stands above the noise."""
        return None if self.voice_dbfs is None else self.voice_dbfs - self.noise_dbfs


@dataclass(frozen=True, slots=True)
class Loudness:
    """level_dbfs: of the last chunk; snr_db: see Hearing."""

    level_dbfs: float
    snr_db: float | None


class _Frame(NamedTuple):
    """low_db, high_db: power in the two bands, to the same unit."""

    level_dbfs: float
    low_db: float
    high_db: float


class SoundCheck:
    """Samples in, sentences for the operator out."""

    def __init__(self) -> None:
        self._rest: Samples = np.zeros(0, np.int16)
        self._frames: deque[_Frame] = deque(maxlen=round(WITHIN_S * SAMPLE_RATE_HZ / FRAME_SAMPLES))
        self._window = np.hanning(FRAME_SAMPLES)
        hz = np.fft.rfftfreq(FRAME_SAMPLES, 1.0 / SAMPLE_RATE_HZ)
        self._low, self._high = ((hz >= low) & (hz <= high) for low, high in (_LOW_HZ, _HIGH_HZ))
        self._said: set[str] = set()

    def accept(self, samples: Samples) -> list[str]:
        """The next samples; what is newly wrong with them."""
        data = np.concatenate([self._rest, samples])
        count = len(data) // FRAME_SAMPLES
        self._rest = data[count * FRAME_SAMPLES :]
        if count:
            frames = data[: count * FRAME_SAMPLES].reshape(count, -1) / 32768.0
            spectra = np.abs(np.fft.rfft(frames * self._window, axis=1)) ** 2
            low, high = (10.0 * np.log10(spectra[:, band].sum(axis=1) + _TINY) for band in (self._low, self._high))
            levels = 10.0 * np.log10(frames.var(axis=1) + _TINY)
            self._frames.extend(
                _Frame(*frame) for frame in zip(levels.tolist(), low.tolist(), high.tolist(), strict=True)
            )
        return self._newly(self._wrong()) if count else []

    @property
    def hearing(self) -> Hearing:
        """As of now."""
        if not self._frames:
            return Hearing(-100.0, None)
        levels = np.array([level for level, _, _ in self._frames])
        noise_dbfs = float(np.percentile(levels, 15))
        voiced = levels[levels > noise_dbfs + VOICE_ABOVE_NOISE_DB]
        if len(voiced) < VOICED_FRAMES:
            return Hearing(noise_dbfs, None)
        return Hearing(noise_dbfs, float(np.percentile(voiced, 75)))

    def _wrong(self) -> list[tuple[str, str]]:
        hearing = self.hearing
        voice_dbfs = hearing.voice_dbfs
        if voice_dbfs is None:
            long_enough = len(self._frames) * FRAME_SAMPLES >= NOISE_FOR_S * SAMPLE_RATE_HZ
            if long_enough and hearing.noise_dbfs > TOO_NOISY_DBFS:
                sentence = (
                    f"too noisy for voice (noise of {hearing.noise_dbfs:.0f} dBFS, no voice stands {VOICE_ABOVE_NOISE_DB:.0f} dB "
                    "above it): use a headset, or hands"
                )
                return [("noise", sentence)]
            return []
        wrong: list[tuple[str, str]] = []
        if voice_dbfs < LOW_LEVEL_DBFS:
            wrong.append(
                ("level", f"the voice is very quiet ({voice_dbfs:.0f} dBFS): turn the microphone's input level up")
            )
        if self._is_narrow(hearing):
            wrong.append(
                (
                    "band",
                    "the voice lacks everything above 4 kHz, as through a telephone: use a wired headset or a wider Bluetooth profile",
                )
            )
        return wrong

    def _is_narrow(self, hearing: Hearing) -> bool:
        voiced = [frame for frame in self._frames if frame.level_dbfs > hearing.noise_dbfs + VOICE_ABOVE_NOISE_DB]
        low_db, high_db = np.percentile([(frame.low_db, frame.high_db) for frame in voiced], _SHARPEST_PERCENT, axis=0)
        return bool(high_db - low_db < NARROW_DB)

    def _newly(self, wrong: list[tuple[str, str]]) -> list[str]:
        new = [sentence for kind, sentence in wrong if kind not in self._said]
        self._said |= {kind for kind, _ in wrong}
        return new
