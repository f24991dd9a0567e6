"""A modality's recogniser at work on a thread of its own, so that it never holds up the control loop."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable


class ThreadedStream(ABC):
    """Runs `_recognise` once, on a daemon thread, and tells how it ended. Every callback runs in that thread."""

    def __init__(self, name: str, on_end: Callable[[Exception | None], None]) -> None:
        """name: the thread's. on_end: called last, once, with the error that ended the stream, or None where its input was
        played or `stop` was called.
        """
        self._on_end = on_end
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self, timeout_s: float = 5.0) -> bool:
        """End it. True if the thread has ended within timeout_s (it takes no more than one more chunk or picture)."""
        self._stopping.set()
        if self._thread.ident is not None and self._thread is not threading.current_thread():
            self._thread.join(timeout_s)
        return not self._thread.is_alive()

    @property
    def alive(self) -> bool:
        return self._thread.is_alive()

    @abstractmethod
    def _recognise(self) -> None:
        """Take the input to its end, or until `_stopping` is set. Whatever it raises ends the stream."""

    def _run(self) -> None:
        error: Exception | None = None
        try:
            self._recognise()
        except Exception as raised:  # noqa: BLE001 whatever it is, the app must know that nobody listens any more
            error = raised
        self._on_end(error)
