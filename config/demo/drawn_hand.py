"""A drawn hand: spheres on a skeleton, shaded like skin, in front of a wall; MediaPipe finds it as it finds a real one.

Drawn, so that the project ships what it shows and tests with; how well real hands are recognised is measured on real pictures.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Self

import cv2
import numpy as np

WIDTH_PX, HEIGHT_PX = 640, 480
MOVING_S = 0.27
"""How long fingers take to fold or stretch."""
PALM_PX = 112.0
TILT_DEG = -16.0
"""The side of the index finger is a little nearer: so a hand is held in front of a camera."""
LIGHT = np.array([-0.35, -0.45, 0.82])
SKIN = np.array([150.0, 178.0, 226.0])  # blue, green, red
DEEP_SKIN = np.array([70.0, 90.0, 165.0])

# Palms long: x towards the thumb, y towards the fingers, z out of the palm. Wrist at the origin.
KNUCKLES = {"index": (0.27, 0.95), "middle": (0.06, 1.0), "ring": (-0.15, 0.95), "little": (-0.34, 0.84)}
BONES = {
    "index": (0.46, 0.28, 0.22),
    "middle": (0.51, 0.31, 0.23),
    "ring": (0.47, 0.29, 0.22),
    "little": (0.36, 0.22, 0.19),
}
THICK = {"index": 0.115, "middle": 0.118, "ring": 0.11, "little": 0.097}
SPREAD_DEG = {"index": -4.0, "middle": 0.0, "ring": 6.0, "little": 14.0}
FOLDED_DEG = (75.0, 105.0, 55.0)
THUMB_OUT = ((0.20, 0.12, 0.06), (0.50, 0.42, 0.10), (0.74, 0.68, 0.10), (0.92, 0.92, 0.08))
THUMB_IN = ((0.20, 0.12, 0.06), (0.42, 0.36, 0.20), (0.24, 0.56, 0.44), (-0.04, 0.62, 0.52))


@dataclass(frozen=True)
class Pose:
    """How far each finger is folded (0 to 1), thumb first, and where the fingers point: degrees anticlockwise from right."""

    folded: tuple[float, float, float, float, float]
    angle_deg: float = 90.0


def pose(folded: str, angle_deg: float) -> Pose:
    """folded: thumb to little finger, | stretched and - folded."""
    return Pose(tuple(float(digit == "-") for digit in folded), angle_deg)  # type: ignore[arg-type]


FIST = pose("-----", 90.0)
# Seen by an unmirrored camera that faces the operator: the operator's left is the picture's right.
GESTURES: dict[str, Pose] = {
    "go_up": pose("-|---", 90.0),
    "go_down": pose("-|---", -84.0),
    "go_left": pose("-|---", 4.0),
    "go_right": pose("-|---", 176.0),
    "go_forward": pose("-||--", 90.0),
    "go_back": pose("-||--", -86.0),
    "turn_left": pose("-||--", 3.0),
    "turn_right": pose("-||--", 177.0),
    "stop": pose("|||||", 90.0),
}
NO_GESTURES: dict[str, Pose] = {
    "fist": FIST,
    "three fingers": pose("-|||-", 88.0),
    "four fingers": pose("-||||", 92.0),
    "thumb and two fingers": pose("|||--", 94.0),
    "between two directions": pose("-|---", 45.0),
}
"""Hands that ask for nothing."""


def skeleton(pose: Pose) -> list[tuple[np.ndarray, np.ndarray, float, float]]:
    """Bones as (from, to, radius there, radius here), in palms, not yet turned."""
    bones = []
    thumb = [
        np.array(a) * (1.0 - pose.folded[0]) + np.array(b) * pose.folded[0]
        for a, b in zip(THUMB_OUT, THUMB_IN, strict=True)
    ]
    for (a, b), (r, s) in zip(pairwise(thumb), ((0.17, 0.135), (0.125, 0.11), (0.11, 0.085)), strict=True):
        bones.append((a, b, r, s))
    for (name, (x, y)), folded in zip(KNUCKLES.items(), pose.folded[1:], strict=True):
        at = np.array([x, y, 0.0])
        radius = THICK[name]
        spread = math.radians(SPREAD_DEG[name] * (1.0 - 0.8 * folded))
        bent = math.radians(6.0)
        for number, (length, full_deg) in enumerate(zip(BONES[name], FOLDED_DEG, strict=True)):
            bent += math.radians(full_deg * folded + (3.0 if number else 0.0))
            along = np.array([-math.sin(spread) * math.cos(bent), math.cos(spread) * math.cos(bent), math.sin(bent)])
            to = at + length * along
            thinner = radius * (0.92 if number < 2 else 0.86)
            bones.append((at, to, radius, thinner))
            at, radius = to, thinner
    return bones


def spheres(pose: Pose) -> np.ndarray:
    """(n, 4): x, y, z, radius in palms, of everything that is skin, and the forearm."""
    out = []
    for a, b, r, s in skeleton(pose):
        steps = max(3, int(np.linalg.norm(b - a) / 0.03))
        out += [(*(a + (b - a) * t), r + (s - r) * t) for t in np.linspace(0.0, 1.0, steps)]
    # The palm: a slab between the wrist and the knuckles, thicker at the balls of thumb and little finger.
    for u in np.linspace(0.0, 1.0, 13):
        top = np.array([np.interp(u, (0, 0.33, 0.66, 1), [KNUCKLES[f][k] for f in KNUCKLES]) for k in (0, 1)])
        bottom = np.array([0.17 - 0.34 * u, 0.0])
        for v in np.linspace(0.0, 1.0, 15):
            x, y = bottom + (top - bottom) * v
            bulge = 0.05 * math.sin(math.pi * min(1.0, 1.3 * v)) * abs(2.0 * u - 1.0)
            out.append((x, y, 0.02 + bulge, 0.135 - 0.02 * v))
    for v in np.linspace(0.0, 1.0, 60):
        for u in np.linspace(-1.0, 1.0, 5):
            out.append((u * (0.12 + 0.14 * v), -4.2 * v, -0.02, 0.16 + 0.08 * v))
    return np.array(out)


def wall(rng: np.random.Generator) -> np.ndarray:
    """A plain room: soft gradients and a few blurred shapes, (h, w, 3) float."""
    y, x = np.mgrid[0:HEIGHT_PX, 0:WIDTH_PX] / (HEIGHT_PX - 1.0)
    picture = np.stack([168 + 26 * x - 18 * y, 172 + 22 * x - 22 * y, 176 + 18 * x - 26 * y], axis=2)
    for _ in range(5):
        corner = rng.integers(0, (WIDTH_PX, HEIGHT_PX))
        size = rng.integers(60, 220, 2)
        colour = rng.uniform(-26.0, 14.0)
        cv2.rectangle(
            picture, corner.tolist(), (corner + size).tolist(), (150 + colour, 154 + colour, 160 + colour), -1
        )
    return cv2.GaussianBlur(picture, (0, 0), 16.0)


def draw(background: np.ndarray, pose: Pose, centre_px: tuple[float, float], tilt_deg: float = 0.0) -> np.ndarray:
    """The hand in front of the background, (h, w, 3) float. tilt_deg: about the hand's own long axis."""
    balls = spheres(pose)
    lean, turn = math.radians(tilt_deg), math.radians(pose.angle_deg - 90.0)
    x = balls[:, 0] * math.cos(lean) + balls[:, 2] * math.sin(lean)
    z = -balls[:, 0] * math.sin(lean) + balls[:, 2] * math.cos(lean)
    y = balls[:, 1] - 0.75  # the hand's middle
    across = (x * math.cos(turn) - y * math.sin(turn)) * PALM_PX + centre_px[0]
    down = -(x * math.sin(turn) + y * math.cos(turn)) * PALM_PX + centre_px[1]
    depth = np.full((HEIGHT_PX, WIDTH_PX), -np.inf)
    for ball_x, ball_y, ball_z, radius in zip(across, down, z * PALM_PX, balls[:, 3] * PALM_PX, strict=True):
        left, right = max(0, int(ball_x - radius)), min(WIDTH_PX, int(ball_x + radius) + 2)
        top, bottom = max(0, int(ball_y - radius)), min(HEIGHT_PX, int(ball_y + radius) + 2)
        if left >= right or top >= bottom:
            continue
        dx = np.arange(left, right)[None, :] - ball_x
        dy = np.arange(top, bottom)[:, None] - ball_y
        room = radius * radius - dx * dx - dy * dy
        front = np.where(room > 0.0, ball_z + np.sqrt(np.maximum(room, 0.0)), -np.inf)
        patch = depth[top:bottom, left:right]
        np.maximum(patch, front, out=patch)
    return _shade(background, depth)


