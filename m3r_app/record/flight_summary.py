"""A flight record as a story: requests with what became of them, modes, tracks, margins. Pure; for the report.

A record is told as far as it goes: what is missing in it is missing in the story, never made up.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from m3r_app.output import (
    EVENT_TYPES,
    DecisionEvent,
    EndEvent,
    ModeEvent,
    MotionEvent,
    OutputEvent,
    RequestEvent,
    Told,
    known,
)
from m3r_app.output_schema import event_of

Place = tuple[float, float, float]
"""North, east, down, metres."""
EVENTS = frozenset(kind.name for kind in EVENT_TYPES)
TRACK_S = 0.1
"""Telemetry is thinned to this; a report is no replay."""


@dataclass
class Asked:
    """One request. decisions: in order, the last is final; motions: started, completed, aborted."""

    t_s: float
    id: str
    command: str
    modality: str
    confidence: float | None
    evidence: str
    latency_ms: float | None
    place: Place | None
    """Where the drone was."""
    confirmed: float | None = None
    """Confidence after a second modality confirmed it."""
    decisions: list[DecisionEvent] = field(default_factory=list)
    decided_s: list[float] = field(default_factory=list)
    """When each decision fell."""
    motions: list[MotionEvent] = field(default_factory=list)

    @property
    def verdict(self) -> str:
        """The final verdict; empty for what gets none (stop, activate, disconnect)."""
        return str(self.decisions[-1].verdict) if self.decisions else ""

    @property
    def outcome(self) -> str:
        return str(self.motions[-1].status) if self.motions else ""


@dataclass
class Track:
    """Where somebody was, thinned."""

    times_s: list[float] = field(default_factory=list)
    places: list[Place] = field(default_factory=list)
    speeds_m_s: list[float] = field(default_factory=list)


@dataclass
class Story:
    """The whole. Times in seconds since the start."""

    events: list[Told] = field(default_factory=list)
    """The machine-readable output."""
    requests: list[Asked] = field(default_factory=list)
    modes: list[tuple[float, str, str]] = field(default_factory=list)
    """When, mode, fine state."""
    track: Track = field(default_factory=Track)
    neighbours: dict[str, Track] = field(default_factory=dict)
    plans: list[tuple[float, list[Place]]] = field(default_factory=list)
    anchors: list[tuple[float, Place, float]] = field(default_factory=list)
    """When, where, radius of the workspace."""
    margins: dict[str, list[tuple[float, float | None]]] = field(default_factory=dict)
    static_scene: Mapping[str, Any] = field(default_factory=dict)
    """What stands still, as `m3r_app.environment.static_scene` made it."""
    gaps: int = 0
    """Messages that the record says it lacks."""

    @property
    def end(self) -> EndEvent | None:
        """The last event, if the run came to its end."""
        return next((told.event for told in reversed(self.events) if isinstance(told.event, EndEvent)), None)

    @property
    def length_s(self) -> float:
        """Up to the last thing that is known."""
        times = [told.t_s for told in self.events[-1:]] + self.track.times_s[-1:]
        return max(times, default=0.0)

    def latencies_ms(self) -> dict[str, list[float]]:
        """Of the requests, by modality, rising."""
        found: dict[str, list[float]] = {}
        for asked in self.requests:
            if asked.latency_ms is not None:
                found.setdefault(asked.modality, []).append(asked.latency_ms)
        return {modality: sorted(values) for modality, values in sorted(found.items())}

    def decided_m(self) -> dict[str, list[tuple[float, float, bool]]]:
        """(t_s, margin_m, passed) of every finding in metres of every decision, by constraint."""
        found: dict[str, list[tuple[float, float, bool]]] = {}
        for asked in self.requests:
            for t_s, decision in zip(asked.decided_s, asked.decisions, strict=True):
                for one in decision.findings:
                    if one.margin is not None and one.unit == "m":
                        found.setdefault(one.constraint, []).append((t_s, one.margin, one.passed))
        return found


def story_of(messages: Iterable[tuple[str, float, Mapping[str, Any]]]) -> Story:
    """The story of the messages of a record, (topic, t_s, data) in order."""
    story, by_id = Story(), dict[str, Asked]()
    for topic, t_s, data in messages:
        if topic in EVENTS:
            event = known(event_of(topic, data))
            story.events.append(Told(t_s, event))
            _take(story, by_id, t_s, event)
        match topic:
            case "stage":
                story.static_scene = data
            case "telemetry":
                _follow(story.track, t_s, data.get("position"), data.get("velocity"))
            case "neighbours":
                heard = data["neighbours"]
                for name, where, velocity in zip(
                    heard["names"], heard["positions_ned_m"], heard["velocities_ned_m_s"], strict=True
                ):
                    _follow(story.neighbours.setdefault(str(name), Track()), t_s, where, velocity)
            case "plan":
                points = [place for p in data["points_ned_m"] if (place := place_of(p)) is not None]
                story.plans.append((t_s, points))
            case "anchor":
                anchor, radius_m = place_of(data.get("position")), number(data.get("radius_m"))
                if anchor is not None and radius_m is not None:
                    story.anchors.append((t_s, anchor, radius_m))
            case "margins":
                for name, value in data["margins"].items():
                    story.margins.setdefault(str(name), []).append((t_s, number(value)))
            case "record_gap":
                story.gaps += int(data["dropped"])
    return story


def _take(story: Story, by_id: dict[str, Asked], t_s: float, event: OutputEvent) -> None:
    match event:
        case RequestEvent() if event.id in by_id:
            by_id[event.id].confirmed = event.confidence
        case RequestEvent():
            place = story.track.places[-1] if story.track.places else None
            asked = Asked(
                t_s, event.id, event.command, event.modality, event.confidence, event.evidence, event.latency_ms, place
            )
            by_id[asked.id] = asked
            story.requests.append(asked)
        case DecisionEvent() if event.request in by_id:
            by_id[event.request].decided_s.append(t_s)
            by_id[event.request].decisions.append(event)
        case MotionEvent() if event.request in by_id:
            by_id[event.request].motions.append(event)
        case ModeEvent():
            story.modes.append((t_s, event.mode, event.state))


def number(value: object) -> float | None:
    """A finite number, or None."""
    return float(value) if isinstance(value, (int, float)) and math.isfinite(value) else None


def place_of(value: object) -> Place | None:
    """Three finite numbers, or None."""
    if not isinstance(value, (list, tuple)) or len(value) != 3:
        return None
    north, east, down = (number(one) for one in value)
    return None if north is None or east is None or down is None else (north, east, down)


def _follow(track: Track, t_s: float, where: object, velocity: object) -> None:
    if track.times_s and t_s - track.times_s[-1] < TRACK_S:
        return
    place, speed = place_of(where), place_of(velocity)
    if place is not None:
        track.times_s.append(t_s)
        track.places.append(place)
        track.speeds_m_s.append(math.hypot(*speed) if speed is not None else math.nan)
