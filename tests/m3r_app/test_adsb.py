"""Aircraft with a transponder: what they do not say is unknown, what they say counts, over real UDP too. R5, R11, X6."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from m3r_app.vehicle.adsb import FORGET_S, GEOMETRIC_SIGMA_M, KEPT, PRESSURE_SIGMA_M, AdsbTraffic, aircraft, newest
from safety.vocabulary import Geodetic, Ned
from tests.whole import PLAIN, m3r, simulated

ALL = 1 | 2 | 4 | 8 | 16 | 128
PLACE = Geodetic(47.0, 8.0, 700.0)


def heard(**changes: Any) -> Any:
    fields = {
        "icao_address": 0x3C6444, "latitude_deg": 47.0, "longitude_deg": 8.0, "altitude_type": 1,
        "absolute_altitude_m": 700.0, "heading_deg": 90.0, "horizontal_velocity_m_s": 50.0,
        "vertical_velocity_m_s": 2.0, "callsign": "DLH1 ", "tslc_s": 1,
    }  # fmt: skip
    return SimpleNamespace(**(fields | changes))


@pytest.mark.requirement("R5")
def test_an_aircraft_that_says_everything() -> None:
    one = aircraft(heard(), ALL, 100.0)
    assert one.place == PLACE and one.name == "DLH1" and one.at_s == 99.0 and one.sigma_m == GEOMETRIC_SIGMA_M
    assert one.velocity == pytest.approx(Ned(0.0, 50.0, -2.0), abs=1e-9)
    assert aircraft(heard(altitude_type=0), ALL, 100.0).sigma_m == PRESSURE_SIGMA_M


@pytest.mark.requirement("X6")
@pytest.mark.parametrize(("flags", "placed", "moving", "name"), [
    (0, False, False, "aircraft 3c6444"), (ALL & ~1, False, True, "DLH1"), (ALL & ~2, False, True, "DLH1"),
    (ALL & ~4, True, False, "DLH1"), (ALL & ~8, True, False, "DLH1"), (ALL & ~128, True, False, "DLH1"),
    (ALL & ~16, True, True, "aircraft 3c6444"),
])  # fmt: skip
def test_what_is_not_valid_is_unknown(flags: int, placed: bool, moving: bool, name: str) -> None:
    one = aircraft(heard(), flags, 100.0)
    assert (one.place is not None, one.velocity is not None, one.name) == (placed, moving, name)


@pytest.mark.requirement("X6")
@given(
    st.sampled_from(
        [
            "latitude_deg",
            "longitude_deg",
            "absolute_altitude_m",
            "heading_deg",
            "horizontal_velocity_m_s",
            "vertical_velocity_m_s",
        ]
    ),
    st.sampled_from([math.nan, math.inf]),
)
def test_what_is_no_number_is_unknown(field: str, value: float) -> None:
    if field == "heading_deg" and math.isinf(value):
        value = math.nan
    one = aircraft(heard(**{field: value}), ALL, 100.0)
    assert (one.place is None) == (field in ("latitude_deg", "longitude_deg", "absolute_altitude_m"))
    assert (one.velocity is None) != (one.place is None)


@pytest.mark.requirement("R5")
def test_the_latest_of_each_is_kept_for_a_while() -> None:
    one = AdsbTraffic()
    one.flags(0x3C6444, ALL)
    one.put(heard(), 100.0)
    one.put(heard(latitude_deg=47.1), 101.0)
    (kept,) = one.now(101.0 + FORGET_S)
    assert kept.place == Geodetic(47.1, 8.0, 700.0)
    assert one.now(101.1 + FORGET_S) == ()
    for icao in range(KEPT + 10):
        one.put(heard(icao_address=icao), 200.0)
    assert len(one.now(200.0)) == KEPT and one.now(200.0)[0].icao == 10


def test_of_what_several_hear_the_newest_counts() -> None:
    old, new = aircraft(heard(tslc_s=5), ALL, 100.0), aircraft(heard(), ALL, 100.0)
    other = aircraft(heard(icao_address=7), ALL, 90.0)
    assert set(newest([new, other, old])) == {new, other}


@pytest.mark.requirement("R5")
def test_an_aircraft_nearby_blocks_and_the_paired_drone_sounds(tmp_path: Path) -> None:
    """Only its transponder tells of it: a real flight over UDP. The tune is heard by the drone, as its truth says."""
    scenario = tmp_path / "adsb.toml"
    visitor = (
        "\n[traffic.visitor]\nwaypoints = [[60.0, -40.0, 12.0], [60.0, 40.0, 12.0]]\nspeed_m_s = 5.0\nadsb = true\n"
    )
    text = PLAIN.read_text()
    scenario.write_text(text + visitor)
    script = tmp_path / "script"
    script.write_text("1.5 panel go left\n")
    with simulated(scenario, tmp_path) as fleet:
        assert "visitor" not in fleet.urls
        ran = m3r(
            *("run", "--headless", "--scenario", str(scenario), *fleet.vehicles),
            *("--pair", "red", "--script", str(script)),
        )
        decision = ran.of("decision")[-1]  # heard of late, it may have been delayed first
        failing = {f["constraint"]: f["text"] for f in decision["findings"] if not f["passed"]}
        assert decision["verdict"] == "rejected" and "VISITOR" in " ".join(failing.values()), failing
        assert fleet.last("red")["tunes"] == 1 and fleet.last("green")["tunes"] == 0