def _shade(background: np.ndarray, depth: np.ndarray) -> np.ndarray:
    skin = np.isfinite(depth)
    if not skin.any():
        return background.copy()
    solid = np.where(skin, depth, -0.6 * PALM_PX)
    # Joints melt into each other; the edges between fingers stay.
    smooth = cv2.bilateralFilter(solid.astype(np.float32), 9, 12.0, 4.0).astype(np.float64)
    slope_y, slope_x = np.gradient(smooth)
    normal = np.stack([-slope_x, -slope_y, np.ones_like(slope_x)], axis=2)
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    lit = np.clip(normal @ (LIGHT / np.linalg.norm(LIGHT)), 0.0, 1.0)
    # Where its surroundings are nearer the camera, less light gets in: that parts folded fingers from the palm.
    near = cv2.GaussianBlur(solid, (0, 0), 8.0)
    hidden = np.clip((near - solid) / 20.0, 0.0, 1.0)
    bright = np.clip(0.34 + 0.66 * lit - 0.40 * hidden, 0.0, 1.0)[..., None]
    rim = np.clip(normal[..., 2:], 0.0, 1.0) ** 0.5
    colour = (DEEP_SKIN + (SKIN - DEEP_SKIN) * bright) * (0.62 + 0.38 * rim)
    beside = cv2.warpAffine(
        skin.astype(np.float64), np.array([[1.0, 0.0, 14.0], [0.0, 1.0, 10.0]]), (WIDTH_PX, HEIGHT_PX)
    )
    shadow = cv2.GaussianBlur(beside, (0, 0), 14.0)[..., None]
    behind = background * (1.0 - 0.22 * shadow)
    cover = cv2.GaussianBlur(skin.astype(np.float64), (0, 0), 0.8)[..., None]
    return np.asarray(behind * (1.0 - cover) + colour * cover)


