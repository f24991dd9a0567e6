"""Hands fly the simulated drone through the whole app: real MediaPipe, real MAVSDK, real UDP."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Generator
from pathlib import Path

import cv2
import pytest

from config.settings import load_settings
from m3r_app.inputs import Hands, Senses
from modalities.hands.video import Frame, VideoFile
from modalities.models.catalogue import ModelError, find_hand_model
from modalities.notices import SenseChange
from safety.vocabulary import Command, ManeuverRequest
from tests.whole import PLAIN, m3r

DRAWN = Path(__file__).resolve().parents[1] / "videos" / "all_nine.mp4"
RUN = ("run", "--headless", "--pair", "red", "--scenario", str(PLAIN), "--timeout", "60")


@pytest.fixture(autouse=True)
def _model() -> None:
    try:
        find_hand_model()
    except ModelError as error:
        pytest.skip(f"no hand model: {error}")


def cut(path: Path, *parts: tuple[float, float]) -> Path:
    """These seconds of the project's own video, one after the other."""
    video = VideoFile(DRAWN)
    frames = list(video.frames())
    height_px, width_px = frames[0].picture.shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), video.rate_hz, (width_px, height_px))
    for from_s, to_s in parts:
        for frame in frames:
            if from_s <= frame.captured_at_s < to_s:
                writer.write(frame.picture)
    writer.release()
    return path


def test_hands_fly_the_drone(tmp_path: Path) -> None:
    """A fist asks for nothing, the index finger to the left moves, an open palm stops in mid-move."""
    video = cut(tmp_path / "hands.mp4", (2.4, 3.4), (5.2, 6.8), (21.2, 23.2))
    ran = m3r(*RUN, "--video", str(video), "--audio", "none")
    assert ran.status == 0, ran.told
    requests = ran.of("request")
    assert [(r["command"], r["modality"]) for r in requests] == [("go_left", "gesture"), ("stop", "gesture")]
    assert requests[0]["evidence"] == "index finger left, held 0.5 s"
    assert all(0.0 <= r["latency_ms"] < 1000.0 for r in requests)
    assert ran.verdicts() == {"hand-1": "approved"}
    assert [(m["request"], m["status"]) for m in ran.of("motion")] == [("hand-1", "started"), ("hand-1", "aborted")]
    assert ran.events[-1]["reason"] == "inputs_played"
    assert ran.events[-1]["violations"] == 0


async def test_the_settings_of_gestures_reach_the_hands(tmp_path: Path) -> None:
    """A mirrored video means the other side, and a longer hold is asked for."""
    video = cut(tmp_path / "hands.mp4", (5.2, 7.4))
    gesture = load_settings([], ["gesture.mirrored=true", "gesture.hold_s=0.6"]).gesture
    requests: list[ManeuverRequest] = []
    seen: list[str] = []
    hands = Hands(video, gesture, time.monotonic, lambda _sentence: None)
    assert hands.sentences[1] == f"watching {video}, mirrored: hold a gesture for 0.6 s"
    try:
        assert await hands.play(time.monotonic(), time.monotonic, requests.append, Senses(shown=seen.append)) is None
    finally:
        hands.close()
    assert [(r.command, r.evidence) for r in requests] == [(Command.GO_RIGHT, "index finger right, held 0.6 s")]
    assert "index finger right" in seen


@pytest.mark.requirement("X7")
async def test_a_stuck_camera_does_not_keep_the_end_of_a_run_waiting() -> None:
    """X7: whoever ends the run puts the drone in Hold next."""

    class Stuck:
        dropped = 0
        name = "stuck"
        opened = threading.Event()
        freed = threading.Event()

        def frames(self, _stopping: threading.Event) -> Generator[Frame]:
            self.opened.set()
            self.freed.wait()
            yield from ()

        def close(self) -> None:
            self.freed.set()

    said: list[object] = []
    hands = Hands(DRAWN, load_settings().gesture, time.monotonic, lambda text, change=None: said.append((text, change)))
    stuck = Stuck()
    hands._file, hands._camera = None, stuck  # type: ignore[assignment]
    playing = asyncio.create_task(
        hands.play(time.monotonic(), time.monotonic, lambda _request: None, lambda _shown: None)
    )
    assert await asyncio.to_thread(stuck.opened.wait, 10.0)
    began_s = time.monotonic()
    playing.cancel()
    with pytest.raises(asyncio.CancelledError):
        await playing
    assert time.monotonic() - began_s < 0.5
    assert not stuck.freed.is_set()
    hands.close()
    assert stuck.freed.is_set()
    assert said == []


async def test_a_live_stream_that_breaks_is_told_and_ends_nothing() -> None:
    class Broken:
        dropped = 0
        name = "broken"

        def frames(self, _stopping: threading.Event) -> Generator[Frame]:
            raise OSError("out of memory")
            yield  # a generator, as a camera's frames are

        def close(self) -> None: ...

    told = asyncio.Event()
    said: list[str] = []

    def say(sentence: str, change: SenseChange | None = None) -> None:
        assert change is SenseChange.HANDS_OFF
        said.append(sentence)
        told.set()

    hands = Hands(DRAWN, load_settings().gesture, time.monotonic, say)
    hands._file, hands._camera = None, Broken()  # type: ignore[assignment]
    playing = asyncio.create_task(
        hands.play(time.monotonic(), time.monotonic, lambda _request: None, lambda _shown: None)
    )
    await asyncio.wait_for(told.wait(), 10.0)
    assert said == ["hands are off (out of memory): use another way to say stop"]
    assert not playing.done()
    playing.cancel()
    await asyncio.wait({playing})
    hands.close()


@pytest.mark.soak
def test_a_video_that_breaks_off_is_told_and_the_rest_flies(tmp_path: Path) -> None:
    """Half of a file: hands are off, the script's move is completed, and the file was bad input all the same."""
    whole = cut(tmp_path / "whole.avi", (5.2, 5.9))
    broken = tmp_path / "broken.avi"
    data = whole.read_bytes()
    broken.write_bytes(data[: len(data) // 2])
    with pytest.raises(ValueError, match="damaged"):
        list(VideoFile(broken).frames())
    ran = m3r(*RUN, "--video", str(broken), "--script", "-", stdin="1.5 panel go left\n")
    assert ran.status == 2
    assert any(a["text"].startswith(f"hands are off: video file {broken} is damaged") for a in ran.of("announce"))
    assert [r["modality"] for r in ran.of("request")] == ["panel"]
    assert ran.of("motion", status="completed")
    assert ran.told.count("m3r: video file") == 1


@pytest.mark.parametrize("kind", ["missing", "text", "no model"])
def test_what_cannot_be_watched_is_exit_2(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    video = tmp_path / "hands.mp4"
    named = str(video)
    if kind == "text":
        video.write_text("no video at all\n" * 100)
    elif kind == "no model":
        video, named = DRAWN, "there is no hand model"
        monkeypatch.setenv("M3R_MODELS", str(tmp_path))
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    ran = m3r(*RUN, "--video", str(video))
    assert ran.status == 2
    sentences = [line for line in ran.told.splitlines() if line.startswith("m3r: ")]
    assert len(sentences) == 1, ran.told
    assert named in sentences[0]
