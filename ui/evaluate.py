"""`m3r evaluate`: what it prints, and the settings that it writes. Progress and sentences go to standard error."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
from rich.table import Table
from rich.text import Text

from config.settings import Gesture
from modalities.calibration import Calibration, Sense, calibrate, told_outcome
from modalities.models.catalogue import HandModel, VoiceModel, find_hand_model, find_model
from modalities.models.sources import ModelKind
from modalities.outcomes import EvaluationError, Trial

SHOWN_EVERY = 5
"""Of the thresholds that were looked at, so many are one line of the table; the chosen one always is."""


@dataclass(frozen=True, slots=True)
class Wanted:
    """what: voice or hands. snr_db: voice in noise. out: where the settings go; as_json: never a table."""

    what: str
    folder: Path
    negatives: tuple[str, ...] = ()
    snr_db: float | None = None
    calibrate: bool = False
    out: Path | None = None
    as_json: bool = False


def evaluate(wanted: Wanted, gesture: Gesture) -> None:
    """Recognition of voice or hands on a folder of recordings: one JSON object on standard output, or a table where a person
    calibrates at a terminal. Raises EvaluationError and what the recognisers raise, in one sentence.
    """
    if wanted.out is not None and not wanted.calibrate:
        raise EvaluationError("--out is for the settings of a calibration: give --calibrate too")
    console = Console(stderr=True)
    trials: list[Trial] = []
    model: VoiceModel | HandModel = find_model() if wanted.what == ModelKind.VOICE else find_hand_model()
    console.print(model.sentence, markup=False, highlight=False, soft_wrap=True)
    with Progress(
        TextColumn("recordings"), BarColumn(), MofNCompleteColumn(), console=console, transient=True
    ) as progress:
        task = progress.add_task("")

        def show(done: int, total: int) -> None:
            progress.update(task, completed=done, total=total)

        if isinstance(model, VoiceModel):
            from modalities.voice.evaluation import TOLERATED_FALSE_MOVES as TOLERATED
            from modalities.voice.evaluation import evaluate_voice

            sense = Sense.VOICE
            result = evaluate_voice(
                wanted.folder,
                model,
                snr_db=wanted.snr_db,
                negatives=wanted.negatives,
                take_trials=trials.extend,
                progress=show,
            )
        else:
            from modalities.hands.evaluation import TOLERATED_FALSE_MOVES as TOLERATED
            from modalities.hands.evaluation import evaluate_hands

            sense = Sense.GESTURE
            result = evaluate_hands(
                wanted.folder,
                model,
                hold_s=gesture.hold_s,
                mirrored=gesture.mirrored,
                negatives=wanted.negatives,
                take_trials=trials.extend,
                progress=show,
            )
    calibration = calibrate(sense, trials, TOLERATED) if wanted.calibrate else None
    if calibration is not None:
        if wanted.out is not None:
            _write(wanted.out, calibration.toml(f"{len(trials)} recordings, model {result['model']}"))
        if sys.stdout.isatty() and not wanted.as_json:
            show_calibration(calibration, wanted.out)
            return
        result["calibration"] = calibration.as_json()
    print(json.dumps(result, allow_nan=False, indent=2 if sys.stdout.isatty() else None))


def _say(console: Console, sentence: str) -> None:
    console.print(sentence, markup=False, highlight=False, soft_wrap=True)


def _write(path: Path, toml: str) -> None:
    try:
        path.write_text(toml, encoding="utf-8")
    except OSError as error:
        raise EvaluationError(f"{path} cannot be written ({error.strerror}): give another file to --out") from error


def show_calibration(calibration: Calibration, out: Path | None) -> None:
    """For people. out: where the settings were written."""
    console = Console()
    clips = Table("folder", "file", "outcome", "heard, with confidence", box=None)
    for trial in calibration.trials:
        heard = ", ".join(f"{a.heard.text} {a.heard.confidence:.2f}" for a in trial.answers) or "-"
        result = told_outcome(trial, calibration.chosen.threshold)
        clips.add_row(*(Text(text) for text in (trial.folder, trial.name, result, heard)))
    sweep = Table("threshold", "recall (95 %)", "wrong (95 %)", "false moves (95 %)", box=None)
    for number, row in enumerate(calibration.rows):
        if number % SHOWN_EVERY == 0 or row is calibration.chosen:
            mark = " <" if row is calibration.chosen else ""
            sweep.add_row(f"{row.threshold:g}{mark}", str(row.recall), str(row.wrong), str(row.false))
    console.print(clips, "", sweep, "")
    _say(console, calibration.sentence)
    _say(
        console,
        f"written to {out}: fly with --config {out}" if out is not None else "keep it with --out FILE, for --config",
    )
