"""Loads what stands still about a place: the DEM (rasterio), obstacles and geofence (GeoJSON), into the pure World."""

from __future__ import annotations

import json
import math
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
import shapely
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.warp import transform
from rasterio.windows import Window

from m3r_app.environment.scenario import GeofenceSource, Scenario, TerrainSource
from safety.frames import LocalFrame
from safety.geofence import Geofence
from safety.obstacles import Obstacles
from safety.situation import World
from safety.terrain import Terrain
from safety.vocabulary import Floats, Ned

REACH_M = 600.0
"""How far from the origin the DEM is read."""
LEAST_M = 20.0
"""How far the DEM must at least reach about the origin."""
MOST_NODES = 4_000_000
FAR_M = 20_000.0
"""GeoJSON farther than this from the origin belongs to another place, or has latitude and longitude swapped."""


class WorldError(ValueError):
    """A terrain, obstacle or geofence file that cannot be used; one sentence that names the file and the reason."""


def load_world(scenario: Scenario, frame: LocalFrame, terrain: Terrain | None = None) -> World:
    """The scenario's terrain (unless another is given), obstacles and geofence in the session's frame. Raises WorldError."""
    obstacles = Obstacles.none(frame.origin.amsl_m)
    if scenario.obstacles is not None:
        obstacles = load_obstacles(scenario.file(scenario.obstacles.file), frame)
    fence = None
    if scenario.geofence is not None:
        fence = load_geofence(scenario.file(scenario.geofence.file), scenario.geofence, frame)
    return World(load_terrain(scenario, frame) if terrain is None else terrain, obstacles, fence)


def load_terrain(scenario: Scenario, frame: LocalFrame) -> Terrain:
    """The scenario's DEM, or its flat ground. Raises WorldError."""
    source: TerrainSource = scenario.terrain
    if source.dem is not None:
        return load_dem(scenario.file(source.dem), source.sigma_m, frame)
    assert source.flat_amsl_m is not None  # the scenario has checked that it is one of the two
    return Terrain.flat(source.flat_amsl_m, source.sigma_m, frame.origin.amsl_m)


def load_dem(path: Path, sigma_m: float, frame: LocalFrame) -> Terrain:
    """A one-band DEM of any coordinate system, metres above mean sea level, about the frame's origin. Raises WorldError.

    The DEM's own nodes are kept, nothing is resampled: its grid is placed in the local frame by the affine map that is
    exact at the origin, and 6 cm off at REACH_M. Heights are corrected for the earth's curvature.
    """
    if not (math.isfinite(sigma_m) and sigma_m >= 0.0):
        raise WorldError(f"DEM {path} needs a stated height error sigma_m of 0 m or more")
    if not path.is_file():
        raise WorldError(f"DEM {path} does not exist: name a file on this computer")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)  # said below, in one sentence
            with rasterio.open(path) as dataset:
                return _dem(dataset, path, sigma_m, frame)
    except RasterioError as error:
        raise WorldError(f"DEM {path} cannot be read: {str(error).splitlines()[0]}") from None


