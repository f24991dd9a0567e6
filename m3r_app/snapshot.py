"""What one moment looks like, for whoever watches: frozen, pure, in the session's local frame. And the margins that hold now.

Source: paper III-F (the constraints), design "A rule is one named predicate that returns a margin".
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from m3r_app.arbiter.context import Step
from m3r_app.arbiter.state import ArbiterState
from m3r_app.run_setup import RunSetup
from m3r_app.vehicle.telemetry import Telemetry
from modalities.hands.gestures import Hand
from safety.constraints import RULES, PathRule, Rule, findings, nearby
from safety.frames import LocalFrame
from safety.vocabulary import Finding, FlightMode, Ned, Path

WATCHED = {
    "terrain_clearance": "terrain",
    "agl": "height",
    "obstacle_clearance": "obstacle",
    "separation": "neighbour",
    "workspace": "workspace",
    "geofence": "geofence",
    "standoff": "operator",
}
"""What an operator is shown all the time: constraint and its short name."""
NOWHERE_M = 1e6
"""Who tells to be farther away than this, or NaN, is nowhere."""
FULL_M = 5.0
"""A margin of so many metres or more fills its bar."""
HOVER_RULES: tuple[Rule, ...] = tuple(r for r in RULES if isinstance(r, PathRule) and r.name in WATCHED)


@dataclass(frozen=True, slots=True)
class Craft:
    """One vehicle, as it or somebody else last told. Unknown is None or NaN."""

    name: str
    position: Ned | None
    velocity: Ned | None
    yaw_deg: float
    sigma_m: float
    age_s: float
    """Of its position."""
    link_age_s: float
    battery: float | None
    flight_mode: FlightMode | None
    """None: only others tell of it."""
    in_air: bool | None
    ours: bool
    """It can be paired with; others are only heard."""


@dataclass(frozen=True, slots=True)
class Taken:
    """What the modalities take in right now. Times on the app's clock, -inf: never."""

    words: str = ""
    """Partial words, of what is being said."""
    level_dbfs: float = -math.inf
    """Of the sound, in dB below full scale."""
    snr_db: float | None = None
    """How far the voice stands above the noise; None: no voice yet that does."""
    level_at_s: float = -math.inf
    shown: str = ""
    """What the hands show."""
    hands: tuple[Hand, ...] = ()
    hands_at_s: float = -math.inf


@dataclass(frozen=True, slots=True)
class Snapshot:
    """One moment of a run."""

    at_s: float
    state: ArbiterState
    setup: RunSetup
    craft: tuple[Craft, ...]
    taken: Taken = field(default_factory=Taken)
    air_trouble: str | None = None
    """What is missing of the shared air, in two words."""

    @property
    def paired(self) -> Craft | None:
        """The session's drone."""
        session = self.state.session
        return next((c for c in self.craft if session is not None and c.name == session.colour), None)


@dataclass(frozen=True, slots=True)
class Margin:
    """How far one limit is away. value: signed, in `unit`, negative where it is broken; None: there is nothing to be near to.

    fullness: 0 to 1, how long its bar is; known: False where it cannot be judged, which is never good.
    """

    name: str
    value: float | None
    unit: str
    fullness: float
    known: bool
    text: str
    shown: str = ""
    """What is shown of it where that is not the margin: of a battery its level."""


def craft(name: str, telemetry: Telemetry, frame: LocalFrame, now_s: float, *, ours: bool) -> Craft:
    """A vehicle's telemetry in the session's frame."""
    place = frame.ned(telemetry.geodetic) if telemetry.geodetic is not None else None
    return Craft(
        name,
        place if place is not None and max(map(abs, place)) < NOWHERE_M else None,
        telemetry.velocity,
        telemetry.yaw_deg,
        telemetry.sigma_m,
        telemetry.age_s(now_s),
        telemetry.link_age_s(now_s),
        telemetry.battery,
        telemetry.flight_mode,
        telemetry.in_air,
        ours,
    )


def heard_of(state: ArbiterState, known: frozenset[str], now_s: float) -> tuple[Craft, ...]:
    """The neighbours that only others tell of, not being among those known."""
    n = state.neighbours
    found = []
    for i, name in enumerate(n.names):
        if name in known:
            continue
        place, velocity = Ned(*map(float, n.positions_ned_m[i])), Ned(*map(float, n.velocities_ned_m_s[i]))
        age_s = now_s - float(n.at_s[i])
        found.append(
            Craft(
                name,
                place if place.finite and max(map(abs, place)) < NOWHERE_M else None,
                velocity if velocity.finite else None,
                math.nan,
                float(n.sigmas_m[i]),
                age_s,
                age_s,
                None,
                None,
                None,
                ours=False,
            )
        )
    return tuple(found)


def margins(state: ArbiterState, drone: Craft | None, now_s: float) -> tuple[Margin, ...]:
    """Every watched limit of the session's drone where it is now; none without a session."""
    situation = Step(state, now_s).situation()
    if drone is None or state.session is None:
        return ()
    limits = state.limits
    found: tuple[Margin, ...] = ()
    if situation is not None:
        here = Path(np.array([situation.vehicle.position]), np.zeros(1))
        scene = nearby(situation, here, limits)
        judged = findings(here, scene, limits, rules=HOVER_RULES)
        found = tuple(_of_finding(f) for f in judged)
    return (*found, _battery(drone.battery, limits.battery_min), _link(drone.link_age_s, limits.telemetry_age_s))


def _of_finding(finding: Finding) -> Margin:
    name, margin = WATCHED[finding.constraint], finding.margin
    if margin is None or not math.isfinite(margin):
        # Passed without a number: there is nothing there. Failed without one: it is not known.
        return Margin(name, None, finding.unit, 1.0 if finding.passed else 0.0, finding.passed, finding.text)
    return Margin(name, margin, finding.unit, _share(margin / FULL_M), known=True, text=finding.text)


def _battery(fraction: float | None, least: float) -> Margin:
    if fraction is None or not math.isfinite(fraction):
        return Margin("battery", None, "%", 0.0, known=False, text="the battery is unknown")
    percent = 100.0 * (fraction - least)
    return Margin(
        "battery",
        percent,
        "%",
        _share(fraction),
        known=True,
        text=f"{fraction:.0%}, at least {least:.0%} to fly",
        shown=f"{100.0 * fraction:.0f} %",
    )


def _link(age_s: float, most_s: float) -> Margin:
    if not math.isfinite(age_s):
        return Margin("link age", None, "s", 0.0, known=False, text="never heard")
    return Margin(
        "link age", most_s - age_s, "s", _share(1.0 - age_s / most_s), known=True, text=f"heard {age_s:.2f} s ago"
    )


def _share(value: float) -> float:
    return min(1.0, max(0.0, value))
