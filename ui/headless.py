"""The machine-readable output: one strict JSON object per line, and nothing else, on standard output."""

from __future__ import annotations

import json
import os
import signal
import sys
from typing import IO, TYPE_CHECKING, Any

from m3r_app.plain import plain

if TYPE_CHECKING:
    from collections.abc import Mapping

DECIMALS = 7
"""A centimetre of latitude, a tenth of a microsecond."""


class HeadlessPrinter:
    """Prints events as they happen. Numbers that do not exist are null."""

    def __init__(self, out: IO[str] | None = None) -> None:
        self._out = sys.stdout if out is None else out
        self._gone = False

    def __call__(self, event: Mapping[str, Any]) -> None:
        """Print one event. If nobody reads any more, hang up: the app holds the drone and ends."""
        if self._gone:
            return
        text = line(event)
        try:
            self._out.write(text)
            self._out.flush()
        except (OSError, ValueError):  # ValueError: it has been closed
            self._gone = True
            _discard(self._out)
            hang_up()


def line(event: Mapping[str, Any]) -> str:
    """One event as a line of strict JSON, `t` and `event` first."""
    first = {name: event[name] for name in ("t", "event")}
    return json.dumps(_rounded(plain({**first, **event}, lossless=False)), allow_nan=False) + "\n"


def hang_up() -> None:
    """Tell the app, as a closed terminal would, that its operator is gone; nothing where hanging up is ignored."""
    if callable(signal.getsignal(signal.SIGHUP)):
        signal.raise_signal(signal.SIGHUP)


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return round(value, DECIMALS) + 0.0  # no -0.0
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    return value


def _discard(out: IO[str]) -> None:
    """Let the interpreter's own last flush go nowhere instead of failing."""
    try:
        descriptor = out.fileno()
    except (OSError, ValueError):
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, descriptor)
    os.close(nowhere)
