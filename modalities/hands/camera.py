"""Live pictures from a camera of this machine or of the network: the newest only, stamped when they were captured.

A thread of its own takes every picture, so that none waits in a queue. A camera that is lost is tried again, with growing
pauses; a camera that is frozen, giving the same picture again and again, gives nothing.
"""

from __future__ import annotations

import random
import re
import threading
from collections.abc import Generator
from dataclasses import dataclass

import cv2
import numpy as np

from modalities.hands.video import Clock, Frame, Picture, VideoError, pixel_aspect, squared
from modalities.notices import Say, SenseChange, nothing_said

OPEN_TIMEOUT_S = 5.0
READ_TIMEOUT_S = 2.0
SILENT_S = 2.0
"""After so long without a new picture people are told."""
STALE_S = 0.5
"""An older picture is not looked at any more."""
FIRST_PAUSE_S = 0.5
LONGEST_PAUSE_S = 8.0
_POLL_S = 0.1


@dataclass(frozen=True, slots=True)
class CameraAddress:
    """Where a camera is. target: its number on this machine, or its RTSP or HTTP address; name: as it is said to people."""

    target: int | str
    name: str


def camera_address(text: str) -> CameraAddress | None:
    """What `--video` names, if it is a camera: `camera:0`, `rtsp://…`, `http://…`, `https://…`. Else None: a file.

    Raises VideoError where N is not a number. A password in an address is not repeated in its name.
    """
    if text.startswith("camera:"):
        number = text.removeprefix("camera:")
        if not (number.isascii() and number.isdigit() and int(number) < 100):
            raise VideoError(f"{text} is not a camera: number them from camera:0 on")
        return CameraAddress(int(number), text)
    if re.match(r"(rtsps?|https?)://", text):
        return CameraAddress(text, re.sub(r"//[^/@]*@", "//", text))
    return None


class Camera:
    """A camera that is being watched. `say` is told of its loss and return, from either thread."""

    def __init__(
        self,
        address: CameraAddress,
        *,
        clock: Clock,
        say: Say = nothing_said,
    ) -> None:
        """Opens it, within seconds. Raises VideoError if it cannot be opened or gives no picture now."""
        self.dropped = 0
        self.name = address.name
        self._target = address.target
        self._clock = clock
        self._say = say
        self._fresh = threading.Condition()
        self._newest: Frame | None = None
        self._last: Picture | None = None
        self._stopping = threading.Event()
        self._watched = False
        first = self._open()
        if first is None or self._read(first) is None:
            if first is not None:
                first.release()
            raise VideoError(f"{self.name} gives no picture: check that it is there and that nothing else uses it")
        # From now on, watched or not: a picture that had waited in a queue would be stamped too late.
        self._thread = threading.Thread(target=self._capture, args=(first,), name=self.name, daemon=True)
        self._thread.start()

    def frames(self, stopping: threading.Event) -> Generator[Frame]:
        """See VideoSource. Once only; it goes on through losses until `stopping` is set."""
        self._watched = True
        try:
            silent_since_s = self._clock()
            silent = False
            while not stopping.is_set():
                frame = self._take()
                now_s = self._clock()
                if frame is None:
                    if not silent and now_s - silent_since_s >= SILENT_S:
                        silent = True
                        self._say(
                            f"{self.name} has given no new picture for {SILENT_S:.0f} s: hands are not seen",
                            SenseChange.HANDS_NOT_SEEN,
                        )
                    continue
                if now_s - frame.captured_at_s > STALE_S:
                    self.dropped += 1
                    continue
                if silent:
                    self._say(f"{self.name} gives pictures again", SenseChange.HANDS_SEEN_AGAIN)
                silent, silent_since_s = False, now_s
                yield frame
        finally:
            self.close()

    def close(self) -> None:
        """Let the camera go; calling it again does nothing."""
        self._stopping.set()
        if self._thread is not threading.current_thread():
            self._thread.join(READ_TIMEOUT_S + 1.0)

    def _take(self) -> Frame | None:
        """The newest picture, waited for briefly."""
        with self._fresh:
            if self._newest is None:
                self._fresh.wait(_POLL_S)
            frame, self._newest = self._newest, None
            return frame

    def _capture(self, first: cv2.VideoCapture) -> None:
        capture: cv2.VideoCapture | None = first
        pause_s = FIRST_PAUSE_S
        while True:
            if capture is not None:
                if self._drain(capture):
                    pause_s = FIRST_PAUSE_S
                capture.release()
            if self._stopping.wait(pause_s * random.uniform(0.5, 1.0)):
                return
            pause_s = min(LONGEST_PAUSE_S, 2.0 * pause_s)
            capture = self._open()

    def _drain(self, capture: cv2.VideoCapture) -> bool:
        """Take pictures until the camera is lost or let go. True if there was any."""
        any_came = False
        while not self._stopping.is_set():
            frame = self._read(capture)
            if frame is None:
                break
            any_came = True
            if self._last is not None and np.array_equal(frame.picture, self._last):
                continue  # a sensor's noise is never the same twice: this is the old picture, not a new one
            self._last = frame.picture
            with self._fresh:
                self.dropped += self._watched and self._newest is not None
                self._newest = frame
                self._fresh.notify()
        return any_came

    def _read(self, capture: cv2.VideoCapture) -> Frame | None:
        try:
            if not capture.grab():
                return None
            captured_at_s = self._clock()  # before decoding, which takes its time
            readable, picture = capture.retrieve()
        except cv2.error:
            return None
        if not readable or picture is None:
            return None
        return Frame(squared(np.asarray(picture, np.uint8), pixel_aspect(capture)), captured_at_s)

    def _open(self) -> cv2.VideoCapture | None:
        try:
            if isinstance(self._target, int):
                capture = cv2.VideoCapture(self._target)
                capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
            else:
                limits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, round(OPEN_TIMEOUT_S * 1000.0)]
                limits += [cv2.CAP_PROP_READ_TIMEOUT_MSEC, round(READ_TIMEOUT_S * 1000.0)]
                capture = cv2.VideoCapture(self._target, cv2.CAP_FFMPEG, limits)
        except cv2.error:
            return None
        if capture.isOpened():
            return capture
        capture.release()
        return None
