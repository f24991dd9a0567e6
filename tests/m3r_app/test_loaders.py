"""DEMs of several coordinate systems, obstacles and fences from GeoJSON, and every way in which they can be wrong."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from rasterio.transform import Affine, from_origin
from rasterio.warp import transform

from m3r_app.environment.loaders import WorldError, load_dem, load_geofence, load_obstacles, load_world
from m3r_app.environment.scenario import SHIPPED, GeofenceSource, load_scenario
from safety.frames import LocalFrame
from safety.terrain import Terrain
from safety.vocabulary import Floats, Geodetic, Ned

FRAME = LocalFrame(Geodetic(46.9480, 7.4474, 540.0))
Surface = Callable[[Floats, Floats], Floats]


def bowl(north: Floats, east: Floats) -> Floats:
    return np.asarray(545.0 + 0.15 * north - 0.08 * east + 1.5 * np.sin(north / 30.0) * np.cos(east / 25.0))


def write_dem(path: Path, crs: str | None, surface: Surface = bowl, reach_m: float = 150.0, **changed: Any) -> Path:
    """A DEM about FRAME's origin; cells of 1 m, or what is about that in degrees."""
    (x0,), (y0,) = transform("EPSG:4326", crs or "EPSG:32632", [FRAME.origin.lon_deg], [FRAME.origin.lat_deg])
    cell_x, cell_y = (1.0, 1.0)
    if crs == "EPSG:4326":
        cell_x, cell_y = 1.0 / (111_320.0 * math.cos(math.radians(FRAME.origin.lat_deg))), 1.0 / 111_320.0
    half = round(reach_m)
    count = 2 * half
    west, top = x0 - half * cell_x, y0 + half * cell_y
    columns, rows = np.meshgrid(np.arange(count) + 0.5, np.arange(count) + 0.5)
    lon, lat = transform(
        crs or "EPSG:32632", "EPSG:4326", (west + columns * cell_x).ravel(), (top - rows * cell_y).ravel()
    )
    ned = FRAME.ned_array(np.array(lat), np.array(lon), np.full(len(lat), FRAME.origin.amsl_m))
    heights = surface(ned[:, 0], ned[:, 1]).reshape(count, count).astype(np.float32)
    profile: dict[str, Any] = {
        "driver": "GTiff", "dtype": "float32", "count": 1, "width": count, "height": count, "crs": crs,
        "transform": from_origin(west, top, cell_x, cell_y),
    }  # fmt: skip
    profile |= changed
    with rasterio.open(path, "w", **profile) as dataset:
        for band in range(1, profile["count"] + 1):
            dataset.write(heights.astype(profile["dtype"]), band)
    return path


def below(terrain: Terrain, north: float, east: float) -> float:
    """Altitude of the ground there, from the terrain model."""
    return FRAME.origin.amsl_m - float(terrain.agl_m(np.array([[north, east, 0.0]]))[0])


@pytest.mark.parametrize("crs", ["EPSG:4326", "EPSG:32632", "EPSG:32631", "EPSG:2056", "EPSG:3857"])
def test_any_coordinate_system_gives_the_same_ground(tmp_path: Path, crs: str) -> None:
    terrain = load_dem(write_dem(tmp_path / "dem.tif", crs), 0.1, FRAME)
    assert terrain.sigma_m == 0.1
    for north, east in [(0.0, 0.0), (30.0, -20.0), (-50.0, 50.0), (3.7, 1.2), (80.0, 80.0)]:
        expected = float(bowl(np.array(north), np.array(east)))
        assert below(terrain, north, east) == pytest.approx(expected, abs=0.03), (north, east)


