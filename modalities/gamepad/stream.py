"""A gamepad as a modality of the running app: a thread of its own that turns presses into maneuver requests.

Its requests are the panel's, as sure as those of the console's buttons: a gamepad is a panel in the hand. Losing it, or what
reads it, is STOP. Source: R1, X4.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from typing import Protocol

from modalities.gamepad.reading import Asked, PadEvent, Reading, Told
from modalities.live import Clock, LiveInputError, Take
from modalities.notices import Say
from safety.vocabulary import Command, ManeuverRequest, Modality

POLL_S = 0.01
FIRST_S = 0.5
"""A gamepad that is plugged in has been taken within this."""
OPEN_S = 5.0
JOIN_S = 2.0
CONFIDENCE = 1.0
"""A button is pressed or it is not."""


class PadSource(Protocol):
    """What is looked at; made, used and closed in one thread."""

    @property
    def names(self) -> tuple[str, ...]:
        """Every gamepad that is here."""

    def look(self) -> list[PadEvent]:
        """What happened since the last look. Never waits."""

    def close(self) -> None: ...


class GamepadStream:
    """Reads from when it is made; from `start` on it asks. One of `modalities.live.LiveInput`."""

    def __init__(
        self, opens: Callable[[], PadSource], reading: Reading, wanted: str, *, clock: Clock, say: Say
    ) -> None:
        """opens: called in the reading thread, may raise LiveInputError, as this does within seconds. wanted: a part of the
        gamepad's name, for sentences. say: told, from the reading thread, of loss and return.
        """
        self._opens = opens
        self._reading = reading
        self._wanted = wanted
        self._clock = clock
        self._say = say
        self._take: Take | None = None
        self._made = 0
        self._failure: LiveInputError | None = None
        self._names: tuple[str, ...] = ()
        self._stopping = threading.Event()
        self._ready = threading.Event()
        self._thread = threading.Thread(target=self._run, name="gamepad", daemon=True)
        self._thread.start()
        if not self._ready.wait(OPEN_S):
            self._stopping.set()
            raise LiveInputError("gamepads do not answer", "unplug what is there and plug it in again")
        if self._failure is not None:
            raise self._failure

    @property
    def sentences(self) -> tuple[str, ...]:
        pad = self._reading.pad
        if pad is None:
            named = f" named {self._wanted}" if self._wanted else ""
            others = f" (there is {', '.join(self._names)})" if self._names else ""
            return (f"no gamepad{named} is here{others}: plug it in, and it is taken",)
        doubt = "" if pad.known else "; which of its axes are triggers is not known, so each must rest in its middle"
        return (f"gamepad {pad.name}: buttons and hats ask, any stick or trigger is STOP{doubt}",)

    def start(self, take: Take) -> None:
        self._take = take

    def close(self) -> None:
        self._stopping.set()
        if self._thread is not threading.current_thread():
            self._thread.join(JOIN_S)

    def _run(self) -> None:
        try:
            source = self._opens()
        except LiveInputError as error:
            self._failure = error
            self._ready.set()
            return
        try:
            self._read(source)
        except Exception as error:  # noqa: BLE001 whatever it is, nobody reads any more: the drone holds
            off = f"gamepad is off ({error}) and STOP was asked for: use another way to say stop"
            self._carry_out((Asked(Command.STOP, "gamepad broke"), Told(off)))
        finally:
            self._ready.set()
            source.close()

    def _read(self, source: PadSource) -> None:
        first_s = self._clock() + FIRST_S
        while self._reading.pad is None and self._clock() < first_s and not self._stopping.wait(POLL_S):
            self._look(source)
        self._names = source.names
        self._ready.set()
        started = False
        while not self._stopping.wait(POLL_S):
            if not started and self._take is not None:
                started = True
                self._carry_out(self._reading.start())
            self._look(source)

    def _look(self, source: PadSource) -> None:
        for event in source.look():
            self._carry_out(self._reading.accept(event, self._clock()))

    def _carry_out(self, found: Iterable[Asked | Told]) -> None:
        """In order: STOP comes before what is said of it."""
        take = self._take
        for one in found:
            if isinstance(one, Told):
                self._say(one.sentence)
            elif take is not None:
                self._made += 1
                now_s = self._clock()
                name = f"gamepad-{self._made}"
                take(
                    ManeuverRequest(name, one.command, Modality.PANEL, CONFIDENCE, now_s, now_s, evidence=one.evidence)
                )
