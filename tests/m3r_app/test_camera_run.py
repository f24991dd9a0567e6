"""A camera in the network flies the simulated drone through the whole app, and is unplugged in mid-flight."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from config.demo.drawn_hand import GESTURES, Pose, centre_of, draw, wall
from modalities.models.catalogue import ModelError, find_hand_model
from tests.mjpeg import serving
from tests.whole import PLAIN, App
from ui.check import mirror
from ui.check.command import PARTS
from ui.check.findings import Finding, State, Wanted

RUN = ("run", "--headless", "--pair", "red", "--scenario", str(PLAIN), "--timeout", "60")
PAUSE_S = 0.05


@pytest.fixture(autouse=True)
def _model() -> None:
    try:
        find_hand_model()
    except ModelError as error:
        pytest.skip(f"no hand model: {error}")


@cache
def drawn(pose: Pose | None) -> np.ndarray:
    room = wall(np.random.default_rng(7))
    return room if pose is None else draw(room, pose, centre_of(pose), -16.0)


def seen(shown: Callable[[], str]) -> Callable[[int], np.ndarray]:
    """What a camera gives of the hand that is shown: never the same picture twice."""
    noise = np.random.default_rng(1).normal(0.0, 3.0, (4, 480, 640, 3))

    def picture(number: int) -> np.ndarray:
        return np.clip(drawn(GESTURES.get(shown())) + noise[number % 4], 0, 255).astype(np.uint8)

    return picture


def test_a_camera_unplugged_in_mid_flight() -> None:
    hand = ""
    with serving(seen(lambda: hand), PAUSE_S) as (site, address):
        app = App([*RUN, "--video", str(address.target)])
        app.until("pair", status="confirmed")
        hand = "go_left"
        app.until("motion", status="started")
        site.down = True
        hand = ""
        gone = f"{address.name} has given no new picture for 2 s: hands are not seen"
        lost, flown = app.until("announce", text=gone), app.until("motion", status="completed")  # it flies on
        assert lost["t"] < flown["t"]
        site.down = False
        app.until("announce", text=f"{address.name} gives pictures again")
        hand = "go_up"
        app.until("motion", status="started")
        hand = "stop"
        app.until("motion", status="aborted")
        app.process.terminate()
        ran = app.finish()
    assert [(r["command"], r["modality"]) for r in ran.of("request")] == [
        ("go_left", "gesture"), ("go_up", "gesture"), ("stop", "gesture"),
    ]  # fmt: skip
    assert ran.status == 130
    assert ran.events[-1]["violations"] == 0


@pytest.mark.parametrize(
    ("pointing", "says"), [("go_left", "gesture.mirrored=false"), ("go_right", "gesture.mirrored=true"), ("", None)]
)
def test_the_mirror_test(pointing: str, says: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Somebody points to their own left; before a camera that shows them as a mirror would, it looks like their right."""
    monkeypatch.setattr(mirror, "POINT_S", 10.0 if says else 0.5)
    (look,) = (look for name, look in PARTS if name == "mirror test")
    with serving(seen(lambda: pointing), PAUSE_S) as (_, address):
        (found,) = look(Wanted(camera=address, mirror=True))
    assert (found.state is State.WORKS) == (says is not None)
    assert says is None or says in found.text


def test_the_mirror_test_needs_somebody_and_a_camera(monkeypatch: pytest.MonkeyPatch) -> None:
    with serving(seen(lambda: ""), PAUSE_S) as (_, address):
        monkeypatch.setattr("sys.stdin.isatty", lambda: False, raising=False)
        (found,) = mirror.mirror(Wanted(camera=address))
    assert found == Finding(
        "mirror test",
        State.NOT_DONE,
        "nobody is at a terminal",
        "run m3r check --mirror, standing before the camera",
    )
    monkeypatch.setattr(mirror, "camera_numbers", list)
    assert list(mirror.mirror(Wanted(mirror=True))) == []
