"""What gestures cost beside the landmarker alone: from the completing frame to the request, and pictures per second.

    python benchmarks/hands.py [VIDEO]

VIDEO: without it, the project's own drawn hands. Bare: MediaPipe's landmarker in a loop, decoding and colour conversion
included, same options. Ours: the whole hand stream, in its own thread. Both on the same video in this run, in turn; the fastest
round of each counts, as the least disturbed by what else the machine does.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Generator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from modalities.hands.finder import HandFinder
from modalities.hands.landmarker import HandDetector
from modalities.hands.stream import HandStream
from modalities.hands.video import Frame, VideoError, VideoFile
from modalities.models.catalogue import HandModel, ModelError, find_hand_model
from safety.vocabulary import ManeuverRequest

ROOT = Path(__file__).resolve().parent.parent
ROUNDS = 4
LATENCY_BAR_MS = 5.0
THROUGHPUT_BAR = 0.95


class Timed:
    """The landmarker, with the time that its last picture took."""

    def __init__(self, landmarker: Any) -> None:
        self._landmarker = landmarker
        self.last_s = 0.0

    def detect_for_video(self, image: Any, at_ms: int) -> Any:
        began = time.perf_counter()
        result = self._landmarker.detect_for_video(image, at_ms)
        self.last_s = time.perf_counter() - began
        return result

    def close(self) -> None:
        self._landmarker.close()


class Unpaced:
    """A video as fast as it is taken; notes when the last frame was handed over."""

    dropped = 0

    def __init__(self, file: VideoFile) -> None:
        self._file = file
        self.count = 0
        self.handed_over_s = 0.0

    def frames(self, stopping: threading.Event) -> Generator[Frame]:
        for frame in self._file.frames():
            if stopping.is_set():
                return
            self.count += 1
            self.handed_over_s = time.perf_counter()
            yield frame


def bare_rate_hz(file: VideoFile, model: HandModel) -> float:
    """Pictures per second of a loop that does nothing but find landmarks."""
    import mediapipe

    with HandDetector(model) as detector:  # its landmarker has the shipped options and is warm
        landmarker = detector._landmarker
        capture = cv2.VideoCapture(str(file.path), cv2.CAP_FFMPEG)
        count, began = 0, time.perf_counter()
        while True:
            readable, picture = capture.read()
            if not readable:
                break
            count += 1
            image = mediapipe.Image(mediapipe.ImageFormat.SRGB, cv2.cvtColor(picture, cv2.COLOR_BGR2RGB))
            landmarker.detect_for_video(image, count * 40)
        took_s = time.perf_counter() - began
        capture.release()
    return count / took_s


def our_rate_hz(file: VideoFile, model: HandModel) -> tuple[float, list[float]]:
    """Pictures per second of the whole hand stream, and for each request the seconds from its frame beyond the landmarker."""
    whole, part = HandDetector(model), HandDetector(model, stills=True)
    timed = Timed(whole._landmarker)
    whole._landmarker = timed
    with HandFinder(whole, part) as detector:
        source = Unpaced(file)
        latencies_s: list[float] = []
        ended = threading.Event()
        errors: list[Exception] = []

        def request(_request: ManeuverRequest) -> None:
            latencies_s.append(time.perf_counter() - source.handed_over_s - timed.last_s)

        def end(error: Exception | None) -> None:
            if error is not None:
                errors.append(error)
            ended.set()

        stream = HandStream(source, detector, clock=time.monotonic, on_request=request, on_end=end)
        began = time.perf_counter()
        stream.start()
        ended.wait()
        took_s = time.perf_counter() - began
        stream.stop()
    if errors:
        raise errors[0]
    return source.count / took_s, latencies_s


def main(arguments: list[str]) -> int:
    try:
        file = VideoFile(arguments[0] if arguments else ROOT / "tests" / "videos" / "all_nine.mp4")
        model = find_hand_model()
        print(f"{model.sentence}; video: {file.path}")
        bare, ours, latencies_s = [], [], []
        for _ in range(ROUNDS):
            bare.append(bare_rate_hz(file, model))
            rate_hz, latencies = our_rate_hz(file, model)
            ours.append(rate_hz)
            latencies_s += latencies
    except (ModelError, VideoError) as error:
        print(error, file=sys.stderr)
        return 2
    if not latencies_s:
        print(f"{file.path} shows no gesture that is held: nothing to measure", file=sys.stderr)
        return 2
    ratio = max(ours) / max(bare)
    p50, p95 = (float(np.percentile(latencies_s, percent)) * 1000.0 for percent in (50, 95))
    table = Table(title="hands: what recognition costs beside the landmarker alone")
    for column in ("", "bare", "ours", "bar"):
        table.add_column(column, justify="right")
    table.add_row("pictures per second, best round", f"{max(bare):.1f}", f"{max(ours):.1f}", "")
    table.add_row("throughput beside bare", "1", f"{ratio:.3f}", f"≥ {THROUGHPUT_BAR}")
    table.add_row(f"frame to request beyond the landmarker, p50 of {len(latencies_s)}, ms", "", f"{p50:.2f}", "")
    table.add_row("... p95, ms", "", f"{p95:.2f}", f"≤ {LATENCY_BAR_MS:g}")
    Console(width=120).print(table)
    return 0 if ratio >= THROUGHPUT_BAR and p95 <= LATENCY_BAR_MS else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
