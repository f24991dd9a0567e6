"""What a vehicle last reported: a frozen snapshot, and the latest-value slots that it is taken from.

A slot holds one value and when it arrived; nothing queues, so a slow reader is never behind. Unknown and stale values
are None or NaN, never a default that looks fine (X6). Sources are MAVLink messages as MAVSDK hands them on.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from safety.vocabulary import FlightMode, Geodetic, Ned

MODE_AGE_S = 3.0
"""Flight mode, arming, health and landed state come at about 1 Hz: older than this and they are unknown."""
ACCURACY_AGE_S = 3.0
LOST_FIX_M = 10.0
"""A receiver whose accuracy is worse has no fix that a drone could be flown by near anything."""
DISTANCE_AGE_S = 1.0
RATE_S = 2.0
"""Over this time the rate of positions is measured."""
BATTERY_AGE_S = 10.0
"""PX4 sends BATTERY_STATUS every two seconds."""

NO_HEALTH = ("no health report",)


@dataclass(frozen=True, slots=True)
class Telemetry:
    """One vehicle at one moment. Angles in degrees, yaw as a compass heading in (-180, 180]."""

    at_s: float
    """When the oldest of position (both forms) and attitude arrived; -inf until all of them have."""
    heard_at_s: float
    """When anything at all last arrived: its age is the link's age."""
    geodetic: Geodetic | None
    """GLOBAL_POSITION_INT"""
    local: Ned | None
    """LOCAL_POSITION_NED: about the vehicle's own origin, which is not the session's."""
    velocity: Ned | None
    yaw_deg: float
    yaw_rate_deg_s: float
    sigma_h_m: float
    """1-sigma accuracy that the estimator states (ESTIMATOR_STATUS), or where it states none the receiver (GPS_RAW_INT)."""
    sigma_v_m: float
    flight_mode: FlightMode
    mode_at_s: float
    """When flight_mode arrived (HEARTBEAT, 1 Hz); -inf: never."""
    armed: bool | None
    in_air: bool | None
    healthy: bool
    unhealthy: tuple[str, ...]
    """What is not healthy, by name; empty only if healthy."""
    battery: float | None
    """Remaining fraction, 0 to 1."""
    rc_present: bool | None
    """Whether a remote control is heard by the autopilot (SYS_STATUS)."""
    rate_hz: float = math.nan
    """How many positions arrive in a second, over the last two; NaN: too few to say."""
    home: Geodetic | None = None
    """HOME_POSITION"""
    ground_distance_m: float | None = None
    """What a rangefinder that looks down measures (DISTANCE_SENSOR)."""
    restarts: int = 0
    """How often the autopilot has started anew since it was first heard (SYSTEM_TIME)."""

    @property
    def sigma_m(self) -> float:
        """The larger of the two accuracies, 1 sigma; NaN if either is unknown."""
        return float(np.maximum(self.sigma_h_m, self.sigma_v_m))  # which keeps a NaN; max() may not

    def age_s(self, now_s: float) -> float:
        """How old the position and attitude are; inf if they never came."""
        return now_s - self.at_s

    def link_age_s(self, now_s: float) -> float:
        """How long the vehicle has been silent; inf if it was never heard."""
        return now_s - self.heard_at_s


NEVER_HEARD = Telemetry(
    at_s=-math.inf,
    heard_at_s=-math.inf,
    geodetic=None,
    local=None,
    velocity=None,
    yaw_deg=math.nan,
    yaw_rate_deg_s=math.nan,
    sigma_h_m=math.nan,
    sigma_v_m=math.nan,
    flight_mode=FlightMode.UNKNOWN,
    mode_at_s=-math.inf,
    armed=None,
    in_air=None,
    healthy=False,
    unhealthy=("no telemetry",),
    battery=None,
    rc_present=None,
)


@dataclass(frozen=True, slots=True)
class Health:
    """The autopilot's own checks (SYS_STATUS, HOME_POSITION), each by the name an operator reads."""

    checks: Mapping[str, bool]

    @property
    def failing(self) -> tuple[str, ...]:
        return tuple(name for name, passed in self.checks.items() if not passed)


T = TypeVar("T")


class Arrivals:
    """When the last of one kind of message arrived: how many come in a second. One thread writes, another reads."""

    __slots__ = ("_times_s",)

    def __init__(self) -> None:
        self._times_s: deque[float] = deque(maxlen=256)

    def put(self, at_s: float) -> None:
        """One more has arrived."""
        self._times_s.append(at_s)

    def rate_hz(self, now_s: float) -> float:
        """Over the last RATE_S; NaN where less than half of that time has been heard of."""
        times_s = tuple(self._times_s)
        recent = [t for t in times_s if now_s - t <= RATE_S]
        if len(recent) < 2 or (recent[-1] - times_s[0] < 0.5 * RATE_S):
            return math.nan
        return (len(recent) - 1) / (now_s - recent[0])


