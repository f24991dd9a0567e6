"""A record's messages as the judge's data. What is missing stays missing: the judge says so.

Neither the recorder nor what it recorded is known here, only how the record is written (docs/design.md, plain JSON).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import fields, replace
from enum import Enum
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
import shapely

from config.settings import Settings
from m3r_app.evidence.flight import (
    TOGETHER_S,
    Asked,
    Decided,
    Fence,
    Flight,
    Grid,
    Ground,
    Moved,
    Planned,
    Prism,
    Stretch,
)
from safety.limits import Limits
from safety.vocabulary import (
    FlightMode,
    Geodetic,
    Ned,
    Neighbours,
    Operator,
    Plan,
    Primitive,
    Profile,
    ReservedVolume,
    VehicleState,
)

Member = TypeVar("Member", bound=Enum)
Data = Mapping[str, Any]
Message = tuple[str, float, Data]


class EvidenceError(ValueError):
    """A record that cannot be judged; one sentence."""


def flight_of(metadata: Data, messages: Iterable[Message], *, closed: bool) -> Flight:
    """The flight that a record tells. closed: the file was finished in order.

    Raises EvidenceError where it holds what no m3r writes.
    """
    try:
        return _flight(metadata, list(messages), closed=closed)
    except (AttributeError, KeyError, IndexError, TypeError, ValueError) as error:
        raise EvidenceError(f"it holds what no m3r writes ({error!r}): is it a flight record?") from None


def _flight(metadata: Data, messages: list[Message], *, closed: bool) -> Flight:
    by_topic: dict[str, list[tuple[float, Data]]] = {}
    for topic, t_s, data in messages:
        by_topic.setdefault(topic, []).append((t_s, data))

    def told(topic: str) -> list[tuple[float, Data]]:
        return by_topic.get(topic, [])

    started_s = _started_s(metadata, told("telemetry"))
    anchors = tuple((t_s, Ned(*data["position"])) for t_s, data in told("anchor") if data["position"] is not None)
    operator = metadata.get("operator")
    return Flight(
        _limits(metadata),
        _ground(told("world")[-1][1] if told("world") else metadata["world"]),
        Geodetic(*map(float, metadata["origin"])) if metadata.get("origin") else None,
        Operator(Ned(*operator["position"]), operator["sigma_m"]) if operator else None,
        tuple((t_s, _vehicle(data, started_s)) for t_s, data in told("telemetry")),
        tuple((t_s, _neighbours(data["neighbours"], started_s)) for t_s, data in told("neighbours")),
        tuple((t_s, _volumes(data["volumes"], started_s)) for t_s, data in told("reservations")),
        anchors,
        _ours(told("pair"), anchors, told("noise")),
        tuple(
            Planned(t_s, _plan(data["plan"]) if isinstance(data.get("plan"), dict) else None)
            for t_s, data in told("plan")
        ),
        _requests(told("request")),
        tuple(Decided(t_s, d["request"], d["verdict"], d["granted_m"]) for t_s, d in told("decision")),
        tuple(Moved(t_s, data["request"], data["status"]) for t_s, data in told("motion")),
        sum(data["dropped"] for _, data in told("record_gap")),
        closed and bool(told("end")),
    )


def _started_s(metadata: Data, telemetry: list[tuple[float, Data]]) -> float:
    """The app's clock at the record's zero: told, or as near as the freshest telemetry shows it."""
    if "started_s" in metadata:
        return float(metadata["started_s"])
    return max((data["at_s"] - t_s for t_s, data in telemetry), default=0.0)


def _limits(metadata: Data) -> Limits:
    if isinstance(metadata.get("limits"), dict):
        return Limits(**metadata["limits"])
    return Settings.model_validate(metadata["settings"]).limits()


def _ground(world: Data) -> Ground:
    terrain, obstacles, fence = world["terrain"], world["obstacles"], world["geofence"]
    origins = [part["origin_amsl_m"] for part in (terrain, obstacles, fence) if part is not None]
    names = obstacles["names"]
    polygons = _polygons(obstacles["polygons"])
    if not len(names) == len(polygons) == len(obstacles["bases_amsl_m"]) == len(obstacles["tops_amsl_m"]):
        raise ValueError("obstacles without a shape")
    return Ground(
        float(origins[0]),
        _grid(terrain),
        tuple(map(Prism, names, polygons, obstacles["bases_amsl_m"], obstacles["tops_amsl_m"])),
        None
        if fence is None
        else Fence(_polygons(fence["polygon"])[0], fence["floor_amsl_m"], fence["ceiling_amsl_m"]),
    )


def _grid(terrain: Data | None) -> Grid | None:
    """None too where a large model is told by its digest only: then nothing about the ground can be judged."""
    if terrain is None or isinstance(terrain["heights_amsl_m"], dict):
        return None
    return Grid(
        np.array(terrain["heights_amsl_m"], dtype=np.float64),
        np.array(terrain["corner_ne_m"], dtype=np.float64),
        np.array(terrain["steps_ne_m"], dtype=np.float64),
        float(terrain["sigma_m"]),
    )


def _polygons(told: Data) -> list[Any]:
    """Each polygon's edges are consecutive; its rings are where an edge closes what the first of them began."""
    edges = np.array(told["edges"], dtype=np.float64).reshape(4, -1).T
    firsts = [*told["firsts"], len(edges)]
    found = []
    for first, last in pairwise(firsts):
        rings: list[list[tuple[float, float]]] = [[]]
        for north, east, end_north, end_east in edges[first:last].tolist():
            rings[-1].append((north, east))
            if (end_north, end_east) == rings[-1][0]:
                rings.append([])
        if rings.pop():
            raise ValueError("a polygon that is not closed")
        found.append(shapely.Polygon(rings[0], rings[1:]))
    return found


