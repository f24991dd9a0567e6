"""Neighbours that fall silent, tell an old state anew, have a wrong clock or teleport, in seeded flights judged on the true state.

What they say goes through the product's own judgement of the air (`m3r_app.airspace.traffic`). `make test` flies 1 seed of
each; `M3R_SOAK=1` 100. With separation and age switched off, the same flights come too near.
"""

from __future__ import annotations

import math
import multiprocessing
from collections.abc import Callable
from random import Random

import pytest

from m3r_app.airspace.messages import Place, State, Velocity
from m3r_app.airspace.topics import cells_near
from m3r_app.airspace.traffic import RemoteTraffic
from safety.constraints import RULES
from safety.frames import LocalFrame
from safety.obstacles import Obstacles
from safety.terrain import Terrain
from safety.vocabulary import Command, Geodetic, Ned, Neighbours
from tests.flights import ORIGIN_AMSL_M, Aircraft, Flight
from tests.soak.figures import SOAK, record

pytestmark = pytest.mark.xdist_group("busy")  # it keeps a core busy

SEEDS = 100 if SOAK else 1
HERE = Geodetic(46.679, 7.863, 500.0)
FRAME, CELLS = LocalFrame(HERE), cells_near(HERE)
SIGMA_M = 0.3
GONE_S = 300.0
DURATION_S = 40.0
AWARE = ("separation", "neighbour_age")
"""The rules that look at neighbours."""
Told = tuple[Ned, Ned, float, float]
"""Place, velocity, its age as told, and how far ahead its clock seems (s)."""
Fault = Callable[["Liar", Aircraft, float], Told | None]


class Liar:
    """What one fault needs to remember, and its chances."""

    def __init__(self, seed: int) -> None:
        self.rng = Random(f"{seed}/liar")
        self.last: dict[str, tuple[float, Ned, Ned]] = {}
        self.until_s = 100.0 + self.rng.uniform(2.0, 12.0)
        self.skew_s = self.rng.uniform(-4.0, 4.0)


def honest(_liar: Liar, one: Aircraft, now_s: float) -> Told | None:
    return one.at(now_s).plus(one.error), one.going(now_s), 0.0, 0.0


def silent(liar: Liar, one: Aircraft, now_s: float) -> Told | None:
    """Nothing more is heard of it after some seconds."""
    return honest(liar, one, now_s) if now_s < liar.until_s else None


def frozen(liar: Liar, one: Aircraft, now_s: float) -> Told | None:
    """Its telling goes on, of the same old state, whose age it tells."""
    stuck_s = min(now_s, liar.until_s)
    return one.at(stuck_s).plus(one.error), one.going(stuck_s), min(10.0, now_s - stuck_s), 0.0


def skewed(liar: Liar, one: Aircraft, now_s: float) -> Told | None:
    """Its clock is wrong by up to 4 s, and its messages take up to 0.8 s."""
    transit_s = liar.rng.uniform(0.0, 0.8) if liar.last else 0.0
    liar.last[one.name] = (now_s, one.start, one.velocity)
    then_s = now_s - transit_s
    return one.at(then_s).plus(one.error), one.going(then_s), 0.0, liar.skew_s - transit_s


def teleporting(liar: Liar, one: Aircraft, now_s: float) -> Told | None:
    """Now and then it says, for half a second, that it is 10 to 60 m away from where it is."""
    since_s, off, _ = liar.last.get(one.name, (-math.inf, Ned(0.0, 0.0, 0.0), Ned(0.0, 0.0, 0.0)))
    if now_s - since_s > 0.5:
        angle, off_m = liar.rng.uniform(0.0, 2.0 * math.pi), liar.rng.uniform(10.0, 60.0)
        off = Ned(off_m * math.cos(angle), off_m * math.sin(angle), 0.0)
        if liar.rng.random() < 0.1:
            liar.last[one.name] = (now_s, off, off)
        return honest(liar, one, now_s)
    return one.at(now_s).plus(one.error).plus(off), one.going(now_s), 0.0, 0.0


