"""From options to a console on the screen and back: the run starts first and ends last."""

from __future__ import annotations

import os
from collections import deque
from typing import TYPE_CHECKING, Any

from m3r_app.live import Live
from ui.console.app import KEPT_EVENTS, Console
from ui.console.terminal import log_path, own_screen, require_terminal
from ui.narrator import sentence

if TYPE_CHECKING:
    from collections.abc import Mapping

    from m3r_app.options import RunOptions


def show(options: RunOptions) -> int:
    """Fly one run from the console; returns the exit status. Raises what names bad input or a missing vehicle."""
    require_terminal(os.environ)
    events: deque[Mapping[str, Any]] = deque(maxlen=KEPT_EVENTS)
    ended: list[str] = []

    def take(event: Mapping[str, Any]) -> None:
        events.append(event)
        if event["event"] == "end":
            ended.append(sentence(event) or "")

    live = Live(options, take)
    log = log_path()
    with own_screen(log):
        live.start()
        try:
            Console(live, events, dry_run=options.dry_run, takeoff_m=options.takeoff_m).run()
        finally:
            # Whatever became of the screen, the drone is left in Hold.
            live.interrupt()
            status = live.result()
    print("\n".join(ended))
    return status
