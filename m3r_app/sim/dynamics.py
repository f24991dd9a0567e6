"""A multirotor under a PX4-like position cascade, wind with gusts, and GPS error inside a declared bound. Pure.

Plain floats, explicit dt, seeded generators passed in: a test flies thousands of runs with it. Positions and
velocities are NED (m, m/s). Gains and limits are PX4's defaults (MPC_*, MC_*), lags are set so that the answers to
steps come near to a PX4 1.17 quadcopter flown in offboard mode: a 1 m position step has moved 0.05 m after 0.47 s and
0.9 m after 2.5 s (here 0.08 and 1.02 m); from 0.36 m/s a stop coasts 0.16 to 0.34 m in 1.1 s (here 0.22 m in 1.07 s).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from random import Random
from typing import Protocol

from safety.frames import wrap_deg
from safety.vocabulary import Ned

GRAVITY_M_S2 = 9.80665
ZERO = Ned(0.0, 0.0, 0.0)
UNSET = Ned(math.nan, math.nan, math.nan)


@dataclass(frozen=True, slots=True)
class Accuracy:
    """What a vehicle states of its own errors, one sigma: its estimator's, its GPS receiver's, and of its velocity."""

    estimate_h_m: float
    estimate_v_m: float
    receiver_h_m: float
    receiver_v_m: float
    receiver_m_s: float
    velocity_m_s: float = math.nan
    """By the estimator; NaN: it does not say."""


class EstimateError(Protocol):
    """Estimate minus truth, as it goes on."""

    position: Ned
    velocity: Ned
    stated: Accuracy
    aided: bool
    """The receiver has a fix; set from outside."""

    def step(self, dt_s: float) -> Ned:
        """The position error dt_s later."""

    def sigmas_m(self, blind_s: float) -> tuple[float, float]:
        """Horizontal and vertical accuracy as the estimator states them, blind_s after the last GPS fix."""


@dataclass(frozen=True, slots=True)
class Airframe:
    """Gains, limits and lags; PX4 parameter names beside the ones that are PX4's."""

    xy_p: float = 0.95  # MPC_XY_P
    z_p: float = 1.0  # MPC_Z_P
    xy_vel_p: float = 1.8  # MPC_XY_VEL_P_ACC
    xy_vel_i: float = 0.2  # MPC_XY_VEL_I_ACC is 0.4, which overshoots more here than PX4 does
    xy_vel_d: float = 0.2  # MPC_XY_VEL_D_ACC
    z_vel_p: float = 4.0  # MPC_Z_VEL_P_ACC
    z_vel_i: float = 2.0  # MPC_Z_VEL_I_ACC
    xy_vel_max_m_s: float = 12.0  # MPC_XY_VEL_MAX
    up_max_m_s: float = 3.0  # MPC_Z_VEL_MAX_UP
    down_max_m_s: float = 1.5  # MPC_Z_VEL_MAX_DN
    acc_max_m_s2: float = 5.0  # MPC_ACC_HOR_MAX
    acc_up_m_s2: float = 4.0  # MPC_ACC_UP_MAX
    acc_down_m_s2: float = 3.0  # MPC_ACC_DOWN_MAX
    tilt_max_deg: float = 45.0  # MPC_TILTMAX_AIR
    yaw_p: float = 2.8  # MC_YAW_P
    yaw_rate_max_deg_s: float = 45.0  # MPC_YAWRAUTO_MAX
    yaw_acc_max_deg_s2: float = 60.0
    attitude_lag_s: float = 0.2
    """From a wanted to a flown tilt."""
    thrust_lag_s: float = 0.06
    drag_1_s: float = 0.25
    """Rotor and body drag over mass, linear in airspeed."""


@dataclass(frozen=True, slots=True)
class Setpoint:
    """What to fly to: per axis a position (m), a velocity (m/s) that is added to it, or NaN for none.

    An axis with neither is not controlled: level, or neutral thrust. yaw_deg NaN: yaw_rate_deg_s is flown instead.
    """

    position: Ned = UNSET
    velocity: Ned = UNSET
    yaw_deg: float = math.nan
    yaw_rate_deg_s: float = 0.0
    speed_max_m_s: float = math.inf
    """Horizontal speed limit, beside the airframe's."""
    up_max_m_s: float = math.inf
    down_max_m_s: float = math.inf