FAULTS: dict[str, Fault] = {"silent": silent, "frozen": frozen, "skewed": skewed, "teleporting": teleporting}


def beside(flight: Flight) -> None:
    """Open ground, and one who hovers or drifts a few metres to the right, whither the drone is asked to go."""
    rng = flight.rng
    flight.place = Ned(12.0, 0.0, -6.0)
    flight.terrain = Terrain.flat(ORIGIN_AMSL_M, 0.1, ORIGIN_AMSL_M)
    flight.walls, flight.fence, flight.crossing = Obstacles.none(ORIGIN_AMSL_M), None, False
    place = Ned(12.0 + rng.uniform(-0.5, 0.5), rng.uniform(5.0, 6.5), -6.0 + rng.uniform(-0.5, 0.5))
    drift = Ned(rng.uniform(-0.03, 0.03), rng.uniform(0.0, 0.05), 0.0)
    error = Ned(*(rng.uniform(-SIGMA_M, SIGMA_M) for _ in range(3)))
    flight.aircraft = [Aircraft("blue", place, drift, flight.now_s, flight.now_s + GONE_S, error)]


class Beside(Flight):
    """A flight beside somebody who tells of itself over the air."""

    def __init__(self, seed: int, fault: Fault, *, aware: bool) -> None:
        rules = RULES if aware else tuple(rule for rule in RULES if rule.name not in AWARE)
        super().__init__(seed, rules=rules, commands=(Command.GO_RIGHT,), duration_s=DURATION_S, setting=beside)
        self.fault, self.liar = fault, Liar(seed)
        self.air = RemoteTraffic(lambda _: None)

    def neighbours(self) -> Neighbours:
        for one in self.aircraft:
            told = self.fault(self.liar, one, self.now_s) if one.born_s <= self.now_s < one.gone_s else None
            if told is None:
                continue
            place, velocity, age_s, early_s = told
            state = State(
                place=Place.of(FRAME.geodetic(place)),
                velocity=Velocity(north_m_s=velocity.north, east_m_s=velocity.east, down_m_s=velocity.down),
                sigma_m=SIGMA_M,
                age_s=age_s,
            )
            self.air.heard(one.name, "a", state, early_s, self.now_s)
        return self.air.neighbours(FRAME, CELLS, {}, self.now_s - 0.05, self.now_s)


def fly(job: tuple[int, str, bool]) -> tuple[float, int]:
    """The least true margin to the separation (inf: nobody came), and how many maneuvers were flown."""
    seed, fault, aware = job
    outcome = Beside(seed, FAULTS[fault], aware=aware).fly()
    return outcome.worst.get("separation", math.inf), outcome.flown


def flown(jobs: list[tuple[int, str, bool]]) -> list[tuple[float, int]]:
    if not SOAK:
        return [fly(job) for job in jobs]
    with multiprocessing.get_context("spawn").Pool() as pool:
        return pool.map(fly, jobs, chunksize=5)


@pytest.mark.requirement("R5", "R11")
@pytest.mark.timeout(3000)
@pytest.mark.parametrize("fault", list(FAULTS))
def test_a_neighbour_that_is_not_to_be_relied_on_is_kept_clear_of(fault: str) -> None:
    found = flown([(seed, fault, True) for seed in range(SEEDS)])
    unsafe = sum(margin < 0.0 for margin, _ in found)
    if SOAK:
        without = flown([(seed, fault, False) for seed in range(SEEDS)])
        near = sum(margin < 0.0 for margin, _ in without)
        record(
            "neighbours silent, frozen, skewed, teleporting", fault, count=SEEDS, unsafe=unsafe,
            without_guard=f"{near} of {SEEDS} flights came nearer than the separation, the rules of neighbours switched off",
            least_margin_m=round(min(margin for margin, _ in found), 2), maneuvers=sum(n for _, n in found),
        )  # fmt: skip
        assert near > 0
    assert unsafe == 0
    assert len(found) == SEEDS
