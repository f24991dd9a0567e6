"""What a threshold of confidence would do, by recordings whose content is known: how an operator chooses one. Pure.

Every share has its 95 % interval: a few recordings say little, and the numbers must say so themselves.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from modalities.outcomes import Trial, choose_threshold, false_move, outcome

LOWEST_THRESHOLD = 0.3
"""What the settings allow."""
THRESHOLDS = tuple(round(LOWEST_THRESHOLD + 0.02 * i, 2) for i in range(35))
_Z_95 = 1.959964


class Sense(StrEnum):
    """Whose threshold; the setting is `confidence.confidence_SENSE`."""

    VOICE = "voice"
    GESTURE = "gesture"


@dataclass(frozen=True, slots=True)
class Share:
    """`count` of `of`."""

    count: int
    of: int

    @property
    def value(self) -> float | None:
        return self.count / self.of if self.of else None

    @property
    def interval(self) -> tuple[float, float]:
        """Where the true share lies with 95 % confidence. Source: Wilson 1927."""
        if not self.of:
            return 0.0, 1.0
        p, z2 = self.count / self.of, _Z_95**2
        middle = (p + z2 / (2 * self.of)) / (1 + z2 / self.of)
        half = _Z_95 / (1 + z2 / self.of) * math.sqrt(p * (1 - p) / self.of + z2 / (4 * self.of**2))
        return max(0.0, middle - half), min(1.0, middle + half)

    @property
    def as_json(self) -> dict[str, object]:
        low, high = self.interval
        return {"count": self.count, "of": self.of, "low": round(low, 4), "high": round(high, 4)}

    def __str__(self) -> str:
        if self.value is None:
            return "-"
        low, high = self.interval
        return f"{100 * self.value:.1f} % ({100 * low:.1f} to {100 * high:.1f})"


@dataclass(frozen=True, slots=True)
class Row:
    """What one threshold does. recall, wrong: of the recordings with a command; false: of those without, a move."""

    threshold: float
    recall: Share
    wrong: Share
    false: Share


@dataclass(frozen=True, slots=True)
class Calibration:
    """rows: of every threshold looked at; chosen: one of them."""

    sense: Sense
    rows: tuple[Row, ...]
    chosen: Row
    trials: tuple[Trial, ...]

    @property
    def sentence(self) -> str:
        """What the chosen threshold promises, as far as these recordings can."""
        row = self.chosen
        false = (
            f"{row.false.count} false moves in {row.false.of} recordings without a command, in the long run at most "
            f"{100 * row.false.interval[1]:.1f} % of them"
            if row.false.of
            else "no recordings without a command, so nothing is known of false moves"
        )
        heard = f"recall {row.recall}, wrong {row.wrong}" if row.recall.of else "no recordings of commands"
        return f"confidence.confidence_{self.sense} = {row.threshold:g}: {false}; {heard}"

    def toml(self, of: str) -> str:
        """For `--config`. of: what it was made from, one line."""
        return f"# From {of}.\n# {self.sentence}\n\n[confidence]\nconfidence_{self.sense} = {self.chosen.threshold:g}\n"

    def as_json(self) -> dict[str, object]:
        """Strict JSON, for `calibration`."""
        return {
            "setting": f"confidence.confidence_{self.sense}",
            "threshold": self.chosen.threshold,
            "sentence": self.sentence,
            "sweep": [
                {
                    "threshold": row.threshold,
                    "recall": row.recall.as_json,
                    "wrong": row.wrong.as_json,
                    "false_moves": row.false.as_json,
                }
                for row in self.rows
            ],
            "clips": [
                {
                    "folder": trial.folder,
                    "file": trial.name,
                    "outcome": told_outcome(trial, self.chosen.threshold),
                    "heard": [
                        {
                            "command": a.heard.command.value,
                            "confidence": round(a.heard.confidence, 3),
                            "text": a.heard.text,
                        }
                        for a in trial.answers
                    ],
                }
                for trial in self.trials
            ],
        }


def calibrate(sense: Sense, trials: Sequence[Trial], tolerated_false: float) -> Calibration:
    """tolerated_false: what share of the recordings without a command may become a move."""
    rows = tuple(_row(trials, threshold) for threshold in THRESHOLDS)
    threshold = choose_threshold(trials, tolerated_false, THRESHOLDS)
    return Calibration(sense, rows, next(row for row in rows if row.threshold == threshold), tuple(trials))


def told_outcome(trial: Trial, threshold: float) -> str:
    """right, wrong, missed; of a recording without a command: quiet, or false."""
    if trial.expected is not None:
        return outcome(trial, threshold)
    return "false" if trial.requests(threshold) else "quiet"


def _row(trials: Sequence[Trial], threshold: float) -> Row:
    outcomes = [outcome(trial, threshold) for trial in trials if trial.expected is not None]
    empty = [trial for trial in trials if trial.expected is None]
    return Row(
        threshold,
        Share(outcomes.count("right"), len(outcomes)),
        Share(outcomes.count("wrong"), len(outcomes)),
        Share(sum(false_move(trial, threshold) for trial in empty), len(empty)),
    )
