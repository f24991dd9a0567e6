"""A gesture counts when it has been held: in most frames, long enough, and once. Pure; times are the frames' own.

Design: 0.5 s, an open palm half of that; armed again only after the hand has changed or left.
"""

from __future__ import annotations

import math
import statistics
from collections import deque
from dataclasses import dataclass

from modalities.hands.gestures import Reading
from safety.vocabulary import Command

HOLD_S = 0.5
STOP_HOLD_FACTOR = 0.5
"""An open palm stops after this share of the hold time."""
LEAST_SHARE = 0.8
"""Of the frames in the hold time, how many must show the gesture (N of M)."""
LEAST_FRAMES = 2
"""That agree, however few there are in the hold time: what was seen once was not held."""
LONGEST_GAP_S = 0.25
USUAL_GAPS = 1.5
"""A time without a frame that is longer than LONGEST_GAP_S and than so many of the usual ones ends the hold: what was not seen was not
held. A slow camera's usual ones may be as long as the hold itself.
"""
INTERVALS = 7
"""So many times between frames tell what is usual."""
REARM_S = 0.3
"""How long frames must show something else before the same gesture counts again."""
_ROUNDING_S = 1e-6


@dataclass(frozen=True, slots=True)
class Held:
    """A gesture that was held. confidence: the mean over its frames; captured_at_s: the completing frame's time."""

    command: Command
    confidence: float
    captured_at_s: float
    held_s: float
    text: str


class DwellFilter:
    """Readings in, a held gesture out, once per hold."""

    def __init__(self, hold_s: float = HOLD_S) -> None:
        """hold_s: how long a gesture is held. Raises ValueError unless positive."""
        if not (math.isfinite(hold_s) and hold_s > 0.0):
            raise ValueError(f"a gesture cannot be held for {hold_s} s: give a positive time")
        self._hold_s = hold_s
        self._last_s = -math.inf
        self._intervals_s: deque[float] = deque(maxlen=INTERVALS)
        self._frames: deque[tuple[float, Reading]] = deque()
        self._command: Command | None = None
        self._since_s = math.inf
        self._spent: Command | None = None
        self._changed_s: float | None = None

    def hold_for_s(self, command: Command) -> float:
        return self._hold_s * (STOP_HOLD_FACTOR if command is Command.STOP else 1.0)

    @property
    def rate_hz(self) -> float | None:
        """How many frames a second there usually are; None: not yet known."""
        return 1.0 / statistics.median(self._intervals_s) if len(self._intervals_s) == INTERVALS else None

    @property
    def slowest_hz(self) -> float:
        """At fewer frames a second nothing can be held."""
        return 1.0 / self._hold_s

    def accept(self, reading: Reading, captured_at_s: float) -> Held | None:
        """The next frame's reading; what it completes. A frame that is not newer than the last one is ignored."""
        if not (math.isfinite(captured_at_s) and captured_at_s > self._last_s):
            return None
        if self._is_gap(captured_at_s - self._last_s):
            self._begin(None, captured_at_s)
            self._changed_s = None  # nor was it seen that the hand changed
        self._last_s = captured_at_s
        self._rearm(reading.command, captured_at_s)
        self._follow(reading, captured_at_s)
        command = reading.command
        if command is None or command is self._spent:
            return None
        return self._completed(command, captured_at_s)

    def _is_gap(self, interval_s: float) -> bool:
        if math.isfinite(interval_s):
            self._intervals_s.append(interval_s)
        usual_s = statistics.median(self._intervals_s) if len(self._intervals_s) > 1 else 0.0
        return interval_s > max(LONGEST_GAP_S, min(USUAL_GAPS * usual_s, self._hold_s)) + _ROUNDING_S

    def _rearm(self, command: Command | None, now_s: float) -> None:
        if self._spent is None or command is self._spent:
            self._changed_s = None
        elif self._changed_s is None:
            self._changed_s = now_s
        elif now_s - self._changed_s >= REARM_S - _ROUNDING_S:
            self._spent = self._changed_s = None

    def _follow(self, reading: Reading, now_s: float) -> None:
        if reading.command is not None and reading.command is not self._command:
            self._begin(reading.command, now_s)
        self._frames.append((now_s, reading))
        while self._frames[0][0] < now_s - self._hold_s - _ROUNDING_S:
            self._frames.popleft()

    def _begin(self, command: Command | None, now_s: float) -> None:
        """Count anew, unless nothing but empty frames came before: they belong to the M of which N must show it."""
        if self._command is not None or command is None:
            self._frames.clear()
            self._since_s = now_s
        self._command = command

    def _completed(self, command: Command, now_s: float) -> Held | None:
        hold_s = self.hold_for_s(command)
        begin_s = now_s - hold_s - _ROUNDING_S
        if self._since_s > now_s - hold_s + _ROUNDING_S:
            return None
        if len(self._frames) > 1:  # a slow camera's last two, though an open palm's time is shorter
            begin_s = min(begin_s, self._frames[-2][0])
        window = [reading for at_s, reading in self._frames if at_s >= begin_s]
        showing = [reading for reading in window if reading.command is command]
        if len(showing) < max(LEAST_FRAMES, LEAST_SHARE * len(window)):
            return None
        self._spent, self._changed_s = command, None
        confidence = sum(reading.confidence for reading in showing) / len(showing)
        return Held(command, confidence, now_s, hold_s, showing[-1].text)
