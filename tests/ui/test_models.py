"""`m3r models` and `m3r evaluate` as a person or a script calls them, on a stand-in for a model."""

from __future__ import annotations

import json
import zipfile
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from config.demo.drawn_hand import GESTURES, centre_of, draw, wall
from config.settings import load_settings
from modalities.calibration import Sense, calibrate
from modalities.hands.dwell import Held
from modalities.models import catalogue as voice_models
from modalities.models.catalogue import ModelError, find_hand_model
from modalities.outcomes import Answer, Trial
from safety.vocabulary import Command
from ui import cli
from ui.evaluate import show_calibration

if TYPE_CHECKING:
    import json
from pathlib import Path


@pytest.fixture
def no_model(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A machine on which no voice model has been put."""
    monkeypatch.delenv("M3R_MODELS", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


@pytest.fixture
def model(no_model: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A folder with the files of a voice model, empty of sense."""
    folder = tmp_path / "models" / "vosk-model-small-en-us-test"
    for part in voice_models._PARTS:
        path = folder / part
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"x")
    monkeypatch.setenv("M3R_MODELS", str(folder.parent))
    return folder


@pytest.mark.parametrize("words", [["models", "list", "voice"], ["evaluate", "voice", "somewhere"]])
@pytest.mark.usefixtures("no_model")
def test_no_model_is_one_sentence(capsys: pytest.CaptureFixture[str], words: list[str]) -> None:
    assert cli.main(words) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err == "m3r: there is no voice model on this machine: run `m3r models fetch`\n"


@pytest.mark.parametrize(("action", "ending"), [("list", ""), ("fetch", " (nothing to fetch)")])
def test_a_model_that_is_there_is_named(
    model: Path, capsys: pytest.CaptureFixture[str], action: str, ending: str
) -> None:
    assert cli.main(["models", action, "voice"]) == 0
    out, err = capsys.readouterr()
    assert out.startswith(f"voice model {model.name} ")
    assert out.endswith(f", in {model}{ending}\n")
    assert err == ""


@pytest.mark.parametrize("words", [["models", "list", "hands"], ["evaluate", "hands", "somewhere"]])
@pytest.mark.usefixtures("no_model")
def test_no_hand_model_is_one_sentence(capsys: pytest.CaptureFixture[str], words: list[str]) -> None:
    assert cli.main(words) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err == "m3r: there is no hand model on this machine: run `m3r models fetch`\n"


def test_what_is_there_is_listed_beside_what_is_missing(model: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["models", "list"]) == 2
    out, err = capsys.readouterr()
    assert out.startswith(f"voice model {model.name} ")
    assert err == "m3r: there is no hand model on this machine: run `m3r models fetch`\n"


def test_a_hand_model_that_is_there_is_named(model: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = model.parent / voice_models.HAND_MODEL_NAME
    with zipfile.ZipFile(path, "w") as bundle:
        for part in voice_models._HAND_PARTS:
            bundle.writestr(part, b"x")
    (model.parent / voice_models.DENOISER_NAME).write_bytes(b"x")
    for action in ("list", "fetch"):
        assert cli.main(["models", action]) == 0
        out, err = capsys.readouterr()
        assert [line.split()[:2] for line in out.splitlines()] == [
            ["voice", "model"],
            ["hand", "model"],
            ["denoiser", "gtcrn_simple"],
        ]
        assert err == ""
    path.write_bytes(path.read_bytes()[:-30])
    assert cli.main(["models", "list", "hands"]) == 2
    assert f"{path} is truncated" in capsys.readouterr().err


@pytest.mark.parametrize("action", ["list", "fetch"])
@pytest.mark.usefixtures("no_model")
def test_a_wrong_models_folder_is_named(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, action: str
) -> None:
    monkeypatch.setenv("M3R_MODELS", str(tmp_path))
    assert cli.main(["models", action, "voice"]) == 2
    assert capsys.readouterr().err.startswith(f"m3r: M3R_MODELS names {tmp_path}, which holds no voice model")


def test_evaluating_a_missing_folder_names_it(model: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert model.is_dir()
    assert cli.main(["evaluate", "voice", str(tmp_path / "recordings")]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.splitlines()[-1].startswith("m3r: ")
    assert "recordings" in err.splitlines()[-1]


@pytest.fixture
def pictures(tmp_path: Path) -> Path:
    """A mirrored picture of somebody who points to their left, and a wall."""
    try:
        find_hand_model()
    except ModelError as error:
        pytest.skip(f"no hand model: {error}")
    room = wall(np.random.default_rng(7))
    pose = GESTURES["go_right"]
    for name, picture in (("go_left", draw(room, pose, centre_of(pose), -16.0)), ("none", room)):
        (tmp_path / name).mkdir()
        cv2.imwrite(str(tmp_path / name / "a.png"), picture)
    return tmp_path


def test_hands_are_evaluated_with_the_settings_they_are_flown_with(
    capsys: pytest.CaptureFixture[str], pictures: Path
) -> None:
    out = pictures.parent / f"{pictures.name}.toml"
    mirrored = ["--set", "gesture.mirrored=true"]
    assert cli.main(["evaluate", "hands", str(pictures), "--calibrate", "--out", str(out), *mirrored]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["commands"]["go_left"]["right"] == 1
    assert [clip["outcome"] for clip in result["calibration"]["clips"]] == ["right"]
    assert load_settings([out], []).confidence.confidence_gesture == result["calibration"]["threshold"]
    assert cli.main(["evaluate", "hands", str(pictures), "--set", "gesture.mirored=true"]) == 2
    assert cli.main(["evaluate", "hands", str(pictures), "--out", str(out)]) == 2
    assert "give --calibrate too" in capsys.readouterr().err


def test_recordings_in_which_nothing_is_seen_are_no_result(capsys: pytest.CaptureFixture[str], pictures: Path) -> None:
    (pictures / "go_left" / "a.png").unlink()
    assert cli.main(["evaluate", "hands", str(pictures)]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert "no hand is seen in any of the 1 recordings" in err


def test_a_person_who_calibrates_at_a_terminal_reads_a_table(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    held = Held(Command.GO_LEFT, 0.91, 1.0, 0.5, "index finger left")
    trials = [Trial("go_left", Command.GO_LEFT, (Answer(held, 0.1),), "a[1].png"), Trial("none", None, (), "b.png")]
    monkeypatch.setenv("COLUMNS", "120")
    show_calibration(calibrate(Sense.GESTURE, trials, 0.0), None)
    out = capsys.readouterr().out
    assert "a[1].png" in out
    assert "index finger left 0.91" in out
    assert "100.0 % (20.7 to 100.0)" in out
    assert "confidence.confidence_gesture = 0.7:" in out


def test_a_denoiser_that_is_missing_is_told_and_no_error(model: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with zipfile.ZipFile(model.parent / voice_models.HAND_MODEL_NAME, "w") as bundle:
        for part in voice_models._HAND_PARTS:
            bundle.writestr(part, b"x")
    assert cli.main(["models", "list"]) == 0
    assert "there is no denoiser on this machine" in capsys.readouterr().out
    assert cli.main(["models", "list", "denoiser"]) == 2
