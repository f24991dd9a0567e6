"""What happens on a gamepad, and what that asks for. Pure.

Buttons and hats ask, once for each time that they are pressed. A stick or a trigger never moves anything: moved out of its
dead zone it is STOP, once until it rests again, and until then nothing else is asked. Source: R1, X4.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import assert_never

from safety.vocabulary import Command

CENTRED = (0, 0)
DIRECTIONS = {(-1, 0): "left", (1, 0): "right", (0, 1): "up", (0, -1): "down"}
"""A hat between two of them asks for nothing."""
BACK = 0.8
"""Share of the dead zone within which a stick rests again: at its edge it would tremble in and out."""
FLOOD = 6
WITHIN_S = 0.5
"""More buttons than FLOOD in this time are not an operator's."""


@dataclass(frozen=True, slots=True)
class Pad:
    """What a gamepad has. rests: where each axis rests, from -1 to 1: 0 for a stick, an end for a trigger."""

    name: str
    buttons: int
    hats: int
    rests: tuple[float, ...]
    known: bool = True
    """It is known which axes are triggers."""

    def rest(self, axis: int) -> float:
        return self.rests[axis] if axis < len(self.rests) else 0.0

    def is_off(self, axis: int, value: float, dead_zone: float) -> bool:
        """Whether it is farther from its rest than this share of its travel; what is no number is."""
        rest = self.rest(axis)
        return not abs(value - rest) / (1.0 + abs(rest)) <= dead_zone


@dataclass(frozen=True, slots=True)
class Plugged:
    """A gamepad is there. axes, hats: how they stand."""

    pad: Pad
    axes: tuple[float, ...]
    hats: tuple[tuple[int, int], ...]


@dataclass(frozen=True, slots=True)
class Unplugged:
    """It is gone."""


@dataclass(frozen=True, slots=True)
class ButtonPressed:
    button: int


@dataclass(frozen=True, slots=True)
class HatTurned:
    """place: (right, up), each -1, 0 or 1."""

    hat: int
    place: tuple[int, int]


@dataclass(frozen=True, slots=True)
class AxisMoved:
    """value: from -1 to 1."""

    axis: int
    value: float


PadEvent = Plugged | Unplugged | ButtonPressed | HatTurned | AxisMoved


@dataclass(frozen=True, slots=True)
class Asked:
    """A request and what it was made of."""

    command: Command
    evidence: str


@dataclass(frozen=True, slots=True)
class Told:
    """A sentence for the operator."""

    sentence: str


@dataclass
class Reading:
    """Remembers what of a gamepad is not at rest. commands: by control, `button_3` or `hat_left`; dead_zone: share of the travel."""

    commands: Mapping[str, Command]
    dead_zone: float
    _pad: Pad | None = None
    _away: set[int] = field(default_factory=set)
    _hats: dict[int, tuple[int, int]] = field(default_factory=dict)
    _recent_s: deque[float] = field(default_factory=lambda: deque(maxlen=FLOOD + 1))
    _refusing: bool = False
    """The operator has been told that nothing is asked."""
    _flooded: bool = False
    _lost: bool = False
    _started: bool = False

    def accept(self, event: PadEvent, now_s: float) -> Iterator[Asked | Told]:
        """What comes of it, STOP first. now_s: rising seconds."""
        match event:
            case Plugged():
                yield from self._plugged(event)
            case Unplugged():
                yield from self._unplugged()
            case ButtonPressed():
                yield from self._pressed(f"button_{event.button}", f"button {event.button}", now_s)
            case HatTurned():
                before, self._hats[event.hat] = self._hats.get(event.hat, CENTRED), event.place
                direction = DIRECTIONS.get(event.place)
                if before == CENTRED and direction is not None:
                    yield from self._pressed(f"hat_{direction}", f"hat {direction}", now_s)
            case AxisMoved():
                yield from self._moved(event)
            case _:
                assert_never(event)

    @property
    def pad(self) -> Pad | None:
        """The gamepad that is there."""
        return self._pad

    def start(self) -> Iterator[Asked | Told]:
        """From now on presses count, and what is not at rest is STOP."""
        self._started = True
        if self._away:
            yield Asked(Command.STOP, f"gamepad {self._what(min(self._away))} is not at rest")
            yield from self._refuse()

    def _plugged(self, event: Plugged) -> Iterator[Asked | Told]:
        self._pad = event.pad
        self._hats = dict(enumerate(event.hats))
        self._away = {axis for axis, value in enumerate(event.axes) if event.pad.is_off(axis, value, self.dead_zone)}
        self._refusing = False
        if self._started:
            yield from self.start()
        if self._lost or self._started:
            yield Told(f"the gamepad {event.pad.name} is {'back' if self._lost else 'here'}")
        self._lost = False

    def _unplugged(self) -> Iterator[Asked | Told]:
        name = self._pad.name if self._pad is not None else ""
        self._pad, self._lost = None, True
        self._away.clear()
        yield Asked(Command.STOP, "gamepad unplugged")
        yield Told(f"the gamepad {name} is gone and STOP was asked for: plug it in again, or ask in another way")

    def _moved(self, event: AxisMoved) -> Iterator[Asked | Told]:
        axis, pad = event.axis, self._pad
        if pad is None:
            return
        if axis not in self._away:
            if pad.is_off(axis, event.value, self.dead_zone):
                self._away.add(axis)
                yield Asked(Command.STOP, f"gamepad {self._what(axis)} moved")
        elif not pad.is_off(axis, event.value, BACK * self.dead_zone):
            self._away.remove(axis)
            if not self._away and self._refusing:
                self._refusing = False
                yield Told("the gamepad is at rest: its buttons ask again")

    def _pressed(self, control: str, name: str, now_s: float) -> Iterator[Asked | Told]:
        command = self.commands.get(control)
        if command is None or not self._started:
            return
        if command is Command.STOP:
            yield Asked(command, f"gamepad {name}")
            return
        self._recent_s.append(now_s)
        if len(self._recent_s) > FLOOD and now_s - self._recent_s[0] <= WITHIN_S:
            if not self._flooded:
                yield Told("more gamepad buttons than anybody presses: ignored until they end (STOP is not)")
            self._flooded = True
            return
        self._flooded = False
        if self._away:
            yield from self._refuse()
        else:
            yield Asked(command, f"gamepad {name}")

    def _refuse(self) -> Iterator[Told]:
        if not self._refusing:
            self._refusing = True
            axes = ", ".join(self._what(axis) for axis in sorted(self._away))
            yield Told(f"the gamepad asks for nothing while {axes} is not at rest: let go of it")

    def _what(self, axis: int) -> str:
        trigger = self._pad is not None and self._pad.rest(axis) != 0.0
        return f"{'trigger' if trigger else 'axis'} {axis}"
