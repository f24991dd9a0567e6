"""The arbiter's steps in a record as plain messages: what it was told, in its order, to the last sample.

A typed value is a list that begins with its type: "()", "[]", "{}", "#" an array, "~" no finite number, "apart" a document by its
sha256, else a class, whose fields the record's own head names. It is taken apart here without any of those classes.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from m3r_app.evidence.reading import EvidenceError

Data = Mapping[str, Any]
Message = tuple[str, float, Data]
TOLD_BY_STEPS = frozenset({"telemetry", "neighbours", "reservations", "plan"})
"""Topics that the steps tell of more fully than the record's messages for readers."""

PLACES = ("Ned", "Geodetic")
"""Classes whose values are lists elsewhere in the record, too."""


class Documents:
    """Takes typed values apart. shapes: the field names of each class; texts: what stands apart, by sha256."""

    def __init__(self, shapes: Mapping[str, list[str]], texts: Mapping[str, str]) -> None:
        self._shapes, self._texts = shapes, texts

    def plain(self, value: Any) -> Any:
        """Objects, lists, numbers and arrays. Raises ValueError for what is missing or was changed."""
        if not isinstance(value, list):
            return value
        kind, *rest = value
        match kind:
            case "~":
                return float(rest[0])
            case "()" | "[]" | "<>":
                return [self.plain(one) for one in rest]
            case "{}":
                return {self.plain(key): self.plain(one) for key, one in rest}
            case "#":
                dtype, shape, text = rest
                return np.frombuffer(base64.b64decode(text), dtype=dtype).reshape(shape)
            case "apart":
                return self._apart(rest[0])
        names = self._shapes.get(kind)
        if names is None:
            return rest[0]  # an enumeration's member, by name
        if len(names) != len(rest):
            raise ValueError(f"a {kind} with {len(rest)} fields")
        values = [self.plain(one) for one in rest]
        return values if kind in PLACES else dict(zip(names, values, strict=True))

    def _apart(self, digest: str) -> Any:
        text = self._texts.get(digest)
        if text is None or hashlib.sha256(text.encode()).hexdigest() != digest:
            raise ValueError(f"the document {digest[:12]} is missing or was changed")
        return self.plain(json.loads(text))


def messages_of(steps: Iterable[Data], documents: Documents) -> Iterator[Message]:
    """What the steps tell, as the record's messages would: telemetry, neighbours, reservations, plans, the world, and the noise of
    an estimate for which the session's tube was widened.
    """
    for step in steps:
        t_s, (kind, *fields) = step["t"], step["event"]
        match kind:
            case "TelemetryArrived":
                yield "telemetry", t_s, documents.plain(step["event"])["vehicle"]
            case "NeighboursHeard":
                told = documents.plain(step["event"])
                yield "neighbours", t_s, {"neighbours": told["neighbours"]}
                yield "reservations", t_s, {"volumes": told["reservations"]}
            case "PairingAnswered" if any(isinstance(field, list) and field[0] == "apart" for field in fields):
                yield "world", t_s, documents.plain(step["event"])["world"]
        for effect in step.get("effects", ["()"])[1:]:
            if effect[0] == "Fly":
                yield "plan", t_s, documents.plain(effect)
            elif effect[:2] == ["Announce", ["Notice", "PAIRED"]] and (metres := documents.plain(effect)["metres"]):
                yield "noise", t_s, {"noise_m": metres[0], "wider_m": metres[1]}


def steps_of(
    messages: Iterable[Message], steps: Iterable[Data], shapes: Mapping[str, list[str]], texts: Mapping[str, str]
) -> list[Message]:
    """The record's messages, with what the steps tell in place of what these tell more fully. Raises EvidenceError."""
    try:
        told = list(messages_of(steps, Documents(shapes, texts)))
    except (AttributeError, KeyError, IndexError, TypeError, ValueError) as error:
        raise EvidenceError(f"its steps cannot be read ({error!r})") from None
    kept = [message for message in messages if message[0] not in TOLD_BY_STEPS]
    # Of the same moment, what was told comes before what was made of it.
    return sorted([*told, *kept], key=lambda message: message[1])