def test_a_shift_or_a_turn_of_a_metre_would_be_seen(tmp_path: Path) -> None:
    """On a slope of 1 in 1 the ground is right to centimetres, so the placing is."""
    terrain = load_dem(write_dem(tmp_path / "dem.tif", "EPSG:32632", lambda n, e: 540.0 + n), 0.1, FRAME)
    other = load_dem(write_dem(tmp_path / "dem2.tif", "EPSG:32632", lambda n, e: 540.0 + e), 0.1, FRAME)
    for north, east in [(0.0, 0.0), (60.0, 60.0), (-60.0, 60.0)]:
        assert below(terrain, north, east) == pytest.approx(540.0 + north, abs=0.02)
        assert below(other, north, east) == pytest.approx(540.0 + east, abs=0.02)


def test_only_what_is_near_is_kept(tmp_path: Path) -> None:
    terrain = load_dem(write_dem(tmp_path / "dem.tif", "EPSG:32632", reach_m=700.0), 0.1, FRAME)
    assert max(terrain.heights_amsl_m.shape) <= 1203
    assert math.isfinite(below(terrain, 590.0, 0.0))


def test_heights_follow_the_earth(tmp_path: Path) -> None:
    """Level ground 500 m away lies below the tangent plane by what the full conversion says."""
    level = write_dem(tmp_path / "dem.tif", "EPSG:32632", lambda n, e: np.full(n.shape, 540.0), 600.0)
    place = FRAME.geodetic(Ned(500.0, 0.0, 0.0))
    exact = FRAME.ned(Geodetic(place.lat_deg, place.lon_deg, 540.0)).down
    assert 0.015 < exact < 0.025
    assert 540.0 - below(load_dem(level, 0.1, FRAME), 500.0, 0.0) == pytest.approx(exact, abs=0.002)


def test_declared_nodata_is_unknown_ground(tmp_path: Path) -> None:
    def holed(north: Floats, east: Floats) -> Floats:
        return np.where((np.abs(north - 40.0) < 5.0) & (np.abs(east) < 5.0), -9999.0, 540.0)

    terrain = load_dem(write_dem(tmp_path / "dem.tif", "EPSG:32632", holed, nodata=-9999.0), 0.1, FRAME)
    assert math.isnan(below(terrain, 40.0, 0.0))
    assert below(terrain, 0.0, 0.0) == pytest.approx(540.0)
    with pytest.raises(WorldError, match="-9999 m as a height.*declare its nodata"):
        load_dem(write_dem(tmp_path / "silent.tif", "EPSG:32632", holed), 0.1, FRAME)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"crs": None}, "has no coordinates"),
        ({"transform": Affine.identity()}, "has no coordinates"),
        ({"count": 2}, "2 bands"),
        ({"nodata": 540.0, "surface": lambda n, e: np.full(n.shape, 540.0)}, "no heights about the origin"),
        ({"reach_m": 15.0}, "reaches only 1[45] m about the origin"),
    ],
)
def test_unusable_dems(tmp_path: Path, change: dict[str, Any], reason: str) -> None:
    path = write_dem(tmp_path / "dem.tif", **{"crs": "EPSG:32632", **change})
    with pytest.raises(WorldError, match=reason) as caught:
        load_dem(path, 0.1, FRAME)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_a_dem_of_another_place(tmp_path: Path) -> None:
    path = write_dem(tmp_path / "dem.tif", "EPSG:32632")
    with pytest.raises(WorldError, match="does not cover the origin"):
        load_dem(path, 0.1, LocalFrame(Geodetic(46.0, 8.0, 500.0)))


def test_a_dem_that_is_none_and_an_unstated_error(tmp_path: Path) -> None:
    text = tmp_path / "dem.tif"
    text.write_text("no DEM")
    with pytest.raises(WorldError, match="cannot be read"):
        load_dem(text, 0.1, FRAME)
    with pytest.raises(WorldError, match="does not exist"):
        load_dem(tmp_path / "none.tif", 0.1, FRAME)
    good = write_dem(tmp_path / "good.tif", "EPSG:32632")
    for sigma_m in (math.nan, -0.1, math.inf):
        with pytest.raises(WorldError, match="stated height error"):
            load_dem(good, sigma_m, FRAME)


