"""Gestures at 0.7 to 5 m, in scenes that we make: photos of hands, shrunk, moving, in a background with blur, noise, dark or back light.

    python benchmarks/hands_distance.py [FOLDER] [PHOTOS]

FOLDER: as for `m3r evaluate hands` (default: ../shared/data/hands); PHOTOS: of each command (default 2, some minutes). Each distance is told
beside the paper's way, the landmarker on the whole picture, on the same scenes; dark and back light at 3 m. A hand is 18 cm long, the lens 60° wide, the picture
1280 x 720. Seeded: the same scenes each time.
"""

from __future__ import annotations

import math
import sys
import time
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from modalities.hands.dwell import DwellFilter
from modalities.hands.evaluation import frames_of
from modalities.hands.finder import Detector, HandFinder
from modalities.hands.gestures import read_hands
from modalities.hands.landmarker import HandDetector
from modalities.hands.video import Frame, Picture
from modalities.models.catalogue import HandModel, find_hand_model
from modalities.outcomes import DEFAULT_THRESHOLD, expected_of, recordings_in
from safety.vocabulary import Command

WIDTH_PX, HEIGHT_PX, RATE_HZ = 1280, 720, 30.0
FOCAL_PX = WIDTH_PX / 2 / math.tan(math.radians(30.0))
HAND_M = 0.18
EMPTY_S, SHOWN_S = 0.5, 1.7
Floats = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Light:
    """gain: of the picture; noise: standard deviation of 255; glare: how much brighter the background is than the hand."""

    name: str
    gain: float
    noise: float
    glare: float = 1.0


DAY, DARK, BACK = Light("day", 1.0, 4.0), Light("5 lux", 0.25, 8.0), Light("back light", 0.8, 4.0, 1.7)
SCENES = (*((distance_m, DAY) for distance_m in (0.7, 1.5, 3.0, 5.0)), (3.0, DARK), (3.0, BACK))


@dataclass(frozen=True, slots=True)
class Photo:
    """hand_px: how long the hand in it is, from wrist to the middle finger's tip along its bones."""

    folder: str
    path: Path
    picture: Picture
    hand_px: float


def photos_in(folder: Path, most: int, model: HandModel) -> list[Photo]:
    """So many of each sub-folder in which the landmarker finds a hand when it fills the picture."""
    chosen: list[Photo] = []
    with HandDetector(model) as bare:
        for name, path in recordings_in(folder):
            if sum(photo.folder == name for photo in chosen) < most:
                picture = next(iter(frames_of(path))).picture
                bare.forget()
                for hand in bare.detect(picture, 0.0)[:1]:
                    bones = hand.points_px[[0, 9, 10, 11, 12], :2]
                    length = float(np.linalg.norm(np.diff(bones, axis=0), axis=1).sum())
                    chosen.append(Photo(name, path, picture, length))
    return chosen