def _vehicle(data: Data, started_s: float) -> VehicleState:
    known = {field.name: data[field.name] for field in fields(VehicleState) if field.name in data}
    for name in ("position", "velocity", "disagreement"):
        if name in known:
            known[name] = Ned(*known[name])
    known["flight_mode"] = _member(FlightMode, known.get("flight_mode", "UNKNOWN"))
    return replace(VehicleState(**known), at_s=data["at_s"] - started_s)


def _neighbours(data: Data, started_s: float) -> Neighbours:
    return Neighbours(
        tuple(data["names"]),
        np.array(data["positions_ned_m"], dtype=np.float64).reshape(-1, 3),
        np.array(data["velocities_ned_m_s"], dtype=np.float64).reshape(-1, 3),
        np.array(data["sigmas_m"], dtype=np.float64),
        np.array(data["at_s"], dtype=np.float64) - started_s,
        data["feed_at_s"] - started_s,
    )


def _volumes(data: list[Data], started_s: float) -> tuple[ReservedVolume, ...]:
    return tuple(
        ReservedVolume(
            v["holder"],
            Ned(*v["start"]),
            Ned(*v["end"]),
            v["radius_m"],
            v["from_s"] - started_s,
            v["until_s"] - started_s,
        )
        for v in data
    )


def _plan(data: Data) -> Plan:
    profiles = {
        name: Profile(*(float(data[name][key]) for key in ("distance", "speed", "acceleration")))
        for name in ("move", "turn")
    }
    return Plan(
        _member(Primitive, data["primitive"]),
        Ned(*data["start"]),
        Ned(*data["direction"]),
        profiles["move"],
        float(data["start_yaw_deg"]),
        float(data["turn_deg"]),
        profiles["turn"],
        bool(data["face_first"]),
        float(data["max_duration_s"]),
        float(data["stop_m"]),
    )


def _member(kind: type[Member], told: str) -> Member:
    """By its name, as the steps tell it, or by its value."""
    found = kind.__members__.get(told)
    return found if found is not None else kind(told)


def _requests(told: list[tuple[float, Data]]) -> tuple[Asked, ...]:
    """As they were first understood: a confirmation by a second modality never lifts what alone would be refused."""
    found: dict[str, Asked] = {}
    for t_s, data in told:
        confidence = data["confidence"] if data["confidence"] is not None else math.nan
        found.setdefault(data["id"], Asked(t_s, data["id"], data["command"], data["modality"], confidence))
    return tuple(found.values())


def _ours(
    pairs: list[tuple[float, Data]], anchors: tuple[tuple[float, Ned], ...], noises: list[tuple[float, Data]]
) -> tuple[Stretch, ...]:
    """From a confirmed pairing to the release; the session is about the place of its first anchor."""
    found: list[Stretch] = []
    open_s: float | None = None
    for t_s, data in [*pairs, (math.inf, {"status": "released"})]:
        if data["status"] == "confirmed":
            open_s = t_s
        elif data["status"] == "released" and open_s is not None:
            centre = next((place for at_s, place in anchors if open_s <= at_s <= t_s), None)
            # Told with the confirmation, in the same step.
            noise = next((data for at_s, data in noises if abs(at_s - open_s) <= TOGETHER_S), {})
            wider = noise.get("noise_m", 0.0), noise.get("wider_m", 0.0)
            found.append(Stretch(open_s, t_s, centre, *wider))
            open_s = None
    return tuple(found)
