"""Which of several channels to hear: their mix, unless one alone carries the voice better.

A cable with one side the wrong way round cancels the voice in the mix; a second microphone far away adds but noise. Pure.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

FRAME_S = 0.02
BETTER_DB = 3.0
"""So much more voice over noise a channel alone must have to be taken instead of the mix."""
LOST_DB = 7.0
"""A mix this far below its loudest channel has lost the voice: equal channels lose nothing, a silent second one 6 dB."""
WITHIN_S = 10.0
DECIDE_EVERY_S = 0.25
FULL_SCALE = 32768.0
_FLOOR_DBFS = -80.0
"""What is quieter counts as this: that one channel is gated and another has its noise says nothing of their voices."""

Floats = NDArray[np.float32]


def mixed(data: Floats, rate_hz: int) -> Floats:
    """data: (samples, channels) of a whole recording; the channel or mix to hear, (samples,)."""
    if data.shape[1] == 1:
        return data[:, 0]
    candidates = _candidates(data)
    chosen: Floats = candidates[best(_levels_dbfs(candidates, max(1, round(FRAME_S * rate_hz))))]
    return chosen


def best(levels_dbfs: NDArray[np.float64]) -> int:
    """levels_dbfs: (1 + channels, frames), the mix first. Which one to hear: 0 is the mix."""
    quiet_db, loud_db = np.percentile(levels_dbfs, (10, 95), axis=1)
    voice_db = loud_db - quiet_db
    alone = 1 + int(np.argmax(voice_db[1:]))
    lost = loud_db[0] < loud_db[alone] - LOST_DB
    return alone if lost or voice_db[alone] > voice_db[0] + BETTER_DB else 0


class LiveMix:
    """The same for blocks as they come: what to hear is decided anew four times a second, by the last ten seconds."""

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self._levels: deque[tuple[float, NDArray[np.float64]]] = deque()
        self._at_s = 0.0
        self._decided_s = 0.0
        self._chosen = 0

    def accept(self, data: Floats) -> Floats:
        """data: (samples, channels), the next ones, full scale 32768. What is to be heard of them, (samples,)."""
        if data.shape[1] == 1:
            return data[:, 0]
        candidates = _candidates(data)
        self._at_s += len(data) / self._rate_hz
        self._levels.append((self._at_s, _levels_dbfs(candidates / FULL_SCALE, len(data))))
        while self._levels[0][0] < self._at_s - WITHIN_S:
            self._levels.popleft()
        if self._at_s - self._decided_s >= DECIDE_EVERY_S:
            self._decided_s = self._at_s
            self._chosen = best(np.concatenate([levels for _, levels in self._levels], axis=1))
        chosen: Floats = candidates[self._chosen]
        return chosen


def _candidates(data: Floats) -> Floats:
    return np.concatenate([data.mean(axis=1, keepdims=True, dtype=np.float32), data], axis=1).T


def _levels_dbfs(candidates: Floats, frame: int) -> NDArray[np.float64]:
    """(candidates, frames): root mean square of each frame without its constant offset, below a full scale of 1."""
    count = max(1, candidates.shape[1] // frame)
    whole = candidates[:, : count * frame].astype(np.float64)
    power = whole.reshape(len(candidates), count, -1).var(axis=2)
    levels: NDArray[np.float64] = np.maximum(_FLOOR_DBFS, 10.0 * np.log10(power + 1e-12))
    return levels
