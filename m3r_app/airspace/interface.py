"""Whom a drone and a piece of air belong to: what the app asks. `local` answers in process, `shared` over a broker.

Source: X8, X10, R5, paper III-A, V; design "reserve".
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, Protocol

from safety.vocabulary import Geodetic, Neighbours, ReservedVolume

Answered = Callable[[Literal["granted", "denied"], str], None]
"""Told once: granted, or denied with one sentence."""


class Airspace(Protocol):
    """An answer may never come; whoever asks has a deadline."""

    async def claim(self, drone: str, operator: Geodetic) -> str | None:
        """Have the drone to oneself until given up or lost; None, or one sentence that says why not."""
        ...

    def give_up(self, drone: str) -> None:
        """Let it go, with every volume reserved for it."""
        ...

    def lost(self, drone: str) -> str | None:
        """Why a claimed drone is ours no longer; None while it is."""
        ...

    def reserve(self, drone: str, lease: str, volume: ReservedVolume, answered: Answered) -> None:
        """Have a volume for a maneuver. volume: session's frame, times of the app's clock."""
        ...

    def free(self, drone: str, lease: str) -> None:
        """The maneuver is over."""
        ...

    def held_by_others(self, drone: str) -> tuple[ReservedVolume, ...]:
        """The live volumes of all other drones, session's frame."""
        ...

    def neighbours(self, own: str, linked: Neighbours, now_s: float) -> Neighbours:
        """The aircraft that we are linked with, and those that others tell of."""
        ...

    async def news(self) -> None:
        """Wait until somebody has told something."""
        ...

    @property
    def trouble(self) -> str | None:
        """What is missing of the shared air, in two words; None: nothing."""
        ...
