"""The noise of PX4's own simulation, as measured on it: bands around what its ground truth showed, hovering 200 s."""

from __future__ import annotations

import math
from random import Random
from typing import Any

import numpy as np
import pytest

from m3r_app.sim.dynamics import ZERO, Multirotor, Setpoint
from m3r_app.sim.estimator import SIH_SCALES, SihError
from safety.vocabulary import Ned

HERE = Ned(0.0, 0.0, -10.0)
TICK_S, SUBSTEPS = 0.02, 5


def hover(scale: float, seed: int, seconds: float = 200.0) -> dict[str, Any]:
    """The estimate and its error, tick by tick, of a drone that holds its place by that estimate."""
    error, drone = SihError(scale, Random(seed)), Multirotor(position=HERE)
    setpoint = Setpoint(position=HERE, yaw_deg=0.0)
    rows: dict[str, list[Ned]] = {"position": [], "velocity": [], "position_error": [], "velocity_error": []}
    for tick in range(round((seconds + 10.0) / TICK_S)):
        error.step(TICK_S)
        for _ in range(SUBSTEPS):
            drone.step(TICK_S / SUBSTEPS, setpoint, ZERO, error.position, error.velocity)
        if tick * TICK_S > 10.0:
            rows["position"].append(drone.position.plus(error.position))
            rows["velocity"].append(drone.velocity.plus(error.velocity))
            rows["position_error"].append(error.position)
            rows["velocity_error"].append(error.velocity)
    return {name: np.array(values) for name, values in rows.items()}


def disagreement_m(position: Any, velocity: Any) -> Any:
    """The arbiter's own figure: position against velocity, forgotten over 2 s."""
    keep, last, sizes = math.exp(-TICK_S / 2.0), np.zeros(3), []
    for moved, mean in zip(np.diff(position, axis=0), 0.5 * (velocity[1:] + velocity[:-1]), strict=True):
        last = keep * last + moved - mean * TICK_S
        sizes.append(np.linalg.norm(last))
    return np.array(sizes[round(6.0 / TICK_S) :])


def rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def test_stock_noise_is_what_was_measured() -> None:
    flown = [hover(1.0, seed) for seed in range(4)]
    velocity_error = np.concatenate([run["velocity_error"] for run in flown])
    assert 0.19 < rms(velocity_error[:, :2]) < 0.28
    assert 0.15 < rms(velocity_error[:, 2]) < 0.24
    assert 0.5 < np.abs(velocity_error).max() < 1.1
    speeds = np.linalg.norm(np.concatenate([run["velocity"] for run in flown]), axis=1)
    assert 0.03 < np.mean(speeds < 0.1) < 0.10
    apart = np.concatenate([disagreement_m(run["position"], run["velocity"]) for run in flown])
    assert 0.40 < np.mean(apart > 0.5) < 0.50
    assert 1.0 < np.quantile(apart, 0.99) < 1.6
    position_error = np.concatenate([run["position_error"] for run in flown])
    assert 0.13 < rms(position_error[:, :2]) < 0.30
    assert 0.3 < rms(position_error[:, 2]) < 0.55
    # The drone flies by that estimate, so in truth it wanders by about half a metre.
    assert 0.3 < rms((np.concatenate([run["position"] for run in flown]) - position_error)[:, :2]) < 0.6


def test_the_velocity_is_wrong_for_seconds_on_end() -> None:
    error = np.concatenate([hover(1.0, seed)["velocity_error"][:, :2] for seed in range(4)])

    def likeness(after_s: float) -> float:
        lag = round(after_s / TICK_S)
        return float(np.mean(error[:-lag] * error[lag:]) / np.mean(error**2))

    assert 0.7 < likeness(1.0) < 0.95
    assert 0.5 < likeness(2.0) < 0.8
    assert likeness(4.0) < 0.5


@pytest.mark.parametrize("seed", range(3))
def test_each_run_is_noisy_and_bounded(seed: int) -> None:
    run = hover(1.0, seed)
    assert 0.33 < np.mean(disagreement_m(run["position"], run["velocity"]) > 0.5) < 0.60
    assert np.abs(run["position_error"]).max() < 2.0


def test_it_scales() -> None:
    half, quiet = hover(0.5, 1, 60.0), hover(0.0, 1, 60.0)
    assert 0.08 < rms(half["velocity_error"][:, :2]) < 0.15
    assert np.mean(disagreement_m(half["position"], half["velocity"]) > 0.5) < 0.15
    assert not np.any(quiet["velocity_error"]) and not np.any(quiet["position_error"])
    assert SIH_SCALES == {"px4-sih": 1.0, "px4-sih-half": 0.5, "px4-sih-quiet": 0.0}


def test_the_position_jumps_at_fixes_and_the_velocity_says_nothing_of_it() -> None:
    run = hover(1.0, 2, 20.0)
    moved = np.diff(run["position"], axis=0) - 0.5 * TICK_S * (run["velocity"][1:] + run["velocity"][:-1])
    steps = np.linalg.norm(moved, axis=1)
    assert 0.02 < np.quantile(steps, 0.95) < 0.15
    assert np.mean(steps < 0.005) > 0.7


def test_the_same_seed_is_the_same_noise() -> None:
    one, two, other = (hover(1.0, seed, 5.0)["position_error"] for seed in (7, 7, 8))
    assert np.array_equal(one, two) and not np.array_equal(one, other)


def test_without_fixes_it_drifts_by_metres() -> None:
    drifts = []
    for seed in range(20):
        error = SihError(1.0, Random(seed))
        for _ in range(500):
            error.step(TICK_S)
        error.aided = False
        for _ in range(750):
            error.step(TICK_S)
        drifts.append(error.position.horizontal)
        error.aided = True
        for _ in range(500):
            error.step(TICK_S)
        assert error.position.horizontal < max(0.5 * drifts[-1], 2.0)
    assert 3.0 < sorted(drifts)[10] < 13.0
