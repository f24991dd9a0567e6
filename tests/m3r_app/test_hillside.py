"""The shipped scenario is worth being careful about: what the rules make of moves from where red hovers."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio

from m3r_app.environment.loaders import load_world
from m3r_app.environment.scenario import SHIPPED, Scenario, load_scenario
from m3r_app.sim.autopilot import Autopilot
from m3r_app.sim.fleet import Fleet
from m3r_app.sim.guidance import TICK_S
from safety.frames import LocalFrame
from safety.limits import Limits
from safety.situation import Situation, World
from safety.supervisor import decide, interpret
from safety.vocabulary import (
    Anchor,
    Command,
    Decision,
    FlightMode,
    ManeuverRequest,
    Modality,
    Ned,
    Neighbours,
    Operator,
    VehicleState,
    Verdict,
)

LIMITS = Limits()
FIRST_MOVES = [
    Command.GO_LEFT, Command.GO_RIGHT, Command.GO_FORWARD, Command.GO_BACK, Command.GO_UP, Command.GO_DOWN,
    Command.TURN_LEFT, Command.TURN_RIGHT,
]  # fmt: skip


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load_scenario(SHIPPED / "hillside.toml")


@pytest.fixture(scope="module")
def frame(scenario: Scenario) -> LocalFrame:
    return LocalFrame(scenario.origin.place)


@pytest.fixture(scope="module")
def world(scenario: Scenario, frame: LocalFrame) -> World:
    return load_world(scenario, frame)


@pytest.fixture
def fleet(scenario: Scenario) -> Fleet:
    fleet = Fleet(scenario, 40000)
    fleet.close()
    return fleet


def neighbours(*pilots: Autopilot) -> Neighbours:
    """What their telemetry says of them, fresh."""
    return Neighbours(
        tuple(str(i) for i in range(len(pilots))),
        np.array([pilot.position for pilot in pilots], dtype=float).reshape(-1, 3),
        np.array([pilot.velocity for pilot in pilots], dtype=float).reshape(-1, 3),
        np.array([max(pilot.sigmas_m) for pilot in pilots], dtype=float),
        np.full(len(pilots), 99.9),
        99.9,
    )


def situation(scenario: Scenario, frame: LocalFrame, world: World, fleet: Fleet, sky: Neighbours) -> Situation:
    """Red as its telemetry tells it, paired where it hovers."""
    red = fleet.links["red"].autopilot
    sigma_h_m, sigma_v_m = red.sigmas_m
    vehicle = VehicleState(
        100.0, red.position, Ned(0.0, 0.0, 0.0), 180.0, 0.0, sigma_h_m, sigma_v_m, True, True, FlightMode.HOLD, 1.0
    )
    return Situation(
        now_s=100.0,
        vehicle=vehicle,
        operator=Operator(frame.ned(scenario.operator.place), scenario.operator.sigma_m),
        anchor=Anchor(red.position, 180.0, 99.0),
        session_centre=red.position,
        paired_at_s=99.0,
        neighbours=sky,
        reservations=(),
        world=world,
        authority=True,
    )


def ask(command: Command, here: Situation) -> Decision:
    request = ManeuverRequest("1", command, Modality.PANEL, 1.0, 100.0, 100.0)
    return decide(request, interpret(request, LIMITS), here, LIMITS)


def moved(here: Situation, decision: Decision) -> Situation:
    assert decision.plan is not None
    goal = decision.plan.goal
    return replace(here, vehicle=replace(here.vehicle, position=goal), anchor=Anchor(goal, 180.0, 99.0))


def test_the_shipped_files_are_what_their_script_makes(tmp_path: Path, world: World) -> None:
    specification = importlib.util.spec_from_file_location("make_hillside", SHIPPED / "make_hillside.py")
    assert specification is not None and specification.loader is not None
    script = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(script)
    script.main(tmp_path)
    for name in ("hillside_obstacles.geojson", "hillside_fence.geojson"):
        assert (tmp_path / name).read_text() == (SHIPPED / name).read_text()
    with rasterio.open(tmp_path / "hillside.tif") as made, rasterio.open(SHIPPED / "hillside.tif") as shipped:
        assert (made.crs, made.transform, made.units) == (shipped.crs, shipped.transform, shipped.units)
        assert np.abs(made.read(1) - shipped.read(1)).max() <= 1.0 / 64.0
    # And the app's reading of it is the formula's ground, within the stated error.
    places = np.random.default_rng(1).uniform(-150.0, 150.0, (500, 2))
    assert world.terrain is not None
    read_m = -world.terrain.agl_m(np.column_stack((places, np.zeros(500))))
    errors_m = read_m - script.ground_m(places[:, 0], places[:, 1])
    assert np.abs(errors_m).max() < 2.0 * world.terrain.sigma_m and errors_m.std() < world.terrain.sigma_m


@pytest.mark.parametrize("command", FIRST_MOVES)
def test_first_moves_are_approved_when_nobody_crosses(
    command: Command, scenario: Scenario, frame: LocalFrame, world: World, fleet: Fleet
) -> None:
    others = [fleet.links[name].autopilot for name in ("green", "blue", "courier")]
    here = situation(scenario, frame, world, fleet, neighbours(*others))
    decision = ask(command, here)
    assert decision.verdict is Verdict.APPROVED, [f.text for f in decision.failing]
    distances = [f for f in decision.findings if f.margin is not None and f.unit == "m" and f.constraint != "envelope"]
    assert len(distances) >= 7
    assert min(f.margin for f in distances if f.margin is not None) > 0.3, distances


@pytest.mark.parametrize(
    ("command", "constraint"),
    [
        (Command.GO_RIGHT, "obstacle_clearance"),
        (Command.GO_LEFT, "geofence"),
        (Command.GO_FORWARD, "agl"),
        (Command.GO_DOWN, "agl"),
    ],
)
def test_the_same_move_again_and_again_meets_its_limit(
    command: Command, constraint: str, scenario: Scenario, frame: LocalFrame, world: World, fleet: Fleet
) -> None:
    here = situation(scenario, frame, world, fleet, neighbours())
    approved = 0
    for _ in range(12):
        decision = ask(command, here)
        if decision.verdict is not Verdict.APPROVED:
            break
        approved += 1
        here = moved(here, decision)
    assert 1 <= approved <= 8
    assert decision.verdict in (Verdict.REDUCED, Verdict.REJECTED)
    assert constraint in {f.constraint for f in decision.failing}


def test_the_second_or_third_step_to_the_wall_is_not_made_whole(
    scenario: Scenario, frame: LocalFrame, world: World, fleet: Fleet
) -> None:
    here = situation(scenario, frame, world, fleet, neighbours())
    verdicts = []
    for _ in range(3):
        decision = ask(Command.GO_RIGHT, here)
        verdicts.append(decision.verdict)
        if decision.plan is None:
            break
        here = moved(here, decision)
    assert verdicts[0] is Verdict.APPROVED
    assert verdicts[-1] in (Verdict.REDUCED, Verdict.REJECTED)


def test_the_courier_crosses_often_and_never_comes_near_the_hovering_drone(fleet: Fleet) -> None:
    red, courier = fleet.links["red"].autopilot, fleet.links["courier"].autopilot
    crossings, nearest_m, before = [], np.inf, courier.drone.position.east
    # Only these two need to fly.
    for name in set(fleet.links) - {"red", "courier"}:
        del fleet.links[name]
    for tick in range(round(150.0 / TICK_S)):
        fleet.step()
        nearest_m = min(nearest_m, courier.drone.position.minus(red.drone.position).norm)
        if before * courier.drone.position.east < 0.0:
            crossings.append(tick * TICK_S)
        before = courier.drone.position.east
    assert nearest_m >= 8.0
    gaps = np.diff(crossings)
    assert len(crossings) >= 3 and gaps.min() > 35.0 and gaps.max() < 60.0


def test_while_the_courier_crosses_moving_towards_its_line_is_not_safe(
    scenario: Scenario, frame: LocalFrame, world: World, fleet: Fleet
) -> None:
    """Back, towards the operator, is towards the courier's line; two steps are free, in the crossing a third is not."""
    courier = fleet.links["courier"].autopilot
    while not -8.0 < courier.drone.position.east < 0.0:
        fleet.step()
    crossing = situation(scenario, frame, world, fleet, neighbours(courier))
    for command in FIRST_MOVES:
        assert ask(command, crossing).verdict is Verdict.APPROVED, command
    verdicts = []
    here = crossing
    for _ in range(3):
        decision = ask(Command.GO_BACK, here)
        verdicts.append(decision.verdict)
        if decision.verdict is not Verdict.APPROVED:
            break
        here = moved(here, decision)
    assert verdicts[-1] is not Verdict.APPROVED
    assert {f.constraint for f in decision.failing} == {"separation"}
    assert ask(Command.GO_BACK, replace(here, neighbours=neighbours())).verdict is Verdict.APPROVED
