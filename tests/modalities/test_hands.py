"""Hands seen by the real landmarker in a video that this project draws; the hand stream; the evaluation."""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Generator, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from config.demo.drawn_hand import GESTURES, centre_of, draw, wall
from modalities.hands.dwell import HOLD_S, LEAST_SHARE
from modalities.hands.evaluation import evaluate_hands
from modalities.hands.gestures import Hand, read_hands
from modalities.hands.landmarker import HandDetector
from modalities.hands.stream import HandStream
from modalities.hands.video import Frame, VideoError, VideoFile
from modalities.models.catalogue import HandModel, ModelError
from modalities.outcomes import EvaluationError
from safety.vocabulary import Command, ManeuverRequest, Modality
from tests.modalities.hand_shapes import make_hand

pytestmark = pytest.mark.xdist_group("busy")  # it keeps a core busy: one of them at a time

ROOT = Path(__file__).resolve().parents[2]
VIDEO = ROOT / "tests" / "videos" / "all_nine.mp4"
SHOWN = json.loads(VIDEO.with_suffix(".json").read_text())
PHOTOS = Path(os.environ.get("M3R_HANDS") or ROOT.parent / "shared" / "data" / "hands")


class Source:
    """Frames as fast as they are taken, with their own time."""

    def __init__(self, frames: Iterator[Frame]) -> None:
        self.dropped = 0
        self._frames = frames

    def frames(self, stopping: threading.Event) -> Generator[Frame]:
        for frame in self._frames:
            if stopping.is_set():
                return
            yield frame


class Seen:
    """What a hand stream told."""

    def __init__(self) -> None:
        self.requests: list[ManeuverRequest] = []
        self.texts: list[str] = []
        self.error: Exception | None = None
        self.ended = threading.Event()

    def end(self, error: Exception | None) -> None:
        self.error = error
        self.ended.set()

    def watch(self, source: Source, detector: object, *, mirrored: bool = False) -> HandStream:
        stream = HandStream(
            source,
            detector,  # type: ignore[arg-type]
            clock=time.monotonic,
            on_request=self.requests.append,
            on_seen=self.texts.append,
            on_end=self.end,
            mirrored=mirrored,
        )
        stream.start()
        return stream


class Drawn:
    """Stands in for the landmarker: the hands that a picture's first number asks for."""

    def __init__(self, *hands: tuple[Hand, ...]) -> None:
        self._hands = hands

    def detect(self, picture: np.ndarray, _at_s: float) -> tuple[Hand, ...]:
        return self._hands[int(picture[0, 0, 0])]


def frames(kinds: list[int], rate_hz: float = 20.0) -> Iterator[Frame]:
    for number, kind in enumerate(kinds):
        yield Frame(np.full((2, 2, 3), kind, np.uint8), 5.0 + number / rate_hz)


def test_a_held_gesture_becomes_one_request_that_says_what_was_seen() -> None:
    seen = Seen()
    stream = seen.watch(Source(frames([0] * 5 + [1] * 40)), Drawn((), (make_hand("-|---", 0.0),)))
    assert seen.ended.wait(10.0)
    assert seen.error is None
    (request,) = seen.requests
    assert (request.command, request.modality, request.id) == ("go_left", Modality.GESTURE, "hand-1")
    assert request.evidence == "index finger left, held 0.5 s"
    shown_s = request.captured_at_s - (5.0 + 5 / 20.0)
    assert LEAST_SHARE * HOLD_S <= shown_s + 1e-6 <= HOLD_S
    assert request.confidence >= 0.7
    assert seen.texts == ["no hand", "index finger left"]
    assert stream.stop()


def test_a_mirrored_camera_means_the_other_side() -> None:
    seen = Seen()
    seen.watch(Source(frames([0] * 20)), Drawn((make_hand("-||--", 0.0),)), mirrored=True)
    assert seen.ended.wait(10.0)
    assert [request.command for request in seen.requests] == ["turn_right"]


def test_losing_the_hand_or_the_video_half_way_asks_for_nothing() -> None:
    def breaks_off() -> Iterator[Frame]:
        yield from frames([0] * 9)
        raise VideoError("the video is damaged after 0.5 s")

    for source in (Source(frames([0] * 9 + [1] * 40)), Source(breaks_off())):
        seen = Seen()
        seen.watch(source, Drawn((make_hand("-|---", 0.0),), ()))
        assert seen.ended.wait(10.0)
        assert seen.requests == []
    assert isinstance(seen.error, VideoError)