@dataclass(slots=True)
class Multirotor:
    """The true state of one drone, and `step` that moves it."""

    position: Ned = ZERO
    velocity: Ned = ZERO
    yaw_deg: float = 0.0
    yaw_rate_deg_s: float = 0.0
    landed: bool = False
    motors_on: bool = True
    thrust_fraction: float = 1.0
    """Below 1 a motor is out: no control of attitude, this much of hover thrust."""
    airframe: Airframe = field(default_factory=Airframe)
    tilt_acc: Ned = ZERO
    """Acceleration that the rotors give beyond hover (m/s^2): the attitude, in other words."""
    _integral: Ned = ZERO

    def step(
        self,
        dt_s: float,
        setpoint: Setpoint,
        wind: Ned = ZERO,
        position_error: Ned = ZERO,
        velocity_error: Ned = ZERO,
        ground_down_m: float = math.inf,
    ) -> None:
        """Fly dt_s (at most 0.02 s) towards the setpoint.

        wind: the air's velocity. position_error, velocity_error: estimate minus truth; the setpoint is flown to by the
        estimate. ground_down_m: where the ground is under the drone.
        """
        frame = self.airframe
        pn, pe, pd = self.position
        vn, ve, vd = self.velocity
        an, ae, ad = self.tilt_acc
        if not self.motors_on:
            an = ae = 0.0
            ad = GRAVITY_M_S2
            self._integral = ZERO
        elif self.thrust_fraction < 1.0:
            an = ae = 0.0
            ad = GRAVITY_M_S2 * (1.0 - self.thrust_fraction)
            self.yaw_rate_deg_s = min(self.yaw_rate_deg_s + 180.0 * dt_s, 360.0)
        else:
            an, ae, ad = self._thrust(dt_s, setpoint, position_error, velocity_error)
            self._turn(dt_s, setpoint)
        drag = frame.drag_1_s
        vn += (an - drag * (vn - wind.north)) * dt_s
        ve += (ae - drag * (ve - wind.east)) * dt_s
        vd += (ad - drag * (vd - wind.down)) * dt_s
        pn += vn * dt_s
        pe += ve * dt_s
        pd += vd * dt_s
        self.landed = pd >= ground_down_m - 1e-3 and vd >= -1e-3
        if self.landed:
            pn, pe = self.position.north, self.position.east
            pd = ground_down_m
            vn = ve = vd = an = ae = 0.0
            self.yaw_rate_deg_s = 0.0
            self._integral = ZERO
        self.position = Ned(pn, pe, pd)
        self.velocity = Ned(vn, ve, vd)
        self.tilt_acc = Ned(an, ae, ad)
        if self.yaw_rate_deg_s:
            self.yaw_deg = wrap_deg(self.yaw_deg + self.yaw_rate_deg_s * dt_s)

    def _thrust(
        self, dt_s: float, setpoint: Setpoint, position_error: Ned, velocity_error: Ned
    ) -> tuple[float, float, float]:
        """Position P, velocity PID, limits, lag: the rotors' acceleration beyond hover (m/s^2)."""
        frame = self.airframe
        an, ae, ad = self.tilt_acc
        in_, ie, id_ = self._integral
        true_n, true_e, true_d = self.velocity
        vn, ve, vd = true_n + velocity_error.north, true_e + velocity_error.east, true_d + velocity_error.down
        sp_n, sp_e, sp_d = setpoint.position
        vs_n, vs_e, vs_d = setpoint.velocity
        isnan = math.isnan
        # Horizontal
        if not (isnan(sp_n) or isnan(sp_e)):
            vs_n = (0.0 if isnan(vs_n) else vs_n) + frame.xy_p * (sp_n - self.position.north - position_error.north)
            vs_e = (0.0 if isnan(vs_e) else vs_e) + frame.xy_p * (sp_e - self.position.east - position_error.east)
        if not (isnan(vs_n) or isnan(vs_e)):
            speed = math.hypot(vs_n, vs_e)
            fastest = min(frame.xy_vel_max_m_s, setpoint.speed_max_m_s)
            if speed > fastest:
                vs_n *= fastest / speed
                vs_e *= fastest / speed
            want_n = frame.xy_vel_p * (vs_n - vn) + in_ - frame.xy_vel_d * an
            want_e = frame.xy_vel_p * (vs_e - ve) + ie - frame.xy_vel_d * ae
            wanted = math.hypot(want_n, want_e)
            most = min(frame.acc_max_m_s2, GRAVITY_M_S2 * math.tan(math.radians(frame.tilt_max_deg)))
            if wanted > most:
                want_n *= most / wanted
                want_e *= most / wanted
            else:
                in_ += frame.xy_vel_i * (vs_n - vn) * dt_s
                ie += frame.xy_vel_i * (vs_e - ve) * dt_s
        else:
            want_n = want_e = 0.0
        lag = min(1.0, dt_s / frame.attitude_lag_s)
        an += (want_n - an) * lag
        ae += (want_e - ae) * lag
        # Vertical
        if not isnan(sp_d):
            vs_d = (0.0 if isnan(vs_d) else vs_d) + frame.z_p * (sp_d - self.position.down - position_error.down)
        if not isnan(vs_d):
            highest = min(frame.up_max_m_s, setpoint.up_max_m_s)
            vs_d = max(-highest, min(frame.down_max_m_s, setpoint.down_max_m_s, vs_d))
            want_d = frame.z_vel_p * (vs_d - vd) + id_
            if -frame.acc_up_m_s2 < want_d < frame.acc_down_m_s2:
                id_ += frame.z_vel_i * (vs_d - vd) * dt_s
            else:
                want_d = max(-frame.acc_up_m_s2, min(frame.acc_down_m_s2, want_d))
        else:
            want_d = 0.0
        ad += (want_d - ad) * min(1.0, dt_s / frame.thrust_lag_s)
        self._integral = Ned(in_, ie, id_)
        return an, ae, ad

    def _turn(self, dt_s: float, setpoint: Setpoint) -> None:
        frame = self.airframe
        if not math.isnan(setpoint.yaw_deg):
            error = wrap_deg(setpoint.yaw_deg - self.yaw_deg)
            # The square root is the fastest rate from which it can still stop in time.
            rate = min(
                frame.yaw_p * abs(error),
                math.sqrt(2.0 * 0.8 * frame.yaw_acc_max_deg_s2 * abs(error)),
                frame.yaw_rate_max_deg_s,
            )
            rate = math.copysign(rate, error)
        else:
            rate = max(-frame.yaw_rate_max_deg_s, min(frame.yaw_rate_max_deg_s, setpoint.yaw_rate_deg_s))
        most = frame.yaw_acc_max_deg_s2 * dt_s
        self.yaw_rate_deg_s += max(-most, min(most, rate - self.yaw_rate_deg_s))

    @property
    def roll_pitch_rad(self) -> tuple[float, float]:
        """The attitude that gives `tilt_acc` at the present yaw."""
        yaw = math.radians(self.yaw_deg)
        forward = math.cos(yaw) * self.tilt_acc.north + math.sin(yaw) * self.tilt_acc.east
        right = -math.sin(yaw) * self.tilt_acc.north + math.cos(yaw) * self.tilt_acc.east
        return math.atan2(right, GRAVITY_M_S2), math.atan2(-forward, GRAVITY_M_S2)


