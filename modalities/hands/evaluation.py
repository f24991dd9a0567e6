"""How well gestures are recognised on a folder of pictures or videos: how an operator calibrates.

One sub-folder per expected command (`go_left`, `stop`, ...); what lies in `none`, or
a sub-folder that is declared to be like it, is no command. A still picture
is shown for the hold time; a video plays in its own time.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np

from modalities.hands.dwell import HOLD_S, DwellFilter
from modalities.hands.finder import Detector, HandFinder
from modalities.hands.gestures import read_hands
from modalities.hands.video import Frame, Picture, VideoFile
from modalities.models.catalogue import HandModel
from modalities.outcomes import (
    DEFAULT_THRESHOLD,
    Answer,
    EvaluationError,
    Trial,
    choose_threshold,
    expected_of,
    of_commands,
    of_none,
    recordings_in,
)

STILL_RATE_HZ = 10.0
"""How often a still picture is looked at while it is shown."""
TOLERATED_FALSE_MOVES = 0.02
"""What share of the recordings without a command may become a move at the chosen threshold."""
_STILLS = (".jpg", ".jpeg", ".png", ".bmp", ".webp")


def evaluate_hands(
    folder: Path | str,
    model: HandModel,
    threshold: float = DEFAULT_THRESHOLD,
    *,
    hold_s: float = HOLD_S,
    mirrored: bool = False,
    negatives: Collection[str] = (),
    take_trials: Callable[[Sequence[Trial]], None] = lambda _trials: None,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> dict[str, object]:
    """The contract's object for `m3r evaluate hands`: strict JSON, latencies in ms, null where there is nothing to tell.

    negatives: more sub-folders without a command. take_trials: given
    every recording with what was made of it.
    threshold: the confidence from which a request counts. progress: recordings done and in all. The detector
    forgets each recording before the next. Raises EvaluationError, VideoError or ModelError, which name what is wrong.
    """
    recordings = recordings_in(Path(folder), negatives)
    trials: list[Trial] = []
    no_hand = 0
    with HandFinder.of(model) as detector:
        for done, (name, path) in enumerate(recordings):
            progress(done, len(recordings))
            detector.forget()
            answers, hand_seen = watch(frames_of(path, hold_s), detector, DwellFilter(hold_s), mirrored=mirrored)
            if hand_seen:
                trials.append(Trial(name, expected_of(name), answers, path.name))
            else:
                no_hand += 1
    progress(len(recordings), len(recordings))
    if not trials:
        raise EvaluationError(
            f"no hand is seen in any of the {len(recordings)} recordings in {folder}: show it nearer and in more light"
        )
    take_trials(trials)
    return {
        "commands": of_commands(trials, threshold),
        "none": of_none(trials, threshold),
        "no_hand": no_hand,
        "threshold": choose_threshold(trials, TOLERATED_FALSE_MOVES),
        "model": model.name,
    }


def frames_of(path: Path, hold_s: float = HOLD_S) -> Iterator[Frame]:
    """A video's frames, or a still picture's for the hold time. Raises EvaluationError, VideoError."""
    if path.suffix.lower() not in _STILLS:
        yield from VideoFile(path).frames()
        return
    picture = _picture(path)
    count = round(hold_s * STILL_RATE_HZ)
    for number in range(count + 1):
        yield Frame(picture, number * hold_s / count)


def watch(
    frames: Iterable[Frame], detector: Detector, hold: DwellFilter, *, mirrored: bool = False
) -> tuple[tuple[Answer, ...], bool]:
    """Everything held in one recording, as if it were being captured: a frame cannot be looked at before the detector is done
    with the one before. And whether there was a hand in any frame.
    """
    answers: list[Answer] = []
    hand_seen = False
    done_s = 0.0
    for frame in frames:
        began = time.perf_counter()
        hands = detector.detect(frame.picture, frame.captured_at_s)
        held = hold.accept(read_hands(hands, mirrored=mirrored), frame.captured_at_s) if hands is not None else None
        done_s = max(done_s, frame.captured_at_s) + time.perf_counter() - began
        hand_seen = hand_seen or bool(hands)
        if held is not None:
            answers.append(Answer(held, done_s - frame.captured_at_s))
    return tuple(answers), hand_seen


def _picture(path: Path) -> Picture:
    try:
        data = np.fromfile(path, np.uint8)
        picture = cv2.imdecode(data, cv2.IMREAD_COLOR) if data.size else None
    except (OSError, cv2.error) as error:
        raise EvaluationError(f"{path} cannot be read: give a jpg or png picture, or a video") from error
    if picture is None:
        raise EvaluationError(f"{path} is not a picture that can be read: give a jpg or png picture, or a video")
    return np.asarray(picture, np.uint8)
