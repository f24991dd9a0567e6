"""What recordings asked for beside what they should have: recall, false requests and latency per command. Pure.

A recording lies in a folder named after the command that it holds; in a folder of NEGATIVES, or one that was declared to be, it
holds none. Any other name is a mistake ("go left"). Design, contract of `m3r evaluate`.
"""

from __future__ import annotations

import difflib
import shlex
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from safety.vocabulary import Command

DEFAULT_THRESHOLD = 0.7
NEGLIGIBLE_RECALL = 0.01
NEGATIVES = ("none", "noise", "conversation")
"""Folders of recordings without a command."""
_THRESHOLDS = tuple(round(0.05 * i, 2) for i in range(2, 20))


class EvaluationError(ValueError):
    """A folder that cannot be evaluated; one sentence that names it and says what to do."""


class Candidate(Protocol):
    """What a recogniser made of a recording, or of a part of it."""

    @property
    def command(self) -> Command: ...
    @property
    def confidence(self) -> float: ...
    @property
    def text(self) -> str: ...


@dataclass(frozen=True, slots=True)
class Answer:
    """A request candidate and its latency: end of the evidence to the request, processing included."""

    heard: Candidate
    latency_s: float


@dataclass(frozen=True, slots=True)
class Trial:
    """One recording. expected: None where it holds no command; name: the file's."""

    folder: str
    expected: Command | None
    answers: tuple[Answer, ...]
    name: str = ""

    def requests(self, threshold: float) -> list[Answer]:
        """What counts as requested: STOP at any confidence (design 3), the rest from the threshold on."""
        return [a for a in self.answers if a.heard.command is Command.STOP or a.heard.confidence >= threshold]


def expected_of(folder: str) -> Command | None:
    """The command that recordings in this folder hold."""
    return Command(folder) if folder in set(Command) else None


def recordings_in(folder: Path, negatives: Collection[str] = ()) -> list[tuple[str, Path]]:
    """Sub-folder name and path of every recording. negatives: more names of folders without a command. Raises EvaluationError if
    there is none, or a sub-folder's name means nothing.
    """
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
    for name in dict.fromkeys(name for name, _ in found):
        if expected_of(name) is None and name not in {*NEGATIVES, *negatives}:
            near = difflib.get_close_matches(name.lower().replace(" ", "_"), [c.value for c in Command], n=1)
            meant = f"did you mean {near[0]}? " if near else ""
            raise EvaluationError(
                f"{folder / name} is named after no command: {meant}name it after one, or declare it with --negative {shlex.quote(name)} "
                "where nothing in it is a request"
            )
    return found


def choose_threshold(
    trials: Sequence[Trial], tolerated_false: float, thresholds: Sequence[float] = _THRESHOLDS
) -> float:
    """The threshold nearest to the default among those that keep false requests tolerable and lose no more than
    NEGLIGIBLE_RECALL of what the best of these understands. Where false requests are too many at each: where they are fewest.
    tolerated_false: what share of the recordings without a command may become a request.
    """
    empty = [trial for trial in trials if trial.expected is None]
    asked = [trial for trial in trials if trial.expected is not None]
    tolerated = int(tolerated_false * len(empty))
    false = {t: max(tolerated, sum(false_move(trial, t) for trial in empty)) for t in thresholds}
    fewest = [t for t in thresholds if false[t] == min(false.values())]
    right = {t: sum(outcome(trial, t) == "right" for trial in asked) for t in fewest}
    enough = max(right.values()) - NEGLIGIBLE_RECALL * len(asked)
    return min((t for t in fewest if right[t] >= enough), key=lambda t: abs(t - DEFAULT_THRESHOLD))


def outcome(trial: Trial, threshold: float) -> str:
    """right: the expected command and nothing else; wrong: anything else was requested; missed: nothing was."""
    commands = {answer.heard.command for answer in trial.requests(threshold)}
    if not commands:
        return "missed"
    return "right" if commands == {trial.expected} else "wrong"


def of_commands(trials: Sequence[Trial], threshold: float) -> dict[str, object]:
    """The contract's `commands`."""
    return {
        command.value: _of_command(command, trials, threshold)
        for command in Command
        if any(trial.expected is command for trial in trials)
    }


def of_none(trials: Sequence[Trial], threshold: float) -> dict[str, object]:
    """The contract's `none`, of the recordings without a command."""
    trials = [trial for trial in trials if trial.expected is None]
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


def percentile_ms(latencies_s: Sequence[float], percent: float) -> float | None:
    """In ms, to a tenth; None of nothing."""
    return round(float(np.percentile(latencies_s, percent)) * 1000.0, 1) if latencies_s else None


def _of_command(command: Command, trials: Sequence[Trial], threshold: float) -> dict[str, object]:
    mine = [trial for trial in trials if trial.expected is command]
    outcomes = [outcome(trial, threshold) for trial in mine]
    latencies = [
        next(a.latency_s for a in trial.requests(threshold) if a.heard.command is command)
        for trial, result in zip(mine, outcomes, strict=True)
        if result == "right"
    ]
    return {
        "n": len(mine),
        **{result: outcomes.count(result) for result in ("right", "wrong", "missed")},
        "latency_ms_p50": percentile_ms(latencies, 50),
        "latency_ms_p95": percentile_ms(latencies, 95),
    }


def false_move(trial: Trial, threshold: float) -> bool:
    """Whether anything but STOP was requested."""
    return any(answer.heard.command is not Command.STOP for answer in trial.requests(threshold))


def _false_stop(trial: Trial) -> bool:
    return any(answer.heard.command is Command.STOP for answer in trial.answers)


def _false(trials: Sequence[Trial], threshold: float) -> dict[str, object]:
    """Recordings, and how many of them became a move (or any other request but STOP) and a STOP."""
    return {
        "n": len(trials),
        "false_moves": sum(false_move(trial, threshold) for trial in trials),
        "false_stops": sum(_false_stop(trial) for trial in trials),
    }
