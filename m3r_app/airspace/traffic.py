"""Neighbours from the states that others publish, each checked here: fresh, its clock near ours, plausible, and one
aircraft per name.

A state that is authentic but not plausible makes the drone's place unknown (NaN): it is somewhere, so moves are refused
until its states are plausible again. No message can remove an aircraft. Source: R5, R11, X6, design 10.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from m3r_app.airspace.messages import State
from m3r_app.airspace.topics import cell_of
from safety.frames import LocalFrame
from safety.vocabulary import Geodetic, Ned, Neighbours

TRANSIT_S = 0.05
"""By how much clocks that agree may differ, and what a message takes at least."""
SPEED_MAX_M_S = 60.0
ACCELERATION_M_S2 = 20.0
JUMP_M = 5.0
DOUBT_S = 3.0
"""What was implausible stays in doubt for so long."""
FORGET_S = 120.0
"""Of whom nothing was heard for so long is not counted any more, which is said."""
TRACKS_MAX = 512
UNKNOWN = Ned(math.nan, math.nan, math.nan)


@dataclass(frozen=True, slots=True)
class Track:
    """What is known of one drone. at_s: our clock, when it was there; early_s: how far ahead its clock has been seen."""

    place: Geodetic | None
    velocity: Ned
    sigma_m: float
    at_s: float
    heard_at_s: float
    life: str
    early_s: float = 0.0
    doubted_until_s: float = -math.inf


class RemoteTraffic:
    """The drones heard of. Bounded: more than TRACKS_MAX, and one that is nowhere stands for all that were not kept."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._tracks: dict[str, Track] = {}
        self._say = say
        self._overfull_at_s = -math.inf

    def __len__(self) -> int:
        return len(self._tracks)

    def heard(self, drone: str, life: str, state: State, early_s: float, now_s: float) -> None:
        """An authentic state, early_s ahead of our wall clock, at now_s."""
        last = self._tracks.get(drone)
        if last is None and len(self._tracks) >= TRACKS_MAX:
            self._overfull_at_s = now_s
            return
        same = last is not None and last.life == life
        ahead_s = max(early_s, 0.0, last.early_s if last is not None and same else 0.0)
        age_s = state.age_s + TRANSIT_S + max(0.0, ahead_s - early_s)
        new = Track(state.place.geodetic, state.velocity.ned, state.sigma_m, now_s - age_s, now_s, life, ahead_s)
        if last is None:
            self._tracks[drone] = self._doubted(drone, new, _too_fast(new), now_s)
            return
        doubt = _too_fast(new) or _jump(last, new)
        if new.at_s < last.at_s and (same or doubt is None):
            return  # overtaken on the way: on another topic, or by somebody else who tells of it
        self._tracks[drone] = self._doubted(drone, replace(new, doubted_until_s=last.doubted_until_s), doubt, now_s)

    def doubt(self, drone: str, why: str, now_s: float) -> None:
        """Something authentic of this drone could not be used: it is somewhere, but nobody knows where."""
        last = self._tracks.get(drone)
        if last is None:
            if len(self._tracks) >= TRACKS_MAX:
                self._overfull_at_s = now_s
                return
            last = Track(None, UNKNOWN, math.nan, -math.inf, now_s, "")
        self._tracks[drone] = self._doubted(drone, replace(last, heard_at_s=now_s), why, now_s)

    def _doubted(self, drone: str, track: Track, why: str | None, now_s: float) -> Track:
        if why is None:
            return track
        if track.doubted_until_s <= now_s:
            self._say(f"{drone.capitalize()} is not to be relied on: {why}")
        return replace(track, doubted_until_s=now_s + DOUBT_S)

    def neighbours(
        self,
        frame: LocalFrame,
        cells: frozenset[str],
        linked: Mapping[str, tuple[Geodetic | None, float]],
        feed_at_s: float,
        now_s: float,
    ) -> Neighbours:
        """Everybody who may be near. cells: those listened to; linked: place and age of drones that we see by ourselves."""
        self._forget(cells, now_s)
        shown = [
            (name, track)
            for drone, track in self._tracks.items()
            if (name := _name(drone, track, linked.get(drone), now_s)) is not None
        ]
        names = [name for name, _ in shown]
        places = [_place(track, frame, now_s) for _, track in shown]
        if now_s - self._overfull_at_s <= FORGET_S:
            names.append("somebody else (there are too many)")
            places.append(UNKNOWN)
        spare = len(places) - len(shown)
        return Neighbours(
            tuple(names),
            np.array(places, dtype=np.float64).reshape(-1, 3),
            np.array([*(t.velocity for _, t in shown), *[UNKNOWN] * spare], dtype=np.float64).reshape(-1, 3),
            np.array([*(t.sigma_m for _, t in shown), *[math.nan] * spare], dtype=np.float64),
            np.array([*(t.at_s for _, t in shown), *[-math.inf] * spare], dtype=np.float64),
            min(feed_at_s, now_s),
        )

    def _forget(self, cells: frozenset[str], now_s: float) -> None:
        """Who has told that they are elsewhere now, and who has been silent for long."""
        for drone, track in list(self._tracks.items()):
            gone = track.place is not None and track.doubted_until_s <= now_s and cell_of(track.place) not in cells
            if gone:
                del self._tracks[drone]
            elif now_s - track.heard_at_s > FORGET_S:
                del self._tracks[drone]
                self._say(
                    f"{drone.capitalize()} was not heard of for {FORGET_S:.0f} s and is not counted any more: look for it"
                )


def _name(drone: str, track: Track, seen: tuple[Geodetic | None, float] | None, now_s: float) -> str | None:
    """None: it is one that we see by ourselves. Another aircraft of that name is not."""
    if seen is None:
        return drone
    place, age_s = seen
    if place is None or track.place is None:
        return None if track.place is None else f"another {drone}"
    allowed_m = JUMP_M + 3.0 * track.sigma_m + SPEED_MAX_M_S * (max(0.0, age_s) + max(0.0, now_s - track.at_s))
    return None if _apart_m(place, track.place) <= allowed_m else f"another {drone}"


def _place(track: Track, frame: LocalFrame, now_s: float) -> Ned:
    if track.place is None or track.doubted_until_s > now_s:
        return UNKNOWN
    return frame.ned(track.place)


def _too_fast(track: Track) -> str | None:
    speed_m_s = track.velocity.norm
    return None if speed_m_s <= SPEED_MAX_M_S else f"it says that it flies {speed_m_s:.0f} m/s"


def _jump(last: Track, new: Track) -> str | None:
    """Whether it cannot have come from there to here. Twins with one name do nothing else."""
    if last.place is None or new.place is None:
        return None
    dt_s = max(0.0, new.at_s - last.at_s)
    expected = (
        LocalFrame(last.place)
        .ned(new.place)
        .minus(Ned(*(0.5 * dt_s * (v + w) for v, w in zip(last.velocity, new.velocity, strict=True))))
    )
    reach_m = min(0.5 * ACCELERATION_M_S2 * dt_s**2, 2.0 * SPEED_MAX_M_S * dt_s)
    allowed_m = JUMP_M + 3.0 * (last.sigma_m + new.sigma_m) + reach_m
    if expected.norm <= allowed_m:
        return None
    if last.life != new.life:
        return f"two aircraft {expected.norm:.0f} m apart call themselves so"
    return f"it jumped by {expected.norm:.0f} m"


def _apart_m(a: Geodetic, b: Geodetic) -> float:
    return LocalFrame(a).ned(b).norm