def test_heights_in_feet_are_refused(tmp_path: Path) -> None:
    path = write_dem(tmp_path / "dem.tif", "EPSG:32632")
    with rasterio.open(path, "r+") as dataset:
        dataset.units = ("ft",)
    with pytest.raises(WorldError, match="heights in ft"):
        load_dem(path, 0.1, FRAME)


@pytest.mark.requirement("X6")
@pytest.mark.parametrize("crs", ["EPSG:4979", "OGC:CRS84h", "EPSG:4978"])
def test_heights_above_the_ellipsoid_are_refused(tmp_path: Path, crs: str) -> None:
    """They are tens of metres from those above the sea: twelve "go down" were once flown into the ground by such a DEM."""
    path = write_dem(tmp_path / "dem.tif", "EPSG:4326")
    with rasterio.open(path, "r+") as dataset:
        dataset.crs = rasterio.CRS.from_user_input(crs)
    with pytest.raises(WorldError, match="heights above the ellipsoid") as caught:
        load_dem(path, 0.1, FRAME)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("crs", ["EPSG:4326+5773", "EPSG:4326+5703"])
def test_heights_above_a_geoid_in_metres_are_taken(tmp_path: Path, crs: str) -> None:
    path = write_dem(tmp_path / "dem.tif", "EPSG:4326")
    with rasterio.open(path, "r+") as dataset:
        dataset.crs = rasterio.CRS.from_user_input(crs)
    assert below(load_dem(path, 0.1, FRAME), 3.7, 1.2) == pytest.approx(
        float(bowl(np.array(3.7), np.array(1.2))), abs=0.03
    )


def ring(*corners_ne_m: tuple[float, float]) -> list[list[float]]:
    places = [FRAME.geodetic(Ned(north, east, 0.0)) for north, east in (*corners_ne_m, corners_ne_m[0])]
    return [[place.lon_deg, place.lat_deg] for place in places]


SQUARE = ring((10.0, 0.0), (10.0, 10.0), (20.0, 10.0), (20.0, 0.0))


def feature(rings: list[Any], kind: str = "Polygon", **properties: Any) -> dict[str, Any]:
    return {"type": "Feature", "properties": properties, "geometry": {"type": kind, "coordinates": rings}}


def write(path: Path, *features: dict[str, Any]) -> Path:
    path.write_text(json.dumps({"type": "FeatureCollection", "features": list(features)}))
    return path


def test_obstacles_are_where_the_file_says(tmp_path: Path) -> None:
    path = write(tmp_path / "o.geojson", feature([SQUARE], name="shed", base_amsl_m=539.0, top_amsl_m=545))
    obstacles = load_obstacles(path, FRAME)
    assert obstacles.names == ("shed",)
    points = np.array([[5.0, 5.0, -1.0], [15.0, 5.0, -8.0], [15.0, 5.0, -4.0], [15.0, 13.0, -9.0]])
    assert obstacles.distance_m(points)[:, 0] == pytest.approx([5.0, 3.0, -1.0, 5.0], abs=1e-3)


def test_a_multipolygon_is_as_many_obstacles(tmp_path: Path) -> None:
    far = ring((50.0, 0.0), (50.0, 1.0), (51.0, 1.0))
    path = write(tmp_path / "o.geojson", feature([[SQUARE], [far]], "MultiPolygon", base_amsl_m=1.0, top_amsl_m=2.0))
    assert load_obstacles(path, FRAME).names == ("obstacle 1", "obstacle 1")


