"""The mirror test of `m3r check`: does the camera show the operator as others see them, or as a mirror would?

A person points to their own left; where that is in the picture decides the setting `gesture.mirrored`. Nothing else can tell.
"""

from __future__ import annotations

import sys
import threading
import time
from typing import TYPE_CHECKING, Any

from modalities.native_output import discarded_stderr
from safety.vocabulary import Command
from ui.check.devices import camera_numbers
from ui.check.findings import Finding, State, Wanted, parts_of

if TYPE_CHECKING:
    from collections.abc import Iterator

POINT_S = 10.0
"""How long somebody may take to point."""
PART = "mirror test"
MEANS = {
    Command.GO_LEFT: "the picture is not mirrored: fly with gesture.mirrored=false",
    Command.GO_RIGHT: "the picture is mirrored: fly with --set gesture.mirrored=true",
}


def mirror(wanted: Wanted) -> Iterator[Finding]:
    """Watch for somebody who points to their left. Nothing to say where there is no camera or no hand model: others do."""
    from modalities.hands.camera import camera_address
    from modalities.hands.video import VideoError
    from modalities.models.catalogue import ModelError, find_hand_model

    numbers = camera_numbers()
    address = wanted.camera or (camera_address(f"camera:{numbers[0]}") if numbers else None)
    if address is None:
        return
    if not (wanted.mirror or (sys.stdin.isatty() and sys.stdout.isatty())):
        yield Finding(
            PART, State.NOT_DONE, "nobody is at a terminal", "run m3r check --mirror, standing before the camera"
        )
        return
    print(
        f"Point to your own left with one index finger, for the {PART} ({POINT_S:.0f} s) ...",
        file=sys.stderr,
        flush=True,
    )
    try:
        pointed = _pointed(address, find_hand_model())
    except ModelError:
        return
    except VideoError as error:
        yield Finding(PART, State.MISSING, *parts_of(str(error)))
        return
    if pointed is None:
        remedy = "try again with more light, the whole hand in the picture"
        yield Finding(PART, State.NOT_DONE, f"nobody was seen pointing left or right in {POINT_S:.0f} s", remedy)
    else:
        yield Finding(PART, State.WORKS, MEANS[pointed])


def _pointed(address: Any, model: Any) -> Command | None:
    """What somebody who points is taken to mean in an unmirrored picture; None: nobody did. Raises VideoError, ModelError."""
    from modalities.hands.camera import Camera
    from modalities.hands.dwell import DwellFilter
    from modalities.hands.gestures import read_hands
    from modalities.hands.landmarker import HandDetector

    stopping = threading.Event()
    hold = DwellFilter()
    with discarded_stderr(), HandDetector(model) as detector:
        camera = Camera(address, clock=time.monotonic)
        giving_up = threading.Timer(POINT_S, stopping.set)
        giving_up.start()
        try:
            for frame in camera.frames(stopping):
                hands = detector.detect(frame.picture, frame.captured_at_s)
                held = hold.accept(read_hands(hands, mirrored=False), frame.captured_at_s)
                if held is not None and held.command in MEANS:
                    return held.command
        finally:
            giving_up.cancel()
            stopping.set()
            camera.close()
    return None
