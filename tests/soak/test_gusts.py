"""Gusts and walls: 10,000 seeded flights in wind among walls, hills and traffic, judged on the true state.

In blocks of 200 seeds, none of them one of tests/test_flights.py, so that a block can be passed by itself. `M3R_SOAK=1` only.
"""

from __future__ import annotations

import multiprocessing

import pytest

from safety.constraints import RULES
from tests.flights import Flight, without
from tests.soak.figures import record

BLOCK = 200
FIRST = 100_000
SAMPLE = 40
"""Of the first block, flown with the rule of walls switched off."""

pytestmark = [pytest.mark.soak, pytest.mark.timeout(3000), pytest.mark.xdist_group("busy")]


def fly(job: tuple[int, bool]) -> tuple[dict[str, float], int, float]:
    """Violations by constraint, maneuvers flown, and the least true margin to a wall (m)."""
    seed, walls = job
    outcome = Flight(seed, rules=RULES if walls else without("obstacle_clearance")).fly()
    return outcome.violations, outcome.flown, outcome.worst.get("obstacle_clearance", float("inf"))


def flown(jobs: list[tuple[int, bool]]) -> list[tuple[dict[str, float], int, float]]:
    with multiprocessing.get_context("spawn").Pool() as pool:
        return pool.map(fly, jobs, chunksize=5)


@pytest.mark.requirement("R3", "R4", "R5", "R6", "R7", "R8")
@pytest.mark.parametrize("block", range(50))
def test_nothing_hard_is_violated_in_gusts_among_walls(block: int) -> None:
    first = FIRST + block * BLOCK
    found = flown([(seed, True) for seed in range(first, first + BLOCK)])
    violated = {first + i: violations for i, (violations, _, _) in enumerate(found) if violations}
    told = ""
    if block == 0:
        off = flown([(seed, False) for seed in range(first, first + SAMPLE)])
        hit = sum("obstacle_clearance" in violations for violations, _, _ in off)
        told = f"{hit} of {SAMPLE} came too near a wall, the rule of obstacles switched off"
        assert hit > 0
    record(
        "gusts and walls", f"seeds {first} to {first + BLOCK - 1}", count=BLOCK, unsafe=len(violated),
        without_guard=told, maneuvers=sum(n for _, n, _ in found), least_wall_margin_m=round(min(m for *_, m in found), 2),
    )  # fmt: skip
    assert not violated