BOW_TIE = ring((10.0, 0.0), (20.0, 10.0), (20.0, 0.0), (10.0, 10.0))
SWAPPED = [[lat, lon] for lon, lat in SQUARE]


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (feature([SQUARE], top_amsl_m=545.0), "needs the property base_amsl_m"),
        (feature([SQUARE], base_amsl_m=1.0, top_amsl_m="high"), "needs the property top_amsl_m"),
        (feature([SQUARE], base_amsl_m=True, top_amsl_m=2.0), "needs the property base_amsl_m"),
        (feature([SQUARE], base_amsl_m=5.0, top_amsl_m=5.0), "must be above its base"),
        (feature([BOW_TIE], base_amsl_m=1.0, top_amsl_m=2.0), "not valid"),
        (feature(SQUARE, "LineString", base_amsl_m=1.0, top_amsl_m=2.0), "is a LineString"),
        (feature([SWAPPED], base_amsl_m=1.0, top_amsl_m=2.0), "km from the origin"),
        (feature([[[7.0, 95.0], [7.1, 95.0], [7.1, 95.1], [7.0, 95.0]]], base_amsl_m=1.0, top_amsl_m=2.0), "degrees"),
        (feature([[["a", "b"]]], base_amsl_m=1.0, top_amsl_m=2.0), "make no polygon"),
        (feature([], base_amsl_m=1.0, top_amsl_m=2.0), "obstacle 1"),
        ({"type": "Feature", "properties": {}}, "without a geometry"),
    ],
)
def test_wrong_obstacles(tmp_path: Path, content: dict[str, Any], reason: str) -> None:
    path = write(tmp_path / "o.geojson", content)
    with pytest.raises(WorldError, match=reason) as caught:
        load_obstacles(path, FRAME)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "reason"),
    [("{", "not valid JSON"), ("[]", "no GeoJSON object"), ('{"type": "FeatureCollection"}', "without a geometry"),
     ('{"crs": {}, "type": "FeatureCollection", "features": []}', "coordinate system")],
)  # fmt: skip
def test_what_is_no_geojson(tmp_path: Path, text: str, reason: str) -> None:
    path = tmp_path / "o.geojson"
    path.write_text(text)
    with pytest.raises(WorldError, match=reason):
        load_obstacles(path, FRAME)
    with pytest.raises(WorldError, match="cannot be read"):
        load_obstacles(tmp_path / "none.geojson", FRAME)


FENCE = GeofenceSource(file=Path("f.geojson"), floor_amsl_m=540.0, ceiling_amsl_m=600.0)


def test_a_geofence_with_a_hole(tmp_path: Path) -> None:
    outer = ring((-50.0, -50.0), (-50.0, 50.0), (50.0, 50.0), (50.0, -50.0))
    fence = load_geofence(write(tmp_path / "f.geojson", feature([outer, SQUARE])), FENCE, FRAME)
    points = np.array([[0.0, 0.0, -30.0], [15.0, 5.0, -30.0], [0.0, 0.0, -57.0], [45.0, 40.0, -30.0]])
    assert fence.inside_m(points) == pytest.approx([10.0, -5.0, 3.0, 5.0], abs=1e-3)
    two = write(tmp_path / "two.geojson", feature([outer]), feature([SQUARE]))
    with pytest.raises(WorldError, match="has 2 polygons"):
        load_geofence(two, FENCE, FRAME)
    with pytest.raises(WorldError, match="has 0 polygons"):
        load_geofence(write(tmp_path / "none.geojson"), FENCE, FRAME)


def test_the_shipped_worlds_load() -> None:
    hillside = load_scenario(SHIPPED / "hillside.toml")
    frame = LocalFrame(hillside.origin.place)
    world = load_world(hillside, frame)
    assert world.terrain is not None and world.terrain.sigma_m == 0.1
    assert world.obstacles.names == ("the wall", "the barn")
    assert world.geofence is not None
    plain = load_world(load_scenario(SHIPPED / "plain.toml"), FRAME)
    assert plain.terrain is not None and plain.terrain.is_flat
    assert len(plain.obstacles) == 0 and plain.geofence is None
    assert below(plain.terrain, 100.0, -40.0) == pytest.approx(540.0)
