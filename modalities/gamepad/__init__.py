"""A gamepad: its buttons and hats ask, as the console's buttons do; any stick or trigger is STOP."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

from modalities.gamepad.device import Pads
from modalities.gamepad.reading import Pad, Plugged, Reading
from modalities.gamepad.stream import FIRST_S, POLL_S, GamepadStream
from modalities.live import Clock, LiveInputError, LiveModality, Seen
from modalities.notices import Say
from safety.vocabulary import Command

if TYPE_CHECKING:
    from config.settings import Settings

CONTROLS = ("hat_", "button_")
"""How the names of the settings that map something begin."""


def commands(settings: Settings) -> dict[str, Command]:
    """What each mapped control asks for."""
    mapping = settings.gamepad.model_dump()
    return {
        control: Command(asks) for control, asks in mapping.items() if control.startswith(CONTROLS) and asks != "none"
    }


def open_gamepad(wanted: str, settings: Settings, clock: Clock, say: Say) -> GamepadStream:
    """Find it and read it. A gamepad that is not here yet is taken when it comes. Raises LiveInputError."""
    reading = Reading(commands(settings), settings.gamepad.dead_zone)
    return GamepadStream(lambda: Pads(wanted, clock), reading, wanted, clock=clock, say=say)


def look_at_gamepads(wanted: str, settings: Settings) -> Iterator[Seen]:
    """For `m3r check`: opened and read as a run does, for half a second."""
    mapping, dead_zone = commands(settings), settings.gamepad.dead_zone
    try:
        pads = Pads(wanted, time.monotonic)
    except LiveInputError as error:
        yield Seen("gamepad", error.wrong, error.remedy, missing=True)
        return
    try:
        came = _came(pads)
        names = pads.names
    finally:
        pads.close()
    if came is None:
        named = f" named {wanted}" if wanted else ""
        others = f" (there is {', '.join(names)})" if names else ""
        yield Seen("gamepad", f"no gamepad{named} is here{others}", "plug one in, or do without", missing=True)
        return
    pad = came.pad
    more = [name for name in names if name != pad.name]
    if more:
        yield Seen("gamepads", f"also here: {', '.join(more)} (choose with --gamepad NAME)")
    asks = ", ".join(f"{control.replace('_', ' ')} {command.value}" for control, command in mapping.items())
    text = f"{_shown(pad)}; {asks}; any axis beyond {dead_zone:g} of its travel is stop"
    away = [str(axis) for axis, value in enumerate(came.axes) if pad.is_off(axis, value, dead_zone)]
    if away:
        remedy = "let go of it; until every axis rests its buttons ask for nothing"
        yield Seen("gamepad", f"{text}; axis {', '.join(away)} is not at rest", remedy)
    else:
        yield Seen("gamepad", text)


GAMEPAD = LiveModality(
    name="gamepad",
    metavar="NAME",
    about="a gamepad: buttons and hats ask, any stick is STOP; with a part of its name, where there is more than one",
    open=open_gamepad,
    look=look_at_gamepads,
)


def _came(pads: Pads) -> Plugged | None:
    until_s = time.monotonic() + FIRST_S
    while time.monotonic() < until_s:
        for event in pads.look():
            if isinstance(event, Plugged):
                return event
        time.sleep(POLL_S)
    return None


def _shown(pad: Pad) -> str:
    triggers = [str(axis) for axis, rest in enumerate(pad.rests) if rest]
    axes = f"{len(pad.rests)} axes" + (f" ({', '.join(triggers)} triggers)" if triggers else "")
    return f"{pad.name}: {pad.buttons} buttons, {pad.hats} hat{'s'[: pad.hats != 1]}, {axes}"