def _dem(dataset: Any, path: Path, sigma_m: float, frame: LocalFrame) -> Terrain:
    if dataset.crs is None or dataset.transform.is_identity:
        raise WorldError(f"DEM {path} has no coordinates: give it a coordinate system and a geotransform")
    if dataset.count != 1:
        raise WorldError(f"DEM {path} has {dataset.count} bands, but a terrain model has one")
    if (dataset.units[0] or "m").lower() not in ("m", "metre", "meter", "metres", "meters"):
        raise WorldError(f"DEM {path} gives heights in {dataset.units[0]}, but metres are needed")

    if _THREE_AXES.search(dataset.crs.to_wkt(version="WKT2_2019")):
        raise WorldError(
            f"DEM {path} gives heights above the ellipsoid ({dataset.crs.to_string()[:60]}), which can be 100 m off: convert "
            "it to heights above mean sea level"
        )

    to_pixel = ~dataset.transform

    def pixel(north_m: float, east_m: float) -> tuple[float, float]:
        """Row and column, of pixel centres, of a place in the local frame."""
        lat, lon, _ = frame.geodetic(Ned(north_m, east_m, 0.0))
        xs, ys = transform("EPSG:4326", dataset.crs, [lon], [lat])
        column = to_pixel.a * xs[0] + to_pixel.b * ys[0] + to_pixel.c
        row = to_pixel.d * xs[0] + to_pixel.e * ys[0] + to_pixel.f
        return row - 0.5, column - 0.5

    origin = np.array(pixel(0.0, 0.0))
    if not np.isfinite(origin).all():
        raise WorldError(f"DEM {path} has a coordinate system that does not cover the origin")
    step_m = 10.0
    north = (np.array(pixel(step_m, 0.0)) - np.array(pixel(-step_m, 0.0))) / (2.0 * step_m)
    east = (np.array(pixel(0.0, step_m)) - np.array(pixel(0.0, -step_m))) / (2.0 * step_m)
    pixels_per_m = np.stack((north, east), axis=1)
    """(2, 2): rows and columns per metre north and east."""
    steps = np.linalg.inv(pixels_per_m)
    per_m = np.hypot(pixels_per_m[:, 0], pixels_per_m[:, 1])
    reach_m = min(REACH_M, math.sqrt(MOST_NODES / (4.0 * per_m[0] * per_m[1])))
    last = np.array([dataset.height, dataset.width]) - 1
    around_m = float((np.minimum(origin, last - origin) / per_m).min())
    if around_m < LEAST_M:
        reach = f"reaches only {around_m:.0f} m about" if around_m >= 0.0 else "does not cover"
        raise WorldError(f"DEM {path} {reach} the origin {frame.origin.lat_deg:.6f}, {frame.origin.lon_deg:.6f}")
    first = np.maximum(np.floor(origin - reach_m * per_m), 0).astype(int)
    end = np.minimum(np.ceil(origin + reach_m * per_m), last).astype(int) + 1
    window = Window(int(first[1]), int(first[0]), int(end[1] - first[1]), int(end[0] - first[0]))
    heights = _heights(dataset, path, window)
    corner = steps @ (first - origin)
    rows, columns = np.arange(heights.shape[0])[:, None], np.arange(heights.shape[1])[None, :]
    north_m = corner[0] + steps[0, 0] * rows + steps[0, 1] * columns
    east_m = corner[1] + steps[1, 0] * rows + steps[1, 1] * columns
    heights -= (north_m**2 + east_m**2) / (2.0 * _EARTH_M)
    return Terrain(
        heights,
        (float(corner[0]), float(corner[1])),
        ((float(steps[0, 0]), float(steps[0, 1])), (float(steps[1, 0]), float(steps[1, 1]))),
        sigma_m,
        frame.origin.amsl_m,
    )


_EARTH_M = 6_371_000.0
_THREE_AXES = re.compile(r"\bCS\[(ellipsoidal|cartesian),\s*3\b", re.IGNORECASE)
"""Of a coordinate system whose third axis is no height above sea level. Source: OGC 18-010r7 (WKT 2)."""


def _heights(dataset: Any, path: Path, window: Window) -> Floats:
    """The window's heights in metres; NaN where the DEM says that it has none."""
    band = dataset.read(1, window=window, masked=True)
    heights = np.ma.filled(band.astype(np.float64), np.nan)
    heights = np.asarray(heights * dataset.scales[0] + dataset.offsets[0], dtype=np.float64)
    wild = ~np.isnan(heights) & ((heights < -500.0) | (heights > 9000.0))
    if wild.any():
        value = float(heights[wild][0])
        raise WorldError(f"DEM {path} holds {value:g} m as a height, which is none: declare its nodata value")
    if np.isnan(heights).all():
        raise WorldError(f"DEM {path} has no heights about the origin")
    return heights


