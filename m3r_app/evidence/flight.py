"""One flight as the judge sees it: what stood still, what was told, decided and flown. Frozen data only.

Places are local NED metres about the record's origin; times are seconds on the record's own clock (its `t`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from safety.limits import Limits
from safety.vocabulary import Geodetic, Ned, Neighbours, Operator, Plan, ReservedVolume, VehicleState

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Grid:
    """A terrain model: node (i, j) lies at corner + steps @ (i, j), in north and east. One single node: an endless plane."""

    heights_amsl_m: Floats
    """(rows, cols); NaN: no data."""
    corner_ne_m: Floats
    """(2,)"""
    steps_ne_m: Floats
    """(2, 2): north per row and per column; east likewise."""
    sigma_m: float


@dataclass(frozen=True, eq=False)
class Prism:
    """An obstacle. polygon: a shapely polygon of (north, east)."""

    name: str
    polygon: Any
    base_amsl_m: float
    top_amsl_m: float


@dataclass(frozen=True, eq=False)
class Fence:
    """Where the drone may be. polygon: a shapely polygon of (north, east)."""

    polygon: Any
    floor_amsl_m: float
    ceiling_amsl_m: float


@dataclass(frozen=True, eq=False)
class Ground:
    """What stands still. terrain None: unknown, or not in the record."""

    origin_amsl_m: float
    terrain: Grid | None
    prisms: tuple[Prism, ...]
    fence: Fence | None


class Asked(NamedTuple):
    """A request, as it was first understood."""

    t_s: float
    id: str
    command: str
    modality: str
    confidence: float


class Decided(NamedTuple):
    """A verdict. granted_m None: a turn, or nothing."""

    t_s: float
    request: str
    verdict: str
    granted_m: float | None


class Moved(NamedTuple):
    """A motion that has started, was completed or aborted."""

    t_s: float
    request: str
    status: str


class Planned(NamedTuple):
    """A plan that was given to be flown. plan None: the record holds none that can be read."""

    t_s: float
    plan: Plan | None


class Stretch(NamedTuple):
    """From when to when the drone was ours, and where pairing was confirmed.

    noise_m: how far a noisy estimate was seen to wander, 1 sigma; wider_m: by how much its tube was widened for that.
    """

    from_s: float
    until_s: float
    centre: Ned | None
    noise_m: float = 0.0
    wider_m: float = 0.0


TOGETHER_S = 0.2
"""A plan and the report that its motion has started are told in one step, so no farther apart than this."""


@dataclass(frozen=True, eq=False)
class Flight:
    """All that is judged of one record."""

    limits: Limits
    ground: Ground
    origin: Geodetic | None
    """Of the record's frame."""
    operator: Operator | None
    telemetry: tuple[tuple[float, VehicleState], ...]
    neighbours: tuple[tuple[float, Neighbours], ...]
    reservations: tuple[tuple[float, tuple[ReservedVolume, ...]], ...]
    """Volumes that others held, from each time on."""
    anchors: tuple[tuple[float, Ned], ...]
    ours: tuple[Stretch, ...]
    plans: tuple[Planned, ...]
    requests: tuple[Asked, ...]
    decisions: tuple[Decided, ...]
    motions: tuple[Moved, ...]
    lost: int
    """Messages that the record itself says are missing."""
    whole: bool
    """It was closed, and holds the end of the run."""

    def flown(self) -> tuple[tuple[Planned, Moved | None], ...]:
        """Every plan with the start of its motion: the first after it and before the next plan. None: there is none."""
        found: list[tuple[Planned, Moved | None]] = []
        for i, planned in enumerate(self.plans):
            until_s = min(planned.t_s + TOGETHER_S, self.plans[i + 1].t_s if i + 1 < len(self.plans) else math.inf)
            started = (m for m in self.motions if m.status == "started" and planned.t_s <= m.t_s <= until_s)
            found.append((planned, next(started, None)))
        return tuple(found)
