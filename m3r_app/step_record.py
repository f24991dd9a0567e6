"""Every step of the arbiter in the flight record, so that it can be taken again: event, time, effects, digest of the state.

Topics: `start`, the state before the first step; `step`, one message a step. Worlds are attachments, named by their sha256.
"""

from __future__ import annotations

import hashlib
import json
import operator
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from enum import Enum
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any

import m3r_app.output
import safety.confidence
import safety.constraints
import safety.declarations
import safety.estimate
import safety.findings
import safety.geofence
import safety.limits
import safety.monitor
import safety.obstacles
import safety.polygons
import safety.situation
import safety.supervisor
import safety.terrain
import safety.vocabulary
from m3r_app.arbiter import announcements, effects, events, fusion, state
from m3r_app.arbiter.events import Event
from m3r_app.arbiter.state import ArbiterState
from m3r_app.record.recorder import Line, RecordError, read_attachments, read_header, read_lines
from m3r_app.typed_json import TypedJson
from safety.constraints import RULES
from safety.situation import World

START, STEP = "start", "step"
UNREADABLE = (TypeError, LookupError, AttributeError, ValueError, ArithmeticError, RecursionError)
"""What taking apart a value that nobody wrote so may raise."""
_MODULES = (
    safety.vocabulary, safety.limits, safety.declarations, safety.constraints, safety.situation, safety.terrain, safety.obstacles, safety.polygons,
    safety.geofence, safety.estimate, safety.findings, safety.monitor, safety.supervisor, safety.confidence,
    events, effects, state, announcements, fusion, m3r_app.output,
)  # fmt: skip
ROOT = Path(__file__).resolve().parents[1]
JUDGES = ("safety", "m3r_app/arbiter", "m3r_app/output.py")
"""The code that a step depends on."""


def codec() -> TypedJson:
    """Of all that goes into a step and comes out of it."""
    found = {one for module in _MODULES for one in _classes(module)}
    return TypedJson(sorted(found, key=lambda one: one.__name__), apart=(World,))


def _classes(module: ModuleType) -> Iterator[type]:
    for one in vars(module).values():
        if isinstance(one, type) and one.__module__ == module.__name__:
            named_tuple = issubclass(one, tuple) and hasattr(one, "_fields")
            if is_dataclass(one) or issubclass(one, Enum) or named_tuple:
                yield one


def provenance() -> dict[str, object]:
    """Versions of what decides, and the sha256 of its source, for the head of a record."""
    names = ("m3r", "numpy", "shapely")
    return {
        "versions": {"python": sys.version.split()[0], **{name: version(name) for name in names}},
        "source_sha256": source_sha256(),
        "shapes": codec().shapes(),
    }


def source_sha256() -> str:
    """Of the code that a step depends on."""
    digest = hashlib.sha256()
    for place in JUDGES:
        path = ROOT / place
        for file in [path] if path.is_file() else sorted(path.rglob("*.py")):
            digest.update(f"{file.relative_to(ROOT)}\0".encode())
            digest.update(file.read_bytes())
    return digest.hexdigest()


class StateDigest:
    """A digest of each state of a run; only what has changed since the last one is looked at anew."""

    def __init__(self, text: TypedJson) -> None:
        self._text = text
        self._values: dict[str, object] = {}
        self._parts: dict[str, bytes] = {}

    def of(self, now: ArbiterState) -> str:
        """32 hexadecimal digits; the same for equal states, however they came about."""
        whole = hashlib.blake2b(digest_size=16)
        for name in _STATE_FIELDS:
            value = getattr(now, name)
            if name not in self._parts or self._values[name] is not value:
                self._values[name] = value
                self._parts[name] = hashlib.blake2b(self._text.text(value).encode(), digest_size=16).digest()
            whole.update(self._parts[name])
        return whole.hexdigest()


_STATE_FIELDS = tuple(field.name for field in fields(ArbiterState))


