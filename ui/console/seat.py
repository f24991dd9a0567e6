"""The one seat at a console that several may open (in browser tabs): who uses it, and what the others are told. The
seat is a file that is locked meanwhile; the system unlocks it when the process ends, however that happens.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import time
from typing import TYPE_CHECKING, ClassVar, Self

from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.widgets import Static

if TYPE_CHECKING:
    from pathlib import Path

LOOK_S = 1.0


class Seat:
    """Taken, or not."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file = path.open("a+", encoding="utf-8")
        self._told: str | None = None
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self.taken = False
        else:
            self.taken = True
            self.tell(None)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def tell(self, colour: str | None) -> None:
        """Whoever has the seat flies this drone now."""
        sentence = f"flies {colour.capitalize()}" if colour else "is at the console, paired with no drone"
        if sentence != self._told:
            self._told = sentence
            self._file.seek(0)
            self._file.truncate()
            json.dump({"what": sentence, "since": time.strftime("%H:%M:%S")}, self._file)
            self._file.flush()

    @property
    def occupant(self) -> str:
        """What the others are told."""
        what, since = "is at the console", ""
        with contextlib.suppress(OSError, ValueError, TypeError, KeyError):  # just being written: the next look has it
            told = json.loads(self._path.read_text(encoding="utf-8"))
            what, since = str(told["what"]), f" since {told['since']}"
        return f"Somebody else {what}{since}."


class Occupied(App[None]):
    """What a second tab shows."""

    CSS = "Screen { align: center middle; } Static { width: 70%; height: auto; border: heavy $warning; padding: 1 2; }"
    ENABLE_COMMAND_PALETTE = False
    BINDINGS: ClassVar[list[BindingType]] = [Binding("q,ctrl+c,escape", "quit", "Leave", priority=True)]

    def __init__(self, seat: Seat) -> None:
        super().__init__()
        self._seat = seat

    def compose(self) -> ComposeResult:
        yield Static(id="occupied", markup=False)

    def on_mount(self) -> None:
        self.look()
        self.set_interval(LOOK_S, self.look)

    def look(self) -> None:
        """The occupant changes drones."""
        self.query_one("#occupied", Static).update(
            f"{self._seat.occupant}\n\nOne operator at a time: when that tab is closed, load this page again."
        )
