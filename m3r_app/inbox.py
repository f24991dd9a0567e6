"""The one bounded queue of events between everything that tells of something and the arbiter. Source: X4, design "The flow"."""

from __future__ import annotations

import asyncio
from collections import deque

from m3r_app.arbiter.events import Event, NeighboursHeard, PropertyBroken, Requested, TelemetryArrived, Tick
from safety.vocabulary import Command

SIZE = 512


class Inbox:
    """The one bounded queue. STOP and a property that does not hold go before everything else; of telemetry the oldest is dropped when it is full."""

    def __init__(self, size: int = SIZE) -> None:
        self._urgent: deque[Event] = deque()
        self._waiting: deque[Event] = deque()
        self._size = size
        self._arrived = asyncio.Event()
        self.dropped = 0

    def put(self, event: Event) -> None:
        """Never blocks. From the event loop only."""
        if isinstance(event, PropertyBroken) or (
            isinstance(event, Requested) and event.request.command is Command.STOP
        ):
            self._urgent.append(event)
        else:
            self._waiting.append(event)
            if len(self._waiting) > self._size:
                self._drop_one()
        self._arrived.set()

    def _drop_one(self) -> None:
        self.dropped += 1
        for event in self._waiting:
            if isinstance(event, TelemetryArrived | NeighboursHeard | Tick):
                self._waiting.remove(event)
                return
        self._waiting.popleft()

    @property
    def empty(self) -> bool:
        return not self._urgent and not self._waiting

    async def get(self) -> Event:
        """The next event."""
        while not self._urgent and not self._waiting:
            self._arrived.clear()
            await self._arrived.wait()
        return self._urgent.popleft() if self._urgent else self._waiting.popleft()
