"""Where a voice begins and ends, from the signal's level against the noise around it.

The decoder's own endpoint waits half a second to a second; this one knows within a few hundredths.
"""

from __future__ import annotations

import math

import numpy as np

from modalities.voice.audio import SAMPLE_RATE_HZ, Samples

FRAME_SAMPLES = 160
FRAME_S = FRAME_SAMPLES / SAMPLE_RATE_HZ
QUIETEST_DBFS = -60.0
"""Below this nothing counts as voice."""
ABOVE_NOISE_DB = 9.0
"""A voice stands this far above the noise floor."""
BELOW_PEAK_DB = 26.0
"""What is this far below the utterance's own loudest frame no longer counts as voice."""
FLOOR_RISE_DB_S = 6.0
"""How fast the noise floor follows a noise that gets louder; it follows a quieter one at once."""
SMOOTH_FRAMES = 3


class VoiceActivityDetector:
    """Follows a signal and knows when the last voice in it ended. Times are those of the recording."""

    def __init__(self) -> None:
        self.last_voice_s = -math.inf
        """End of the last frame that held voice; -inf: none since `forget`."""
        self.speaking = False
        self._floor_dbfs = QUIETEST_DBFS - ABOVE_NOISE_DB
        self._peak_dbfs = -math.inf
        self._recent: list[float] = []
        self._rest = np.zeros(0, np.int16)

    @property
    def has_spoken(self) -> bool:
        """Whether there was voice since `forget`."""
        return math.isfinite(self.last_voice_s)

    def accept(self, samples: Samples, captured_at_s: float) -> None:
        """Take the next samples, the last of them captured at captured_at_s."""
        data = np.concatenate([self._rest, samples])
        n = len(data) // FRAME_SAMPLES
        self._rest = data[n * FRAME_SAMPLES :]
        frames = data[: n * FRAME_SAMPLES].reshape(n, FRAME_SAMPLES).astype(np.float64) / 32768.0
        first_s = captured_at_s - len(data) / SAMPLE_RATE_HZ
        powers = frames.var(axis=1)  # variance: a constant offset is no sound
        for i, level in enumerate(10.0 * np.log10(powers + 1e-12)):
            self._frame(float(level), first_s + (i + 1) * FRAME_S)

    def forget(self) -> None:
        """Begin a new utterance; the noise floor is kept."""
        self.last_voice_s = -math.inf
        self.speaking = False
        self._peak_dbfs = -math.inf

    def cut(self) -> None:
        """The next samples do not follow the last ones. The noise floor is kept."""
        self._rest = self._rest[:0]
        self._recent = []

    def _frame(self, level_dbfs: float, end_s: float) -> None:
        self._recent = [*self._recent, level_dbfs][-SMOOTH_FRAMES:]
        smooth = sum(self._recent) / len(self._recent)
        if smooth < self._floor_dbfs:
            self._floor_dbfs = max(smooth, QUIETEST_DBFS - ABOVE_NOISE_DB)
        else:
            self._floor_dbfs = min(smooth, self._floor_dbfs + FLOOR_RISE_DB_S * FRAME_S)
        threshold = max(QUIETEST_DBFS, self._floor_dbfs + ABOVE_NOISE_DB, self._peak_dbfs - BELOW_PEAK_DB)
        self.speaking = smooth > threshold and level_dbfs > QUIETEST_DBFS
        if self.speaking:
            self.last_voice_s = end_s
            self._peak_dbfs = max(self._peak_dbfs, smooth)
