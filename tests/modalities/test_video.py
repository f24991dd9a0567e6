"""Video files in their own time, and cameras: newest picture only, lost and found again, never frozen."""

from __future__ import annotations

import struct
import threading
import time
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from modalities.hands.camera import Camera, CameraAddress, camera_address
from modalities.hands.video import Frame, PlayedFile, VideoError, VideoFile
from modalities.notices import SenseChange
from tests.mjpeg import Site, serving

WIDTH_PX, HEIGHT_PX = 160, 120


def picture(number: int) -> np.ndarray:
    """A picture that says its number by its brightness."""
    return np.full((HEIGHT_PX, WIDTH_PX, 3), 20 + 5 * (number % 45), np.uint8)


def write_video(path: Path, count: int = 30, rate_hz: float = 15.0, codec: str = "mp4v") -> Path:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), rate_hz, (WIDTH_PX, HEIGHT_PX))
    for number in range(count):
        writer.write(picture(number))
    writer.release()
    return path


def until(condition: Callable[[], object], seconds: float = 10.0) -> None:
    deadline = time.monotonic() + seconds
    tick = threading.Event()
    while not condition():
        assert time.monotonic() < deadline, "it did not come about in time"
        tick.wait(0.01)


@pytest.mark.parametrize(("name", "codec"), [("a.mp4", "mp4v"), ("a.webm", "VP80"), ("a.avi", "MJPG")])
def test_a_files_pictures_carry_its_own_time(tmp_path: Path, name: str, codec: str) -> None:
    frames = list(VideoFile(write_video(tmp_path / name, codec=codec)).frames())
    assert len(frames) == 30
    assert [frame.captured_at_s for frame in frames] == pytest.approx([n / 15.0 for n in range(30)], abs=2e-3)
    assert frames[10].picture.shape == (HEIGHT_PX, WIDTH_PX, 3)
    assert abs(float(frames[10].picture.mean()) - 70.0) < 8.0


