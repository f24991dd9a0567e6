"""Which keys make which requests, and which key events are ignored. Pure.

A held key repeats, and a paste arrives faster than a person types. The operator means none of these keys as requests,
so all of them are ignored, except STOP.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from safety.vocabulary import Command

KEYS: dict[str, Command] = {
    "left": Command.GO_LEFT,
    "right": Command.GO_RIGHT,
    "up": Command.GO_FORWARD,
    "down": Command.GO_BACK,
    "pageup": Command.GO_UP,
    "pagedown": Command.GO_DOWN,
    "left_square_bracket": Command.TURN_LEFT,
    "right_square_bracket": Command.TURN_RIGHT,
    "c": Command.CONTINUE,
}
"""Textual's names of the keys that ask at once."""
REPEAT_S = 0.4
"""The same key again within this time counts as held down."""
FLOOD = 6
WITHIN_S = 0.5
"""More keys than FLOOD in this time were not typed by an operator."""


@dataclass
class Keys:
    """Remembers the keys pressed lately. Times in seconds, rising."""

    ignored: int = 0
    """How many keys of the present flood were ignored."""
    _last: dict[str, float] = field(default_factory=dict)
    _recent: deque[float] = field(default_factory=lambda: deque(maxlen=FLOOD + 1))

    def believes(self, key: str, now_s: float) -> bool:
        """Whether this key makes a request. STOP is never passed through here."""
        self._recent.append(now_s)
        if self.flooded(now_s):
            self.ignored += 1
            self._last[key] = now_s
            return False
        self.ignored = 0
        last_s = self._last.get(key)
        self._last[key] = now_s
        return last_s is None or now_s - last_s >= REPEAT_S

    def flooded(self, now_s: float) -> bool:
        """Whether more keys come than anybody types."""
        return len(self._recent) > FLOOD and now_s - self._recent[0] <= WITHIN_S
