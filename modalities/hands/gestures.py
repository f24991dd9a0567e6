"""Hand landmarks to one of nine gestures, or nothing. Pure: numbers in, a reading out.

The grammar: the index finger alone moves in the picture's plane; index and middle together go forward (up), back (down) or
turn (left, right); an open palm stops. A fist, three or four fingers, a thumb, a relaxed hand, no hand: nothing. Source:
paper section on gesture-based maneuvers, design 1 and 3.

Left and right are the operator's. An unmirrored camera that faces the operator shows the operator's left on the picture's
right; a mirrored one (a phone's selfie view) the other way round. Up and down are the picture's: hold the camera level.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from safety.vocabulary import Command

Points = NDArray[np.float64]

LANDMARKS = 21
"""MediaPipe's order: wrist 0; thumb 1 to 4, index 5 to 8, middle 9 to 12, ring 13 to 16, little 17 to 20, tips last."""
_WRIST = 0
_KNUCKLES = (5, 9, 13, 17)
_TIPS = (4, 8, 12, 16, 20)

LEAST_CONFIDENCE = 0.4
"""A reading less sure than this is no gesture at all: a hand on its way from one to another."""


class Direction(StrEnum):
    """Where fingers point, as the operator means it."""

    UP = "up"
    DOWN = "down"
    LEFT = "left"
    RIGHT = "right"


_ONE_FINGER = {
    Direction.UP: Command.GO_UP,
    Direction.DOWN: Command.GO_DOWN,
    Direction.LEFT: Command.GO_LEFT,
    Direction.RIGHT: Command.GO_RIGHT,
}
_TWO_FINGERS = {
    Direction.UP: Command.GO_FORWARD,
    Direction.DOWN: Command.GO_BACK,
    Direction.LEFT: Command.TURN_LEFT,
    Direction.RIGHT: Command.TURN_RIGHT,
}


@dataclass(frozen=True, slots=True)
class Hand:
    """One hand as the landmarker saw it.

    points_px: (21, 3) in the picture, x right, y down, z away from the camera at the scale of x. world_m: (21, 3) about the
    hand's middle. score: the detector's own, 0 to 1. width_px, height_px: of the picture.
    """

    points_px: Points
    world_m: Points
    score: float
    width_px: int
    height_px: int


@dataclass(frozen=True, slots=True)
class Fingers:
    """How likely each finger is extended, 0 to 1."""

    thumb: float
    index: float
    middle: float
    ring: float
    little: float

    @property
    def likely(self) -> tuple[float, float, float, float, float]:
        return self.thumb, self.index, self.middle, self.ring, self.little

    @property
    def extended(self) -> tuple[bool, ...]:
        return tuple(likely > 0.5 for likely in self.likely)

    @property
    def sureness(self) -> float:
        """How likely it is that all five are as they seem: every finger's margin counts."""
        return math.prod(max(likely, 1.0 - likely) for likely in self.likely)


@dataclass(frozen=True, slots=True)
class Reading:
    """What one picture asks for. command: None for nothing; text: what was seen, for people."""

    command: Command | None
    confidence: float
    text: str


NO_HAND = Reading(None, 0.0, "no hand")
DISAGREE = Reading(None, 0.0, "hands that disagree")
ELSEWHERE = Reading(None, 0.0, "a hand outside the operator's part of the picture")
TOO_MANY = Reading(None, 0.0, "more hands than can be told apart: only an open palm counts")
MOST_HANDS = 6
"""So many are looked for at once; where there are as many, there may be more, and one of them an open palm."""

