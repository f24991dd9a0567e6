"""When the app itself spoke, so that what the microphone hears of it is not taken for a request. Source: R1, X4."""

from __future__ import annotations

import math
import threading
from collections import deque

TAIL_S = 0.3
"""How long the echo of a room and the buffers of a sound card go on after the last word."""
KEPT = 64
"""Older utterances than this many are of no use: no voice is that long."""


class SelfSpeech:
    """The times during which something is being spoken, on the app's monotonic clock. Any thread.

    Whoever speaks calls `begins` and `ends`; whoever listens asks `overlaps`.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._spoken: deque[tuple[float, float]] = deque(maxlen=KEPT)
        self._since_s: float | None = None

    def begins(self, at_s: float) -> None:
        """Something is spoken from now on."""
        with self._lock:
            if self._since_s is None:
                self._since_s = at_s

    def ends(self, at_s: float) -> None:
        """It is over, spoken or cut off; nothing where nothing was spoken."""
        with self._lock:
            if self._since_s is not None:
                self._spoken.append((self._since_s, at_s + TAIL_S))
                self._since_s = None

    def overlaps(self, from_s: float, to_s: float) -> bool:
        """Whether something was being spoken at any time from from_s to to_s. A time that is not finite overlaps all."""
        with self._lock:
            spoken = [*self._spoken] if self._since_s is None else [*self._spoken, (self._since_s, math.inf)]
        return any(not (until_s < from_s or to_s < since_s) for since_s, until_s in spoken)
