"""A script of timed requests, in place of a person at the buttons.

One request a line, `#` begins a comment::

    2.0 panel go left
    4.5 voice go up confidence=0.4
    6.0 panel activate red

The time is in seconds since recorded inputs began; then the modality, the request in the words of the voice grammar, and
optionally the confidence that the modality would have given it.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from modalities.voice.phrases import PhraseTable
from safety.vocabulary import Command, ManeuverRequest, Modality

SURE: dict[Modality, float] = {Modality.PANEL: 1.0, Modality.VOICE: 0.95, Modality.GESTURE: 0.95}
"""The confidence of a scripted request that states none."""
LONGEST_SCRIPT_BYTES = 1 << 20
SHOWN = 60
"""Characters of a wrong word or line that an error shows."""


class ScriptError(ValueError):
    """A script that cannot be read; one sentence that names the line and what is wrong with it."""


@dataclass(frozen=True, slots=True)
class ScriptedRequest:
    """at_s: since recorded inputs began. text: the words of the line, as evidence."""

    at_s: float
    modality: Modality
    command: Command
    colour: str | None
    confidence: float
    text: str
    line: int

    def request(self, request_id: str, began_s: float) -> ManeuverRequest:
        """It as a request; began_s: when recorded inputs began, on the app's clock."""
        at_s = began_s + self.at_s
        return ManeuverRequest(
            request_id, self.command, self.modality, self.confidence, at_s, at_s, self.text, self.colour
        )


def read_script(path: Path | str, colours: Iterable[str]) -> tuple[ScriptedRequest, ...]:
    """The script in a file; "-": standard input. Raises ScriptError."""
    if str(path) == "-":
        return parse_script(
            _text(sys.stdin.buffer.read(LONGEST_SCRIPT_BYTES + 1), "standard input"), colours, "standard input"
        )
    path = Path(path)
    try:
        with path.open("rb") as file:
            data = file.read(LONGEST_SCRIPT_BYTES + 1)
    except FileNotFoundError:
        raise ScriptError(f"script {path} does not exist: check its name") from None
    except OSError as error:
        raise ScriptError(f"script {path} cannot be read ({error.strerror}): give a text file") from None
    return parse_script(_text(data, f"script {path}"), colours, f"script {path}")


def _text(data: bytes, name: str) -> str:
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ScriptError(f"{name} is not text: give timed requests such as `2.0 panel go left`") from None


def parse_script(text: str, colours: Iterable[str], name: str = "script") -> tuple[ScriptedRequest, ...]:
    """The requests of a script, in time. name: what to call it in errors. Raises ScriptError."""
    if len(text) > LONGEST_SCRIPT_BYTES:
        raise ScriptError(f"{name} is longer than {LONGEST_SCRIPT_BYTES >> 20} MB: give timed requests only")
    table = PhraseTable(colours)
    requests: list[ScriptedRequest] = []
    for number, raw in enumerate(text.splitlines(), start=1):
        line = raw.split("#", 1)[0].strip()
        if not line:
            continue
        try:
            request = _parse_line(line, number, table)
            if requests and request.at_s < requests[-1].at_s:
                raise ScriptError(f"time {request.at_s:g} is before {requests[-1].at_s:g}, the line before it")
        except ScriptError as error:
            raise ScriptError(f"{name}, line {number}: {error}") from None
        requests.append(request)
    return tuple(requests)


def _parse_line(line: str, number: int, table: PhraseTable) -> ScriptedRequest:
    words = line.split()
    if len(words) < 3:
        raise ScriptError(f"{_clipped(line)} is not `TIME MODALITY REQUEST`, for example `2.0 panel go left`")
    at_s = _number(words[0], "time in seconds", 0.0, math.inf)
    modality = {m.value: m for m in SURE}.get(words[1].lower())
    if modality is None:
        raise ScriptError(f"{_clipped(words[1])} is no modality: use {', '.join(SURE)}")
    confidence = SURE[modality]
    if words[-1].lower().startswith("confidence="):
        confidence = _number(words.pop().split("=", 1)[1], "confidence", 0.0, 1.0)
    text = " ".join(words[2:]).lower()
    phrase = table.interpret(text) if re.fullmatch(r"[a-z ]+", text) else None
    if phrase is None or (phrase.command is Command.STOP and text != "stop"):
        raise ScriptError(_unknown_request(text, table))
    return ScriptedRequest(at_s, modality, phrase.command, phrase.colour, confidence, text, number)


def _unknown_request(text: str, table: PhraseTable) -> str:
    verb, _, rest = text.partition(" ")
    if verb in ("activate", "disconnect") and rest:
        return f"{_clipped(rest)} is no drone here: the colours are {', '.join(table.colours)}"
    return (
        f"{_clipped(text)} is no request: use for example `go left`, `turn right`, `stop`, `continue` or `activate red`"
    )


def _number(word: str, what: str, lowest: float, highest: float) -> float:
    try:
        value = float(word)
    except ValueError:
        raise ScriptError(f"{_clipped(word)} is no {what}") from None
    if not (math.isfinite(value) and lowest <= value <= highest):
        bounds = f"from {lowest:g}" if math.isinf(highest) else f"from {lowest:g} to {highest:g}"
        raise ScriptError(f"{word!r} is no {what}: give a number {bounds}")
    return value


def _clipped(text: str) -> str:
    """Shortened so that it fits into a sentence."""
    return repr(text if len(text) <= SHOWN else f"{text[:SHOWN]}...")
