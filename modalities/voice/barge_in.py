"""*Stop*, heard through what the app itself is saying.

A decoder that has been following the app's own words takes the operator's for more of them. So while a cue is spoken,
the last WINDOW_S of sound are decoded by themselves, again for every chunk. Source: X4 (STOP from any modality, at any time), design 3.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from modalities.voice.audio import CHUNK_SAMPLES, SAMPLE_RATE_HZ, Samples, quiet

WINDOW_S = 0.8
"""Long enough for the word, short enough to leave out most of what the app says before it."""
EVERY_SAMPLES = 2 * CHUNK_SAMPLES
AGREEING = 2
"""Successive looks that must find it: one alone is found in 4 % of our own cues, two in 1 % or less."""


class BargeIn:
    """Looks for *stop* in the last WINDOW_S of what is heard."""

    def __init__(self, finds: Callable[[Samples], bool]) -> None:
        """finds: whether the word is in these samples, decoded by themselves."""
        self._finds = finds
        self._heard: Samples = quiet(0.0)
        self._new = 0
        self._found = 0

    def accept(self, samples: Samples) -> bool:
        """Take the next samples, heard while the app speaks; whether *stop* is in the last of them."""
        self._heard = np.concatenate([self._heard, samples])[-round(WINDOW_S * SAMPLE_RATE_HZ) :]
        self._new += len(samples)
        if self._new < EVERY_SAMPLES or len(self._heard) < WINDOW_S * SAMPLE_RATE_HZ / 2:
            return False
        self._new = 0
        self._found = self._found + 1 if self._finds(self._heard) else 0
        return self._found >= AGREEING

    def forget(self) -> None:
        """The app is silent again, or it has been found."""
        self._heard = quiet(0.0)
        self._new = 0
        self._found = 0
