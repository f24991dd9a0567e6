"""Makes the hillside scenario's DEM, obstacles and geofence: `python config/scenarios/make_hillside.py`.

The place is invented: a meadow that rises into a hillside to the north, a wall to the east, a no-fly area to the west.
Everything comes from the formulas below and one seed, so that the files can be made again at any time.
"""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import rasterio
from rasterio.transform import from_origin
from rasterio.warp import transform

from safety.frames import LocalFrame
from safety.vocabulary import Floats, Geodetic, Ned

HERE = Path(__file__).resolve().parent
ORIGIN = Geodetic(46.6790, 7.8630, 580.0)
"""Where the operator stands."""
UTM = "EPSG:32632"
REACH_M = 200.0
CELL_M = 1.0
SEED = 7

WALL_NE_M = ((9.0, 5.0), (26.0, 5.0), (26.0, 5.6), (9.0, 5.6))
WALL_TOP_M = 9.0
"""Above the origin; it stands on the meadow and against the slope."""
BARN_NE_M = ((-20.0, 22.0), (-20.0, 32.0), (-12.0, 32.0), (-12.0, 22.0))
BARN_TOP_M = 7.0
FENCE_NE_M = ((-60.0, -80.0), (-60.0, 80.0), (120.0, 80.0), (120.0, -80.0))
NO_FLY_NE_M = ((9.0, -20.0), (9.0, -6.5), (30.0, -6.5), (30.0, -20.0))


def ground_m(north_m: Floats, east_m: Floats) -> Floats:
    """Height of the ground over the origin: a meadow, from 13 m north on a slope that rises to 60 m."""
    along = np.clip((north_m - 13.0 - 0.05 * np.abs(east_m)) / 90.0, 0.0, None)
    hill = 60.0 * (1.0 - np.exp(-(along**1.25) * 1.4))
    meadow = 0.25 * np.sin(north_m / 23.0) * np.cos(east_m / 31.0)
    spur = 4.0 * np.exp(-(((north_m - 45.0) / 18.0) ** 2 + ((east_m + 12.0) / 14.0) ** 2))
    return np.asarray(hill + meadow + spur)


def make_dem(path: Path) -> None:
    """Write the DEM: UTM, 1 m cells, float32 in steps of 1/64 m, deflate."""
    frame = LocalFrame(ORIGIN)
    (x0,), (y0,) = transform("EPSG:4326", UTM, [ORIGIN.lon_deg], [ORIGIN.lat_deg])
    west, north = math.floor(x0 - REACH_M), math.ceil(y0 + REACH_M)
    count = round(2.0 * REACH_M / CELL_M)
    columns, rows = np.meshgrid(np.arange(count) + 0.5, np.arange(count) + 0.5)
    lon, lat = transform(UTM, "EPSG:4326", (west + columns * CELL_M).ravel(), (north - rows * CELL_M).ravel())
    ned = frame.ned_array(np.array(lat), np.array(lon), np.full(count * count, ORIGIN.amsl_m))
    rough = np.random.default_rng(SEED).normal(0.0, 0.02, count * count)
    heights = ORIGIN.amsl_m + ground_m(ned[:, 0], ned[:, 1]) + rough
    profile = {
        "driver": "GTiff", "dtype": "float32", "count": 1, "width": count, "height": count, "crs": UTM,
        "transform": from_origin(west, north, CELL_M, CELL_M), "nodata": -9999.0,
        "compress": "deflate", "predictor": 3, "zlevel": 9, "tiled": True, "blockxsize": 256, "blockysize": 256,
    }  # fmt: skip
    with rasterio.open(path, "w", **profile) as dataset:
        # Sixty-fourths of a metre pack well, and are a sixth of the stated error.
        dataset.write((np.round(heights.reshape(count, count) * 64.0) / 64.0).astype(np.float32), 1)
        dataset.units = ("m",)
        dataset.update_tags(1, description="invented hillside, metres above mean sea level")


def ring(corners_ne_m: tuple[tuple[float, float], ...]) -> list[list[float]]:
    """A closed GeoJSON ring (longitude, latitude)."""
    frame = LocalFrame(ORIGIN)
    places = [frame.geodetic(Ned(north, east, 0.0)) for north, east in (*corners_ne_m, corners_ne_m[0])]
    return [[round(place.lon_deg, 8), round(place.lat_deg, 8)] for place in places]


def feature(rings: list[list[list[float]]], **properties: object) -> dict[str, object]:
    return {"type": "Feature", "properties": properties, "geometry": {"type": "Polygon", "coordinates": rings}}


def write(path: Path, *features: dict[str, object]) -> None:
    path.write_text(json.dumps({"type": "FeatureCollection", "features": list(features)}, indent=1) + "\n")


def main(folder: Path = HERE) -> None:
    """Make all three files."""
    ground = ORIGIN.amsl_m
    make_dem(folder / "hillside.tif")
    write(
        folder / "hillside_obstacles.geojson",
        feature([ring(WALL_NE_M)], name="the wall", base_amsl_m=ground - 2.0, top_amsl_m=ground + WALL_TOP_M),
        feature([ring(BARN_NE_M)], name="the barn", base_amsl_m=ground - 2.0, top_amsl_m=ground + BARN_TOP_M),
    )
    write(
        folder / "hillside_fence.geojson", feature([ring(FENCE_NE_M), ring(NO_FLY_NE_M)], name="geofence, no-fly hole")
    )


if __name__ == "__main__":
    main()
