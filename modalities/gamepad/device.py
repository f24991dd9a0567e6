"""The gamepads of this machine, by SDL's joystick interface (pygame-ce). One thread makes a `Pads`, looks and closes it.

Chosen by trial: pygame-ce comes ready made, starts in milliseconds, knows which axes of a gamepad are triggers, and has virtual
gamepads to test with; evdev has to be compiled against the kernel's headers and is tested with uinput alone.
"""

from __future__ import annotations

import contextlib
import os
import re
from typing import TYPE_CHECKING

from modalities.gamepad.reading import AxisMoved, ButtonPressed, HatTurned, Pad, PadEvent, Plugged, Unplugged
from modalities.live import Clock, LiveInputError

if TYPE_CHECKING:
    from pygame._sdl2.controller import Controller
    from pygame.event import Event
    from pygame.joystick import JoystickType

SETTLE_S = 0.2
"""What is held or off centre when a gamepad comes is told within this, and is not a press of now."""
SDL = {
    "PYGAME_HIDE_SUPPORT_PROMPT": "1",  # standard output is ours
    "SDL_VIDEODRIVER": "dummy",
    "SDL_AUDIODRIVER": "dummy",
    "SDL_NO_SIGNAL_HANDLERS": "1",  # Ctrl-C is ours
    "SDL_JOYSTICK_ALLOW_BACKGROUND_EVENTS": "1",  # there is no window that could have the focus
    "SDL_JOYSTICK_HIDAPI": "0",  # the kernel's numbers of the buttons, whatever this user may open
}
_TRIGGER = re.compile(r"a(\d+)(~?)")


class Pads:
    """Takes the first gamepad whose name has `wanted` in it, and after its loss one of the same name."""

    def __init__(self, wanted: str, clock: Clock) -> None:
        """Raises LiveInputError where the library is missing or fails."""
        os.environ.update(SDL)
        try:
            import pygame
            from pygame._sdl2 import controller
        except ImportError as error:
            raise LiveInputError(
                f"the Python package pygame-ce is missing ({error})", "install m3r again with its dependencies"
            ) from error
        self._pygame = pygame
        self._controller = controller
        self._wanted = wanted
        self._clock = clock
        self._joystick: JoystickType | None = None
        self._mapped: Controller | None = None
        self._pad: Pad | None = None
        self._settled_at_s = 0.0
        self._settling = False
        try:
            pygame.display.init()
            pygame.joystick.init()
            controller.init()
        except pygame.error as error:
            raise LiveInputError(f"gamepads cannot be read ({error})", "run without --gamepad") from error
        self._open()

    @property
    def names(self) -> tuple[str, ...]:
        """Every gamepad that is here, whether wanted or not."""
        sticks = self._pygame.joystick
        found = []
        for index in range(sticks.get_count()):
            with contextlib.suppress(self._pygame.error):  # gone in this moment
                found.append(sticks.Joystick(index).get_name())
        return tuple(found)

    def look(self) -> list[PadEvent]:
        """What happened since the last look. Never waits."""
        found: list[PadEvent] = []
        for event in self._pygame.event.get():
            if event.type == self._pygame.JOYDEVICEADDED:
                if self._joystick is None:
                    self._open()
            elif self._joystick is None or getattr(event, "instance_id", None) != self._joystick.get_instance_id():
                continue
            elif event.type == self._pygame.JOYDEVICEREMOVED:
                # What its axes did last was SDL's: it centres them.
                found = [] if self._settling else [Unplugged()]
                self._let_go()
            elif not self._settling:
                found += self._of(event)
        if self._settling and self._clock() >= self._settled_at_s:
            found.append(self._plugged())
        return found

    def close(self) -> None:
        self._let_go()
        self._controller.quit()
        self._pygame.joystick.quit()
        self._pygame.display.quit()

    def _of(self, event: Event) -> list[PadEvent]:
        if event.type == self._pygame.JOYBUTTONDOWN:
            return [ButtonPressed(event.button)]
        if event.type == self._pygame.JOYHATMOTION:
            return [HatTurned(event.hat, event.value)]
        if event.type == self._pygame.JOYAXISMOTION:
            return [AxisMoved(event.axis, event.value)]
        return []

    def _open(self) -> None:
        for index in range(self._pygame.joystick.get_count()):
            try:
                joystick = self._pygame.joystick.Joystick(index)
                if self._wanted.lower() not in joystick.get_name().lower():
                    continue
                mapped = self._controller.Controller(index) if self._controller.is_controller(index) else None
            except self._pygame.error:
                continue  # gone in this moment
            self._joystick, self._mapped = joystick, mapped
            self._settling, self._settled_at_s = True, self._clock() + SETTLE_S
            return

    def _let_go(self) -> None:
        self._joystick = self._mapped = None
        self._settling = False

    def _plugged(self) -> Plugged:
        joystick = self._joystick
        assert joystick is not None
        self._settling = False
        self._wanted = joystick.get_name()
        mapping = self._mapped.get_mapping() if self._mapped is not None else {}
        rests = [0.0] * joystick.get_numaxes()
        for side in ("lefttrigger", "righttrigger"):
            found = _TRIGGER.fullmatch(mapping.get(side, ""))
            if found and int(found[1]) < len(rests):
                rests[int(found[1])] = 1.0 if found[2] else -1.0
        pad = Pad(
            joystick.get_name(), joystick.get_numbuttons(), joystick.get_numhats(), tuple(rests), known=bool(mapping)
        )
        hats = [joystick.get_hat(hat) for hat in range(pad.hats)]
        return Plugged(
            pad,
            tuple(joystick.get_axis(axis) for axis in range(len(rests))),
            tuple((int(right), int(up)) for right, up in hats),
        )
