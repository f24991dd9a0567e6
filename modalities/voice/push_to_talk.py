"""Push-to-talk: the operator is heard only while they have opened the microphone with a key. Source: R1, X4.

A terminal tells when a key goes down, not when it comes up: so Enter opens the microphone, and Enter closes it again.
"""

from __future__ import annotations

import os
import select
import threading
from collections.abc import Callable, Iterator

LOOK_S = 0.2


class PushToTalk:
    """Whether the operator is to be heard now; closed at first. Any thread."""

    def __init__(self, say: Callable[[str], None], key: str = "Enter") -> None:
        """say: told, in a sentence, whenever it changes. key: the name of the key that toggles it."""
        self._key = key
        self._open = threading.Event()
        self._say = say

    def talking(self) -> bool:
        return self._open.is_set()

    def toggle(self) -> None:
        """Open what is closed, close what is open."""
        if self._open.is_set():
            self.close()
        else:
            self._open.set()
            self._say(f"the microphone is open: press {self._key} when you have spoken")

    def close(self) -> None:
        """From now on nothing is heard."""
        if self._open.is_set():
            self._open.clear()
            self._say(f"the microphone is closed, a spoken stop too is not heard: press {self._key} to speak")

    def follow(self, terminal: int) -> None:
        """Enter in this terminal (a file descriptor) toggles it from now on; when the terminal is gone, it is closed."""

        def watch() -> None:
            for _ in _enters(terminal):
                self.toggle()
            self.close()

        threading.Thread(target=watch, name="push-to-talk", daemon=True).start()


def _enters(terminal: int) -> Iterator[None]:
    """Once for every Enter, until the terminal is gone."""
    pause = threading.Event()
    while True:
        try:
            readable, _, _ = select.select([terminal], [], [], LOOK_S)
            if not readable:
                continue
            if not _ours(terminal):
                pause.wait(LOOK_S)
                continue
            typed = os.read(terminal, 1024)
        except (OSError, ValueError):
            return
        if not typed:
            return
        for _ in range(typed.count(b"\n")):
            yield


def _ours(terminal: int) -> bool:
    """A process that reads its terminal from the background is suspended, which an app that flies must never be."""
    try:
        return os.tcgetpgrp(terminal) == os.getpgrp()
    except OSError:
        return True  # it does not control us, so it does not suspend us