class GaussMarkov:
    """First-order Gauss-Markov noise: standard deviation sigma, correlation time tau_s, exact for any dt."""

    __slots__ = ("_dt_s", "_keep", "_kick", "_rng", "sigma", "tau_s", "value")

    def __init__(self, sigma: float, tau_s: float, rng: Random) -> None:
        """Starts from its stationary distribution, so that a run has no warm-up."""
        self.sigma, self.tau_s, self._rng = sigma, tau_s, rng
        self._dt_s = self._keep = self._kick = 0.0
        self.value = rng.gauss(0.0, sigma) if sigma else 0.0

    def step(self, dt_s: float) -> float:
        if not self.sigma:
            return 0.0
        if dt_s != self._dt_s:
            self._dt_s = dt_s
            self._keep = math.exp(-dt_s / self.tau_s)
            self._kick = self.sigma * math.sqrt(1.0 - self._keep**2)
        self.value = self.value * self._keep + self._rng.gauss(0.0, self._kick)
        return self.value


class Wind:
    """A mean wind and gusts about it, each axis Gauss-Markov, never further from the mean than twice gust_sigma_m_s."""

    def __init__(
        self, speed_m_s: float, from_deg: float, gust_sigma_m_s: float, gust_tau_s: float, rng: Random
    ) -> None:
        """from_deg: the bearing it blows from, as weather reports say it."""
        towards = math.radians(from_deg + 180.0)
        self.mean = Ned(speed_m_s * math.cos(towards), speed_m_s * math.sin(towards), 0.0)
        self._bound_m_s = 2.0 * gust_sigma_m_s
        # The horizontal deviation is the radius, hence the root; vertical gusts near the ground are weaker.
        axis = gust_sigma_m_s / math.sqrt(2.0)
        self._gusts = [GaussMarkov(s, gust_tau_s, rng) for s in (axis, axis, axis / 2.0)]

    def step(self, dt_s: float) -> Ned:
        """The air's velocity (NED, m/s) dt_s later."""
        n, e, d = (gust.step(dt_s) for gust in self._gusts)
        size = math.sqrt(n * n + e * e + d * d)
        if size > self._bound_m_s:
            scale = self._bound_m_s / size
            n, e, d = n * scale, e * scale, d * scale
        return Ned(self.mean.north + n, self.mean.east + e, d)


