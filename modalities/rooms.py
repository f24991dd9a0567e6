"""The live modalities that the app has beside voice and hands: a new one is one more of them here."""

from __future__ import annotations

from modalities.gamepad import GAMEPAD
from modalities.live import LiveModality

LIVE: tuple[LiveModality, ...] = (
    GAMEPAD,
)  # fmt: skip
