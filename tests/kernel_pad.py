"""A gamepad that the kernel makes (uinput): what is plugged in is then a device like any other, for the whole machine.

The layout and the numbers are those of a wired Xbox pad, which SDL knows: axes 2 and 5 are triggers.
"""

from __future__ import annotations

import fcntl
import os
import struct
import time
from pathlib import Path

from tests.virtual_pad import HELD_S

UINPUT = Path("/dev/uinput")
EVENTS, KEYS, ABSOLUTE = 0x40045564, 0x40045565, 0x40045567
"""UI_SET_EVBIT, UI_SET_KEYBIT, UI_SET_ABSBIT"""
CREATE, DESTROY, SETUP, ABSOLUTE_SETUP = 0x5501, 0x5502, 0x405C5503, 0x401C5504
SYSTEM_NAME = 0x8040552C
EV_SYN, EV_KEY, EV_ABS = 0, 1, 3
USB, MICROSOFT, PAD_360, VERSION = 3, 0x045E, 0x028E, 0x0114
BUTTONS = (0x130, 0x131, 0x133, 0x134, 0x136, 0x137, 0x13A, 0x13B, 0x13C, 0x13D, 0x13E)
STICKS, TRIGGERS, HAT = (0, 1, 3, 4), (2, 5), (0x10, 0x11)
STICK, TRIGGER, ONE = (-32768, 32767), (0, 255), (-1, 1)
APPEARS_S = 3.0


class KernelPad:
    """The same methods as `tests.virtual_pad.VirtualPad`."""

    def __init__(self) -> None:
        self._file = -1

    def plug(self) -> None:
        """Raises OSError where the kernel does not make it, TimeoutError where nobody can read it."""
        self._file = os.open(UINPUT, os.O_WRONLY | os.O_NONBLOCK)
        for kind in (EV_KEY, EV_ABS):
            fcntl.ioctl(self._file, EVENTS, kind)
        for code in BUTTONS:
            fcntl.ioctl(self._file, KEYS, code)
        for codes, (low, high) in ((STICKS, STICK), (TRIGGERS, TRIGGER), (HAT, ONE)):
            for code in codes:
                fcntl.ioctl(self._file, ABSOLUTE, code)
                fcntl.ioctl(self._file, ABSOLUTE_SETUP, struct.pack("Hxxiiiiii", code, 0, low, high, 0, 0, 0))
        identity = struct.pack("HHHH80sI", USB, MICROSOFT, PAD_360, VERSION, b"Microsoft X-Box 360 pad", 0)
        fcntl.ioctl(self._file, SETUP, identity)
        fcntl.ioctl(self._file, CREATE)
        name = fcntl.ioctl(self._file, SYSTEM_NAME, bytes(64)).rstrip(b"\0").decode()
        deadline_s = time.monotonic() + APPEARS_S
        while not any(os.access(f"/dev/input/{node.name}", os.R_OK) for node in _nodes(name)):
            if time.monotonic() > deadline_s:
                self.unplug()
                raise TimeoutError(f"{name} has no device file that can be read")
            time.sleep(0.05)

    def unplug(self) -> None:
        if self._file >= 0:
            fcntl.ioctl(self._file, DESTROY)
            os.close(self._file)
            self._file = -1

    close = unplug

    def axis(self, axis: int, value: float) -> None:
        low, high = TRIGGER if axis in TRIGGERS else STICK
        self._tell(EV_ABS, axis, round(low + (high - low) * (value + 1.0) / 2.0))

    def button(self, button: int, down: bool) -> None:
        self._tell(EV_KEY, BUTTONS[button], int(down))

    def hat(self, right: int, up: int) -> None:
        self._tell(EV_ABS, HAT[0], right)
        self._tell(EV_ABS, HAT[1], -up)

    def press(self, button: int) -> None:
        self.button(button, True)
        time.sleep(HELD_S)
        self.button(button, False)
        time.sleep(HELD_S)

    def _tell(self, kind: int, code: int, value: int) -> None:
        for event in ((kind, code, value), (EV_SYN, 0, 0)):
            os.write(self._file, struct.pack("llHHi", 0, 0, *event))


def kernel_makes_pads() -> bool:
    """Whether one can be made here and read."""
    pad = KernelPad()
    try:
        pad.plug()
    except OSError:  # no uinput, or not for us
        return False
    pad.unplug()
    return True


def _nodes(name: str) -> list[Path]:
    return list(Path("/sys/devices/virtual/input", name).glob("event*"))