class Slot(Generic[T]):
    """The latest value of one kind. Written by one thread, read by another: the pair is replaced whole."""

    __slots__ = ("_held",)

    def __init__(self) -> None:
        self._held: tuple[T, float] | None = None

    def put(self, value: T, at_s: float) -> None:
        """Replace what is held by a value that arrived at at_s."""
        self._held = (value, at_s)

    @property
    def value(self) -> T | None:
        held = self._held
        return None if held is None else held[0]

    @property
    def at_s(self) -> float:
        """When it arrived; -inf: never."""
        held = self._held
        return -math.inf if held is None else held[1]

    def fresh(self, now_s: float, within_s: float) -> T | None:
        """The value if it is at most within_s old, else None."""
        held = self._held
        return None if held is None or now_s - held[1] > within_s else held[0]


@dataclass(frozen=True, slots=True)
class Accuracy:
    """1-sigma accuracies (m) from one source; NaN: not stated."""

    horizontal_m: float
    vertical_m: float


class Slots:
    """Every latest value of one vehicle."""

    def __init__(self) -> None:
        self.geodetic: Slot[Geodetic] = Slot()
        self.local: Slot[tuple[Ned, Ned]] = Slot()
        """Position and velocity, of one message."""
        self.yaw_deg: Slot[float] = Slot()
        self.yaw_rate_deg_s: Slot[float] = Slot()
        self.estimator: Slot[Accuracy] = Slot()
        self.receiver: Slot[Accuracy] = Slot()
        self.flight_mode: Slot[FlightMode] = Slot()
        self.armed: Slot[bool] = Slot()
        self.in_air: Slot[bool] = Slot()
        self.health: Slot[Health] = Slot()
        self.battery: Slot[float] = Slot()
        self.rc_present: Slot[bool] = Slot()
        self.home: Slot[Geodetic] = Slot()
        self.ground_distance_m: Slot[float] = Slot()
        self.restarts: Slot[int] = Slot()
        self.positions = Arrivals()

    def snapshot(self, now_s: float) -> Telemetry:
        """All of it as one value; what is too old is unknown. Positions stay: the caller judges their age."""
        held = self.local.value
        health = self.health.fresh(now_s, MODE_AGE_S)
        failing = NO_HEALTH if health is None else health.failing
        every = [slot for slot in vars(self).values() if isinstance(slot, Slot)]
        return Telemetry(
            at_s=min(self.local.at_s, self.geodetic.at_s, self.yaw_deg.at_s),
            heard_at_s=max(slot.at_s for slot in every),
            geodetic=self.geodetic.value,
            local=None if held is None else held[0],
            velocity=None if held is None else held[1],
            yaw_deg=_or_nan(self.yaw_deg.value),
            yaw_rate_deg_s=_or_nan(self.yaw_rate_deg_s.value),
            sigma_h_m=self._sigma_m(now_s, "horizontal_m"),
            sigma_v_m=self._sigma_m(now_s, "vertical_m"),
            flight_mode=self.flight_mode.fresh(now_s, MODE_AGE_S) or FlightMode.UNKNOWN,
            mode_at_s=self.flight_mode.at_s,
            armed=self.armed.fresh(now_s, MODE_AGE_S),
            in_air=self.in_air.fresh(now_s, MODE_AGE_S),
            healthy=not failing,
            unhealthy=failing,
            battery=self.battery.fresh(now_s, BATTERY_AGE_S),
            rc_present=self.rc_present.fresh(now_s, MODE_AGE_S),
            rate_hz=self.positions.rate_hz(now_s),
            home=self.home.value,
            ground_distance_m=self.ground_distance_m.fresh(now_s, DISTANCE_AGE_S),
            restarts=self.restarts.value or 0,
        )

    def _sigma_m(self, now_s: float, axis: str) -> float:
        """What the estimator states, whose position it is, or else the receiver of its raw fixes. NaN: nobody.

        A receiver that has lost its fix is believed before an estimator that has not noticed: it dead-reckons for seconds,
        and states centimetres.
        """
        fresh = (slot.fresh(now_s, ACCURACY_AGE_S) for slot in (self.estimator, self.receiver))
        stated = [getattr(accuracy, axis) for accuracy in fresh if accuracy is not None]
        believed = [float(sigma) for sigma in stated if math.isfinite(sigma) and sigma > 0]
        return max(believed) if any(sigma >= LOST_FIX_M for sigma in believed) else next(iter(believed), math.nan)


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value
