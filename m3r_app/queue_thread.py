"""A thread that works off a queue, so that whoever puts something in never waits: not for a disk, a reader or a loudspeaker."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator
from typing import Generic, TypeVar

Item = TypeVar("Item")


class QueueThread(Generic[Item]):
    """Runs `work` on a daemon thread of its own from `start` on; `work` iterates over the items until `close` is called."""

    def __init__(self, name: str, work: Callable[[], None], longest: int | None = None) -> None:
        """longest: so many items may wait, and what is put in beyond that is dropped; None: any number."""
        self._longest = longest
        self._closed = threading.Event()
        self._queue: queue.SimpleQueue[Item | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=work, name=name, daemon=True)

    def start(self) -> None:
        self._thread.start()

    def put(self, item: Item) -> bool:
        """Queue it; it may not be changed afterwards. Never blocks. False: dropped, since the queue is full or closed.

        From any thread.
        """
        if self._closed.is_set() or (self._longest is not None and self._queue.qsize() >= self._longest):
            return False
        self._queue.put(item)
        return True

    def close(self, timeout_s: float) -> bool:
        """Let it work off what waits. True if it has ended within timeout_s. Safe to call twice."""
        if not self._closed.is_set():
            self._closed.set()
            self._queue.put(None)
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    @property
    def closed(self) -> bool:
        return self._closed.is_set()

    @property
    def alive(self) -> bool:
        return self._thread.is_alive()

    @property
    def waiting(self) -> int:
        """How many items wait."""
        return self._queue.qsize()

    def __iter__(self) -> Iterator[Item]:
        """The items as they come, until the queue is closed. For `work` alone."""
        while (item := self._queue.get()) is not None:
            yield item

    def or_after(self, wait_s: Callable[[], float | None]) -> Iterator[Item | None]:
        """As iterating does, but None whenever nothing has come for so long. wait_s: asked each time; None: for ever."""
        while True:
            try:
                item = self._queue.get(timeout=wait_s())
            except queue.Empty:
                yield None
                continue
            if item is None:
                return
            yield item
