"""Copies of recorded messages in Foxglove's well-known schemas (JSON encoding), for maps, 3D scenes and logs. Pure.

Frames: "local" is east, north, up (m) about the session's origin; each drone has a frame of its own, x forward.
Source: Foxglove's message schema reference (LocationFix, FrameTransform, PoseInFrame, Log; the scene is in `foxglove_scene`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

LOCAL = "local"
INFO, WARNING, ERROR = 2, 3, 4


@dataclass(frozen=True)
class View:
    """One message in a schema of `SCHEMAS`."""

    topic: str
    schema: str
    message: dict[str, Any]


def views(topic: str, data: Mapping[str, Any], log_ns: int) -> list[View]:
    """The views of one recorded message (as `plain` made it); none where there is nothing to see."""
    stamp = {"sec": log_ns // 1_000_000_000, "nsec": log_ns % 1_000_000_000}
    match topic:
        case "telemetry":
            return _telemetry(data, stamp)
        case "setpoint":
            return _setpoint(data, stamp)
        case "announce":
            return [_log(INFO, str(data.get("text", "")), stamp)]
        case "mode":
            return [_log(INFO, f"{data.get('mode')} ({data.get('cause')})", stamp)]
        case "violation":
            return [_log(ERROR, f"{data.get('kind')} violation of {_words(data.get('requirements'))}", stamp)]
        case "record_gap":
            return [_log(WARNING, f"{data.get('dropped')} messages are missing here", stamp)]
    return []


def _telemetry(data: Mapping[str, Any], stamp: dict[str, int]) -> list[View]:
    name = str(data.get("vehicle", "drone"))
    found = []
    place: Any = data.get("geodetic")
    if numbers(place, 3):
        variance_h, variance_v = (_square(data.get(key)) for key in ("sigma_h_m", "sigma_v_m"))
        known = variance_h is not None and variance_v is not None
        fix = {
            "timestamp": stamp,
            "frame_id": name,
            "latitude": place[0],
            "longitude": place[1],
            "altitude": place[2],
            "position_covariance": [variance_h, 0, 0, 0, variance_h, 0, 0, 0, variance_v] if known else [0] * 9,
            "position_covariance_type": 2 if known else 0,
        }
        found.append(View(f"{name}/fix", "foxglove.LocationFix", fix))
    if numbers(data.get("position"), 3) and numbers([data.get("yaw_deg")], 1):
        frame = {
            "timestamp": stamp,
            "parent_frame_id": LOCAL,
            "child_frame_id": name,
            "translation": enu(data["position"]),
            "rotation": heading(data["yaw_deg"]),
        }
        found.append(View(f"{name}/frame", "foxglove.FrameTransform", frame))
    return found


def _setpoint(data: Mapping[str, Any], stamp: dict[str, int]) -> list[View]:
    if not (numbers(data.get("position"), 3) and numbers([data.get("yaw_deg")], 1)):
        return []
    pose = {"position": enu(data["position"]), "orientation": heading(data["yaw_deg"])}
    return [View("setpoint", "foxglove.PoseInFrame", {"timestamp": stamp, "frame_id": LOCAL, "pose": pose})]


def _log(level: int, text: str, stamp: dict[str, int]) -> View:
    message = {"timestamp": stamp, "level": level, "message": text, "name": "m3r", "file": "", "line": 0}
    return View("log", "foxglove.Log", message)


def _words(items: object) -> str:
    return ", ".join(map(str, items)) if isinstance(items, list) and items else "an unnamed limit"


def numbers(value: object, count: int) -> bool:
    return (
        isinstance(value, (list, tuple))
        and len(value) == count
        and all(isinstance(item, (int, float)) and math.isfinite(item) for item in value)
    )


def _square(value: object) -> float | None:
    return float(value) ** 2 if isinstance(value, (int, float)) and math.isfinite(value) else None


def xyz(x: float, y: float, z: float) -> dict[str, float]:
    return {"x": x, "y": y, "z": z}


def enu(ned: Sequence[float]) -> dict[str, float]:
    return xyz(ned[1], ned[0], -ned[2])


def heading(yaw_deg: float) -> dict[str, float]:
    """The rotation about up that turns x (east) to the compass heading."""
    half = math.radians(90.0 - yaw_deg) / 2.0
    return {"x": 0.0, "y": 0.0, "z": math.sin(half), "w": math.cos(half)}
