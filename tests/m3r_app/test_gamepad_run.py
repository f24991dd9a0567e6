"""A gamepad flies the simulated drone through the whole app, stops it by a stick, and is unplugged in mid-flight."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests import kernel_pad, virtual_pad
from tests.kernel_pad import KernelPad, kernel_makes_pads
from tests.virtual_pad import Fingers
from tests.whole import PLAIN, App

RUN = ("run", "--headless", "--pair", "red", "--scenario", str(PLAIN), "--timeout", "60", "--gamepad")


@dataclass(frozen=True)
class Plugged:
    """A gamepad that is plugged in, and the program that sees it."""

    fingers: KernelPad | Fingers
    program: str
    trigger: int

    def app(self) -> App:
        return App(RUN, program=self.program)


@pytest.fixture
def plugged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Plugged]:
    """The kernel's where it makes them, else SDL's."""
    if kernel_makes_pads():
        plugged = Plugged(KernelPad(), "ui.entry", kernel_pad.TRIGGERS[0])
    else:
        fingers = Fingers(tmp_path / "pad")
        monkeypatch.setenv("M3R_TEST_PAD", str(fingers.path))
        plugged = Plugged(fingers, "tests.virtual_pad", virtual_pad.TRIGGERS[0])
    plugged.fingers.plug()
    yield plugged
    plugged.fingers.close()


def name_told(app: App) -> str:
    """The gamepad's name, as it is told before anything flies."""
    while True:
        told = re.fullmatch(
            "gamepad (.+): buttons and hats ask, any stick or trigger is STOP", app.until("announce")["text"]
        )
        if told:
            return told[1]


@pytest.mark.requirement("R1", "X4")
def test_buttons_ask_a_stick_stops_and_so_does_the_plug(plugged: Plugged) -> None:
    app, fingers = plugged.app(), plugged.fingers
    name = name_told(app)
    app.until("pair", status="confirmed")
    fingers.press(3)
    app.until("motion", status="completed")
    fingers.hat(-1, 0)
    app.until("motion", status="started")
    fingers.axis(1, 0.5)
    app.until("motion", status="aborted")
    fingers.press(3)
    app.until("announce", text="the gamepad asks for nothing while axis 1 is not at rest: let go of it")
    fingers.axis(1, 0.0)
    app.until("announce", text="the gamepad is at rest: its buttons ask again")
    fingers.press(4)
    app.until("motion", status="started")
    fingers.unplug()
    app.until(
        "announce", text=f"the gamepad {name} is gone and STOP was asked for: plug it in again, or ask in another way"
    )
    app.until("motion", status="aborted")
    fingers.plug()
    app.until("announce", text=f"the gamepad {name} is back")
    fingers.press(0)
    app.until("motion", status="started")
    fingers.axis(plugged.trigger, -0.2)
    app.until("motion", status="aborted")
    app.process.terminate()
    ran = app.finish()
    assert [(r["command"], r["modality"], r["confidence"], r["evidence"]) for r in ran.of("request")] == [
        ("go_up", "panel", 1.0, "gamepad button 3"),
        ("go_left", "panel", 1.0, "gamepad hat left"),
        ("stop", "panel", 1.0, "gamepad axis 1 moved"),
        ("turn_left", "panel", 1.0, "gamepad button 4"),
        ("stop", "panel", 1.0, "gamepad unplugged"),
        ("go_down", "panel", 1.0, "gamepad button 0"),
        ("stop", "panel", 1.0, f"gamepad trigger {plugged.trigger} moved"),
    ]
    assert set(ran.verdicts().values()) == {"approved"}
    assert ran.status == 130
    assert ran.events[-1]["violations"] == 0


@pytest.mark.requirement("X4")
def test_a_stick_that_is_held_over_at_the_start_moves_nothing(plugged: Plugged) -> None:
    fingers = plugged.fingers
    fingers.axis(3, -0.9)
    app = plugged.app()
    app.until("pair", status="confirmed")
    app.until("announce", text="the gamepad asks for nothing while axis 3 is not at rest: let go of it")
    fingers.press(3)
    fingers.press(4)
    fingers.axis(3, 0.05)
    app.until("announce", text="the gamepad is at rest: its buttons ask again")
    app.process.terminate()
    ran = app.finish()
    assert [(r["command"], r["evidence"]) for r in ran.of("request")] == [("stop", "gamepad axis 3 is not at rest")]
    assert ran.of("motion") == []


def test_a_run_without_the_gamepad_it_was_told_of_says_so_and_flies() -> None:
    app = App([*RUN, "nobody's", "--set", "gamepad.button_3=stop"])
    app.until("announce", text="no gamepad named nobody's is here: plug it in, and it is taken")
    app.until("pair", status="confirmed")
    app.process.terminate()
    assert app.finish().status == 130


@pytest.mark.parametrize(
    ("setting", "says"),
    [
        ("gamepad.button_3=fly", 'setting gamepad.button_3 is fly (--set gamepad.button_3=fly), but must be "none" or'),
        (
            "gamepad.button_17=stop",
            "there is no setting gamepad.button_17 (--set gamepad.button_17=stop); did you mean",
        ),
        ("gamepad.dead_zone=0.9", "but must be a number from 0.05 to 0.6"),
    ],
)
def test_a_wrong_mapping_is_one_sentence(setting: str, says: str) -> None:
    ran = App([*RUN, "--set", setting]).finish()
    assert ran.status == 2
    (said,) = [line for line in ran.told.splitlines() if line.startswith("m3r: ")]
    assert says in said