def background(random: np.random.Generator) -> Floats:
    """Soft shapes of many sizes, and edges."""
    picture: Floats = np.full((HEIGHT_PX, WIDTH_PX, 3), 120.0, np.float32)
    for rows in (8, 16, 40, 90):
        soft = random.normal(0.0, 1.0, (rows, rows * 16 // 9, 3)).astype(np.float32)
        picture += cv2.resize(soft, (WIDTH_PX, HEIGHT_PX), interpolation=cv2.INTER_CUBIC) * 30.0 / math.sqrt(rows / 8)
    for _ in range(25):
        x, y = int(random.integers(WIDTH_PX)), int(random.integers(HEIGHT_PX))
        across, down = random.integers(20, 300, 2)
        shade = random.uniform(-40.0, 40.0, 3).astype(np.float32)
        picture[y : y + int(down), x : x + int(across)] += shade
    return np.clip(picture, 0.0, 255.0)


def scene(photo: Photo, distance_m: float, light: Light) -> Iterator[Frame]:
    """An empty room, then the hand is raised into it and sways."""
    random = np.random.default_rng(zlib.crc32(f"{photo.path.name} {distance_m} {light.name}".encode()))
    room = np.clip(background(random) * light.glare, 0.0, 255.0)
    scale = min(FOCAL_PX * HAND_M / distance_m / photo.hand_px, 700 / photo.picture.shape[0])
    hand = cv2.resize(photo.picture.astype(np.float32), None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    height, width = hand.shape[:2]
    down, across = np.mgrid[0:height, 0:width]
    rim = np.minimum.reduce([across, down, width - 1 - across, height - 1 - down]) / max(2.0, 0.08 * height)
    opaque = np.clip(rim, 0.0, 1.0)[..., None]
    left, top = random.uniform(0, WIDTH_PX - width), random.uniform(0, HEIGHT_PX - height)
    for number in range(round((EMPTY_S + SHOWN_S) * RATE_HZ)):
        at_s = number / RATE_HZ
        picture = room.copy()
        if at_s >= EMPTY_S:
            rise_px = 60.0 * max(0.0, 1.0 - (at_s - EMPTY_S) / 0.2)
            x = int(np.clip(left + 6.0 * math.sin(4.4 * at_s), 0, WIDTH_PX - width))
            y = int(np.clip(top + 4.0 * math.sin(3.1 * at_s) + rise_px, 0, HEIGHT_PX - height))
            under = picture[y : y + height, x : x + width]
            picture[y : y + height, x : x + width] = opaque * hand + (1.0 - opaque) * under
        seen = cv2.GaussianBlur(picture, (0, 0), 0.8) * light.gain
        seen = seen + random.normal(0.0, light.noise, seen.shape)
        yield Frame(np.clip(seen, 0.0, 255.0).astype(np.uint8), at_s)


def asked(frames: Iterator[Frame], detector: Detector, spent_s: list[float]) -> list[tuple[Command, float]]:
    """What counts as requested, and the seconds from showing to it."""
    detector.forget()
    hold = DwellFilter()
    requests: list[tuple[Command, float]] = []
    for frame in frames:
        began = time.perf_counter()
        hands = detector.detect(frame.picture, frame.captured_at_s)
        spent_s.append(time.perf_counter() - began)
        held = hold.accept(read_hands(hands), frame.captured_at_s) if hands is not None else None
        if held is not None and (held.command is Command.STOP or held.confidence >= DEFAULT_THRESHOLD):
            requests.append((held.command, frame.captured_at_s - EMPTY_S))
    return requests


def tell(name: str, photos: list[Photo], distance_m: float, light: Light, detector: Detector) -> None:
    spent_s: list[float] = []
    right = wrong = moves = 0
    delays_s: list[float] = []
    for photo in photos:
        requests = asked(scene(photo, distance_m, light), detector, spent_s)
        commands, expected = {command for command, _ in requests}, expected_of(photo.folder)
        if expected is None:
            moves += bool(commands - {Command.STOP})
        elif commands == {expected}:
            right += 1
            delays_s.append(requests[0][1])
        else:
            wrong += bool(commands)
    shown = sum(expected_of(photo.folder) is not None for photo in photos)
    delay = f"{float(np.median(delays_s)):.2f} s" if delays_s else "-"
    print(
        f"{distance_m:g} m, {light.name}, {name}: {right} of {shown} right, {wrong} wrong, {delay} from showing to request (median); "
        f"other hands: {moves} of {len(photos) - shown} a move; {1000.0 * float(np.mean(spent_s)):.1f} ms a picture",
        flush=True,
    )


def main() -> None:
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "../shared/data/hands")
    if not folder.is_dir():
        sys.exit(f"{folder} is no folder: name one of photos of hands, as for m3r evaluate hands")
    model = find_hand_model()
    photos = photos_in(folder, int(sys.argv[2]) if len(sys.argv) > 2 else 2, model)
    with HandDetector(model) as whole, HandFinder.of(model) as finder:
        for distance_m, light in SCENES:
            tell("ours", photos, distance_m, light, finder)
            tell("whole picture", photos, distance_m, light, whole)


if __name__ == "__main__":
    main()
