"""Landmarks of a hand made of numbers, for tests of what is pure."""

from __future__ import annotations

import math

import numpy as np

from modalities.hands.gestures import Hand

WIDTH_PX, HEIGHT_PX = 640, 480
_KNUCKLES = ((0.27, 0.95), (0.06, 1.0), (-0.15, 0.95), (-0.34, 0.84))
_BONES = ((0.46, 0.28, 0.22), (0.51, 0.31, 0.23), (0.47, 0.29, 0.22), (0.36, 0.22, 0.19))
_THUMB_OUT = ((0.20, 0.12, -0.06), (0.50, 0.42, -0.10), (0.74, 0.68, -0.10), (0.92, 0.92, -0.08))
_THUMB_IN = ((0.20, 0.12, -0.06), (0.42, 0.36, -0.20), (0.24, 0.56, -0.44), (-0.04, 0.62, -0.52))


def make_hand(
    stretched: str,
    angle_deg: float = 90.0,
    *,
    size_px: float = 90.0,
    at_px: tuple[float, float] = (320.0, 240.0),
    left_hand: bool = False,
    towards_camera_deg: float = 0.0,
    folded: float = 1.0,
    score: float = 0.98,
) -> Hand:
    """stretched: thumb to little finger, | stretched and - folded (by `folded`, 0 to 1). angle_deg: where the hand points in the
    picture, anticlockwise from its right. towards_camera_deg: how far it leans to the camera.
    """
    points = [(0.0, 0.0, 0.0)]
    out = 1.0 if stretched[0] == "|" else 1.0 - folded
    points += [
        tuple(o * out + i * (1.0 - out) for o, i in zip(a, b, strict=True))
        for a, b in zip(_THUMB_OUT, _THUMB_IN, strict=True)
    ]
    for (x, y), bones, sign in zip(_KNUCKLES, _BONES, stretched[1:], strict=True):
        by = 0.0 if sign == "|" else folded
        at, bent = np.array([x, y, 0.0]), 0.05
        points.append(tuple(at))
        for length, full_deg in zip(bones, (75.0, 100.0, 60.0), strict=True):
            bent += math.radians(full_deg * by)
            at = at + length * np.array([0.0, math.cos(bent), -math.sin(bent)])
            points.append(tuple(at))
    shape = np.array(points)
    if left_hand:
        shape[:, 0] *= -1.0
    lean, turn = math.radians(towards_camera_deg), math.radians(angle_deg - 90.0)
    y, z = (
        shape[:, 1] * math.cos(lean) + shape[:, 2] * math.sin(lean),
        shape[:, 2] * math.cos(lean) - shape[:, 1] * math.sin(lean),
    )
    x = shape[:, 0] * math.cos(turn) - y * math.sin(turn)
    up = shape[:, 0] * math.sin(turn) + y * math.cos(turn)
    turned = np.stack([x, -up, z], axis=1)
    return Hand(turned * size_px + (*at_px, 0.0), turned * 0.09, score, WIDTH_PX, HEIGHT_PX)
