"""Hands at any distance, with one call of the landmarker a picture: the whole picture while that shows them, else tiles in turn, and
then a part of the picture that goes with the hand.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol, Self

import cv2
import numpy as np

from modalities.hands.gestures import Hand, Region, read_hand
from modalities.hands.landmarker import HandDetector
from modalities.hands.tiles import GRID, Grey, Square, Turns, around, motion_between
from modalities.hands.video import Picture
from modalities.models.catalogue import HandModel
from safety.vocabulary import Command

WHOLE_EVERY = 5
"""Of the pictures in which a hand is searched, so many a look at the whole; the others at tiles."""
BLINKS = 5
"""A hand that the whole picture showed is not searched elsewhere before it has been missed so many times."""
ELSEWHERE_EVERY = 4
"""Of the pictures in which a hand is followed, every so many a look elsewhere: others may show an open palm, or object."""
SIDE_PER_HAND = 3.0
"""Side of the part that goes with a hand, in sizes of the hand."""
SMALLEST_SIDE_PX = 96
WIDENED = 1.4
"""... for every picture in which it is not found there."""
LOST_S = 0.6
"""Given up after so long."""
OTHERS_S = 1.0
"""How long a hand that was seen elsewhere still counts as there."""
FOLLOWING = 0.5
"""How much of a new speed is believed at once (constant velocity, smoothed)."""


class Detector(Protocol):
    """Hands in successive pictures; None where one was looked at elsewhere than where they are, so that it tells nothing."""

    def detect(self, picture: Picture, at_s: float) -> tuple[Hand, ...] | None: ...
    def forget(self) -> None: ...


class Whole(Protocol):
    """Hands in successive whole pictures: HandDetector."""

    def detect(self, picture: Picture, at_s: float) -> tuple[Hand, ...]: ...
    def forget(self) -> None: ...
    def close(self) -> None: ...


class Part(Protocol):
    """Hands in a part of one picture: HandDetector made for stills."""

    def detect_in(self, picture: Picture, part: Square) -> tuple[Hand, ...]: ...
    def close(self) -> None: ...


@dataclass(frozen=True, slots=True)
class _Followed:
    """Where the hand was last seen, in pixels and pixels a second. asks: it showed a gesture; missed: pictures since then in which it
    was not found.
    """

    x: float
    y: float
    size: float
    speed: tuple[float, float]
    at_s: float
    asks: bool
    missed: int = 0


class HandFinder:
    """Used by one thread at a time; close it."""

    def __init__(self, whole: Whole, part: Part, region: Region = Region.ALL) -> None:
        """region: where the operator's own hands are, which are followed."""
        self._region = region
        self._whole = whole
        self._part = part
        self._turns: Turns | None = None
        self._size = (0, 0)
        self.forget()

    @classmethod
    def of(cls, model: HandModel, region: Region = Region.ALL) -> Self:
        """Takes seconds. Raises ModelError as HandDetector does."""
        whole = HandDetector(model)
        try:
            return cls(whole, HandDetector(model, stills=True), region)
        except Exception:
            whole.close()
            raise

    def forget(self) -> None:
        """Another video follows."""
        self._whole.forget()
        self._before: Grey | None = None
        self._followed: _Followed | None = None
        self._blinks = BLINKS - 1
        self._looks = 0
        self._others: tuple[tuple[float, Hand], ...] = ()

    def detect(self, picture: Picture, at_s: float) -> tuple[Hand, ...] | None:
        """See Detector."""
        self._looks += 1
        if self._followed is not None:
            return self._follow(self._followed, picture, at_s)
        if self._blinks < BLINKS or self._looks % WHOLE_EVERY == 0:
            hands = self._whole.detect(picture, at_s)
            self._blinks = 0 if hands else self._blinks + 1
            return hands
        return self._take(self._look_at_a_tile(picture), at_s)

    def _look_at_a_tile(self, picture: Picture) -> tuple[Hand, ...]:
        height, width = picture.shape[:2]
        if self._turns is None or self._size != (width, height):
            self._turns, self._size, self._before = Turns(width, height), (width, height), None
        rows, columns = GRID
        small = cv2.resize(picture, (columns * 2, rows * 2), interpolation=cv2.INTER_AREA)
        now = cv2.resize(small, (columns, rows), interpolation=cv2.INTER_AREA).mean(axis=2, dtype=np.float32)
        motion = motion_between(self._before, now)
        self._before = now
        return self._part.detect_in(picture, self._turns.next(motion))

    def _take(self, hands: tuple[Hand, ...], at_s: float) -> tuple[Hand, ...]:
        """Follow the surest of the hands in a tile: an open palm first, then one that shows another gesture."""
        if hands:
            hand = max(
                hands, key=lambda one: (self._shows(one) is Command.STOP, self._shows(one) is not None, one.score)
            )
            x, y, size = _place(hand)
            self._followed = _Followed(x, y, size, (0.0, 0.0), at_s, self._shows(hand) is not None)
        return hands

    def _follow(self, last: _Followed, picture: Picture, at_s: float) -> tuple[Hand, ...] | None:
        self._others = tuple((seen_s, hand) for seen_s, hand in self._others if at_s - seen_s <= OTHERS_S)
        since_s = at_s - last.at_s
        if last.missed == 0 and self._looks % ELSEWHERE_EVERY == 0:
            return self._look_elsewhere(last, picture, at_s)
        if since_s > LOST_S:
            self._followed, self._others = None, ()
            return ()
        x, y = last.x + last.speed[0] * since_s, last.y + last.speed[1] * since_s
        side = max(SMALLEST_SIDE_PX, SIDE_PER_HAND * last.size) * WIDENED**last.missed
        height, width = picture.shape[:2]
        hands = self._part.detect_in(picture, around(x, y, side, width, height))
        if not hands:
            self._followed = replace(last, missed=last.missed + 1)
            return ()
        nearest = min(hands, key=lambda one: (_place(one)[0] - x) ** 2 + (_place(one)[1] - y) ** 2)
        new_x, new_y, size = _place(nearest)
        speed = (0.0, 0.0)
        if since_s > 0.0:
            measured = ((new_x - last.x) / since_s, (new_y - last.y) / since_s)
            speed = (
                last.speed[0] + FOLLOWING * (measured[0] - last.speed[0]),
                last.speed[1] + FOLLOWING * (measured[1] - last.speed[1]),
            )
        asks = any(self._shows(hand) is not None for hand in hands)
        self._followed = _Followed(new_x, new_y, size, speed, at_s, asks)
        # Who was seen elsewhere, once, may object, but asks for nothing.
        return (*hands, *(hand for _, hand in self._others if not _near(hand, self._followed))) if asks else hands

    def _look_elsewhere(self, last: _Followed, picture: Picture, at_s: float) -> tuple[Hand, ...] | None:
        """Whether anybody else shows anything. An open palm is followed from now on, and any gesture where this hand shows none."""
        if self._looks % (ELSEWHERE_EVERY * WHOLE_EVERY) == 0:
            found = self._whole.detect(picture, at_s)
        else:
            found = self._look_at_a_tile(picture)
        others = tuple(hand for hand in found if not _near(hand, last))
        shown = {self._shows(hand) for hand in others} - {None}
        if Command.STOP in shown or (shown and not last.asks):
            return self._take(others, at_s)
        self._others += tuple((at_s, hand) for hand in others)
        return None

    def _shows(self, hand: Hand) -> Command | None:
        """Its gesture, left and right as in the picture; of others' hands an open palm alone."""
        command = read_hand(hand).command
        return command if command is Command.STOP or self._region.holds(hand) else None

    def close(self) -> None:
        """Give its memory and threads back; calling it again does nothing."""
        self._whole.close()
        self._part.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _place(hand: Hand) -> tuple[float, float, float]:
    """Middle and size of a hand, in pixels."""
    low, high = hand.points_px[:, :2].min(axis=0), hand.points_px[:, :2].max(axis=0)
    return float((low[0] + high[0]) / 2), float((low[1] + high[1]) / 2), float((high - low).max())


def _near(hand: Hand, last: _Followed) -> bool:
    x, y, size = _place(hand)
    return max(abs(x - last.x), abs(y - last.y)) < max(size, last.size)
