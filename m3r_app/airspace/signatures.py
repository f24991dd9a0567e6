"""Signed messages: who, which one, when, on which topic. What is forged, replayed, reordered or cut off is dropped and counted.

One line before the body: `M3R1 KEY-ID LIFE SEQUENCE UNIX-MS MAC`, the MAC being HMAC-SHA256 over the topic, the line without
it and the body. A life is one start of one signer; within it and a topic the sequence only rises. A life is remembered until
its messages are too old to be taken anyway, so the memory is bounded by what authentic signers do. HMAC is symmetric: whoever
can verify a key's messages can also sign them, so it keeps out those without a key; what those with keys may publish is
for the broker's access list to say.
"""

from __future__ import annotations

import hashlib
import hmac
import re
import secrets
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass

WINDOW_S = 5.0
"""Messages whose time is further off are refused: too old, or of a clock that is wrong."""
LIVES_MAX = 4096
_LINE = re.compile(rb"(M3R1 ([a-z0-9._-]{1,80}) ([0-9a-f]{16}) ([0-9]{1,15}) ([0-9]{1,15})) ([0-9a-f]{64})")
_LINE_MAX = 240


@dataclass(frozen=True, slots=True)
class Envelope:
    """A message that its signer has really sent, once. early_s: how far ahead of our clock its time is (negative: behind)."""

    signer: str
    life: str
    sequence: int
    early_s: float
    body: bytes


class Dropped(Exception):  # noqa: N818  (not an error: the ordinary fate of what is not authentic)
    """Why a message was dropped, in one word or two. signer: who has really signed it, if that much is certain."""

    def __init__(self, reason: str, signer: str | None = None) -> None:
        super().__init__(reason)
        self.reason = reason
        self.signer = signer


class Signer:
    """Signs with one key. Its sequence rises with every message."""

    def __init__(self, key_id: str, key: bytes, wall_clock: Callable[[], float] = time.time) -> None:
        self.key_id = key_id
        self.life = secrets.token_hex(8)
        self._key = key
        self._wall_clock = wall_clock
        self._sequence = 0

    def seal(self, topic: str, body: bytes) -> bytes:
        """The payload for a topic."""
        self._sequence += 1
        line = f"M3R1 {self.key_id} {self.life} {self._sequence} {round(self._wall_clock() * 1000)}".encode()
        return line + b" " + _mac(self._key, topic, line, body).encode() + b"\n" + body


class Verifier:
    """Opens what was signed with one of the keys."""

    def __init__(self, keys: Mapping[str, bytes], wall_clock: Callable[[], float] = time.time) -> None:
        self.dropped: Counter[str] = Counter()
        """How many messages, by reason."""
        self._keys = dict(keys)
        self._wall_clock = wall_clock
        self._last: dict[tuple[str, str, str], tuple[int, float]] = {}

    def open(self, topic: str, payload: bytes, signer: str) -> Envelope:
        """The authentic message of this signer. Raises Dropped, which is counted too."""
        try:
            return self._open(topic, payload, signer)
        except Dropped as drop:
            self.dropped[drop.reason] += 1
            raise

    def _open(self, topic: str, payload: bytes, signer: str) -> Envelope:
        line, newline, body = payload.partition(b"\n")
        match = _LINE.fullmatch(line) if newline and len(line) <= _LINE_MAX else None
        if match is None:
            raise Dropped("unreadable")
        signed, key_id = match[1], match[2].decode()
        if key_id != signer or signer not in self._keys:
            raise Dropped("wrong signer")
        if not hmac.compare_digest(_mac(self._keys[signer], topic, signed, body).encode(), match[6]):
            raise Dropped("forged")
        life, sequence, sent_s = match[3].decode(), int(match[4]), int(match[5]) / 1000.0
        now_s = self._wall_clock()
        if not abs(sent_s - now_s) <= WINDOW_S:
            raise Dropped("clock", signer)
        one = (signer, life, topic)
        last = self._last.get(one)
        if last is not None and sequence <= last[0]:
            raise Dropped("replayed", signer)
        if last is None:
            self._make_room(now_s)
        self._last[one] = (sequence, sent_s)
        return Envelope(signer, life, sequence, sent_s - now_s, body)

    def _make_room(self, now_s: float) -> None:
        """Forget lives whose messages would be refused for their time by now. Raises Dropped if that is not enough."""
        if len(self._last) < LIVES_MAX:
            return
        self._last = {one: last for one, last in self._last.items() if abs(last[1] - now_s) <= WINDOW_S}
        if len(self._last) >= LIVES_MAX:
            raise Dropped("too many lives")


def _mac(key: bytes, topic: str, line: bytes, body: bytes) -> str:
    return hmac.new(key, b"\n".join((topic.encode(), line, body)), hashlib.sha256).hexdigest()