def test_what_is_no_video_is_one_sentence_that_names_it(tmp_path: Path) -> None:
    (tmp_path / "empty.mp4").write_bytes(b"")
    (tmp_path / "text.mp4").write_text("not a video" * 100)
    cut = write_video(tmp_path / "cut.mp4").read_bytes()
    (tmp_path / "cut.mp4").write_bytes(cut[: len(cut) // 2])  # its table stands at the end
    for path in (tmp_path, tmp_path / "missing.mp4", *(tmp_path / n for n in ("empty.mp4", "text.mp4", "cut.mp4"))):
        with pytest.raises(VideoError) as error:
            VideoFile(path)
        assert str(path) in str(error.value)
        assert "\n" not in str(error.value)


def test_a_video_that_ends_too_early_says_so_after_what_it_gives(tmp_path: Path) -> None:
    whole = write_video(tmp_path / "a.avi", codec="MJPG").read_bytes()
    path = tmp_path / "broken.avi"
    path.write_bytes(whole[: len(whole) // 2])
    given: list[Frame] = []
    with pytest.raises(VideoError, match=r"broken.avi is damaged after \d"):
        given.extend(VideoFile(path).frames())


def encoded(path: Path, times_s: list[float], aspect: Fraction = Fraction(1)) -> Path:
    """Pictures at these times, of pixels that are `aspect` as wide as high."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=30)
        stream.width, stream.height, stream.pix_fmt = WIDTH_PX, HEIGHT_PX, "yuv420p"
        stream.codec_context.sample_aspect_ratio = aspect
        stream.codec_context.time_base = Fraction(1, 1000)
        for number, at_s in enumerate(times_s):
            frame = av.VideoFrame.from_ndarray(picture(number), format="bgr24")
            frame.pts, frame.time_base = round(1000 * at_s), Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


@pytest.mark.parametrize(
    ("aspect", "shape"), [(Fraction(2), (120, 320)), (Fraction(1, 2), (240, 160)), (1, (120, 160))]
)
def test_pixels_that_are_not_square_are_made_so(tmp_path: Path, aspect: Fraction, shape: tuple[int, int]) -> None:
    path = encoded(tmp_path / "a.mp4", [n / 10.0 for n in range(4)], Fraction(aspect))
    assert [frame.picture.shape[:2] for frame in VideoFile(path).frames()] == [shape] * 4


def test_a_variable_rate_is_no_damage(tmp_path: Path) -> None:
    times_s = [n / 30.0 for n in range(30)] + [1.0 + n / 3.0 for n in range(9)]
    for name in ("a.mp4", "a.mkv"):
        frames = list(VideoFile(encoded(tmp_path / name, times_s)).frames())
        assert [frame.captured_at_s for frame in frames] == pytest.approx(times_s, abs=2e-3)


def test_a_picture_that_was_taken_sideways_is_turned(tmp_path: Path) -> None:
    """As telephones state it: by a matrix in the track's header."""
    path = encoded(tmp_path / "a.mp4", [n / 10.0 for n in range(4)])
    content = bytearray(path.read_bytes())
    at = content.index(b"tkhd") + 44
    content[at : at + 36] = struct.pack(">9i", 0, 1 << 16, 0, -(1 << 16), 0, 0, 0, 0, 1 << 30)
    path.write_bytes(content)
    assert next(VideoFile(path).frames()).picture.shape[:2] == (WIDTH_PX, HEIGHT_PX)


class Hand:
    """A clock that is moved by hand, and an event whose waiting moves it."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.waited: list[float] = []

    def __call__(self) -> float:
        return self.now_s

    def wait(self, seconds: float) -> bool:
        self.waited.append(seconds)
        self.now_s += seconds
        return False


def test_a_played_file_keeps_its_time_and_leaves_out_what_comes_too_late(tmp_path: Path) -> None:
    clock = Hand()
    played = PlayedFile(VideoFile(write_video(tmp_path / "a.mp4")), clock=clock, began_s=100.0)
    times = []
    for frame in played.frames(clock):  # type: ignore[arg-type]
        times.append(frame.captured_at_s - 100.0)
        assert clock.now_s - frame.captured_at_s < 1.0 / 15.0, "only the newest"
        clock.now_s += 0.1  # a detector that takes longer than a frame lasts
    assert played.dropped > 5
    assert len(times) + played.dropped == 30
    assert times == sorted(times)
    assert times[-1] > 1.8


def test_playing_stops_when_told(tmp_path: Path) -> None:
    stopping = threading.Event()
    played = PlayedFile(VideoFile(write_video(tmp_path / "a.mp4")), clock=time.monotonic, began_s=time.monotonic())
    frames = played.frames(stopping)
    next(frames)
    stopping.set()
    assert list(frames) == []


@pytest.mark.parametrize(
    ("text", "target"),
    [
        ("camera:0", 0),
        ("camera:12", 12),
        ("rtsp://127.0.0.1:8554/a", "rtsp://127.0.0.1:8554/a"),
        ("http://127.0.0.1/v", "http://127.0.0.1/v"),
    ],
)
def test_cameras_are_told_from_files(text: str, target: object) -> None:
    address = camera_address(text)
    assert address is not None
    assert address.target == target
    assert camera_address("hands.mp4") is None
    assert camera_address("camera.mp4") is None


@pytest.mark.parametrize("text", ["camera:", "camera:x", "camera:-1", "camera:1000"])
def test_a_camera_number_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(VideoError, match=text):
        camera_address(text)


def test_a_password_is_not_repeated() -> None:
    address = camera_address("rtsp://me:secret@127.0.0.1/a")
    assert address == CameraAddress("rtsp://me:secret@127.0.0.1/a", "rtsp://127.0.0.1/a")


@pytest.fixture
def site() -> Iterator[tuple[type[Site], CameraAddress]]:
    with serving(picture) as (handler, address):
        yield handler, address


def test_an_address_where_nothing_is_is_one_sentence() -> None:
    address = camera_address("http://127.0.0.1:9/none")
    assert address is not None
    with pytest.raises(VideoError, match=r"http://127.0.0.1:9/none gives no picture"):
        Camera(address, clock=time.monotonic)


def test_a_camera_number_where_nothing_is_is_one_sentence(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(VideoError, match="camera:97 gives no picture"):
        Camera(CameraAddress(97, "camera:97"), clock=time.monotonic)
    assert capfd.readouterr().out == ""


class Watcher:
    """Takes a camera's frames in a thread, as the hand stream does."""

    def __init__(self, camera: Camera, pause_s: float = 0.0) -> None:
        self.frames: list[Frame] = []
        self.stopping = threading.Event()
        self._pause_s = pause_s
        self._camera = camera
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        for frame in self._camera.frames(self.stopping):
            self.frames.append(frame)
            self.stopping.wait(self._pause_s)

    def end(self) -> None:
        self.stopping.set()
        self._thread.join(10.0)
        assert not self._thread.is_alive()


def test_live_pictures_are_stamped_and_only_the_newest_is_looked_at(site: tuple[type[Site], CameraAddress]) -> None:
    _, address = site
    watcher = Watcher(camera := Camera(address, clock=time.monotonic), pause_s=0.1)
    try:
        until(lambda: len(watcher.frames) >= 5 and camera.dropped >= 5)
    finally:
        watcher.end()
    times = [frame.captured_at_s for frame in watcher.frames]
    assert times == sorted(set(times))
    assert time.monotonic() - 60.0 < times[0] <= times[-1] <= time.monotonic()


def test_a_lost_camera_is_announced_and_taken_up_again(
    site: tuple[type[Site], CameraAddress], monkeypatch: pytest.MonkeyPatch
) -> None:
    handler, address = site
    monkeypatch.setattr("modalities.hands.camera.SILENT_S", 0.3)
    monkeypatch.setattr("modalities.hands.camera.FIRST_PAUSE_S", 0.1)
    monkeypatch.setattr("modalities.hands.camera.LONGEST_PAUSE_S", 0.2)
    said: list[tuple[str, SenseChange | None]] = []
    watcher = Watcher(Camera(address, clock=time.monotonic, say=lambda text, change=None: said.append((text, change))))
    try:
        until(lambda: len(watcher.frames) >= 3)
        handler.down = True
        until(lambda: said)
        before = len(watcher.frames)
        handler.down = False
        until(lambda: len(watcher.frames) > before and len(said) == 2)
    finally:
        watcher.end()
    assert [change for _, change in said] == [SenseChange.HANDS_NOT_SEEN, SenseChange.HANDS_SEEN_AGAIN]
    assert "hands are not seen" in said[0][0]
    assert "gives pictures again" in said[1][0]
    assert address.name in said[0][0]


def test_a_frozen_camera_gives_nothing(site: tuple[type[Site], CameraAddress], monkeypatch: pytest.MonkeyPatch) -> None:
    handler, address = site
    monkeypatch.setattr("modalities.hands.camera.SILENT_S", 0.3)
    said: list[tuple[str, SenseChange | None]] = []
    watcher = Watcher(Camera(address, clock=time.monotonic, say=lambda text, change=None: said.append((text, change))))
    try:
        until(lambda: len(watcher.frames) >= 3)
        handler.frozen = True
        until(lambda: said)
        given = len(watcher.frames)
        served = handler.served
        until(lambda: handler.served >= served + 10)
        assert len(watcher.frames) == given, "the same picture again is no new one"
        handler.frozen = False
        until(lambda: len(watcher.frames) > given)
    finally:
        watcher.end()
