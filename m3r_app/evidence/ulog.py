"""What a ULog of PX4 tells of where the drone was, in the record's frame."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pymap3d

from m3r_app.evidence.witness import Track
from safety.vocabulary import Geodetic

ESTIMATE, TRUTH = "vehicle_local_position", "vehicle_local_position_groundtruth"


class ULogError(ValueError):
    """A log that cannot be read; one sentence that names the file."""


def read_tracks(path: Path, origin: Geodetic) -> tuple[Track, ...]:
    """The autopilot's own estimate, and of a simulation the ground truth. Raises ULogError."""
    from pyulog import ULog  # only for who has such a log
    from pyulog.core import ULogException

    if not path.is_file():
        raise ULogError(f"{path} is no file: name a log of PX4 (ULog)")
    try:
        log = ULog(str(path), [ESTIMATE, TRUTH])
    except (ULogException, TypeError, ValueError, KeyError, IndexError, OSError) as error:
        raise ULogError(f"{path} cannot be read as a log of PX4 (ULog): {error}") from None
    tracks = (_track(one.name, one.data, origin) for one in log.data_list if one.multi_id == 0)
    return tuple(track for track in tracks if track is not None)


def _track(name: str, data: Mapping[str, Any], origin: Geodetic) -> Track | None:
    """None: it never told where its own frame lies."""
    needed = ("timestamp", "x", "y", "z", "ref_lat", "ref_lon", "ref_alt")
    if any(field not in data for field in needed):
        return None
    columns = np.column_stack([np.asarray(data[field], dtype=np.float64) for field in needed])
    told = np.isfinite(columns).all(axis=1)
    if "xy_global" in data:
        told &= np.asarray(data["xy_global"], dtype=bool) & np.asarray(data["z_global"], dtype=bool)
    columns = columns[told]
    if not len(columns):
        return None
    place = pymap3d.ned2geodetic(*columns[:, 1:4].T, *columns[:, 4:].T)
    ned = np.column_stack(pymap3d.geodetic2ned(*place, *origin))
    return Track(name, columns[:, 0] * 1e-6, ned, truth=name == TRUTH)