def load_obstacles(path: Path, frame: LocalFrame) -> Obstacles:
    """GeoJSON polygons with properties base_amsl_m and top_amsl_m (m), name if it has one. Raises WorldError."""
    names: list[str] = []
    polygons: list[shapely.Polygon] = []
    bases: list[float] = []
    tops: list[float] = []
    for number, (geometry, properties) in enumerate(_features(path)):
        name = str(properties.get("name") or f"obstacle {number + 1}")
        base, top = (_metres(path, name, properties, key) for key in ("base_amsl_m", "top_amsl_m"))
        for polygon in _polygons(path, name, geometry, frame):
            names.append(name)
            polygons.append(polygon)
            bases.append(base)
            tops.append(top)
    try:
        return Obstacles.of(names, polygons, bases, tops, frame.origin.amsl_m)
    except ValueError as error:
        raise WorldError(f"obstacles {path}: {error}") from None


def load_geofence(path: Path, source: GeofenceSource, frame: LocalFrame) -> Geofence:
    """One GeoJSON polygon, its holes being no-fly areas. Raises WorldError."""
    features = _features(path)
    polygons = [polygon for geometry, _ in features for polygon in _polygons(path, "the geofence", geometry, frame)]
    if len(polygons) != 1:
        raise WorldError(f"geofence {path} has {len(polygons)} polygons, but a geofence is one, with holes")
    try:
        return Geofence.of(polygons[0], source.floor_amsl_m, source.ceiling_amsl_m, frame.origin.amsl_m)
    except ValueError as error:
        raise WorldError(f"geofence {path}: {error}") from None


def _features(path: Path) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    """Geometry and properties of each feature of a GeoJSON file (RFC 7946: longitude, latitude)."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise WorldError(f"GeoJSON {path} cannot be read: {error.strerror or error}") from None
    except (json.JSONDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise WorldError(f"GeoJSON {path} is not valid JSON: {error}") from None
    if not isinstance(data, dict):
        raise WorldError(f"GeoJSON {path} is no GeoJSON object")
    if "crs" in data:
        raise WorldError(f"GeoJSON {path} names a coordinate system; remove it and give WGS-84 longitude, latitude")
    kind = data.get("type")
    if kind == "FeatureCollection":
        features = data.get("features")
    elif kind == "Feature":
        features = [data]
    else:
        features = [{"type": "Feature", "geometry": data, "properties": {}}]
    if not isinstance(features, list) or not all(
        isinstance(f, dict) and isinstance(f.get("geometry"), dict) for f in features
    ):
        raise WorldError(f"GeoJSON {path} has a feature without a geometry")
    return [(f["geometry"], f.get("properties") or {}) for f in features]


def _polygons(path: Path, name: str, geometry: dict[str, Any], frame: LocalFrame) -> list[shapely.Polygon]:
    """The geometry's polygons in local (north, east) metres."""
    if geometry.get("type") not in ("Polygon", "MultiPolygon"):
        raise WorldError(f"GeoJSON {path}: {name} is a {geometry.get('type')}, but a Polygon is needed")
    try:
        shape = shapely.from_geojson(json.dumps(geometry))
        lon_lat = shapely.get_coordinates(shape)
    except (shapely.errors.GEOSException, ValueError, TypeError):
        raise WorldError(f"GeoJSON {path}: {name} has coordinates that make no polygon") from None
    lon, lat = lon_lat[:, 0], lon_lat[:, 1]
    if not len(lon_lat) or not (np.abs(lat) <= 90.0).all() or not (np.abs(lon) <= 180.0).all():
        raise WorldError(f"GeoJSON {path}: {name} has coordinates that are no longitude, latitude in degrees")
    north_east = frame.ned_array(lat, lon, np.full(len(lat), frame.origin.amsl_m))[:, :2]
    far_m = float(np.hypot(north_east[:, 0], north_east[:, 1]).max())
    if far_m > FAR_M:
        raise WorldError(
            f"GeoJSON {path}: {name} is {far_m / 1000:.0f} km from the origin; it must be longitude, latitude of this place"
        )
    moved = shapely.set_coordinates(shape, north_east)
    parts = moved.geoms if isinstance(moved, shapely.MultiPolygon) else [moved]
    return [part for part in parts if isinstance(part, shapely.Polygon)]


def _metres(path: Path, name: str, properties: dict[str, Any], key: str) -> float:
    value = properties.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise WorldError(f"GeoJSON {path}: {name} needs the property {key}, a number of metres")
    return float(value)
