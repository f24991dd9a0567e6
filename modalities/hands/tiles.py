"""Where to look for a hand that is too small for the whole picture: overlapping square tiles, in turn, where something moves first. Pure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

SHARES = (0.5, 0.25)
"""Sides of tiles, of the picture's height: a landmarker finds a hand of a fifth of its picture or more."""
SMALLEST_PX = 150
OVERLAP = 0.5
MOTION_WEIGHT = 40.0
"""A tile in which all the motion is waits this many times less long than one in which there is none."""
GRID = (45, 80)
"""Rows and columns that motion is measured on."""

Picture = NDArray[np.uint8]
Grey = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Square:
    """A part of a picture, in its pixels."""

    left: int
    top: int
    side: int

    def holds(self, points_px: NDArray[np.float64]) -> bool:
        """Whether all points (n, 2 or more) lie in it."""
        inside = (points_px[:, :2] >= (self.left, self.top)) & (
            points_px[:, :2] <= (self.left + self.side, self.top + self.side)
        )
        return bool(inside.all())

    def of(self, picture: Picture) -> Picture:
        """A copy: the landmarker reads a view that is not contiguous wrongly."""
        return np.ascontiguousarray(picture[self.top : self.top + self.side, self.left : self.left + self.side])


def around(x: float, y: float, side: float, width: int, height: int) -> Square:
    """The square of that side about a point, moved and shrunk into the picture."""
    whole = max(2, min(round(side), width, height))
    left, top = (round(min(max(0.0, at - whole / 2), size - whole)) for at, size in ((x, width), (y, height)))
    return Square(left, top, whole)


def tiles(width: int, height: int) -> tuple[Square, ...]:
    """Every tile of a picture of that size, the larger ones first."""
    sides = sorted({max(SMALLEST_PX, round(share * height)) for share in SHARES}, reverse=True)
    return tuple(
        Square(left, top, side)
        for side in sides
        if side <= min(width, height)
        for top in _starts(height, side)
        for left in _starts(width, side)
    )


def motion_between(before: Grey | None, now: Grey) -> Grey:
    """How much each cell of the grid has changed, each at least a little."""
    if before is None:
        return np.zeros_like(now)
    changed: Grey = np.abs(now - before)
    above: Grey = np.maximum(0.0, changed - 3.0 * float(np.median(changed)))
    return above


class Turns:
    """Whose turn it is: the tile that has waited longest, counted faster where something moves."""

    def __init__(self, width: int, height: int) -> None:
        self._tiles = tiles(width, height)
        self._waited = np.zeros(len(self._tiles))
        rows, columns = GRID
        self._cells = np.array(
            [
                (
                    int(tile.top / height * rows),
                    int(np.ceil((tile.top + tile.side) / height * rows)),
                    int(tile.left / width * columns),
                    int(np.ceil((tile.left + tile.side) / width * columns)),
                )
                for tile in self._tiles
            ],
            dtype=np.intp,
        ).reshape(-1, 4)

    def next(self, motion: Grey) -> Square:
        """motion: see `motion_between`. The tile to look at now."""
        sums = np.zeros((GRID[0] + 1, GRID[1] + 1))
        sums[1:, 1:] = motion.cumsum(axis=0, dtype=np.float64).cumsum(axis=1)
        top, bottom, left, right = self._cells.T
        inside = sums[bottom, right] - sums[top, right] - sums[bottom, left] + sums[top, left]
        self._waited += 1.0 + MOTION_WEIGHT * inside / max(sums[-1, -1], 1e-9)
        chosen = int(np.argmax(self._waited))
        self._waited[chosen] = 0.0
        return self._tiles[chosen]


def _starts(size: int, side: int) -> list[int]:
    """Where tiles of that side begin along one axis, evenly, overlapping by OVERLAP or a little more."""
    count = 1 + int(np.ceil((size - side) / (side * (1.0 - OVERLAP))))
    return [round(start) for start in np.linspace(0, size - side, count)]