# How likely a finger is extended: logistic regression on how far its two outer joints are bent and how far its tip reaches
# beyond its middle joint, seen from the wrist, in palms; for the thumb on its bend and on its tip's distance from the
# little finger's knuckle, in the picture and in the landmarker's world. Fitted (L2 1) on the digits zero to nine shown by
# 105 people, at all four right angles; measured on people left out of the fit.
_FINGER_BIAS = 2.33
_FINGER_PER_RIGHT_ANGLE = -6.71
_FINGER_PER_PALM = 5.91
_THUMB_BIAS = -7.25
_THUMB_PER_RIGHT_ANGLE = (-2.10, -2.54)
_THUMB_PER_PALM = (4.56, 3.70)
_THUMB_GOES_ALONG = 0.6
"""Log odds that the thumb does as the others do: out beside four extended fingers, in otherwise. A thumb that merely rests
along the index finger is in; and a palm that is missed is worse than one that is imagined.
"""

_SURE_WITHIN_DEG = 36.0
"""Fingers this far off the picture's axes point there as likely as not; beyond 45° it would be another direction."""
_TILT_SCALE_DEG = 3.0
_LEAST_IN_PLANE = 0.6
"""What share of a finger's length must lie in the picture's plane: pointing at the camera points nowhere."""
_IN_PLANE_SCALE = 0.05


class Region(StrEnum):
    """The part of the picture, as the camera gives it, whose hands are the operator's; others' count for nothing but STOP."""

    ALL = "all"
    LEFT = "left"
    RIGHT = "right"

    def holds(self, hand: Hand) -> bool:
        """By the middle of the hand."""
        share = float(hand.points_px[:, 0].mean()) / hand.width_px
        return self is Region.ALL or (share < 0.5 if self is Region.LEFT else share >= 0.5)


def read_hands(hands: Sequence[Hand], *, mirrored: bool = False, region: Region = Region.ALL) -> Reading:
    """What all hands in one picture ask for together.

    An open palm wins: STOP beats all (X4), and a false one is safe. Otherwise hands that show different gestures ask for nothing; a hand that
    shows none (a fist, a resting hand) does not object. Of MOST_HANDS or more nothing but STOP is taken: one that was not seen might object.
    """
    every = [(hand, read_hand(hand, mirrored=mirrored)) for hand in hands]
    readings = [reading for hand, reading in every if reading.command is Command.STOP or region.holds(hand)]
    if not readings:
        return NO_HAND if not every else ELSEWHERE
    asked = [reading for reading in readings if reading.command is not None]
    if not asked:
        return readings[0]
    stops = [reading for reading in asked if reading.command is Command.STOP]
    if not stops and len(hands) >= MOST_HANDS:
        return TOO_MANY
    if not stops and len({reading.command for reading in asked}) > 1:
        return DISAGREE
    return max(stops or asked, key=lambda reading: reading.confidence)


def read_hand(hand: Hand, *, mirrored: bool = False) -> Reading:
    """What one hand asks for. Nothing, where landmarks are not numbers or a fingertip lies outside the picture (it would be
    the landmarker's guess).
    """
    if not _is_whole(hand):
        return Reading(None, 0.0, "part of a hand")
    fingers = finger_states(hand)
    sure = fingers.sureness * (hand.score if 0.0 <= hand.score <= 1.0 else 0.0)
    extended = fingers.extended
    tips: tuple[int, ...]
    match extended:
        case (True, True, True, True, True):
            return _reading(Command.STOP, sure, "open palm")
        case (False, True, False, False, False):
            tips, name, commands = (8,), "index finger", _ONE_FINGER
        case (False, True, True, False, False):
            tips, name, commands = (8, 12), "index and middle finger", _TWO_FINGERS
        case _:
            return Reading(None, 0.0, _shape_of(extended))
    direction, likely = pointing(hand.points_px, tips, mirrored=mirrored)
    return _reading(commands[direction], sure * likely, f"{name} {direction}")


