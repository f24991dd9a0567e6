"""A seeded flight of the pure core in virtual time, as the messages that the app would have recorded of it."""

from __future__ import annotations

import copy
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from config.settings import load_settings
from m3r_app.arbiter.announcements import Announce
from m3r_app.arbiter.effects import AnchorMoved, Fly
from m3r_app.arbiter.events import Event, NeighboursHeard, TelemetryArrived
from m3r_app.output import Notice
from m3r_app.plain import plain, restored
from m3r_app.record.recorder import Recorder
from tests.flights import Flight

STARTED_S = 97.0
"""The clock of `tests.flights` at the record's zero."""


class RecordedFlight(Flight):
    """Records as `runtime.Shell` does."""

    def __init__(self, seed: int, **more: Any) -> None:
        self.messages: list[tuple[str, float, dict[str, Any]]] = []
        super().__init__(seed, **more)

    def record(self, topic: str, data: dict[str, Any]) -> None:
        as_json = json.loads(json.dumps(plain(data, lossless=True), allow_nan=False))
        self.messages.append((topic, self.now_s - STARTED_S, restored(as_json)))

    def put(self, event: Event) -> None:
        if isinstance(event, TelemetryArrived):
            state = event.vehicle
            self.record("telemetry", {name: getattr(state, name) for name in state.__slots__})
        if isinstance(event, NeighboursHeard):
            self.record("neighbours", {"neighbours": event.neighbours})
            self.record("reservations", {"volumes": list(event.reservations)})
        super().put(event)

    def carry_out(self, effect: object) -> None:
        said = len(self.outcome.reports)
        super().carry_out(effect)
        for _, event, fields in self.outcome.reports[said:]:
            self.record(event, fields)
        if isinstance(effect, Fly):
            self.record("plan", {"plan": effect.plan})
        if isinstance(effect, Announce) and effect.notice is Notice.PAIRED and effect.metres:
            self.record("noise", {"noise_m": effect.metres[0], "wider_m": effect.metres[1]})
        if isinstance(effect, AnchorMoved):
            self.record("anchor", {"position": effect.position, "radius_m": effect.radius_m})

    def told(self) -> Told:
        """Fly it, to its end."""
        self.fly()
        self.end()
        metadata = {
            "app": "0",
            "settings": load_settings((), ()).model_dump(),
            "operator": self.operator,
            "world": self.world,
        }
        return Told(restored(json.loads(json.dumps(plain(metadata, lossless=True)))), self.messages)

    def end(self) -> None:
        from m3r_app.arbiter.events import Ended

        self.put(Ended("the run is over"))
        self.record("end", {"reason": "inputs_played"})


class Told:
    """Metadata and messages of a flight, to be edited."""

    def __init__(self, metadata: dict[str, Any], messages: list[tuple[str, float, dict[str, Any]]]) -> None:
        self.metadata, self.messages = metadata, messages

    def copy(self) -> Told:
        return copy.deepcopy(self)

    def of(self, topic: str) -> list[tuple[float, dict[str, Any]]]:
        return [(t_s, data) for name, t_s, data in self.messages if name == topic]

    def write(self, path: Path, steps: Sequence[dict[str, Any]] = ()) -> Path:
        """As a file. steps: of the arbiter, as they are."""

        def failed(sentence: str) -> None:
            raise AssertionError(sentence)

        made = Recorder(path, self.metadata, failed)
        for topic, t_s, data in self.messages:
            made.record(topic, t_s, data)
        for step in steps:
            made.record("step", 0.0, step)
        made.close()
        return path
