"""A threshold chosen by recordings: intervals, the sweep, the setting, and the names of folders."""

from __future__ import annotations

import json
import tomllib
from dataclasses import dataclass
from pathlib import Path

import pytest

from config.settings import load_settings
from modalities.calibration import THRESHOLDS, Sense, Share, calibrate
from modalities.outcomes import Answer, EvaluationError, Trial, recordings_in
from safety.vocabulary import Command


@dataclass(frozen=True)
class Said:
    command: Command
    confidence: float
    text: str = "go left"


def trial(expected: Command | None, *confidences: float, command: Command = Command.GO_LEFT) -> Trial:
    folder = expected.value if expected is not None else "none"
    return Trial(folder, expected, tuple(Answer(Said(command, c), 0.3) for c in confidences), "clip.wav")


@pytest.mark.parametrize(("count", "of"), [(0, 200), (1, 200), (96, 100), (40, 40), (3, 7)])
def test_the_interval_is_wilsons(count: int, of: int) -> None:
    """By its definition: at each end the observed share lies 1.96 standard deviations away."""
    for end in Share(count, of).interval:
        if 0.0 < end < 1.0:
            deviation = (end * (1.0 - end) / of) ** 0.5
            assert abs(count / of - end) == pytest.approx(1.959964 * deviation, rel=1e-6)
        else:
            assert count in {0, of}


def test_nothing_of_nothing_says_nothing() -> None:
    assert Share(0, 0).interval == (0.0, 1.0)
    assert Share(0, 0).value is None
    assert str(Share(0, 0)) == "-"


def test_the_threshold_keeps_false_moves_out_and_requests_in() -> None:
    right = [trial(Command.GO_LEFT, 0.9) for _ in range(100)]
    doubtful = [trial(None, 0.79) for _ in range(4)]
    quiet = [trial(None) for _ in range(196)]
    result = calibrate(Sense.VOICE, [*right, *doubtful, *quiet], 0.005)
    assert 0.79 < result.chosen.threshold <= 0.9
    assert (result.chosen.recall, result.chosen.false) == (Share(100, 100), Share(0, 200))
    by_threshold = {row.threshold: row for row in result.rows}
    assert tuple(by_threshold) == THRESHOLDS
    assert by_threshold[0.7].false == Share(4, 200)
    assert by_threshold[0.92].recall == Share(0, 100)
    assert "0 false moves in 200 recordings" in result.sentence
    assert "at most 1.9 %" in result.sentence


def test_the_setting_is_one_that_is_taken(tmp_path: Path) -> None:
    result = calibrate(Sense.GESTURE, [trial(Command.GO_LEFT, 0.9), trial(None, 0.85)], 0.0)
    text = result.toml("2 recordings")
    assert tomllib.loads(text) == {"confidence": {"confidence_gesture": result.chosen.threshold}}
    path = tmp_path / "mine.toml"
    path.write_text(text)
    assert load_settings([path], []).confidence.confidence_gesture == result.chosen.threshold


def test_every_clip_is_told_with_what_was_heard() -> None:
    result = calibrate(Sense.VOICE, [trial(Command.GO_LEFT, 0.9), trial(None), trial(None, 0.95)], 1.0)
    told = json.loads(json.dumps(result.as_json(), allow_nan=False))
    assert [clip["outcome"] for clip in told["clips"]] == ["right", "quiet", "false"]
    assert told["clips"][0]["heard"] == [{"command": "go_left", "confidence": 0.9, "text": "go left"}]
    assert told["setting"] == "confidence.confidence_voice"


def test_without_negatives_nothing_is_promised_of_false_moves() -> None:
    assert "nothing is known of false moves" in calibrate(Sense.VOICE, [trial(Command.GO_LEFT, 0.9)], 0.005).sentence


def test_a_folder_that_is_named_after_no_command_is_an_error(tmp_path: Path) -> None:
    for name in ("go_left", "none", "noise", "chatter"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "a.wav").touch()
    with pytest.raises(EvaluationError, match="chatter is named after no command: name it"):
        recordings_in(tmp_path)
    assert len(recordings_in(tmp_path, ["chatter"])) == 4
    (tmp_path / "go left").mkdir()
    (tmp_path / "go left" / "a.wav").touch()
    with pytest.raises(EvaluationError, match="did you mean go_left"):
        recordings_in(tmp_path, ["chatter"])
