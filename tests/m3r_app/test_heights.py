"""Heights that should agree and do not refuse pairing and take-off, with their numbers. Source: X6, X8; design 8."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from m3r_app.heights import disagreements
from m3r_app.vehicle.telemetry import NEVER_HEARD, Telemetry
from safety.frames import LocalFrame
from safety.limits import Limits
from safety.terrain import Terrain
from safety.vocabulary import Geodetic, Ned, Operator

FRAME = LocalFrame(Geodetic(46.0, 7.0, 500.0))
OPERATOR = Operator(Ned(0.0, 0.0, 0.0), 0.5)
FLAT = Terrain.flat(500.0, 0.5, 500.0)


def drone(up_m: float, **changes: Any) -> Telemetry:
    place = FRAME.geodetic(Ned(10.0, 0.0, -up_m))
    return replace(NEVER_HEARD, geodetic=place, sigma_h_m=0.3, sigma_v_m=0.3, **changes)


def said(telemetry: Telemetry, operator: Operator = OPERATOR, terrain: Terrain | None = FLAT) -> str:
    return "; ".join(disagreements(telemetry, FRAME, operator, terrain, Limits()))


def test_heights_that_agree_say_nothing() -> None:
    home = FRAME.geodetic(Ned(9.0, 1.0, -0.5))
    assert said(drone(0.2, in_air=False, home=home)) == ""
    assert said(drone(12.0, in_air=True, home=home, ground_distance_m=12.3)) == ""


# What can be explained: twice 0.3 m of the drone and 0.5 m of the terrain, and half a metre of skids.
@pytest.mark.parametrize(("up_m", "refused"), [(2.0, False), (2.3, True), (30.0, True), (-2.0, False), (-2.3, True)])
def test_a_landed_drone_stands_on_the_ground(up_m: float, refused: bool) -> None:
    words = said(drone(up_m, in_air=False))
    assert (f"{abs(up_m):.1f} m {'above' if up_m > 0 else 'below'} the terrain model" in words) == refused


@pytest.mark.requirement("X8")
@pytest.mark.parametrize(("up_m", "refused"), [(100.0, False), (-1.5, False), (-1.7, True), (-20.0, True)])
def test_a_flying_drone_is_not_under_the_ground(up_m: float, refused: bool) -> None:
    assert ("its altitude is" in said(drone(up_m, in_air=True))) == refused


@pytest.mark.requirement("X8")
@pytest.mark.parametrize(("up_m", "refused"), [(3.9, False), (4.1, True), (-30.0, True), (30.0, True)])
def test_an_operator_stands_on_the_ground(up_m: float, refused: bool) -> None:
    """Twice 0.5 m of the operator and 0.5 m of the terrain, and what they may hold in their hand."""
    operator = Operator(Ned(0.0, 0.0, -up_m), 0.5)
    assert ("your altitude" in said(drone(10.0, in_air=True), operator)) == refused


@pytest.mark.parametrize(("up_m", "refused"), [(3.5, False), (3.7, True), (-48.0, True)])
def test_home_is_on_the_ground(up_m: float, refused: bool) -> None:
    """A geoid's undulation is 48 m in the Alps."""
    home = FRAME.geodetic(Ned(0.0, 20.0, -up_m))
    assert ("its home" in said(drone(10.0, in_air=True, home=home))) == refused


@pytest.mark.parametrize(
    ("measured_m", "refused"), [(10.0, False), (8.0, False), (7.5, True), (12.5, False), (13.0, True)]
)
def test_a_rangefinder_agrees_with_the_model(measured_m: float, refused: bool) -> None:
    assert ("rangefinder" in said(drone(10.0, in_air=True, ground_distance_m=measured_m))) == refused


def test_what_cannot_be_compared_says_nothing_here() -> None:
    """Others refuse it: no terrain, no place, no data there."""
    hole = Terrain(np.full((2, 2), math.nan), (-50.0, -50.0), ((100.0, 0.0), (0.0, 100.0)), 0.5, 500.0)
    assert said(drone(30.0, in_air=False), terrain=None) == ""
    assert said(replace(drone(30.0, in_air=False), geodetic=None)) == ""
    assert said(drone(30.0, in_air=False), terrain=hole) == ""


def test_accuracy_that_is_unknown_explains_nothing() -> None:
    """It is refused by others; here it must not look like an explanation."""
    blind = replace(drone(30.0, in_air=False), sigma_v_m=math.nan)
    assert disagreements(blind, FRAME, OPERATOR, FLAT, Limits()) == ()