def test_whatever_goes_wrong_in_the_detector_is_told() -> None:
    seen = Seen()
    stream = seen.watch(Source(frames([3])), Drawn())
    assert seen.ended.wait(10.0)
    assert isinstance(seen.error, IndexError)
    assert stream.stop()
    assert not stream.alive


def test_stopping_ends_an_endless_video() -> None:
    def endless() -> Iterator[Frame]:
        number = 0
        while True:
            yield Frame(np.zeros((2, 2, 3), np.uint8), number / 30.0)
            number += 1

    seen = Seen()
    stream = seen.watch(Source(endless()), Drawn(()))
    assert stream.stop()
    assert seen.ended.is_set()
    assert seen.error is None


def test_the_landmarker_sees_all_nine_gestures_in_the_drawn_video_and_nothing_else(
    hand_model: HandModel, capfd: pytest.CaptureFixture[str]
) -> None:
    seen = Seen()
    detector = HandDetector(hand_model)
    assert capfd.readouterr() == ("", ""), "the library keeps quiet while it loads"
    found: list[bool] = []
    detect = detector.detect

    class Counting:
        def detect(self, picture: np.ndarray, at_s: float) -> tuple[Hand, ...]:
            hands = detect(picture, at_s)
            if any(part["from_s"] <= at_s < part["to_s"] for part in SHOWN):
                found.append(bool(hands))
            return hands

    seen.watch(Source(VideoFile(VIDEO).frames()), Counting())
    assert seen.ended.wait(100.0)
    detector.close()
    detector.close()
    assert seen.error is None
    assert sum(found) >= 0.95 * len(found)
    assert len(found) > 100
    assert [r.command for r in seen.requests] == [part["command"] for part in SHOWN if part["command"] != "none"]
    for request, part in zip(seen.requests, (p for p in SHOWN if p["command"] != "none"), strict=True):
        assert part["from_s"] - 0.2 <= request.captured_at_s < part["to_s"]
        assert request.confidence >= 0.7 or request.command == "stop"


def test_too_slow_a_camera_is_told_once() -> None:
    seen = Seen()
    told: list[str] = []
    pointing = (make_hand("-|---", 0.0),)
    slow = (Frame(np.zeros((2, 2, 3), np.uint8), number / 1.5) for number in range(12))
    stream = HandStream(
        Source(slow),
        Drawn(*[pointing] * 12),
        clock=lambda: 0.0,
        on_request=seen.requests.append,
        on_warning=told.append,
        on_end=lambda _error: seen.ended.set(),
    )
    stream.start()
    assert seen.ended.wait(10.0)
    assert seen.requests == []
    (sentence,) = told
    assert "only 1.5 pictures a second are seen and no gesture counts below 2.0" in sentence


@pytest.mark.requirement("X4")
def test_an_open_palm_is_seen_beside_two_hands_that_were_there_before(hand_model: HandModel) -> None:
    """Both of the landmarker's slots used to be taken by them."""
    cells = {
        name: cv2.resize(
            draw(wall(np.random.default_rng(1)), GESTURES[name], centre_of(GESTURES[name]), -16.0), (320, 240)
        )
        for name in ("go_up", "stop")
    }
    empty = cv2.resize(wall(np.random.default_rng(1)), (320, 240))
    row = np.hstack([cells["go_up"], cells["go_up"]])
    before, after = (np.vstack([row, np.hstack([empty, last])]).astype(np.uint8) for last in (empty, cells["stop"]))
    with HandDetector(hand_model) as detector:
        seen = [len(detector.detect(before, number / 30.0)) for number in range(4)]
        readings = [read_hands(detector.detect(after, (4 + number) / 30.0)) for number in range(4)]
    assert seen[-1] == 2
    assert readings[-1].command is Command.STOP


def still(at_s: float) -> np.ndarray:
    return next(frame.picture for frame in VideoFile(VIDEO).frames() if frame.captured_at_s >= at_s)


