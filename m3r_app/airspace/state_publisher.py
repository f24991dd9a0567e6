"""Tells where drones are, 10 times a second each, in the cells that they are in. Source: R5, R11."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Protocol

from pydantic import ValidationError

from m3r_app.airspace.messages import Place, State, Velocity
from m3r_app.airspace.signed_channel import SignedChannel
from m3r_app.airspace.topics import StateTopic, cell_of, cells_near, cells_told
from safety.vocabulary import Geodetic, Ned

PERIOD_S = 0.1


class Reported(Protocol):
    """What a drone reports of itself, as far as the air is told of it: degrees and metres, m/s, 1-sigma metres, seconds."""

    @property
    def geodetic(self) -> Geodetic | None: ...
    @property
    def velocity(self) -> Ned | None: ...
    @property
    def sigma_m(self) -> float: ...
    @property
    def at_s(self) -> float: ...


class StatePublisher:
    """Publishes complete states only; an incomplete one is left out, and listeners judge the silence by its age."""

    def __init__(self, channel: SignedChannel, clock: Callable[[], float] = time.monotonic) -> None:
        self._channel = channel
        self._clock = clock
        self._told_at_s: dict[str, float] = {}
        self._cells: dict[str, tuple[str, frozenset[str]]] = {}
        """Of each drone: the cell it is in, and those around."""

    @property
    def near(self) -> frozenset[str]:
        """The cells about all drones told of."""
        return frozenset().union(*(around for _, around in self._cells.values()))

    @property
    def tells(self) -> bool:
        """Whether anything was told lately."""
        return self._clock() - max(self._told_at_s.values(), default=-math.inf) < 1.0

    def telemetry(self, drone: str, telemetry: Reported) -> None:
        """A drone's newest telemetry."""
        if telemetry.geodetic is None or telemetry.velocity is None:
            return
        self.tell(drone, telemetry.geodetic, telemetry.velocity, telemetry.sigma_m, self._clock() - telemetry.at_s)

    def tell(self, drone: str, place: Geodetic, velocity: Ned, sigma_m: float, age_s: float) -> None:
        """A drone's newest state; told if the last was PERIOD_S ago."""
        now_s = self._clock()
        # A little early is better than one telemetry period late.
        if now_s - self._told_at_s.get(drone, -math.inf) < 0.9 * PERIOD_S:
            return
        if not all(map(math.isfinite, place)):
            return
        cell, cells = cell_of(place), cells_told(place)
        if self._cells.get(drone, ("", frozenset[str]()))[0] != cell:
            self._cells[drone] = (cell, cells_near(place))
        if not self._channel.may_sign(f"drone.{drone}"):
            return
        try:
            body = State(
                place=Place.of(place),
                velocity=Velocity(north_m_s=velocity.north, east_m_s=velocity.east, down_m_s=velocity.down),
                sigma_m=sigma_m,
                age_s=max(age_s, 0.0),  # in this order a NaN stays one, and is refused
            )
        except ValidationError:
            return  # incomplete or stale
        self._told_at_s[drone] = now_s
        for one in cells:
            self._channel.send(StateTopic(one, drone), body, f"drone.{drone}")
