"""Aircraft with a transponder, as the drones' receivers hear them (MAVLink ADSB_VEHICLE, through MAVSDK's transponder plugin).

The plugin hands on no validity flags, so they are taken from the message itself: what is not flagged valid is unknown (X6).
ADS-B tells nothing of an empty sky: its silence proves nothing. Source: R5, R11.
"""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass
from typing import Any

from m3r_app.readable import readable
from safety.vocabulary import Geodetic, Ned

KEPT = 256
"""Aircraft; of more, those heard longest ago are dropped."""
FORGET_S = 60.0
"""Not heard for so long, an aircraft has left or landed; until then it could be ever farther from where it was."""
COORDINATES, ALTITUDE, HEADING, VELOCITY, CALLSIGN, VERTICAL = 1, 2, 4, 8, 16, 128
"""ADSB_FLAGS"""
CALLSIGN_LONGEST = 9
"""Characters of ADSB_VEHICLE's field."""
GEOMETRIC_SIGMA_M, PRESSURE_SIGMA_M = 50.0, 100.0
"""What a position of usual quality (NACp 8: 93 m with 95 %) may be wrong by, and a pressure altitude beyond that, 1 sigma."""
GEOMETRIC = 1
"""ADSB_ALTITUDE_TYPE_GEOMETRIC"""


@dataclass(frozen=True, slots=True)
class Aircraft:
    """As last heard. place, velocity: None where it did not say all of it; at_s: when it said so."""

    icao: int
    callsign: str
    place: Geodetic | None
    velocity: Ned | None
    sigma_m: float
    at_s: float
    heard_at_s: float

    @property
    def name(self) -> str:
        """For a person: its callsign or address."""
        return self.callsign or f"aircraft {self.icao:06x}"


class AdsbTraffic:
    """The aircraft that one drone hears of. `flags` and `put` are called on MAVSDK's threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._flags: dict[int, int] = {}
        self._heard: dict[int, Aircraft] = {}

    def flags(self, icao: int, flags: int) -> None:
        """Which fields of an aircraft's messages are valid."""
        with self._lock:
            self._flags[icao] = flags
            if len(self._flags) > KEPT:
                self._flags.pop(next(iter(self._flags)))

    def put(self, vehicle: Any, now_s: float) -> None:
        """vehicle: MAVSDK's AdsbVehicle, just heard."""
        with self._lock:
            found = aircraft(vehicle, self._flags.get(int(vehicle.icao_address), 0), now_s)
            self._heard.pop(found.icao, None)
            self._heard[found.icao] = found
            if len(self._heard) > KEPT:
                self._heard.pop(next(iter(self._heard)))

    def now(self, now_s: float) -> tuple[Aircraft, ...]:
        """All that count."""
        with self._lock:
            self._heard = {i: a for i, a in self._heard.items() if now_s - a.heard_at_s <= FORGET_S}
            return tuple(self._heard.values())


def aircraft(vehicle: Any, flags: int, now_s: float) -> Aircraft:
    """MAVSDK's AdsbVehicle with the flags of its message (ADSB_FLAGS)."""
    place = Geodetic(float(vehicle.latitude_deg), float(vehicle.longitude_deg), float(vehicle.absolute_altitude_m))
    placed = flags & COORDINATES and flags & ALTITUDE and all(map(math.isfinite, place)) and abs(place.lat_deg) <= 90.0
    heading = math.radians(float(vehicle.heading_deg))
    along, up = float(vehicle.horizontal_velocity_m_s), float(vehicle.vertical_velocity_m_s)
    velocity = Ned(along * math.cos(heading), along * math.sin(heading), -up)
    known = flags & HEADING and flags & VELOCITY and flags & VERTICAL and velocity.finite
    return Aircraft(
        int(vehicle.icao_address),
        readable(str(vehicle.callsign), CALLSIGN_LONGEST) if flags & CALLSIGN else "",
        place if placed else None,
        velocity if known else None,
        GEOMETRIC_SIGMA_M if int(vehicle.altitude_type) == GEOMETRIC else PRESSURE_SIGMA_M,
        now_s - max(0.0, float(vehicle.tslc_s)),
        now_s,
    )


def newest(heard: list[Aircraft]) -> list[Aircraft]:
    """Of what several drones hear: the latest of each aircraft."""
    latest: dict[int, Aircraft] = {}
    for one in sorted(heard, key=lambda a: a.at_s):
        latest[one.icao] = one
    return list(latest.values())
