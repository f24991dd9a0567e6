"""What the judge says: one line for each limit of each thing judged. Frozen data only."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

Part = Literal["plan", "telemetry", "record", "property", "witness"]


@dataclass(frozen=True, slots=True)
class Line:
    """One limit of one thing. margin: signed, in `unit`, negative where it is broken; None: there is no such number."""

    part: Part
    limit: str
    subject: str
    """The request whose plan it is, or what else it is about; empty: the whole flight."""
    margin: float | None
    unit: str
    passed: bool
    at_s: float | None = None
    note: str = ""


@dataclass(frozen=True, slots=True)
class Judgement:
    """Of one flight. Nothing passes that was not judged."""

    lines: tuple[Line, ...]
    plans: int
    samples: int
    """Telemetry samples judged: those while the drone was ours."""
    requests: int

    @property
    def passed(self) -> bool:
        return all(line.passed for line in self.lines)

    @property
    def failing(self) -> tuple[Line, ...]:
        return tuple(line for line in self.lines if not line.passed)

    def worst(self) -> tuple[tuple[Line, int, int], ...]:
        """Of each part and limit the worst line, how many there are, and how many of them fail; in the order judged."""
        groups: dict[tuple[str, str], list[Line]] = {}
        for line in self.lines:
            groups.setdefault((line.part, line.limit), []).append(line)
        return tuple((min(g, key=_rank), len(g), sum(not line.passed for line in g)) for g in groups.values())


def _rank(line: Line) -> tuple[bool, float]:
    margin = line.margin if line.margin is not None else math.inf
    return line.passed, -math.inf if math.isnan(margin) else margin
