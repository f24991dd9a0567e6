"""The simulated multirotor answers like the PX4 quadcopter it stands for, and its noise keeps the bounds it declares."""

from __future__ import annotations

import math
from random import Random

import pytest

from m3r_app.sim.dynamics import ZERO, Airframe, GaussMarkov, Multirotor, PositionError, Setpoint, Wind
from safety.limits import Limits
from safety.vocabulary import Ned

DT_S = 0.004
HIGH = Ned(0.0, 0.0, -50.0)


def fly(drone: Multirotor, setpoint: Setpoint, seconds: float, wind: Ned = ZERO, dt_s: float = DT_S) -> None:
    for _ in range(round(seconds / dt_s)):
        drone.step(dt_s, setpoint, wind)


def test_a_step_of_one_metre_as_px4_flies_it() -> None:
    """Measured on PX4 1.17: 0.05 m after 0.47 s, 0.9 m after 2.5 s."""
    drone, setpoint = Multirotor(position=HIGH), Setpoint(position=Ned(1.0, 0.0, -50.0))
    fly(drone, setpoint, 0.47)
    assert 0.03 < drone.position.north < 0.12
    fly(drone, setpoint, 2.03)
    assert 0.8 < drone.position.north < 1.1
    fly(drone, setpoint, 6.0)
    assert drone.position.north == pytest.approx(1.0, abs=0.03)


def test_a_stop_as_px4_flies_it() -> None:
    """Measured on PX4 1.17: from 0.36 m/s it coasts 0.16 to 0.34 m in 1.1 s."""
    drone = Multirotor(position=HIGH, velocity=Ned(0.36, 0.0, 0.0))
    setpoint, seconds = Setpoint(position=Ned(0.18, 0.0, -50.0)), 0.0
    while drone.velocity.norm > 0.05:
        drone.step(DT_S, setpoint)
        seconds += DT_S
    assert 0.8 < seconds < 1.5
    assert 0.16 < drone.position.north < 0.34


@pytest.mark.parametrize("dt_s", [0.002, 0.004, 0.01, 0.02])
def test_the_step_size_hardly_matters(dt_s: float) -> None:
    drone, fine = Multirotor(position=HIGH), Multirotor(position=HIGH)
    setpoint = Setpoint(position=Ned(1.0, -0.5, -50.5), yaw_deg=90.0)
    for _ in range(40):
        fly(drone, setpoint, 0.1, dt_s=dt_s)
        fly(fine, setpoint, 0.1, dt_s=0.001)
        assert drone.position.minus(fine.position).norm < 0.03


def test_limits_hold_on_a_far_setpoint() -> None:
    drone = Multirotor(position=HIGH)
    setpoint = Setpoint(position=Ned(500.0, 500.0, -500.0), yaw_deg=180.0, speed_max_m_s=5.0)
    frame, rate_before = Airframe(), 0.0
    for _ in range(2500):
        drone.step(DT_S, setpoint)
        assert drone.velocity.horizontal <= 5.0 * 1.15
        assert -drone.velocity.down <= frame.up_max_m_s * 1.15
        assert drone.tilt_acc.horizontal <= frame.acc_max_m_s2 + 1e-9
        assert abs(drone.yaw_rate_deg_s) <= frame.yaw_rate_max_deg_s + 1e-9
        assert abs(drone.yaw_rate_deg_s - rate_before) <= frame.yaw_acc_max_deg_s2 * DT_S + 1e-9
        rate_before = drone.yaw_rate_deg_s
    roll, pitch = drone.roll_pitch_rad
    assert max(abs(roll), abs(pitch)) <= math.radians(frame.tilt_max_deg)


def test_it_turns_the_short_way_and_stops_there() -> None:
    drone = Multirotor(position=HIGH, yaw_deg=170.0)
    setpoint = Setpoint(position=HIGH, yaw_deg=-170.0)
    for _ in range(1000):
        drone.step(DT_S, setpoint)
        assert drone.yaw_deg > 169.0 or drone.yaw_deg < -168.0
    assert drone.yaw_deg == pytest.approx(-170.0, abs=0.5)
    fly(drone, Setpoint(position=HIGH, yaw_rate_deg_s=20.0), 2.0)
    assert drone.yaw_rate_deg_s == pytest.approx(20.0)


def test_wind_is_held_against() -> None:
    drone, setpoint = Multirotor(position=HIGH), Setpoint(position=HIGH)
    furthest = 0.0
    for _ in range(250 * 60):
        drone.step(DT_S, setpoint, Ned(-3.0, 4.0, 0.0))
        furthest = max(furthest, drone.position.minus(HIGH).norm)
    assert 0.1 < furthest < 1.5
    assert drone.position.minus(HIGH).norm < 0.01
    forward, right = drone.tilt_acc.north, drone.tilt_acc.east
    assert forward == pytest.approx(0.25 * 3.0, rel=0.05) and right == pytest.approx(-0.25 * 4.0, rel=0.05)