def test_the_evaluation_counts_as_the_contract_says(tmp_path: Path, hand_model: HandModel) -> None:
    begins = {part["command"]: part["from_s"] + 0.3 for part in reversed(SHOWN)}
    for folder, shown in (
        ("go_left", "go_left"),
        ("stop", "stop"),
        ("go_up", "go_down"),
        ("odd", "none"),
        ("none", "go_right"),
    ):
        (tmp_path / folder).mkdir()
        cv2.imwrite(str(tmp_path / folder / "a.png"), still(begins[shown]))
    cv2.imwrite(str(tmp_path / "stop" / "empty.png"), still(0.0))
    result = evaluate_hands(tmp_path, hand_model, negatives=["odd"])
    json.dumps(result, allow_nan=False)
    commands = result["commands"]
    assert isinstance(commands, dict)
    assert {name: (c["n"], c["right"], c["wrong"], c["missed"]) for name, c in commands.items()} == {
        "go_left": (1, 1, 0, 0),
        "go_up": (1, 0, 1, 0),
        "stop": (1, 1, 0, 0),
    }
    assert 0.0 < commands["go_left"]["latency_ms_p50"] < 5000.0
    assert commands["go_up"]["latency_ms_p50"] is None
    none = result["none"]
    assert isinstance(none, dict)
    assert (none["n"], none["false_moves"], none["false_stops"]) == (2, 1, 0)
    assert none["by_command"] == {"go_right": 1}
    assert none["by_folder"]["odd"] == {"n": 1, "false_moves": 0, "false_stops": 0}
    assert result["no_hand"] == 1
    assert result["model"] == "hand_landmarker"
    assert 0.0 < float(str(result["threshold"])) < 1.0


def test_what_cannot_be_evaluated_is_one_sentence(tmp_path: Path, hand_model: HandModel) -> None:
    with pytest.raises(EvaluationError, match="no sub-folder"):
        evaluate_hands(tmp_path, hand_model)
    (tmp_path / "stop").mkdir()
    (tmp_path / "stop" / "a.jpg").write_bytes(b"")
    with pytest.raises(EvaluationError, match=r"a\.jpg"):
        evaluate_hands(tmp_path, hand_model)
    (tmp_path / "stop" / "a.jpg").rename(tmp_path / "stop" / "a.mp4")
    with pytest.raises(VideoError, match=r"a\.mp4"):
        evaluate_hands(tmp_path, hand_model)


def test_a_model_that_only_looks_like_one_is_refused(tmp_path: Path) -> None:
    import zipfile

    path = tmp_path / "hand_landmarker.task"
    with zipfile.ZipFile(path, "w") as bundle:
        bundle.writestr("hand_detector.tflite", b"x" * 100)
        bundle.writestr("hand_landmarks_detector.tflite", b"x" * 100)
    with pytest.raises(ModelError, match=str(path)):
        HandDetector(HandModel(path, "a test"))
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(ModelError, match="truncated"):
        HandDetector(HandModel(path, "a test"))


@pytest.mark.skipif(
    not PHOTOS.is_dir(), reason="no photos of real hands (../shared/data/hands, or the folder that M3R_HANDS names)"
)
def test_real_hands_of_a_few_people(tmp_path: Path, hand_model: HandModel) -> None:
    """Every tenth photo; all of them are measured by `m3r evaluate hands`."""
    for folder in sorted(PHOTOS.iterdir()):
        (tmp_path / folder.name).mkdir()
        for photo in sorted(folder.iterdir())[::10]:
            (tmp_path / folder.name / photo.name).symlink_to(photo)
    result = evaluate_hands(tmp_path, hand_model)
    commands, none = result["commands"], result["none"]
    assert isinstance(commands, dict)
    assert isinstance(none, dict)
    assert len(commands) == 9
    assert sum(c["right"] for c in commands.values()) >= 0.94 * sum(c["n"] for c in commands.values())
    assert sum(c["wrong"] for c in commands.values()) == 0
    assert none["false_moves"] <= 0.05 * none["n"]


def test_a_missing_system_library_is_named_with_its_packages(
    hand_model: HandModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """MediaPipe loads libEGL when a landmarker is made, not when it is imported."""
    from mediapipe.tasks.python import vision

    def missing(_options: object) -> None:
        raise OSError("libEGL.so.1: cannot open shared object file: No such file or directory")

    monkeypatch.setattr(vision.HandLandmarker, "create_from_options", missing)
    with pytest.raises(ModelError, match=r"a library is missing: install libegl1 and libgles2 \(libEGL.so.1"):
        HandDetector(hand_model)
