"""How well voice is recognised on a folder of recordings: how an operator calibrates.

One sub-folder per expected command (`go_left`, `stop`, ...); what lies in any other sub-folder is no command.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import vosk

from modalities.audio import SAMPLE_RATE_HZ, Samples, chunks, quiet, read_audio
from modalities.models import VoiceModel
from modalities.phrases import PhraseTable
from modalities.voice import Heard, Recognizer, load_model
from safety.vocabulary import Command

PADDING_S = 2.0
DEFAULT_THRESHOLD = 0.7
TOLERATED_FALSE_MOVES = 0.005
"""What share of the recordings without a command may become a request at the chosen threshold."""
NEGLIGIBLE_RECALL = 0.01
_THRESHOLDS = tuple(round(0.05 * i, 2) for i in range(2, 20))


class EvaluationError(ValueError):
    """A folder that cannot be evaluated; one sentence that names it and says what to do."""


@dataclass(frozen=True, slots=True)
class Answer:
    """A request candidate and its latency: end of the voice to the request, processing included."""

    heard: Heard
    latency_s: float


@dataclass(frozen=True, slots=True)
class Trial:
    """One recording. expected: None where it holds no command."""

    folder: str
    expected: Command | None
    answers: tuple[Answer, ...]

    def requests(self, threshold: float) -> list[Answer]:
        """What counts as requested: STOP at any confidence (design 3), the rest from the threshold on."""
        return [a for a in self.answers if a.heard.command is Command.STOP or a.heard.confidence >= threshold]


def hear(samples: Samples, recognizer: Recognizer) -> tuple[Answer, ...]:
    """Everything heard in one recording, as if it were being captured: a chunk cannot be decoded before it is there, nor
    before the decoder is done with the one before.
    """
    answers: list[Answer] = []
    done_s = 0.0
    for chunk in chunks(samples):
        began = time.perf_counter()
        heard = recognizer.accept(chunk)
        done_s = max(done_s, chunk.captured_at_s) + time.perf_counter() - began
        answers += [Answer(one, done_s - one.captured_at_s) for one in heard]
    began = time.perf_counter()
    heard = recognizer.finish(len(samples) / SAMPLE_RATE_HZ)
    done_s += time.perf_counter() - began
    return (*answers, *(Answer(one, done_s - one.captured_at_s) for one in heard))


def evaluate_voice(
    folder: Path | str,
    model: VoiceModel,
    colours: Iterable[str] = ("red", "green", "blue"),
    threshold: float = DEFAULT_THRESHOLD,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> dict[str, object]:
    """The contract's object for `m3r evaluate voice`: strict JSON, latencies in ms, null where there is nothing to tell.

    threshold: the confidence from which a request counts. progress: recordings done and in all. Each recording is heard
    by a fresh recogniser and followed by 2 s of quiet. Raises EvaluationError, AudioError or ModelError, which name what
    is wrong.
    """
    recordings = _recordings(Path(folder))
    loaded = load_model(model.folder)
    table = PhraseTable(colours)
    trials: list[Trial] = []
    for done, (name, path) in enumerate(recordings):
        progress(done, len(recordings))
        trials.append(_trial(name, path, loaded, table))
    progress(len(recordings), len(recordings))
    return {
        "commands": {
            command.value: _of_command(command, trials, threshold)
            for command in Command
            if any(trial.expected is command for trial in trials)
        },
        "none": _of_none([trial for trial in trials if trial.expected is None], threshold),
        "threshold": choose_threshold(trials),
        "model": model.name,
    }


def choose_threshold(trials: Sequence[Trial]) -> float:
    """The threshold nearest to the default among those that keep false requests tolerable and lose no more than
    NEGLIGIBLE_RECALL of what the best of these understands. Where false requests are too many at each: where they are fewest.
    """
    empty = [trial for trial in trials if trial.expected is None]
    asked = [trial for trial in trials if trial.expected is not None]
    tolerated = int(TOLERATED_FALSE_MOVES * len(empty))
    false = {t: max(tolerated, sum(_false_move(trial, t) for trial in empty)) for t in _THRESHOLDS}
    fewest = [t for t in _THRESHOLDS if false[t] == min(false.values())]
    right = {t: sum(_outcome(trial, t) == "right" for trial in asked) for t in fewest}
    enough = max(right.values()) - NEGLIGIBLE_RECALL * len(asked)
    return min((t for t in fewest if right[t] >= enough), key=lambda t: abs(t - DEFAULT_THRESHOLD))


def percentile_ms(latencies_s: Sequence[float], percent: float) -> float | None:
    """In ms, to a tenth; None of nothing."""
    return round(float(np.percentile(latencies_s, percent)) * 1000.0, 1) if latencies_s else None


def _recordings(folder: Path) -> list[tuple[str, Path]]:
    """Sub-folder name and path of every recording."""
    if not folder.is_dir():
        raise EvaluationError(f"{folder} is no folder: name one with a sub-folder of recordings per command")
    found = [
        (sub.name, path)
        for sub in sorted(folder.iterdir())
        if sub.is_dir() and not sub.name.startswith(".")
        for path in sorted(sub.rglob("*"))
        if path.is_file() and not path.name.startswith(".")
    ]
    if not found:
        raise EvaluationError(f"{folder} has no sub-folder with recordings: make one per command, such as go_left")
    return found


def _trial(name: str, path: Path, model: vosk.Model, table: PhraseTable) -> Trial:
    samples = np.concatenate([read_audio(path), quiet(PADDING_S)])
    expected = Command(name) if name in set(Command) else None
    return Trial(name, expected, hear(samples, Recognizer(model, table)))


def _outcome(trial: Trial, threshold: float) -> str:
    """right: the expected command and nothing else; wrong: anything else was requested; missed: nothing was."""
    commands = {answer.heard.command for answer in trial.requests(threshold)}
    if not commands:
        return "missed"
    return "right" if commands == {trial.expected} else "wrong"


def _false_move(trial: Trial, threshold: float) -> bool:
    return any(answer.heard.command is not Command.STOP for answer in trial.requests(threshold))


def _false_stop(trial: Trial) -> bool:
    return any(answer.heard.command is Command.STOP for answer in trial.answers)


def _of_command(command: Command, trials: Sequence[Trial], threshold: float) -> dict[str, object]:
    mine = [trial for trial in trials if trial.expected is command]
    outcomes = [_outcome(trial, threshold) for trial in mine]
    latencies = [
        next(a.latency_s for a in trial.requests(threshold) if a.heard.command is command)
        for trial, outcome in zip(mine, outcomes, strict=True)
        if outcome == "right"
    ]
    return {
        "n": len(mine),
        **{outcome: outcomes.count(outcome) for outcome in ("right", "wrong", "missed")},
        "latency_ms_p50": percentile_ms(latencies, 50),
        "latency_ms_p95": percentile_ms(latencies, 95),
    }


def _of_none(trials: Sequence[Trial], threshold: float) -> dict[str, object]:
    by_command: dict[str, int] = {}
    for trial in trials:
        for command in {answer.heard.command for answer in trial.requests(threshold)}:
            by_command[command.value] = by_command.get(command.value, 0) + 1
    return {
        **_false(trials, threshold),
        "by_command": by_command,
        "by_folder": {
            folder: _false([trial for trial in trials if trial.folder == folder], threshold)
            for folder in sorted({trial.folder for trial in trials})
        },
    }


def _false(trials: Sequence[Trial], threshold: float) -> dict[str, object]:
    """Recordings, and how many of them became a move (or any other request but STOP) and a STOP."""
    return {
        "n": len(trials),
        "false_moves": sum(_false_move(trial, threshold) for trial in trials),
        "false_stops": sum(_false_stop(trial) for trial in trials),
    }
