"""MediaPipe's hand landmarker: pictures in, hands out."""

from __future__ import annotations

import math
from typing import Any, Self

import cv2
import numpy as np

from modalities.hands.gestures import MOST_HANDS, Hand
from modalities.hands.tiles import Square
from modalities.hands.video import Picture
from modalities.models.catalogue import HandModel, ModelError, hand_model_at
from modalities.native_output import discarded_stderr

LIBRARIES = "libegl1 and libgles2"
_EMPTY: Picture = np.zeros((480, 640, 3), np.uint8)


class HandDetector:
    """Finds hands in successive pictures of one video. Used by one thread at a time; close it."""

    def __init__(self, model: HandModel, *, stills: bool = False) -> None:
        """Takes seconds (imports and compiles). stills: each picture is looked at by itself, for `detect_in`.

        Raises ModelError for an unusable model or missing libraries.
        """
        self._stills = stills
        self._last_ms = -1
        self._begin_ms = 0
        hand_model_at(model.path, model.origin)  # it may have changed since it was found
        with discarded_stderr():
            self._load(model)
            # The first picture takes longest, and is talked about.
            if stills:
                self.detect_in(_EMPTY, Square(0, 0, _EMPTY.shape[0]))
            else:
                self.detect(_EMPTY, 0.0)

    def _load(self, model: HandModel) -> None:
        try:
            import mediapipe
            from mediapipe.tasks.python import BaseOptions, vision

            self._mediapipe = mediapipe
            options = vision.HandLandmarkerOptions(
                base_options=BaseOptions(model_asset_path=str(model.path)),
                running_mode=vision.RunningMode.IMAGE if self._stills else vision.RunningMode.VIDEO,
                num_hands=MOST_HANDS,
            )
            self._landmarker: Any = vision.HandLandmarker.create_from_options(options)
        except (ImportError, OSError) as error:
            raise ModelError(
                f"hands cannot be recognised, a library is missing: install {LIBRARIES} ({error})"
            ) from error
        except (RuntimeError, ValueError) as error:
            raise ModelError(
                f"{model.path} is not a usable hand model: delete it and run `m3r models fetch`"
            ) from error

    def detect(self, picture: Picture, at_s: float) -> tuple[Hand, ...]:
        """The hands in the next picture of the video. at_s: its time in seconds, from any start; what does not lie after the
        last one counts as 1 ms later, since the landmarker's time must increase.
        """
        height_px, width_px = picture.shape[:2]
        at_ms = self._begin_ms + round(at_s * 1000.0) if math.isfinite(at_s) else 0
        self._last_ms = max(self._last_ms + 1, at_ms)
        result = self._landmarker.detect_for_video(self._image(picture), self._last_ms)
        return _hands(result, (width_px, height_px, width_px), (0.0, 0.0, 0.0), (width_px, height_px))

    def detect_in(self, picture: Picture, part: Square) -> tuple[Hand, ...]:
        """The hands that lie whole in a part of a picture, in the picture's own pixels. Only of one made for stills."""
        result = self._landmarker.detect(self._image(part.of(picture)))
        height_px, width_px = picture.shape[:2]
        hands = _hands(result, (part.side,) * 3, (part.left, part.top, 0.0), (width_px, height_px))
        return tuple(hand for hand in hands if part.holds(hand.points_px))

    def _image(self, picture: Picture) -> Any:
        # A conversion, not a view: the landmarker reads a view that is not contiguous wrongly.
        return self._mediapipe.Image(self._mediapipe.ImageFormat.SRGB, cv2.cvtColor(picture, cv2.COLOR_BGR2RGB))

    def forget(self) -> None:
        """Another video follows, whose time may start anew: an empty picture ends all tracking."""
        self.detect(_EMPTY, 0.0)
        self._begin_ms = self._last_ms + 1000

    def close(self) -> None:
        """Give its memory and threads back; calling it again does nothing."""
        landmarker, self._landmarker = self._landmarker, None
        if landmarker is not None:
            landmarker.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _hands(
    result: Any, scale: tuple[float, float, float], begin: tuple[float, float, float], size_px: tuple[int, int]
) -> tuple[Hand, ...]:
    """The landmarker's result in the picture's pixels. scale: of what it saw; begin: where that lies in the picture of `size_px`."""
    return tuple(
        Hand(
            points_px=np.array([(p.x, p.y, p.z) for p in landmarks]) * scale + begin,
            world_m=np.array([(p.x, p.y, p.z) for p in world]),
            score=float(categories[0].score),
            width_px=size_px[0],
            height_px=size_px[1],
        )
        for categories, landmarks, world in zip(
            result.handedness, result.hand_landmarks, result.hand_world_landmarks, strict=True
        )
    )