def test_a_wrong_estimate_moves_the_true_drone() -> None:
    drone, setpoint = Multirotor(position=HIGH), Setpoint(position=HIGH)
    for _ in range(250 * 15):
        drone.step(DT_S, setpoint, position_error=Ned(2.0, 0.0, -1.0))
    assert drone.position.minus(HIGH) == pytest.approx((-2.0, 0.0, 1.0), abs=0.02)


def test_uncontrolled_axes_drift_with_the_wind() -> None:
    drone = Multirotor(position=HIGH)
    fly(drone, Setpoint(velocity=Ned(math.nan, math.nan, 0.7)), 30.0, Ned(0.0, 2.0, 0.0))
    assert drone.velocity.east == pytest.approx(2.0, rel=0.05)
    assert drone.velocity.down == pytest.approx(0.7, rel=0.05)


def test_it_falls_without_motors_and_lies_on_the_ground() -> None:
    drone = Multirotor(position=Ned(0.0, 0.0, -10.0), motors_on=False)
    for _ in range(250 * 3):
        drone.step(DT_S, Setpoint(position=HIGH), ground_down_m=2.0)
    assert drone.landed
    assert drone.position == (0.0, 0.0, 2.0) and drone.velocity == ZERO
    broken = Multirotor(position=HIGH, thrust_fraction=0.6)
    fly(broken, Setpoint(position=HIGH), 2.0)
    assert broken.velocity.down > 4.0


def test_it_takes_off_from_the_ground() -> None:
    drone = Multirotor(landed=True)
    for _ in range(250 * 6):
        drone.step(DT_S, Setpoint(position=Ned(0.0, 0.0, -2.0)), ground_down_m=0.0)
    assert not drone.landed
    assert drone.position.down == pytest.approx(-2.0, abs=0.1)


def test_gauss_markov_has_the_sigma_and_the_memory_it_says() -> None:
    noise = GaussMarkov(2.0, 3.0, Random(1))
    values = [noise.step(0.1) for _ in range(200_000)]
    assert math.sqrt(sum(v * v for v in values) / len(values)) == pytest.approx(2.0, rel=0.05)
    lag = 30
    covariance = sum(a * b for a, b in zip(values, values[lag:], strict=False)) / (len(values) - lag)
    assert covariance / 4.0 == pytest.approx(math.exp(-1.0), abs=0.05)
    assert GaussMarkov(0.0, 1.0, Random(1)).step(0.1) == 0.0


@pytest.mark.parametrize("tau_s", [10.0, 300.0])
def test_a_position_error_never_leaves_what_it_declares(tau_s: float) -> None:
    errors, squares_h, squares_v, count = (
        [PositionError(0.25, 0.35, tau_s, 0.01, Random(i)) for i in range(40)],
        0.0,
        0.0,
        0,
    )
    touched = 0.0
    for _ in range(500):
        for error in errors:
            before = error.position
            n, e, d = error.step(0.02)
            outside = math.sqrt((n * n + e * e) / 0.25**2 + d * d / 0.35**2)
            touched = max(touched, outside)
            assert outside <= 2.0 + 1e-9
            moved = error.position.minus(before)
            assert moved.norm <= 0.02 * 0.02 + 1e-12
            assert moved == pytest.approx(tuple(v * 0.02 for v in error.velocity), abs=1e-12)
            squares_h, squares_v, count = squares_h + n * n + e * e, squares_v + d * d, count + 1
    assert touched > 1.5
    # The bound cuts off the tails, so it is a little better than it says, and not much.
    assert 0.6 * 0.25 < math.sqrt(squares_h / count) < 1.1 * 0.25
    assert 0.6 * 0.35 < math.sqrt(squares_v / count) < 1.1 * 0.35


def test_gusts_stay_within_twice_their_sigma() -> None:
    wind = Wind(5.0, 270.0, 0.8, 3.0, Random(3))
    assert wind.mean == pytest.approx((0.0, 5.0, 0.0), abs=1e-9)
    gusts = [wind.step(0.02).minus(wind.mean) for _ in range(50_000)]
    assert max(gust.norm for gust in gusts) == pytest.approx(1.6, abs=1e-6)
    assert math.sqrt(sum(gust.horizontal**2 for gust in gusts) / len(gusts)) == pytest.approx(0.8, rel=0.1)


def test_a_hover_in_the_shipped_winds_gusts_stays_in_the_tracking_tube() -> None:
    """The tube's radius is safety.limits.Limits.tracking_m; what counts here is truth against estimate."""
    furthest = 0.0
    for seed in range(4):
        rng = Random(seed)
        wind, error = Wind(3.0, 250.0, 0.4, 3.0, rng), PositionError(0.25, 0.35, 300.0, 0.01, rng)
        drone = Multirotor(position=HIGH.minus(error.position))
        for tick in range(50 * 60):
            air = wind.step(0.02)
            error.step(0.02)
            for _ in range(5):
                drone.step(DT_S, Setpoint(position=HIGH), air, error.position, error.velocity)
            if tick > 500:
                furthest = max(furthest, drone.position.plus(error.position).minus(HIGH).norm)
    assert 0.02 < furthest < Limits().tracking_m
