"""Scenario files: the shipped ones load, every mistake is one sentence that names file and key."""

from __future__ import annotations

from pathlib import Path

import pytest

from m3r_app.environment.scenario import SHIPPED, ScenarioError, load_scenario

PLAIN = (SHIPPED / "plain.toml").read_text(encoding="utf-8")


def refusal(tmp_path: Path, text: str) -> str:
    path = tmp_path / "broken.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ScenarioError) as caught:
        load_scenario(path)
    sentence = str(caught.value)
    assert str(path) in sentence and "\n" not in sentence
    return sentence


@pytest.mark.parametrize("path", sorted(SHIPPED.glob("*.toml")), ids=lambda path: path.stem)
def test_shipped_scenarios_load_and_their_files_exist(path: Path) -> None:
    scenario = load_scenario(path)
    assert scenario.name == path.stem
    assert set(scenario.vehicles) == {"red", "green", "blue"}
    for source in (scenario.terrain.dem, scenario.obstacles and scenario.obstacles.file):
        assert source is None or scenario.file(source).is_file()
    assert scenario.geofence is None or scenario.file(scenario.geofence.file).is_file()


def test_the_shipped_dem_is_small() -> None:
    assert (SHIPPED / "hillside.tif").stat().st_size < 300_000


def test_blue_keeps_the_autopilots_defaults_and_red_does_not() -> None:
    vehicles = load_scenario(SHIPPED / "hillside.toml").vehicles
    assert vehicles["blue"].params == {}
    assert vehicles["red"].params == {"COM_OF_LOSS_T": 0.5, "COM_OBL_RC_ACT": 5}


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("seed = 1", 'seed = "many"', "seed"),
        ("seed = 1", "sead = 1", "sead: there is no such key"),
        ('name = "plain"', "", "name: this key is required"),
        ("lat_deg = 46.9480", "lat_deg = 85.0", "origin.lat_deg"),
        ("lon_deg = 7.4474", "lon_deg = 180.1", "origin.lon_deg"),
        ("ground_amsl_m = 540.0", "ground_amsl_m = inf", "origin.ground_amsl_m"),
        ("sigma_m = 0.2", "sigma_m = -0.1", "operator.sigma_m"),
        ("flat_amsl_m = 540.0\nsigma_m = 0.1", "flat_amsl_m = 540.0", "terrain.sigma_m: this key is required"),
        ("flat_amsl_m = 540.0", "", "terrain: give either dem or flat_amsl_m"),
        ("flat_amsl_m = 540.0", 'flat_amsl_m = 540.0\ndem = "x.tif"', "terrain: give either dem or flat_amsl_m"),
        ("sigma_h_m = 0.25", "sigma_h_m = 0.0", "gps.sigma_h_m"),
        ("height_m = 6.0", "height_m = 0.0", "vehicles.red: height_m"),
        ("height_m = 6.0", "height_m = 6.0\ncolour = 1", "vehicles.red.colour: there is no such key"),
        ('state = "ground"', 'state = "ground"\nheight_m = 1.0', "vehicles.green: height_m"),
        ('state = "ground"', 'state = "parked"', "vehicles.green.state"),
        ("[vehicles.red]", "[vehicles.Red]", "vehicles.Red"),
        ("COM_OF_LOSS_T = 0.5", "COM_OF_LOSS_T = nan", "vehicles.red.params.COM_OF_LOSS_T"),
        ("waypoints = [[-40.0, 0.0, 10.0], [-60.0, 0.0, 10.0], [-60.0, 20.0, 12.0]]", "", "vehicles.blue: state"),
        ("[[-40.0, 0.0, 10.0],", "[[-40.0, 0.0],", "vehicles.blue.waypoints.0"),
        ("north_m = 14.0", "north_m = 500.1", "vehicles.red.north_m"),
        ('name = "plain"', 'name = "plain"\npath = "/x"', "path: there is no such key"),
        ("[gps]", "[gps", "not valid TOML"),
    ],
)
def test_a_mistake_is_named(tmp_path: Path, old: str, new: str, key: str) -> None:
    assert PLAIN.count(old) >= 1
    assert key in refusal(tmp_path, PLAIN.replace(old, new, 1))


def test_traffic_needs_a_line_and_a_name_of_its_own(tmp_path: Path) -> None:
    one_point = "\n[traffic.x]\nwaypoints = [[0.0, 0.0, 5.0]]\nspeed_m_s = 1.0\n"
    assert "traffic.x.waypoints" in refusal(tmp_path, PLAIN + one_point)
    red = "\n[traffic.red]\nwaypoints = [[0.0, 0.0, 5.0], [9.0, 0.0, 5.0]]\nspeed_m_s = 1.0\n"
    assert "red names both a vehicle and traffic" in refusal(tmp_path, PLAIN + red)


def test_a_fence_has_its_floor_below_its_ceiling(tmp_path: Path) -> None:
    fence = '\n[geofence]\nfile = "x.geojson"\nfloor_amsl_m = 600.0\nceiling_amsl_m = 600.0\n'
    assert "geofence: floor_amsl_m must be below ceiling_amsl_m" in refusal(tmp_path, PLAIN + fence)


def test_a_missing_and_a_binary_file(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="cannot be read"):
        load_scenario(tmp_path / "none.toml")
    path = tmp_path / "bytes.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ScenarioError, match="not valid TOML"):
        load_scenario(path)
