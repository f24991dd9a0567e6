"""A gamepad flies the simulated drone through the whole app, stops it by a stick, and is unplugged in mid-flight."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.virtual_pad import NAME, TRIGGERS, Fingers
from tests.whole import PLAIN, App

RUN = ("run", "--headless", "--pair", "red", "--scenario", str(PLAIN), "--timeout", "60", "--gamepad")


@pytest.fixture
def fingers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Fingers]:
    fingers = Fingers(tmp_path / "pad")
    monkeypatch.setenv("M3R_TEST_PAD", str(fingers.path))
    yield fingers
    fingers.close()


@pytest.mark.requirement("R1", "X4")
def test_buttons_ask_a_stick_stops_and_so_does_the_plug(fingers: Fingers) -> None:
    app = App(RUN, program="tests.virtual_pad")
    fingers.plug()
    app.until("announce", text=f"gamepad {NAME}: buttons and hats ask, any stick or trigger is STOP")
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
        "announce", text=f"the gamepad {NAME} is gone and STOP was asked for: plug it in again, or ask in another way"
    )
    app.until("motion", status="aborted")
    fingers.plug()
    app.until("announce", text=f"the gamepad {NAME} is back")
    fingers.press(0)
    app.until("motion", status="started")
    fingers.axis(TRIGGERS[0], -0.2)
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
        ("stop", "panel", 1.0, "gamepad trigger 4 moved"),
    ]
    assert set(ran.verdicts().values()) == {"approved"}
    assert ran.status == 130
    assert ran.events[-1]["violations"] == 0


@pytest.mark.requirement("X4")
def test_a_stick_that_is_held_over_at_the_start_moves_nothing(fingers: Fingers) -> None:
    app = App(RUN, program="tests.virtual_pad")
    fingers.plug()
    fingers.axis(3, -0.9)
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
