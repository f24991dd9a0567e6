"""Everything that stands against pairing, each a sentence. X8, P1, design 12."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest
import shapely

from m3r_app.pairing import PairingLimits, needed_rate_hz, objections
from m3r_app.vehicle.telemetry import NEVER_HEARD, Telemetry
from safety.frames import LocalFrame
from safety.geofence import Geofence
from safety.limits import Limits
from safety.obstacles import Obstacles
from safety.situation import World
from safety.terrain import Terrain
from safety.vocabulary import FlightMode, Geodetic, Ned, Operator

FRAME = LocalFrame(Geodetic(46.0, 7.0, 500.0))
OPERATOR = Operator(Ned(0.0, 0.0, 0.0), 0.5)
WORLD = World(Terrain.flat(500.0, 0.1, 500.0), Obstacles.none(), None)
LIMITS, PAIRING = Limits(), PairingLimits(100.0, 3.0)
FIT = replace(
    NEVER_HEARD, at_s=100.0, heard_at_s=100.0, geodetic=FRAME.geodetic(Ned(10.0, 0.0, -10.0)), local=Ned(0, 0, 0),
    velocity=Ned(0, 0, 0), yaw_deg=0.0, yaw_rate_deg_s=0.0, sigma_h_m=0.3, sigma_v_m=0.3, flight_mode=FlightMode.HOLD,
    mode_at_s=100.0, armed=True, in_air=True, healthy=True, unhealthy=(), rate_hz=50.0, battery=0.8,
)  # fmt: skip


def found(telemetry: Telemetry = FIT, operator: Operator = OPERATOR, world: World = WORLD) -> tuple[str, ...]:
    return objections(telemetry, FRAME, operator, world, LIMITS, PAIRING, 100.1)


def at(*ned: float) -> dict[str, Any]:
    return {"geodetic": FRAME.geodetic(Ned(*ned))}


@pytest.mark.requirement("X8")
def test_nothing_stands_against_a_fit_drone() -> None:
    assert found() == ()


@pytest.mark.requirement("P1", "X8")
@pytest.mark.parametrize(("change", "says"), [
    ({"at_s": 99.0}, "stale"), ({"at_s": math.nan}, "stale"),
    ({"healthy": False, "unhealthy": ("gyro", "home")}, "gyro, home"),
    ({"in_air": False}, "take off first"), ({"in_air": None}, "take off first"),
    ({"flight_mode": FlightMode.POSITION}, "POSCTL"), ({"flight_mode": FlightMode.UNKNOWN}, "UNKNOWN"),
    ({"geodetic": None}, "position is unknown"),
    (at(101.0, 0.0, 0.0), "more than 100 m"), (at(3.9, 0.0, -10.0), "nearer than 4.0 m"),
    ({"geodetic": Geodetic(math.nan, 7.0, 500.0)}, "away"),
    ({"sigma_h_m": 2.1}, "localisation confidence"), ({"sigma_v_m": math.nan}, "unknown, 0.50"),
])  # fmt: skip
def test_each_objection(change: dict[str, Any], says: str) -> None:
    assert any(says in sentence for sentence in found(replace(FIT, **change)))


@pytest.mark.requirement("X8")
@pytest.mark.parametrize("sigma_m", [3.1, math.nan, math.inf])
def test_the_operator_must_be_located(sigma_m: float) -> None:
    assert any("operator's position" in s for s in found(operator=replace(OPERATOR, sigma_m=sigma_m)))


@pytest.mark.requirement("X8")
@pytest.mark.parametrize("terrain", [None, Terrain.flat(500.0, 2.1, 500.0), Terrain.flat(500.0, math.nan, 500.0)])
def test_the_terrain_must_be_known(terrain: Terrain | None) -> None:
    assert any("terrain model" in s for s in found(world=replace(WORLD, terrain=terrain)))


@pytest.mark.requirement("X8")
def test_a_silent_drone_has_every_objection_at_once() -> None:
    assert len(found(NEVER_HEARD)) >= 6


# ---------------------------------------------------------------- as vehicles are out there


@pytest.mark.requirement("X8")
@pytest.mark.parametrize(("rate_hz", "refused"), [(6.0, False), (5.9, True), (4.0, True), (math.nan, True)])
def test_positions_must_come_often_enough(rate_hz: float, refused: bool) -> None:
    """At 4 Hz pairing succeeded and every move was aborted: the last position was too old."""
    assert any("a second, 6 are needed" in s for s in found(replace(FIT, rate_hz=rate_hz))) == refused


def test_the_needed_rate_follows_from_the_limits() -> None:
    assert needed_rate_hz(LIMITS) == pytest.approx(6.0)
    assert needed_rate_hz(replace(LIMITS, telemetry_age_s=0.2)) == pytest.approx(15.0)
    assert needed_rate_hz(replace(LIMITS, speed_m_s=2.0, tracking_m=0.1)) == pytest.approx(40.0)


@pytest.mark.requirement("X8")
@pytest.mark.parametrize(
    ("battery", "declared", "refused"),
    [(None, False, True), (None, True, False), (0.19, True, True), (0.2, False, False), (0.0, False, True)],
)
def test_the_battery_is_known_or_declared_unknown(battery: float | None, declared: bool, refused: bool) -> None:
    pairing = replace(PAIRING, battery_may_be_unknown=declared)
    said = objections(replace(FIT, battery=battery), FRAME, OPERATOR, WORLD, LIMITS, pairing, 100.1)
    assert any("battery" in s for s in said) == refused


@pytest.mark.requirement("X8")
def test_a_drone_in_somebody_elses_offboard_is_not_taken() -> None:
    assert any("OFFBOARD" in s for s in found(replace(FIT, flight_mode=FlightMode.OFFBOARD)))


@pytest.mark.requirement("X8")
@pytest.mark.parametrize(("up_m", "refused"), [(1.9, True), (2.1, False)])
def test_a_drone_that_hovers_lower_than_it_may_is_not_paired_with(up_m: float, refused: bool) -> None:
    """The best estimate counts: what is uncertain is counted against every move."""
    said = found(replace(FIT, **at(10.0, 0.0, -up_m)))
    assert any("it hovers" in s and "too low" in s for s in said) == refused


STANDING = replace(FIT, in_air=False, armed=False, flight_mode=FlightMode.HOLD, **at(10.0, 0.0, -0.1))


@pytest.mark.requirement("X8")
@pytest.mark.parametrize(
    ("metres", "says"),
    [
        (10.0, None),
        (1.2, "too low above the ground"),
        (2.9, "too low above the ground"),
        (60.0, "geofence"),
    ],
)
def test_a_take_off_is_judged_where_it_leads(metres: float, says: str | None) -> None:
    fence = Geofence.of(shapely.box(-50.0, -50.0, 50.0, 50.0), 490.0, 540.0, 500.0)
    world = replace(WORLD, geofence=fence)
    said = objections(STANDING, FRAME, OPERATOR, world, LIMITS, PAIRING, 100.1, metres)
    assert (
        (said == ()) if says is None else any(f"a take-off to {metres:g} m brings it" in s and says in s for s in said)
    )


@pytest.mark.requirement("X8")
@pytest.mark.parametrize("change", [at(3.0, 0.0, -0.1), {"healthy": False}, {"sigma_h_m": 3.0}, {"rate_hz": 2.0}])
def test_what_is_known_on_the_ground_forbids_the_take_off(change: dict[str, Any]) -> None:
    assert objections(replace(STANDING, **change), FRAME, OPERATOR, WORLD, LIMITS, PAIRING, 100.1, 10.0)
    nowhere = replace(WORLD, terrain=None)
    assert objections(STANDING, FRAME, OPERATOR, nowhere, LIMITS, PAIRING, 100.1, 10.0)