class StepWriter:
    """Makes the lines of the topics `start` and `step`. Called on the recorder's thread, with frozen values."""

    def __init__(self) -> None:
        self._text = codec()
        self._digest = StateDigest(self._text)
        self._number = 0
        self._written: set[str] = set()

    def line(self, topic: str, data: Mapping[str, object]) -> Line:
        """The JSON of one message without its braces, and what must be attached before it."""
        after = data["state"]
        assert isinstance(after, ArbiterState)
        if topic == START:
            body = f'"state":{self._text.text(after)}'
            self._digest.of(after)
        else:
            self._number += 1
            effects_text = f',"effects":{self._text.text(data["effects"])}' if data["effects"] else ""
            body = (
                f'"n":{self._number},"now_s":{self._text.text(data["now_s"])},"event":{self._text.text(data["event"])}'
                f'{effects_text},"state":"{self._digest.of(after)}"'
            )
        new = {digest: text for digest, text in self._text.documents.items() if digest not in self._written}
        self._written |= new.keys()
        return Line(body, {f"{digest}.json": text.encode() for digest, text in new.items()})


@dataclass(frozen=True)
class RecordedStep:
    """One step as it was taken. effects: their text; t_s: since the run began."""

    number: int
    t_s: float
    now_s: float
    event: Event
    effects: str
    state_digest: str


@dataclass(frozen=True)
class RecordedFlight:
    """What a record says of the arbiter's steps."""

    path: Path
    metadata: dict[str, Any]
    complete: bool
    start: ArbiterState
    text: TypedJson

    def steps(self) -> Iterator[RecordedStep]:
        """In their order, up to the end or the first damage. Raises RecordError for one that cannot be read."""
        for topic, line in read_lines(self.path, (STEP,)):
            assert topic == STEP
            with_effects = line.get("effects", ["()"])
            try:
                event = self.text.value(line["event"])
                now_s = self.text.value(line["now_s"])
                number = operator.index(line["n"])
                yield RecordedStep(
                    number, line["t"], now_s, event, json.dumps(with_effects, separators=(",", ":")), line["state"]
                )
            except UNREADABLE as error:
                raise RecordError(f"{self.path} cannot be replayed: step {line.get('n')}: {error}") from None


def read_flight(path: Path) -> RecordedFlight:
    """The steps of a record. Raises RecordError for one that has none, or that this m3r cannot take apart."""
    header = read_header(path)
    text = codec()
    # One that is no text any more does not have the sha256 that it is asked for by.
    attached = read_attachments(path)
    text.documents.update({name.partition(".")[0]: data.decode(errors="replace") for name, data in attached})
    recorded, known = header.metadata.get("shapes"), text.shapes()
    if recorded is not None and not isinstance(recorded, dict):
        raise RecordError(f"{path} cannot be replayed: what it says of its values cannot be read")
    for name, names in (recorded or {}).items():
        if known.get(name) != names:
            raise RecordError(
                f"{path} cannot be replayed: its {name} is not that of this m3r; use the version that made it"
            )
    for _, line in read_lines(path, (START,)):
        try:
            start, same_rules = _first_state(line["state"], text)
        except UNREADABLE as error:
            raise RecordError(f"{path} cannot be replayed: its first state cannot be read ({error})") from None
        if not same_rules:
            raise RecordError(f"{path} cannot be replayed: it was flown under other rules than those of this m3r")
        return RecordedFlight(path, header.metadata, header.complete, start, text)
    raise RecordError(f"{path} cannot be replayed: it holds no steps of the arbiter, so an older m3r made it")


def _first_state(written: list[Any], text: TypedJson) -> tuple[ArbiterState, bool]:
    """The state, and whether its rules are ours: they are functions, of which a record has the names."""
    at = 1 + _STATE_FIELDS.index("rules")
    same = written[at] == json.loads(text.text(RULES))
    start = text.value([*written[:at], ["()"], *written[at + 1 :]])
    if not isinstance(start, ArbiterState):
        raise TypeError("it is none")
    return replace(start, rules=RULES), same
