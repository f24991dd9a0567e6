"""What an estimate of position and velocity is wrong by, as PX4's own simulation (SIH) makes it: unlike `PositionError`. Pure.

PX4 1.17's SIH adds much noise to its accelerometer and gyroscope, so that the estimator's velocity is wrong by decimetres
a second for seconds on end, and each GPS fix pulls the position back without the velocity saying so. Hovering 200 s and
more, on SIH against its ground truth, and as `SihError` makes it in the loop with `Multirotor`:

                                                       SIH                    here
    velocity error, rms per axis, horizontal, down     0.18 to 0.25, 0.19     0.20 to 0.25, 0.15 to 0.20 m/s
    its autocorrelation after 1, 2, 4 s                0.85, 0.6, 0.1         0.85, 0.65, 0.35
    position error, rms per axis, horizontal, down     0.13 to 0.19, 0.37     0.19 to 0.25, 0.30 to 0.48 m
    estimated speed below 0.1 m/s                      3 to 9 %               3 to 7 % of the time
    position against velocity over 2 s, above 0.5 m    43 to 49 %             35 to 53 % of the time
        99 % of the time below                         1.0 to 1.6             1.0 to 1.2 m
    where it truly hovers, rms per axis, horizontal    0.33 to 0.49           0.39 to 0.49 m
    stated: estimator, receiver, velocity              0.29 and 0.29 m, 0.9 and 1.78 m, 0.13 m/s
    the same 1, 3 and 5 s after the last GPS fix       0.33, 0.76, 1.51       0.32, 0.78, 1.59 m; the receiver: no fix, 100 m
    and the drone's drift by then                      5 m in 6 s             2 to 6 m in 6 s
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from random import Random

from m3r_app.sim.dynamics import ZERO, Accuracy, GaussMarkov
from safety.vocabulary import Ned

SIH_STATED = Accuracy(0.29, 0.29, 0.9, 1.78, 0.4, 0.13)
"""However much the noise is."""
GPS_PERIOD_S = 0.125
SIH_SCALES = {"px4-sih": 1.0, "px4-sih-half": 0.5, "px4-sih-quiet": 0.0}
"""Of the stock noise, by the names that scenarios give to them."""


@dataclass(frozen=True, slots=True)
class _Axis:
    """One axis of the filter. Fitted to the measurements above."""

    walk_m_s: float
    """White accelerometer noise: how much the velocity error walks in a second."""
    tilt_m_s2: float
    """Attitude error times gravity, first-order Gauss-Markov of `TILT_TAU_S`."""
    gps_m: float
    gps_m_s: float
    position_gain: float
    """Of a GPS fix, upon the position; the next upon the velocity (1/s)."""
    velocity_from_position_1_s: float
    velocity_gain: float


TILT_TAU_S = 1.0
_HORIZONTAL = _Axis(0.06, 0.135, 0.2, 0.07, 0.11, 0.025, 0.018)
_VERTICAL = _Axis(0.085, 0.05, 0.5, 0.158, 0.04, 0.01, 0.007)


class SihError:
    """Estimate minus truth of a drone on PX4 SIH; scale 1 is its stock noise."""

    def __init__(self, scale: float, rng: Random) -> None:
        self.scale, self._rng = scale, rng
        self.stated, self.aided = SIH_STATED, True
        self.position = self.velocity = ZERO
        self._axes = (_HORIZONTAL, _HORIZONTAL, _VERTICAL)
        self._tilts = [GaussMarkov(axis.tilt_m_s2 * scale, TILT_TAU_S, rng) for axis in self._axes]
        self._to_fix_s = 0.0

    def step(self, dt_s: float) -> Ned:
        """The position error dt_s later."""
        self._to_fix_s -= dt_s
        fix = self._to_fix_s <= 0.0
        if fix:
            self._to_fix_s += GPS_PERIOD_S
        fix = fix and self.aided
        position, velocity, gauss, scale = [], [], self._rng.gauss, self.scale
        for axis, tilt, p, v in zip(self._axes, self._tilts, self.position, self.velocity, strict=True):
            faster = v + tilt.step(dt_s) * dt_s + gauss(0.0, axis.walk_m_s * scale * math.sqrt(dt_s))
            further = p + 0.5 * (v + faster) * dt_s
            if fix:
                off = gauss(0.0, axis.gps_m * scale) - further
                slow = gauss(0.0, axis.gps_m_s * scale) - faster
                further += axis.position_gain * off
                faster += axis.velocity_from_position_1_s * off + axis.velocity_gain * slow
            position.append(further)
            velocity.append(faster)
        self.position, self.velocity = Ned(*position), Ned(*velocity)
        return self.position

    def sigmas_m(self, blind_s: float) -> tuple[float, float]:
        """As stated, and as dead reckoning was seen to grow. Only the receiver says at once that there is no fix."""
        stated = self.stated
        return math.hypot(stated.estimate_h_m, 0.14 * blind_s**1.5), stated.estimate_v_m + 0.06 * blind_s
