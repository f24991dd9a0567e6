"""The recorded and scripted inputs of one run: opened before anything flies, played in their own time."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass

from m3r_app.options import RunOptions
from modalities.script import ScriptedRequest, read_script
from safety.vocabulary import ManeuverRequest

Sink = Callable[[ManeuverRequest], None]


@dataclass
class Inputs:
    """What will be played. sentences: for the operator, before it begins; model: which voice model, for the record."""

    script: tuple[ScriptedRequest, ...]
    sentences: tuple[str, ...] = ()
    model: str | None = None

    async def play(self, began_s: float, clock: Callable[[], float], sink: Sink) -> None:
        """Hand every request to `sink` at its time; returns when all have been played."""
        await asyncio.gather(self._play_script(began_s, clock, sink))

    async def _play_script(self, began_s: float, clock: Callable[[], float], sink: Sink) -> None:
        for number, scripted in enumerate(self.script, start=1):
            await asyncio.sleep(max(0.0, began_s + scripted.at_s - clock()))
            sink(scripted.request(f"script-{number}", began_s))

    def close(self) -> None:
        """End what still runs."""


def open_inputs(options: RunOptions, colours: tuple[str, ...]) -> Inputs:
    """Read and load everything that is to be played. Raises ScriptError, AudioError, ModelError: one sentence."""
    script = read_script(options.script, colours) if options.script is not None else ()
    return Inputs(script)
