"""The authority for claims and volumes of one area: pure, the clock a parameter, the same in process and over a broker.

A grant carries a rising fencing number and expires by itself; what is not surely free is refused. One drone has one operator,
and one app of that operator. Source: P1, X8, X10, R5; paper III-A, V; design "reserve".
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from safety.vocabulary import ReservedVolume
from safety.volumes import volumes_meet

CLAIM_S = 5.0
"""A claim that is not renewed for this long is over."""
WANTED_S = 30.0
"""An operator who was refused stays first in line for this long after asking."""
LEASES_MAX = 256
CLAIMS_MAX = 256


class App(NamedTuple):
    """Who asks. operator: the verified signer; inbox: the instance of the app, which others may learn and which alone proves nothing."""

    operator: str
    inbox: str


@dataclass(frozen=True, slots=True)
class HeldBy:
    """A claim."""

    app: App
    fence: int
    until_s: float

    @property
    def operator(self) -> str:
        return self.app.operator


@dataclass(frozen=True, slots=True)
class Waiting:
    """The operator who was last refused a drone and is first in line once it is free."""

    operator: str
    until_s: float


@dataclass(frozen=True, slots=True)
class Volume:
    """A lease. fence: of this grant."""

    drone: str
    app: App
    volume: ReservedVolume
    fence: int


@dataclass(frozen=True, slots=True)
class Verdict:
    """fence and lasts_s: of the grant. reason: one sentence, if not granted."""

    granted: bool
    fence: int = 0
    lasts_s: float = 0.0
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Authority:
    """Everything it knows. fence: the highest number given out."""

    fence: int = 0
    claims: Mapping[str, HeldBy] = field(default_factory=dict)
    waiting: Mapping[str, Waiting] = field(default_factory=dict)
    volumes: Mapping[str, Volume] = field(default_factory=dict)


def no(reason: str) -> Verdict:
    return Verdict(granted=False, reason=reason)


def claim(a: Authority, drone: str, app: App, fence: int | None, now_s: float) -> tuple[Authority, Verdict]:
    """A drone for an operator's app: new, or renewed. fence: of the claim that the app believes to hold."""
    a, operator = _expired(a, now_s), app.operator
    held, waits = a.claims.get(drone), a.waiting.get(drone)
    if held is not None and held.app != app:
        waiting = waits or Waiting(operator, now_s + WANTED_S)
        if waiting.operator == operator:
            waiting = Waiting(operator, now_s + WANTED_S)
        a = replace(a, waiting={**a.waiting, drone: waiting})
        whose = f"another app of {operator}" if held.operator == operator else held.operator
        return a, no(f"{whose} holds it")
    if held is not None:
        held = replace(held, until_s=now_s + CLAIM_S)
        return replace(a, claims={**a.claims, drone: held}), Verdict(True, held.fence, CLAIM_S)
    if fence is not None:
        return a, no("the claim was not renewed in time and has run out")
    if waits is not None and waits.operator != operator:
        return a, no(f"{waits.operator} has asked for it before and comes first")
    if len(a.claims) >= CLAIMS_MAX:
        return a, no(f"this area has {CLAIMS_MAX} drones claimed and takes no more")
    number = a.fence + 1
    new = HeldBy(app, number, now_s + CLAIM_S)
    waiting_now = {d: w for d, w in a.waiting.items() if d != drone}
    return replace(a, fence=number, claims={**a.claims, drone: new}, waiting=waiting_now), Verdict(
        True, number, CLAIM_S
    )


def give_up(a: Authority, drone: str, app: App, now_s: float) -> tuple[Authority, Verdict]:
    """The holder releases it, with every volume held for it. Whoever waits is first in line from now on."""
    a = _expired(a, now_s)
    held = a.claims.get(drone)
    if held is None or held.app != app:
        return a, no("it is not held by this app")
    claims = {d: c for d, c in a.claims.items() if d != drone}
    volumes = {k: v for k, v in a.volumes.items() if v.drone != drone}
    return replace(a, claims=claims, volumes=volumes), Verdict(True, held.fence)


def reserve(
    a: Authority, drone: str, app: App, fence: int, lease: str, volume: ReservedVolume, now_s: float
) -> tuple[Authority, Verdict]:
    """The volume for a maneuver of a claimed drone, unless it intersects one that another drone holds."""
    a = _expired(a, now_s)
    held = a.claims.get(drone)
    if held is None or held.app != app or held.fence != fence:
        return a, no(f"{drone} is not claimed by this app" if held is None else f"{held.operator} holds {drone}")
    if not _is_whole(volume):
        return a, no("the volume asked for is incomplete")
    known = a.volumes.get(lease)
    if known is not None and known.drone != drone:
        return a, no("a lease of that name is another drone's")
    for other in a.volumes.values():
        if other.drone != drone and volumes_meet(other.volume, volume):
            return a, no(f"{other.drone} holds it for another {other.volume.until_s - now_s:.1f} s")
    if len(a.volumes) >= LEASES_MAX:
        return a, no(f"this area has {LEASES_MAX} volumes reserved and takes no more")
    number = a.fence + 1
    new = Volume(drone, app, replace(volume, holder=drone), number)
    return replace(a, fence=number, volumes={**a.volumes, lease: new}), Verdict(True, number, volume.until_s - now_s)


def free(a: Authority, drone: str, app: App, lease: str, now_s: float) -> tuple[Authority, Verdict]:
    """Give a volume back; an unknown one is given back already."""
    a = _expired(a, now_s)
    known = a.volumes.get(lease)
    if known is not None and (known.drone, known.app) != (drone, app):
        return a, no("it is held by another app")
    return replace(a, volumes={k: v for k, v in a.volumes.items() if k != lease}), Verdict(True)


def resumed(a: Authority, away_s: float) -> Authority:
    """After the authority could not be reached for away_s: nothing ran out meanwhile, since nobody could renew it.

    So whoever held a drone before may have it again before anybody else can.
    """

    def later(volume: ReservedVolume) -> ReservedVolume:
        return replace(volume, from_s=volume.from_s + away_s, until_s=volume.until_s + away_s)

    return replace(
        a,
        claims={d: replace(c, until_s=c.until_s + away_s) for d, c in a.claims.items()},
        volumes={k: replace(v, volume=later(v.volume)) for k, v in a.volumes.items()},
    )


def current(a: Authority, now_s: float) -> Authority:
    """Without what has run out."""
    return _expired(a, now_s)


def _expired(a: Authority, now_s: float) -> Authority:
    claims = {d: c for d, c in a.claims.items() if c.until_s > now_s}
    waiting = {d: w for d, w in a.waiting.items() if w.until_s > now_s}
    # A volume outlives its claim: the drone may still be in it.
    volumes = {k: v for k, v in a.volumes.items() if v.volume.until_s > now_s}
    if len(claims) == len(a.claims) and len(waiting) == len(a.waiting) and len(volumes) == len(a.volumes):
        return a
    return replace(a, claims=claims, waiting=waiting, volumes=volumes)


def _is_whole(volume: ReservedVolume) -> bool:
    """Whether it says where and when (X6): what is not finite could neither be kept clear nor expire."""
    numbers = (volume.radius_m, volume.from_s, volume.until_s)
    return volume.start.finite and volume.end.finite and all(map(math.isfinite, numbers))
