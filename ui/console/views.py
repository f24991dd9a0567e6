"""The views on the screen: drawings by textual-plot, the hands' skeleton by its canvas."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from textual_hires_canvas import Canvas, HiResMode
from textual_plot import PlotWidget

from ui.console.drawing import nice_step
from ui.console.panels import ink

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from modalities.hands.gestures import Hand
    from ui.console.drawing import Drawing, Stroke, Window

    Floats = NDArray[np.float64]

MOST_SIGNS = 2000
"""Of one line."""
INKS = {
    "contour": "rgb(130,110,80)",
    "ground": "rgb(160,120,60)",
    "agl": "rgb(110,110,110)",
    "fence": "magenta",
    "obstacle": "rgb(200,120,60)",
    "anchor": "cyan",
    "granted": "bold green",
    "refused": "bold red",
    "spread": "yellow",
    "stale": "bold yellow",
    "operator": "bold",
}
"""What has no colour of its own name."""
PLAIN_SIGNS = {"contour": ".", "ground": "=", "agl": "-", "fence": "x", "obstacle": "#", "anchor": "~", "refused": "!"}
"""What lines are made of where there is ASCII only: with one sign for all a hillside would be a solid block."""
BONES = (
    (0, 1, 2, 3, 4),
    (0, 5, 6, 7, 8),
    (5, 9, 10, 11, 12),
    (9, 13, 14, 15, 16),
    (13, 17, 18, 19, 20),
    (0, 17),
)
"""MediaPipe's hand landmarks in rows."""


class View(PlotWidget, can_focus=False):
    """A drawing in metres, never scrolled by keys: they fly the drone."""

    def __init__(self, *, id: str) -> None:  # noqa: A002  (Textual's name)
        super().__init__(id=id, allow_pan_and_zoom=False)
        self._drawn: Drawing | None = None
        self._plain = False

    def on_mount(self) -> None:
        super().on_mount()
        self.margin_left, self.margin_top, self.margin_bottom = 5, 0, 1

    @property
    def aspect(self) -> float:
        """Width over height in metres: a cell is twice as high as wide."""
        width, height = self.size.width - 7, self.size.height - 3
        return max(0.2, width / (2.0 * max(1, height)))

    def draw(self, drawing: Drawing, *, plain: bool) -> None:
        """Show it. plain: with ASCII signs only."""
        self.clear()
        window = drawing.window
        self.set_xlimits(window.x_min, window.x_max)
        self.set_ylimits(window.y_min, window.y_max)
        self.set_yticks(heights(window.y_min, window.y_max, self.size.height - 3))
        for stroke in drawing.strokes:
            style = INKS.get(stroke.kind) or ink(stroke.name)
            if plain:
                xs, ys = signed(stroke, window, (window.x_max - window.x_min) / max(1, self.size.width))
                self.scatter(xs, ys, marker=PLAIN_SIGNS.get(stroke.kind, "."), marker_style=style)
            else:
                self.plot(stroke.xs, stroke.ys, line_style=style, hires_mode=HiResMode.BRAILLE)
        for mark in drawing.marks:
            style = INKS.get(mark.kind) or f"bold {ink(mark.name)}"
            self.scatter([mark.x], [mark.y], marker=mark.sign, marker_style=style)


def heights(low_m: float, high_m: float, rows: int) -> list[float]:
    """Round numbers for the upright axis, more than a row apart: nearer, one would be written over another."""
    step_m = nice_step(1.25 * (high_m - low_m) / max(1, rows))
    return [n * step_m for n in range(math.ceil(low_m / step_m), math.floor(high_m / step_m) + 1)]


def signed(stroke: Stroke, window: Window, apart_m: float) -> tuple[Floats, Floats]:
    """Places in the window along a stroke, no farther apart than apart_m, to put signs at."""
    known = np.isfinite(stroke.xs) & np.isfinite(stroke.ys)
    xs, ys = stroke.xs[known], stroke.ys[known]
    if not xs.size:
        return xs, ys
    along = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(xs), np.diff(ys)))])
    at = np.linspace(0.0, along[-1], min(MOST_SIGNS, 2 + math.ceil(along[-1] / apart_m)))
    xs, ys = np.interp(at, along, xs), np.interp(at, along, ys)
    seen = (xs >= window.x_min) & (xs <= window.x_max) & (ys >= window.y_min) & (ys <= window.y_max)
    return xs[seen], ys[seen]


class Skeleton(Canvas):
    """The landmarks of the hands in the last picture, as the detector sees them."""

    def draw(self, hands: Sequence[Hand]) -> None:
        if not self.size.area:
            return
        self.reset()
        width, height = self.size
        for hand in hands:
            scale = min(width / hand.width_px * 2.0, height / hand.height_px * 4.0)  # dots per pixel; 2 x 4 dots a cell
            places = [(float(x) * scale / 2.0, float(y) * scale / 4.0) for x, y in hand.points_px[:, :2]]
            for row in BONES:
                for a, b in pairwise(row):
                    self.draw_hires_line(*places[a], *places[b], hires_mode=HiResMode.BRAILLE, style="green")