class PositionError:
    """What a position estimate is wrong by: Gauss-Markov as GPS, smooth as a filter's output, and bounded.

    The declared sigmas are honest: sigma_h_m is the root mean square of the horizontal error, sigma_v_m of the
    vertical one (as PX4's eph and epv), and the error never leaves the ellipsoid of twice both. It moves at most at
    2 * drift_m_s in 3D. So a margin of k = 2 sigmas always suffices.
    """

    _SMOOTH_S = 2.0

    def __init__(self, sigma_h_m: float, sigma_v_m: float, tau_s: float, drift_m_s: float, rng: Random) -> None:
        self.sigma_h_m, self.sigma_v_m = sigma_h_m, sigma_v_m
        self.stated = Accuracy(sigma_h_m, sigma_v_m, sigma_h_m, sigma_v_m, 0.1)
        self.aided = True
        self._rate_max_m_s = 2.0 * drift_m_s
        axis = sigma_h_m / math.sqrt(2.0)
        self._raw = [GaussMarkov(s, tau_s, rng) for s in (axis, axis, sigma_v_m)]
        self._inside = self._bounded(*(noise.value for noise in self._raw))
        self._reckoned = ZERO
        self.position, self.velocity = self._inside, ZERO

    def _bounded(self, n: float, e: float, d: float) -> Ned:
        if not self.sigma_h_m or not self.sigma_v_m:
            return Ned(n, e, d)
        size = math.sqrt((n * n + e * e) / self.sigma_h_m**2 + d * d / self.sigma_v_m**2)
        if size <= 2.0:
            return Ned(n, e, d)
        return Ned(2.0 * n / size, 2.0 * e / size, 2.0 * d / size)

    def step(self, dt_s: float) -> Ned:
        """The position error dt_s later; its rate is then in `velocity`.

        Without aid, dead reckoning drifts beyond the bound, with what the filter takes for standing still.
        """
        # Following a point of a convex set from inside it never leaves the set: the bound survives the smoothing.
        goal = self._bounded(*(noise.step(dt_s) for noise in self._raw))
        rate = [(g - p) / self._SMOOTH_S for g, p in zip(goal, self._inside, strict=True)]
        speed = math.sqrt(sum(r * r for r in rate))
        if speed > self._rate_max_m_s:
            rate = [r * self._rate_max_m_s / speed for r in rate]
        self.velocity = Ned(*rate)
        self._inside = Ned(*(p + r * dt_s for p, r in zip(self._inside, rate, strict=True)))
        self._reckoned = ZERO if self.aided else self._reckoned.plus(Ned(0.1 * dt_s, 0.1 * dt_s, 0.0))
        self.position = self._inside.plus(self._reckoned)
        return self.position

    def sigmas_m(self, blind_s: float) -> tuple[float, float]:
        """As stated, and more without aid."""
        return self.stated.estimate_h_m + 0.5 * blind_s, self.stated.estimate_v_m + 0.1 * blind_s