def between(a: Pose, b: Pose, part: float) -> Pose:
    eased = 0.5 - 0.5 * math.cos(math.pi * part)
    folded = tuple(p + (q - p) * eased for p, q in zip(a.folded, b.folded, strict=True))
    return Pose(folded, a.angle_deg + (b.angle_deg - a.angle_deg) * eased)  # type: ignore[arg-type]


def centre_of(pose: Pose) -> tuple[float, float]:
    """The hand's middle: so that the fingers stay inside the picture and the arm comes from its edge."""
    turn = math.radians(pose.angle_deg)
    return WIDTH_PX / 2.0 - 40.0 * math.cos(turn), HEIGHT_PX / 2.0 + 30.0 * math.sin(turn)


class Film:
    """A video of one hand that comes, shows something and leaves. For use in a `with` block."""

    def __init__(self, target: Path, rate_hz: float, codec: str = "mp4v") -> None:
        self._background = wall(np.random.default_rng(7))
        self._rate_hz = rate_hz
        self._count = 0
        size_px = (WIDTH_PX, HEIGHT_PX)
        self._writer = cv2.VideoWriter(str(target), cv2.VideoWriter.fourcc(*codec), rate_hz, size_px)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._writer.release()

    @property
    def length_s(self) -> float:
        """So far."""
        return self._count / self._rate_hz

    def nothing(self, for_s: float) -> None:
        """The empty room."""
        for _ in range(round(for_s * self._rate_hz)):
            self._write(self._background)

    def shows(self, what: Pose, for_s: float) -> tuple[float, float]:
        """A fist comes, becomes this, which stays for_s, and leaves as a fist. Returns from when to when it is there, s."""
        start = Pose(FIST.folded, what.angle_deg)
        moving = round(MOVING_S * self._rate_hz)
        for number in range(moving):
            self._hand(between(start, what, number / moving), 0.3 * number)
        from_s = self.length_s
        for number in range(round(for_s * self._rate_hz)):
            self._hand(what, 0.3 * (moving + number))
        to_s = self.length_s
        for number in range(moving):
            self._hand(between(what, start, number / moving), 0.3 * number)
        return from_s, to_s

    def _hand(self, what: Pose, sway: float) -> None:
        x, y = centre_of(what)
        centre_px = (x + 3.0 * math.sin(sway), y + 2.0 * math.cos(0.7 * sway))
        self._write(draw(self._background, what, centre_px, TILT_DEG + 3.0 * math.sin(0.5 * sway)))

    def _write(self, picture: np.ndarray) -> None:
        self._writer.write(np.clip(np.rint(picture), 0, 255).astype(np.uint8))
        self._count += 1
