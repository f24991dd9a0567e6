"""A voice that arrives too quiet is raised before it is recognised: slowly, up to a ceiling, and never a noise with it.

The gain falls at once where sound is loud, so that nothing is clipped, and rises slowly; it depends on what has been heard only,
so a recording and a microphone are treated alike.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from modalities.voice.audio import SAMPLE_RATE_HZ, Samples

FRAME_SAMPLES = 160
TARGET_DBFS = -26.0
"""Where the loud frames of a voice are brought to; what is louder already is left as it is."""
CEILING_DB = 40.0
NOISE_DBFS = -62.0
"""No gain brings the noise between the words above this: it would be taken for a voice."""
RISE_DB_S = 6.0
FLOOR_RISE_DB_S = 3.0
SILENCE_DBFS = -100.0


class SlowGain:
    """Samples in, the same raised out."""

    def __init__(self) -> None:
        self._floor_dbfs = math.inf
        self._peak_dbfs = -math.inf
        self._gain_db: float | None = None

    @property
    def gain_db(self) -> float:
        return self._gain_db or 0.0

    def accept(self, samples: Samples) -> Samples:
        """The next samples."""
        if not len(samples):
            return samples
        span_s = len(samples) / SAMPLE_RATE_HZ
        levels_dbfs = _levels_dbfs(samples)
        quiet_dbfs = float(np.median(levels_dbfs))
        self._floor_dbfs = min(quiet_dbfs, self._floor_dbfs + FLOOR_RISE_DB_S * span_s)
        self._peak_dbfs = max(float(levels_dbfs.max()), self._peak_dbfs - RISE_DB_S * span_s)
        wanted_db = min(TARGET_DBFS - self._peak_dbfs, NOISE_DBFS - self._floor_dbfs, CEILING_DB)
        wanted_db = max(0.0, wanted_db)
        before_db = wanted_db if self._gain_db is None else self._gain_db
        self._gain_db = min(wanted_db, before_db + RISE_DB_S * span_s)
        if self._gain_db == 0.0 == before_db:
            return samples
        # From the last gain to this one within a frame, or a click would be heard; down at once where it would clip.
        gains_db = np.full(len(samples), self._gain_db)
        ramp = min(FRAME_SAMPLES, len(samples))
        gains_db[:ramp] = np.linspace(before_db, self._gain_db, ramp)
        raised = samples * 10.0 ** (gains_db / 20.0)
        return np.clip(np.rint(raised), -32768, 32767).astype(np.int16)


def _levels_dbfs(samples: Samples) -> NDArray[np.float64]:
    count = max(1, len(samples) // FRAME_SAMPLES)
    frames = samples[: count * FRAME_SAMPLES].reshape(count, -1).astype(np.float64) / 32768.0
    power = frames.var(axis=1)
    levels: NDArray[np.float64] = np.maximum(SILENCE_DBFS, 10.0 * np.log10(power + 1e-12))
    return levels
