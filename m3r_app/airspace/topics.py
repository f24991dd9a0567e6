"""The topics, version 1, and the map cells by which neighbours' states are cut.

    m3r/1/state/CELL/DRONE              where a drone is; not retained, QoS 0
    m3r/1/ask/AREA/DRONE/OPERATOR       to the authority of the area, QoS 1
    m3r/1/answer/OPERATOR/INBOX         its answers, QoS 1; the inbox is one app's
    m3r/1/held/AREA                     all live claims and volumes, once a second; not retained

Cells are H3 hexagons of about 1 km (resolution 8): they have neighbours everywhere, at the poles and the date line too.
A topic names its one signer, so what is signed by anybody else is dropped.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from safety.vocabulary import Geodetic

ROOT = "m3r/1"
RESOLUTION = 8
EDGE_M = 50.0
"""A drone this near to a cell's edge is told of in the next cell too."""
NAME = r"[a-z][a-z0-9_-]{0,31}"
_EARTH_M_DEG = 111_320.0
_SEEN_FROM = ((1, 0), (0.5, 0.87), (-0.5, 0.87), (-1, 0), (-0.5, -0.87), (0.5, -0.87))


@dataclass(frozen=True, slots=True)
class StateTopic:
    """Where a drone tells its state."""

    cell: str
    drone: str

    def __str__(self) -> str:
        return f"{ROOT}/state/{self.cell}/{self.drone}"

    @property
    def signer(self) -> str:
        return f"drone.{self.drone}"


@dataclass(frozen=True, slots=True)
class AskTopic:
    """Where an operator asks the authority of an area for something about a drone."""

    area: str
    drone: str
    operator: str

    def __str__(self) -> str:
        return f"{ROOT}/ask/{self.area}/{self.drone}/{self.operator}"

    @property
    def signer(self) -> str:
        return f"operator.{self.operator}"


@dataclass(frozen=True, slots=True)
class AnswerTopic:
    """Where one app of an operator is answered by an authority."""

    operator: str
    inbox: str

    def __str__(self) -> str:
        return f"{ROOT}/answer/{self.operator}/{self.inbox}"

    @property
    def signer(self) -> None:
        """The authority that was asked: whose area it is does not stand in the topic."""
        return


@dataclass(frozen=True, slots=True)
class HeldTopic:
    """Where an authority tells what is held in its area."""

    area: str

    def __str__(self) -> str:
        return f"{ROOT}/held/{self.area}"

    @property
    def signer(self) -> str:
        return f"airspace.{self.area}"


Topic = StateTopic | AskTopic | AnswerTopic | HeldTopic

_PATTERNS: tuple[tuple[re.Pattern[str], type[StateTopic | AskTopic | AnswerTopic | HeldTopic]], ...] = (
    (re.compile(rf"{ROOT}/state/([0-9a-f]{{15}})/({NAME})"), StateTopic),
    (re.compile(rf"{ROOT}/ask/({NAME})/({NAME})/({NAME})"), AskTopic),
    (re.compile(rf"{ROOT}/answer/({NAME})/([0-9a-f]{{16}})"), AnswerTopic),
    (re.compile(rf"{ROOT}/held/({NAME})"), HeldTopic),
)


def parse_topic(text: str) -> Topic | None:
    """The topic that is meant; None for any other."""
    for pattern, kind in _PATTERNS:
        match = pattern.fullmatch(text)
        if match:
            return kind(*match.groups())
    return None


def cell_of(place: Geodetic) -> str:
    """The cell a place lies in."""
    import h3  # only shared air needs it

    return str(h3.latlng_to_cell(place.lat_deg, place.lon_deg, RESOLUTION))


def cells_told(place: Geodetic) -> frozenset[str]:
    """Where a drone there must tell its state: its cell, and those that begin within EDGE_M."""
    cells = {cell_of(place)}
    step_deg = EDGE_M / _EARTH_M_DEG
    # Towards the poles a degree of longitude shrinks; beyond 89 degrees the cell's own neighbours are near enough.
    shrink = max(0.017, math.cos(math.radians(place.lat_deg)))
    for north, east in _SEEN_FROM:
        lat_deg = min(90.0, max(-90.0, place.lat_deg + north * step_deg))
        cells.add(cell_of(Geodetic(lat_deg, place.lon_deg + east * step_deg / shrink, place.amsl_m)))
    return frozenset(cells)


def cells_near(place: Geodetic) -> frozenset[str]:
    """What somebody there must listen to: its cell and all that touch it, so at least 700 m around."""
    import h3

    return frozenset(map(str, h3.grid_disk(cell_of(place), 1)))
