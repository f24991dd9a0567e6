"""Video from a file as a camera would give it: pictures in order, each with its capture time.

In a file time is counted from the data, never from a clock. Live pictures come from `modalities.hands.camera`.
"""

from __future__ import annotations

import math
import os
import threading
from collections.abc import Callable, Generator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # what goes wrong is said in our own sentence
cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)

Clock = Callable[[], float]
Picture = NDArray[np.uint8]
"""(height, width, 3), blue green red, as OpenCV gives it."""

USUAL_RATE_HZ = 30.0
"""For files that do not say."""
_HIGHEST_RATE_HZ = 240.0
_NARROWEST = 0.25
_WHOLE = 0.9
"""A file that gives fewer of its pictures than this is damaged (containers state their length only roughly)."""


class VideoError(ValueError):
    """A video that cannot be used, or not any more; one sentence that names it and says what to do."""


@dataclass(frozen=True, slots=True)
class Frame:
    """One picture. captured_at_s: when it was taken, on its source's clock (a file: from its start)."""

    picture: Picture
    captured_at_s: float


def pixel_aspect(capture: cv2.VideoCapture) -> float:
    """Width of a pixel over its height; 1 where it is not stated or nonsense. (A stated rotation OpenCV applies by itself.)"""
    across, down = (float(capture.get(part)) for part in (cv2.CAP_PROP_SAR_NUM, cv2.CAP_PROP_SAR_DEN))
    aspect = across / down if across > 0.0 and down > 0.0 else 1.0
    return aspect if _NARROWEST <= aspect <= 1.0 / _NARROWEST else 1.0


def squared(picture: Picture, aspect: float) -> Picture:
    """The picture with square pixels: the longer side of them is kept, the other one stretched."""
    if aspect == 1.0:
        return picture
    height, width = picture.shape[:2]
    size = (round(width * aspect), height) if aspect > 1.0 else (width, round(height / aspect))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_LINEAR), np.uint8)


class VideoSource(Protocol):
    """Pictures as time passes, stamped on the app's clock; only the newest, those that came too late counted."""

    dropped: int

    def frames(self, stopping: threading.Event) -> Generator[Frame]:
        """Until the video ends or `stopping` is set. Raises VideoError where it breaks off for good."""
        ...


class VideoFile:
    """A video file, opened and tried."""

    def __init__(self, path: Path | str) -> None:
        """Raises VideoError if it is missing, or holds no picture that can be decoded."""
        self.path = Path(path)
        if self.path.is_dir():
            raise VideoError(f"{self.path} is a folder: name one video file")
        if not self.path.is_file():
            raise VideoError(f"video file {self.path} does not exist: check its name")
        capture = self._open()
        try:
            readable, picture = capture.read()
            rate_hz = float(capture.get(cv2.CAP_PROP_FPS))
            self._stated_frames = float(capture.get(cv2.CAP_PROP_FRAME_COUNT))
            self._aspect = pixel_aspect(capture)
        finally:
            capture.release()
        if not readable or picture is None:
            raise self._unreadable()
        known = math.isfinite(rate_hz) and 0.0 < rate_hz <= _HIGHEST_RATE_HZ
        self.rate_hz = rate_hz if known else USUAL_RATE_HZ

    def frames(self) -> Generator[Frame]:
        """Every picture, from the start. Raises VideoError at the end of what a damaged file still gives."""
        capture = self._open()
        count = 0
        last_s = -math.inf
        try:
            while True:
                readable, picture = capture.read()
                if not readable or picture is None:
                    break
                at_s = float(capture.get(cv2.CAP_PROP_POS_MSEC)) / 1000.0
                if not (math.isfinite(at_s) and at_s > last_s):
                    at_s = 0.0 if count == 0 else last_s + 1.0 / self.rate_hz
                count, last_s = count + 1, at_s
                yield Frame(squared(np.asarray(picture, np.uint8), self._aspect), at_s)
        finally:
            capture.release()
        if count == 0:
            raise self._unreadable()
        # A file of variable rate holds fewer pictures than its length at its rate, but lasts as long as it says.
        lasted = (last_s + 1.0 / self.rate_hz) * self.rate_hz
        if self._stated_frames > 0.0 and max(count, lasted) < _WHOLE * self._stated_frames - 1.0:
            raise VideoError(f"video file {self.path} is damaged after {last_s:.1f} s: record or convert it again")

    def _open(self) -> cv2.VideoCapture:
        try:
            capture = cv2.VideoCapture(str(self.path), cv2.CAP_FFMPEG)
        except cv2.error as error:
            raise self._unreadable() from error
        if not capture.isOpened():
            raise self._unreadable()
        return capture

    def _unreadable(self) -> VideoError:
        return VideoError(f"video file {self.path} cannot be read as video: give an mp4, webm, mkv or avi file")


class PlayedFile:
    """A video file in its own time: its second s is the app's time began_s + s."""

    def __init__(self, file: VideoFile, *, clock: Clock, began_s: float) -> None:
        self.dropped = 0
        self._file = file
        self._clock = clock
        self._began_s = began_s

    def frames(self, stopping: threading.Event) -> Generator[Frame]:
        """See VideoSource. A picture is left out where the next one is due already."""
        for frame in self._file.frames():
            due_s = self._began_s + frame.captured_at_s
            if stopping.wait(max(0.0, due_s - self._clock())):
                return
            if self._clock() - due_s >= 1.0 / self._file.rate_hz:
                self.dropped += 1
                continue
            yield Frame(frame.picture, due_s)
