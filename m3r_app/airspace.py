"""The authority for airspace volumes, in process: what one laptop alone needs. Pure state, the clock is a parameter.

Grants carry rising fencing numbers and expire by themselves. Source: X10, R5, paper V (air leases), design "reserve".
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from safety.vocabulary import ReservedVolume
from safety.volumes import volumes_meet


@dataclass(frozen=True, slots=True)
class Grant:
    """A volume that is held, and its fencing number: a later grant has a higher one."""

    lease_id: str
    volume: ReservedVolume
    fence: int


class LocalAirspace:
    """Grants a volume unless somebody else holds one that meets it at the same time."""

    def __init__(self) -> None:
        self._grants: dict[str, Grant] = {}
        self._fence = 0

    def reserve(self, lease_id: str, volume: ReservedVolume, now_s: float) -> Grant | str:
        """The grant, or one sentence that says who is in the way."""
        self._expire(now_s)
        if not _is_whole(volume):
            return "the volume asked for is incomplete"
        for held in self._grants.values():
            if held.volume.holder != volume.holder and volumes_meet(held.volume, volume):
                return f"{held.volume.holder} holds it for another {held.volume.until_s - now_s:.1f} s"
        self._fence += 1
        grant = Grant(lease_id, volume, self._fence)
        self._grants[lease_id] = grant
        return grant

    def release(self, lease_id: str) -> None:
        """Give a volume back; an unknown one is none of ours any more."""
        self._grants.pop(lease_id, None)

    def held_by_others(self, holder: str, now_s: float) -> tuple[ReservedVolume, ...]:
        """The live volumes of everybody else."""
        self._expire(now_s)
        return tuple(g.volume for g in self._grants.values() if g.volume.holder != holder)

    def _expire(self, now_s: float) -> None:
        self._grants = {k: g for k, g in self._grants.items() if g.volume.until_s > now_s}


def _is_whole(volume: ReservedVolume) -> bool:
    """Whether it says where and when (X6): what is no number could neither be kept clear nor expire."""
    numbers = (volume.radius_m, volume.from_s, volume.until_s)
    return volume.start.finite and volume.end.finite and all(map(math.isfinite, numbers))
