"""Frames: there and back again within a millimetre. Paper III-A, III-D."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from safety.frames import LocalFrame, bearing_deg, enu, wrap_deg
from safety.vocabulary import Geodetic, Ned

origins = st.builds(Geodetic, st.floats(-85.0, 85.0), st.floats(-180.0, 180.0), st.floats(-100.0, 5000.0))
near = st.floats(-3000.0, 3000.0)
places = st.builds(Ned, near, near, st.floats(-500.0, 500.0))


@given(origins, places)
def test_local_to_geodetic_and_back(origin: Geodetic, point: Ned) -> None:
    frame = LocalFrame(origin)
    assert frame.ned(frame.geodetic(point)).minus(point).norm < 1e-3


@given(origins, places)
def test_arrays_agree_with_single_places(origin: Geodetic, point: Ned) -> None:
    frame = LocalFrame(origin)
    place = frame.geodetic(point)
    many = frame.ned_array(np.array([place.lat_deg] * 2), np.array([place.lon_deg] * 2), np.array([place.amsl_m] * 2))
    assert many == pytest.approx(np.array([point, point]), abs=1e-3)


@given(origins)
def test_north_is_north_up_is_up(origin: Geodetic) -> None:
    frame = LocalFrame(origin)
    assert frame.ned(origin).norm < 1e-6
    assert frame.geodetic(Ned(100.0, 0.0, 0.0)).lat_deg > origin.lat_deg
    assert frame.geodetic(Ned(0.0, 0.0, -100.0)).amsl_m == pytest.approx(origin.amsl_m + 100.0, abs=1e-3)
    assert frame.amsl_m(-100.0) == pytest.approx(origin.amsl_m + 100.0)


@given(st.floats(-1e5, 1e5))
def test_wrap(angle_deg: float) -> None:
    wrapped = wrap_deg(angle_deg)
    assert -180.0 < wrapped <= 180.0
    assert math.cos(math.radians(wrapped)) == pytest.approx(math.cos(math.radians(angle_deg)), abs=1e-6)
    assert math.sin(math.radians(wrapped)) == pytest.approx(math.sin(math.radians(angle_deg)), abs=1e-6)


@pytest.mark.parametrize(("angle_deg", "wrapped_deg"), [
    (180.0, 180.0), (-180.0, 180.0), (180.001, -179.999), (360.0, 0.0), (540.0, 180.0), (-540.0, 180.0), (-0.0, 0.0),
])  # fmt: skip
def test_wrap_at_its_ends(angle_deg: float, wrapped_deg: float) -> None:
    assert wrap_deg(angle_deg) == pytest.approx(wrapped_deg)


@pytest.mark.parametrize("angle_deg", [math.nan, math.inf, -math.inf])
def test_what_is_no_angle_stays_none(angle_deg: float) -> None:
    assert math.isnan(wrap_deg(angle_deg))


@pytest.mark.parametrize(("end", "bearing"), [
    (Ned(1, 0, 0), 0.0), (Ned(0, 1, 0), 90.0), (Ned(-1, 0, 0), 180.0), (Ned(0, -1, 0), -90.0), (Ned(1, 1, 9), 45.0),
])  # fmt: skip
def test_bearings(end: Ned, bearing: float) -> None:
    assert bearing_deg(Ned(0.0, 0.0, 0.0), end) == pytest.approx(bearing)


def test_east_north_up() -> None:
    assert enu(Ned(1.0, 2.0, 3.0)) == (2.0, 1.0, -3.0)
