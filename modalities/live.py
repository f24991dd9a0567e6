"""What a live modality is to the rest of the app, and how its requests reach it: few, and STOP first.

A room of `modalities` describes itself with a `LiveModality`; `modalities.rooms` lists them. From that come its option, its
start and end in a run, and its lines in `m3r check`. Source: R1, X4.
"""

from __future__ import annotations

import contextlib
import threading
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from modalities.notices import Say
from safety.vocabulary import Command, ManeuverRequest

if TYPE_CHECKING:
    from config.settings import Settings  # loads pydantic, which the options alone do not need

Clock = Callable[[], float]
"""The app's monotonic seconds, from any thread."""
Take = Callable[[ManeuverRequest], None]
"""Takes a request, from any thread."""
WAITING = 16
"""So many requests of one modality wait for the event loop, STOP not counted."""


class LiveInputError(ValueError):
    """A device that cannot be used at all; one sentence that says what is `wrong`, a colon, and the `remedy`."""

    def __init__(self, wrong: str, remedy: str) -> None:
        super().__init__(f"{wrong}: {remedy}")
        self.wrong = wrong
        self.remedy = remedy


class LiveInput(Protocol):
    """An open device. It reads in a thread or process of its own and tells by itself what becomes of the device."""

    @property
    def sentences(self) -> tuple[str, ...]:
        """What it is and how it is used, for the operator, before anything flies."""

    def start(self, take: Take) -> None:
        """From now on what is asked for counts. Returns at once; once only."""

    def close(self) -> None:
        """Let the device go; calling it again does nothing. May take a second."""


@dataclass(frozen=True, slots=True)
class Seen:
    """One line of `m3r check`. remedy: what to do, None where the device works; missing: it cannot be used."""

    part: str
    text: str
    remedy: str | None = None
    missing: bool = False


@dataclass(frozen=True, slots=True)
class LiveModality:
    """name: its option `--name`, which may be given `metavar`. open, look: the option's value, "" for none; `open` raises LiveInputError."""

    name: str
    metavar: str
    about: str
    open: Callable[[str, Settings, Clock, Say], LiveInput]
    look: Callable[[str, Settings], Iterable[Seen]]


class Handover:
    """Requests on their way from a modality's thread into the event loop: a bounded queue in which STOP goes first."""

    def __init__(self, wake: Callable[[Callable[[], None]], object], sink: Take) -> None:
        """wake: has the event loop call something soon (`loop.call_soon_threadsafe`); sink: called there."""
        self._wake = wake
        self._sink = sink
        self._lock = threading.Lock()
        self._waiting: deque[ManeuverRequest] = deque()
        self._woken = False
        self.dropped = 0

    def put(self, request: ManeuverRequest) -> None:
        """From any thread; never waits. What finds the queue full is dropped, STOP never."""
        with self._lock:
            if request.command is Command.STOP:
                self._waiting.appendleft(request)
            elif len(self._waiting) < WAITING:
                self._waiting.append(request)
            else:
                self.dropped += 1
            woken, self._woken = self._woken, True
        if not woken:
            with contextlib.suppress(RuntimeError):  # the loop has closed: nobody is left to ask
                self._wake(self._drain)

    def _drain(self) -> None:
        with self._lock:
            taken = tuple(self._waiting)
            self._waiting.clear()
            self._woken = False
        for request in taken:
            self._sink(request)
