"""Everything that stands against pairing, each a sentence. X8, P1, design 12."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from m3r_app.pairing import PairingLimits, objections
from m3r_app.vehicle.telemetry import NEVER_HEARD, Telemetry
from safety.frames import LocalFrame
from safety.limits import Limits
from safety.obstacles import Obstacles
from safety.situation import World
from safety.terrain import Terrain
from safety.vocabulary import Geodetic, Ned, Operator

FRAME = LocalFrame(Geodetic(46.0, 7.0, 500.0))
OPERATOR = Operator(Ned(0.0, 0.0, 0.0), 0.5)
WORLD = World(Terrain.flat(500.0, 0.1, 500.0), Obstacles.none(), None)
LIMITS, PAIRING = Limits(), PairingLimits(100.0, 3.0)
FIT = replace(
    NEVER_HEARD, at_s=100.0, heard_at_s=100.0, geodetic=FRAME.geodetic(Ned(10.0, 0.0, -10.0)), local=Ned(0, 0, 0),
    velocity=Ned(0, 0, 0), yaw_deg=0.0, yaw_rate_deg_s=0.0, sigma_h_m=0.3, sigma_v_m=0.3, flight_mode="HOLD",
    mode_at_s=100.0, armed=True, in_air=True, healthy=True, unhealthy=(),
)  # fmt: skip


def found(telemetry: Telemetry = FIT, operator: Operator = OPERATOR, world: World = WORLD) -> tuple[str, ...]:
    return objections(telemetry, FRAME, operator, world, LIMITS, PAIRING, 100.1)


def at(*ned: float) -> dict[str, Any]:
    return {"geodetic": FRAME.geodetic(Ned(*ned))}


def test_nothing_stands_against_a_fit_drone() -> None:
    assert found() == ()


@pytest.mark.parametrize(("change", "says"), [
    ({"at_s": 99.0}, "stale"), ({"at_s": math.nan}, "stale"),
    ({"healthy": False, "unhealthy": ("gyro", "home")}, "gyro, home"),
    ({"in_air": False}, "take off first"), ({"in_air": None}, "take off first"),
    ({"flight_mode": "POSCTL"}, "POSCTL"), ({"flight_mode": "UNKNOWN"}, "UNKNOWN"),
    ({"geodetic": None}, "position is unknown"),
    (at(101.0, 0.0, 0.0), "more than 100 m"), (at(3.9, 0.0, -10.0), "nearer than 4.0 m"),
    ({"geodetic": Geodetic(math.nan, 7.0, 500.0)}, "away"),
    ({"sigma_h_m": 2.1}, "localisation confidence"), ({"sigma_v_m": math.nan}, "unknown, 0.50"),
])  # fmt: skip
def test_each_objection(change: dict[str, Any], says: str) -> None:
    assert any(says in sentence for sentence in found(replace(FIT, **change)))


@pytest.mark.parametrize("sigma_m", [3.1, math.nan, math.inf])
def test_the_operator_must_be_located(sigma_m: float) -> None:
    assert any("operator's position" in s for s in found(operator=replace(OPERATOR, sigma_m=sigma_m)))


@pytest.mark.parametrize("terrain", [None, Terrain.flat(500.0, 2.1, 500.0), Terrain.flat(500.0, math.nan, 500.0)])
def test_the_terrain_must_be_known(terrain: Terrain | None) -> None:
    assert any("terrain model" in s for s in found(world=replace(WORLD, terrain=terrain)))


def test_a_silent_drone_has_every_objection_at_once() -> None:
    assert len(found(NEVER_HEARD)) >= 6