def finger_states(hand: Hand) -> Fingers:
    """How likely each finger is extended, whatever the hand's size, side and rotation."""
    picture, world = _palm(hand.points_px), _palm(hand.world_m)
    others = []
    for knuckle in _KNUCKLES:
        joints = (knuckle, knuckle + 1, knuckle + 2, knuckle + 3)
        reach = (_apart(hand.points_px, joints[3], _WRIST) - _apart(hand.points_px, joints[1], _WRIST)) / picture
        bend = _bend_deg(hand.points_px, joints) / 90.0
        others.append(_logistic(_FINGER_BIAS + _FINGER_PER_RIGHT_ANGLE * bend + _FINGER_PER_PALM * reach))
    thumb = _THUMB_BIAS + (_THUMB_GOES_ALONG if min(others) > 0.5 else -_THUMB_GOES_ALONG)
    for points, palm, per_angle, per_palm in (
        (hand.points_px, picture, _THUMB_PER_RIGHT_ANGLE[0], _THUMB_PER_PALM[0]),
        (hand.world_m, world, _THUMB_PER_RIGHT_ANGLE[1], _THUMB_PER_PALM[1]),
    ):
        thumb += per_angle * _bend_deg(points, (1, 2, 3, 4)) / 90.0 + per_palm * _apart(points, 4, 17) / palm
    return Fingers(_logistic(thumb), *others)


def pointing(points_px: Points, tips: Sequence[int], *, mirrored: bool = False) -> tuple[Direction, float]:
    """Where the fingers with these tips point together, and how likely that is: near 1 along the picture's axes, small
    between two of them and towards the camera.
    """
    x, y, z = np.mean([points_px[tip] - points_px[tip - 3] for tip in tips], axis=0).tolist()
    operators_left = -x if mirrored else x
    up = -y
    if abs(up) >= abs(operators_left):
        direction = Direction.UP if up >= 0.0 else Direction.DOWN
    else:
        direction = Direction.LEFT if operators_left > 0.0 else Direction.RIGHT
    off_deg = math.degrees(math.atan2(min(abs(x), abs(y)), max(abs(x), abs(y))))
    length = math.hypot(x, y, z)
    in_plane = math.hypot(x, y) / length if length > 0.0 else 0.0
    likely = _logistic((_SURE_WITHIN_DEG - off_deg) / _TILT_SCALE_DEG)
    return direction, likely * _logistic((in_plane - _LEAST_IN_PLANE) / _IN_PLANE_SCALE)


def _reading(command: Command, confidence: float, text: str) -> Reading:
    if not confidence >= LEAST_CONFIDENCE:  # NaN too
        return Reading(None, 0.0, f"{text}, not clear")
    return Reading(command, confidence, text)


def _is_whole(hand: Hand) -> bool:
    for points in (hand.points_px, hand.world_m):
        if points.shape != (LANDMARKS, 3) or not np.isfinite(points).all() or _palm(points) <= 0.0:
            return False
    tips = hand.points_px[list(_TIPS), :2]
    return bool((tips >= 0.0).all() and (tips <= (hand.width_px, hand.height_px)).all())


def _shape_of(extended: tuple[bool, ...]) -> str:
    count = sum(extended)
    if count == 0:
        return "fist"
    if extended == (True, False, False, False, False):
        return "thumb"
    return "one other finger" if count == 1 else f"{('two', 'three', 'four')[count - 2]} fingers that mean nothing"


def _palm(points: Points) -> float:
    """The palm's size: wrist to three knuckles and across, averaged."""
    return (_apart(points, 0, 5) + _apart(points, 0, 9) + _apart(points, 0, 17) + _apart(points, 5, 17)) / 4.0


def _apart(points: Points, a: int, b: int) -> float:
    return math.dist(points[a], points[b])


def _bend_deg(points: Points, joints: tuple[int, int, int, int]) -> float:
    """How far a finger is bent at its two inner joints together; 0: straight."""
    first, second, third = (points[b] - points[a] for a, b in pairwise(joints))
    return _angle_deg(first, second) + _angle_deg(second, third)


def _angle_deg(u: Points, v: Points) -> float:
    lengths = math.hypot(*u) * math.hypot(*v)
    return math.degrees(math.acos(max(-1.0, min(1.0, float(u @ v) / lengths)))) if lengths > 0.0 else 0.0


def _logistic(log_odds: float) -> float:
    return 1.0 / (1.0 + math.exp(-max(-60.0, min(60.0, log_odds))))
