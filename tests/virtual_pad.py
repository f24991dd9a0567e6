"""A gamepad that is not there, and the app with one plugged in.

It is SDL's own, in the process that reads it, and so there on every machine; where the kernel makes devices `tests.kernel_pad`
takes its place. `main` is the whole app with such a one: what is done on it comes line by line from the pipe that
M3R_TEST_PAD names.
"""

from __future__ import annotations

import ctypes
import functools
import importlib
import os
import threading
import time
from pathlib import Path
from typing import Any

from modalities.gamepad.device import SDL
from ui import entry

NAME = "Virtual Controller"
"""SDL's name of it."""
GAMEPAD, AXES, BUTTONS, HATS = 1, 6, 17, 1
TRIGGERS = (4, 5)
JOYSTICK = 0x200
QUITS = 4
"""So many times at most what reads a device while it is plugged in ends SDL, which pygame does without having begun it."""
HELD_S = 0.06
"""Longer than any two looks at it are apart."""
PLACES = {(0, 0): 0, (0, 1): 1, (1, 0): 2, (0, -1): 4, (-1, 0): 8, (1, 1): 3}


@functools.cache
def _sdl() -> Any:
    """The very library that pygame loads."""
    os.environ.update(SDL)
    importlib.import_module("pygame")
    loaded = {
        line.split(maxsplit=5)[5] for line in Path("/proc/self/maps").read_text().splitlines() if "libSDL2-" in line
    }
    (path,) = loaded
    sdl = ctypes.CDLL(path)
    sdl.SDL_JoystickOpen.restype = ctypes.c_void_p
    for name in ("Axis", "Button", "Hat"):
        getattr(sdl, f"SDL_JoystickSetVirtual{name}").argtypes = [ctypes.c_void_p, ctypes.c_int, ctypes.c_int]
    sdl.SDL_JoystickClose.argtypes = [ctypes.c_void_p]
    return sdl


class VirtualPad:
    """SDL's, in this process. Every method may be called from any thread."""

    def __init__(self, kind: int = GAMEPAD) -> None:
        self._kind = kind
        self._index = -1
        self._joystick: Any = None

    def plug(self) -> None:
        for _ in range(QUITS):  # SDL counts: the device outlives who reads it
            assert _sdl().SDL_InitSubSystem(JOYSTICK) == 0
        self._index = _sdl().SDL_JoystickAttachVirtual(self._kind, AXES, BUTTONS, HATS)
        assert self._index >= 0
        self._joystick = _sdl().SDL_JoystickOpen(self._index)

    def unplug(self) -> None:
        if self._joystick is not None:
            _sdl().SDL_JoystickClose(self._joystick)
            assert _sdl().SDL_JoystickDetachVirtual(self._index) == 0
            self._joystick = None

    def axis(self, axis: int, value: float) -> None:
        _sdl().SDL_JoystickSetVirtualAxis(self._joystick, axis, round(32767 * value))

    def button(self, button: int, down: bool) -> None:
        _sdl().SDL_JoystickSetVirtualButton(self._joystick, button, int(down))

    def hat(self, right: int, up: int) -> None:
        _sdl().SDL_JoystickSetVirtualHat(self._joystick, 0, PLACES[right, up])

    def press(self, button: int) -> None:
        self.button(button, True)
        time.sleep(HELD_S)
        self.button(button, False)
        time.sleep(HELD_S)


class Fingers:
    """The operator's, on the gamepad of another process: the same methods as `VirtualPad`, sent as lines."""

    def __init__(self, path: Path) -> None:
        os.mkfifo(path)
        self.path = path
        self._fd = os.open(path, os.O_RDWR)  # so that it waits for nobody

    def close(self) -> None:
        os.close(self._fd)

    def __getattr__(self, name: str) -> Any:
        def do(*arguments: float) -> None:
            os.write(self._fd, f"{name} {' '.join(map(str, arguments))}\n".encode())

        return do


def _obey(path: str) -> None:
    pad = VirtualPad()
    with Path(path).open() as lines:
        for line in lines:
            name, *words = line.split()
            getattr(pad, name)(*(float(word) if "." in word else int(word) for word in words))


def main() -> int:
    threading.Thread(target=_obey, args=(os.environ["M3R_TEST_PAD"],), daemon=True).start()
    return entry.main()
