"""Where the events of a run go: JSON lines or sentences, written on a thread of its own.

Whoever reads our output may be slow, stuck or gone, and that may not reach the control loop: `emit` only queues.
"""

from __future__ import annotations

import os
import signal
from typing import Self

from m3r_app.output import Told, line
from m3r_app.queue_thread import QueueThread
from ui.narrator import every_sentence, narrated, sentence

STANDARD_OUTPUT, STANDARD_ERROR = 1, 2
CLOSE_S = 5.0
"""How long the end of a run waits for a reader that does not read."""


class Output:
    """Writes events as they happen; headless: JSON to `out` and sentences to `err`, else sentences to `out`."""

    def __init__(
        self, *, headless: bool, plain: bool = False, out: int = STANDARD_OUTPUT, err: int = STANDARD_ERROR
    ) -> None:
        """plain: a sentence for every event, not only for those that tell something new. out, err: file descriptors, written to without a buffer so that every line is out at once."""
        self._headless = headless
        self._sentence = every_sentence if plain else sentence
        self._out = out
        self._err = err
        self._gone: set[int] = set()
        self._events: QueueThread[Told] = QueueThread("m3r-output", self._run)

    def __enter__(self) -> Self:
        self._events.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._events.close(CLOSE_S)

    def emit(self, event: Told) -> None:
        """Queue one event. Never blocks."""
        self._events.put(event)

    def _run(self) -> None:
        for event in self._events:
            if self._headless:
                self._write(self._out, line(event))
            text = narrated(event, self._sentence)
            if text is not None:
                self._write(self._err if self._headless else self._out, text)

    def _write(self, descriptor: int, text: str) -> None:
        """One line. If nobody reads `out` any more, hang up: the app holds the drone and ends."""
        if descriptor in self._gone:
            return
        data = f"{text}\n".encode(errors="backslashreplace")
        try:
            while data:
                data = data[os.write(descriptor, data) :]
        except OSError as error:
            self._gone.add(descriptor)
            if descriptor == self._out and not isinstance(error, BrokenPipeError):
                self._write(self._err, f"m3r: standard output cannot be written ({error.strerror}): the run ends")
            if descriptor == self._out:
                hang_up()


def discard_stdout() -> None:
    """Whoever read standard output is gone: what is still written there is lost, and is no error."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), STANDARD_OUTPUT)


def hang_up() -> None:
    """Tell the app, as a closed terminal would, that its operator is gone; nothing where nobody waits for that."""
    if callable(signal.getsignal(signal.SIGHUP)):
        os.kill(os.getpid(), signal.SIGHUP)
