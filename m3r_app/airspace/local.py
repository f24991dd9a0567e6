"""The answer in process for one laptop alone. `m3r_app.airspace.shared` asks the same of an authority over a broker.

Source: X8, X10, R5, paper III-A, V; design "reserve".
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

from m3r_app.airspace import authority
from m3r_app.airspace.authority import App, Authority
from m3r_app.airspace.interface import Answered
from safety.vocabulary import Geodetic, Neighbours, ReservedVolume

HERE = App("you", "here")


class LocalAirspace:
    """The authority in this process: nobody else asks it, and a claim needs no renewing."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._authority = Authority()

    async def claim(self, drone: str, operator: Geodetic) -> str | None:  # noqa: ARG002  (only one stands here)
        self._authority, verdict = authority.claim(self._authority, drone, HERE, None, self._clock())
        return None if verdict.granted else verdict.reason

    def give_up(self, drone: str) -> None:
        self._authority, _ = authority.give_up(self._authority, drone, HERE, self._clock())

    def lost(self, drone: str) -> str | None:  # noqa: ARG002
        return None

    def reserve(self, drone: str, lease: str, volume: ReservedVolume, answered: Answered) -> None:
        now_s = self._clock()
        self._authority, mine = authority.claim(self._authority, drone, HERE, None, now_s)
        self._authority, verdict = authority.reserve(self._authority, drone, HERE, mine.fence, lease, volume, now_s)
        answered("granted" if verdict.granted else "denied", verdict.reason)

    def free(self, drone: str, lease: str) -> None:
        self._authority, _ = authority.free(self._authority, drone, HERE, lease, self._clock())

    def held_by_others(self, drone: str) -> tuple[ReservedVolume, ...]:
        self._authority = authority.current(self._authority, self._clock())
        return tuple(v.volume for v in self._authority.volumes.values() if v.drone != drone)

    def neighbours(self, own: str, linked: Neighbours, now_s: float) -> Neighbours:  # noqa: ARG002
        return linked

    async def news(self) -> None:
        await asyncio.Event().wait()  # nobody tells anything

    @property
    def trouble(self) -> str | None:
        return None
