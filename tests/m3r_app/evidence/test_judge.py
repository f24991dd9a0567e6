"""The independent judge: a flight in order holds, and whatever is broken in it is found under its own name."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from m3r_app.evidence.judge import judge
from m3r_app.evidence.reading import EvidenceError, flight_of
from m3r_app.evidence.verdict import Judgement
from safety.obstacles import Obstacles
from safety.terrain import Terrain
from tests.flights import ORIGIN_AMSL_M
from tests.m3r_app.evidence.recorded import STARTED_S, RecordedFlight, Told

Edit = Callable[[Told], None]
SEED = 11
JUDGED = 1
"""Which of its plans is broken: one metre back; the one before it goes down."""


@pytest.fixture(scope="module")
def flown() -> Told:
    return RecordedFlight(SEED, duration_s=16.5).told()


def judged(told: Told, *, closed: bool = True) -> Judgement:
    return judge(flight_of(told.metadata, told.messages, closed=closed))


def failing(told: Told) -> set[tuple[str, str]]:
    return {(line.part, line.limit) for line in judged(told).failing}


def test_a_flight_in_order_holds_and_every_limit_was_judged(flown: Told) -> None:
    found = judged(flown)
    assert found.failing == ()
    assert (found.plans, found.requests) == (2, 4)
    confirmed_s = flown.of("pair")[0][0]
    assert found.samples == sum(t_s >= confirmed_s for t_s, _ in flown.of("telemetry")) > 200
    assert {line.limit for line in found.lines if line.part == "plan"} >= {
        "terrain_clearance", "agl", "terrain_confidence", "obstacle_clearance", "geofence", "standoff", "workspace",
        "session", "envelope", "separation", "neighbour_age", "localization", "telemetry_age", "input_confidence",
    }  # fmt: skip
    assert {line.limit for line in found.lines if line.part == "telemetry"} == {
        "terrain_clearance", "agl", "obstacle_clearance", "geofence", "standoff", "workspace", "session", "separation",
        "speed",
    }  # fmt: skip


FINE_M, COARSE_M = 0.001, 0.06
"""The rules bound what lies between two points of a path, so theirs may be so much smaller; never larger."""


def disagreements(told: Told) -> dict[tuple[str, str], tuple[float, float]]:
    """Where the least margin of the judge and that of the rules, of one plan and limit, are not the same (m)."""
    mine: dict[tuple[str, str], float] = {}
    for line in judged(told).lines:
        if line.part == "plan" and line.margin is not None:
            key = line.subject, line.limit
            mine[key] = min(line.margin, mine.get(key, math.inf))
    theirs = {
        (data["request"], finding["constraint"]): finding["margin"]
        for _, data in told.of("decision")
        if data["granted_m"] is not None
        for finding in data["granted_findings"]
        if finding["constraint"] in SAME and (finding["constraint"] not in CUT_OFF or finding["margin"] < 2.9)
    }
    pairs = {key: (mine[key], margin) for key, margin in theirs.items()}
    return {key: pair for key, pair in pairs.items() if not -FINE_M <= pair[0] - pair[1] <= COARSE_M}


SAME = frozenset({"workspace", "geofence", "standoff", "obstacle_clearance", "terrain_clearance"})
"""Limits of which both geometries tell the same distance; of the others the rules tell a bound."""
CUT_OFF = frozenset({"geofence", "obstacle_clearance", "terrain_clearance"})
"""What stands still is looked for 3 m beyond what is required."""


def test_two_geometries_that_share_no_code_tell_the_same_margins() -> None:
    """Hills, walls, a fence and traffic at random, and an estimate that is noisy."""
    told = RecordedFlight(25).told()
    assert judged(told).failing == ()
    assert disagreements(told) == {}
    told.metadata["operator"]["position"][0] += 0.1
    raise_the_ground(told, 0.1)
    assert {limit for _, limit in disagreements(told)} == {"standoff", "terrain_clearance"}


# ---------------------------------------------------------------- plans


def the_plan(told: Told) -> dict[str, Any]:
    plan: dict[str, Any] = told.of("plan")[JUDGED][1]["plan"]
    return plan


def ahead(told: Told, along_m: float) -> list[float]:
    """A place on the plan's line."""
    plan = the_plan(told)
    return [s + along_m * d for s, d in zip(plan["start"], plan["direction"], strict=True)]


def raise_the_ground(told: Told, by_m: float) -> None:
    terrain = told.metadata["world"]["terrain"]
    terrain["heights_amsl_m"] = (np.array(terrain["heights_amsl_m"]) + by_m).tolist()


def a_spike(told: Told) -> None:
    """Beside the plan's line, as high as it: far above it in no place, but near."""
    terrain = told.metadata["world"]["terrain"]
    north, east, down = ahead(told, 0.5)
    heights = np.array(terrain["heights_amsl_m"])
    row, col = round(north + 40.0), round(east + 40.0) + 2
    heights[row, col] = ORIGIN_AMSL_M - down
    terrain["heights_amsl_m"] = heights.tolist()


def a_hole(told: Told) -> None:
    terrain = told.metadata["world"]["terrain"]
    north, east, _ = ahead(told, 0.5)
    heights = np.array(terrain["heights_amsl_m"])
    heights[round(north + 40.0), round(east + 40.0)] = math.nan
    terrain["heights_amsl_m"] = heights.tolist()


def a_wall(told: Told) -> None:
    """A pole of a hand's width, 1.2 m beside the line."""
    import shapely

    from m3r_app.plain import plain

    plan, (north, east, _) = the_plan(told), ahead(told, 0.5)
    side = (-plan["direction"][1], plan["direction"][0])
    pole = shapely.Point(north + 1.2 * side[0], east + 1.2 * side[1]).buffer(0.05)
    made = Obstacles.of(["pole"], [pole], [480.0], [520.0], ORIGIN_AMSL_M)
    told.metadata["world"]["obstacles"] = plain(made, lossless=True)


def a_closer_fence(told: Told) -> None:
    """Its edges drawn in about its start."""
    edges = np.array(told.metadata["world"]["geofence"]["polygon"]["edges"])
    middle = np.array(the_plan(told)["start"][:2] * 2)[:, None]
    told.metadata["world"]["geofence"]["polygon"]["edges"] = (middle + 0.2 * (edges - middle)).tolist()


def a_lower_ceiling(told: Told) -> None:
    """And up it goes, from where that is broken already."""
    the_plan(told)["direction"] = [0.0, 0.0, -1.0]
    told.metadata["world"]["geofence"]["ceiling_amsl_m"] = ORIGIN_AMSL_M - the_plan(told)["start"][2] + 0.5


def an_operator_below(told: Told) -> None:
    north, east, _ = ahead(told, 0.5)
    told.metadata["operator"]["position"] = [north, east, 0.0]


def a_small(section: str, key: str, value: float) -> Edit:
    def edit(told: Told) -> None:
        assert key in told.metadata["settings"][section]
        told.metadata["settings"][section][key] = value

    return edit


def of_the_plan(change: Callable[[dict[str, Any]], None]) -> Edit:
    return lambda told: change(the_plan(told))


def before_it(topic: str, change: Callable[[dict[str, Any]], None]) -> Edit:
    """Change the last such message before the plan."""

    def edit(told: Told) -> None:
        began_s = told.of("plan")[JUDGED][0]
        change([data for t_s, data in told.of(topic) if t_s <= began_s][-1])

    return edit


def somebody(
    above_m: float, *, age_s: float = 0.0, velocity: tuple[float, float, float] = (0.0, 0.0, 0.0), along_m: float = 0.5
) -> Edit:
    """above_m over a place on the plan's line, as told when it began."""

    def edit(told: Told) -> None:
        began_s = told.of("plan")[JUDGED][0]
        place = ahead(told, along_m)
        place[2] -= above_m
        sky = [data for t_s, data in told.of("neighbours") if t_s <= began_s][-1]["neighbours"]
        sky["names"] = ["zoe"]
        sky["positions_ned_m"], sky["velocities_ned_m_s"] = [place], [list(velocity)]
        sky["sigmas_m"], sky["at_s"] = [0.1], [STARTED_S + began_s - age_s]

    return edit


def crossing(told: Told) -> None:
    """20 m above when the plan begins, and through its line 5 s later."""
    somebody(20.0, velocity=(0.0, 0.0, 4.0))(told)


def a_reservation(told: Told) -> None:
    began_s = told.of("plan")[JUDGED][0]
    volume = {
        "holder": "zoe", "start": ahead(told, 0.5), "end": ahead(told, 3.0), "radius_m": 1.0,
        "from_s": STARTED_S + began_s, "until_s": STARTED_S + began_s + 30.0,
    }  # fmt: skip
    [data for t_s, data in told.of("reservations") if t_s <= began_s][-1]["volumes"] = [volume]


def longer(plan: dict[str, Any]) -> None:
    plan["move"]["distance"] = 1.5


PLANS: dict[str, tuple[Edit, str]] = {
    "ground": (lambda told: raise_the_ground(told, 2.5), "agl"),
    "spike": (a_spike, "terrain_clearance"),
    "unknown ground": (a_hole, "terrain_clearance"),
    "terrain's accuracy": (lambda told: told.metadata["world"]["terrain"].update(sigma_m=2.5), "terrain_confidence"),
    "terrain missing": (lambda told: told.metadata["world"].update(terrain=None), "terrain_clearance"),
    "pole": (a_wall, "obstacle_clearance"),
    "fence": (a_closer_fence, "geofence"),
    "ceiling": (a_lower_ceiling, "geofence"),
    "operator": (an_operator_below, "standoff"),
    "workspace": (a_small("workspace", "workspace_m", 1.2), "workspace"),
    "session": (a_small("workspace", "session_m", 1.2), "session"),
    "length": (of_the_plan(longer), "envelope"),
    "speed": (of_the_plan(lambda plan: plan["move"].update(speed=0.6, acceleration=1.0)), "envelope"),
    "descent": (of_the_plan(lambda plan: plan.update(direction=[0.0, 0.0, 1.0])), "envelope"),
    "turn": (of_the_plan(lambda plan: plan["turn"].update(distance=90.0, speed=45.0)), "envelope"),
    "duration": (of_the_plan(lambda plan: plan.update(max_duration_s=60.0)), "envelope"),
    "coasting told": (of_the_plan(lambda plan: plan.update(stop_m=0.1)), "envelope"),
    "start": (of_the_plan(lambda plan: plan.update(start=[c + 0.3 for c in plan["start"]])), "envelope"),
    "moving": (before_it("telemetry", lambda data: data.update(velocity=[0.5, 0.0, 0.0])), "envelope"),
    "not a number": (of_the_plan(lambda plan: plan["move"].update(distance=math.nan)), "envelope"),
    "neighbour": (somebody(0.0, along_m=5.0), "separation"),
    "crossing": (crossing, "separation"),
    "silent": (somebody(20.0, age_s=5.0), "neighbour_age"),
    "dead feed": (
        before_it("neighbours", lambda data: data["neighbours"].update(feed_at_s=STARTED_S)),
        "neighbour_age",
    ),
    "reservation": (a_reservation, "reservation"),
    "accuracy": (before_it("telemetry", lambda data: data.update(sigma_h_m=3.0)), "localization"),
    "no accuracy": (before_it("telemetry", lambda data: data.update(sigma_h_m=math.nan)), "localization"),
    "old telemetry": (before_it("telemetry", lambda data: data.update(at_s=data["at_s"] - 2.0)), "telemetry_age"),
    "confidence": (lambda told: [d.update(confidence=0.6) for _, d in told.of("request")], "input_confidence"),
}


@pytest.mark.parametrize("edit", list(PLANS))
def test_a_plan_that_breaks_a_limit_is_found(flown: Told, edit: str) -> None:
    told = flown.copy()
    change, limit = PLANS[edit]
    change(told)
    assert ("plan", limit) in failing(told)


@pytest.mark.requirement("X13")
def test_what_is_broken_already_may_be_mended_and_nothing_else(flown: Told) -> None:
    """Down from a ceiling that it is too close to; the same plan up is found above."""
    told = flown.copy()
    plan = told.of("plan")[0][1]["plan"]
    told.metadata["world"]["geofence"]["ceiling_amsl_m"] = ORIGIN_AMSL_M - plan["start"][2] + 0.5
    lines = [x for x in judged(told).lines if (x.part, x.limit, x.note[:5]) == ("plan", "geofence", "floor")]
    assert lines[0].passed
    assert lines[0].margin < 0.0
    assert "mended" in lines[0].note


def test_a_margin_is_the_distance_itself(flown: Told) -> None:
    """A neighbour that hovers 10 m above the line: 10 m less all that must be kept."""
    told = flown.copy()
    somebody(10.0)(told)
    (line,) = [x for x in judged(told).lines if (x.part, x.limit, x.note) == ("plan", "separation", "zoe")]
    assert line.margin == pytest.approx(10.0 - (3.0 + 0.3 + 2.0 * (0.35 + 0.1)), abs=1e-3)


# ---------------------------------------------------------------- telemetry


def in_flight(told: Told) -> dict[str, Any]:
    """A sample half a second into the first motion."""
    began_s = told.of("plan")[JUDGED][0]
    return next(data for t_s, data in told.of("telemetry") if t_s >= began_s + 0.5)


def moved(place: Callable[[Told, list[float]], list[float]]) -> Edit:
    def edit(told: Told) -> None:
        sample = in_flight(told)
        sample["position"] = place(told, sample["position"])

    return edit


def lowered(told: Told, place: list[float]) -> list[float]:
    """To 1 m above the ground."""
    terrain = told.metadata["world"]["terrain"]
    ground = Terrain(np.array(terrain["heights_amsl_m"]), (-40.0, -40.0), ((1.0, 0.0), (0.0, 1.0)), 0.1, ORIGIN_AMSL_M)
    return [place[0], place[1], place[2] + float(ground.agl_m(np.array([place]))[0]) - 1.0]


def into_the_wall(told: Told, place: list[float]) -> list[float]:
    edges = np.array(told.metadata["world"]["obstacles"]["polygons"]["edges"])
    return [edges[0, 0], edges[1, 0], place[2]]


def met(told: Told) -> None:
    """Somebody told to be 2 m beside the sample."""
    began_s = told.of("plan")[JUDGED][0]
    somebody(2.0)(told)
    place = in_flight(told)["position"]
    sky = [data for t_s, data in told.of("neighbours") if t_s <= began_s + 0.5][-1]["neighbours"]
    sky.update(
        names=["zoe"], positions_ned_m=[[place[0], place[1], place[2] - 2.0]], velocities_ned_m_s=[[0.0, 0.0, 0.0]],
        sigmas_m=[0.1], at_s=[STARTED_S + began_s + 0.5],
    )  # fmt: skip


def dashes(told: Told) -> None:
    """From here on it is half a metre farther than it was."""
    began_s = told.of("plan")[JUDGED][0]
    for t_s, data in told.of("telemetry"):
        if t_s >= began_s + 1.0:
            data["position"][2] -= 0.5


TELEMETRY: dict[str, tuple[Edit, str]] = {
    "ground": (moved(lowered), "terrain_clearance"),
    "height": (moved(lowered), "agl"),
    "wall": (moved(into_the_wall), "obstacle_clearance"),
    "fence": (moved(lambda _, p: [p[0] + 15.0, p[1], p[2]]), "geofence"),
    "ceiling": (moved(lambda _, p: [p[0], p[1], p[2] - 4.5]), "geofence"),
    "operator": (moved(lambda _, p: [1.0, 0.0, p[2]]), "standoff"),
    "workspace": (moved(lambda _, p: [p[0], p[1], p[2] - 5.5]), "workspace"),
    "session": (moved(lambda _, p: [p[0], p[1], p[2] - 60.0]), "session"),
    "neighbour": (met, "separation"),
    "speed": (dashes, "speed"),
    "nowhere": (moved(lambda _, p: [math.nan, p[1], p[2]]), "position"),
}


@pytest.mark.requirement("R9")
@pytest.mark.parametrize("edit", list(TELEMETRY))
def test_a_sample_beyond_a_limit_is_found(flown: Told, edit: str) -> None:
    told = flown.copy()
    change, limit = TELEMETRY[edit]
    change(told)
    assert ("telemetry", limit) in failing(told)


def test_what_the_drone_does_when_it_is_not_ours_is_not_ours_to_answer_for(flown: Told) -> None:
    told = flown.copy()
    before = next(data for t_s, data in told.of("telemetry"))
    before["position"] = [0.0, 0.0, 50.0]
    assert failing(told) == set()


# ---------------------------------------------------------------- the account


def without(topic: str, **wanted: object) -> Edit:
    """Lose the first such message."""

    def edit(told: Told) -> None:
        i = next(
            i
            for i, (name, _, data) in enumerate(told.messages)
            if name == topic and all(data[k] == v for k, v in wanted.items())
        )
        del told.messages[i]

    return edit


def twice(topic: str, **wanted: object) -> Edit:
    def edit(told: Told) -> None:
        i = next(
            i
            for i, (name, _, data) in enumerate(told.messages)
            if name == topic and all(data[k] == v for k, v in wanted.items())
        )
        told.messages.insert(i, told.messages[i])

    return edit


ACCOUNT: dict[str, tuple[Edit, str]] = {
    "no verdict": (without("decision", verdict="rejected"), "verdict"),
    "two verdicts": (twice("decision", verdict="approved"), "verdict"),
    "unasked": (without("request", command="go_down"), "verdict"),
    "no end of a motion": (without("motion", status="completed"), "motion"),
    "no start of a motion": (without("motion", status="started"), "motion"),
    "no plan": (without("plan"), "grant"),
    "no grant": (without("decision", verdict="approved"), "grant"),
    "longer than granted": (of_the_plan(lambda plan: plan["move"].update(distance=0.99)), "grant"),
    "gap": (lambda told: told.messages.append(("record_gap", 1.0, {"dropped": 3})), "gapless"),
    "no end": (without("end"), "complete"),
}


@pytest.mark.parametrize("edit", list(ACCOUNT))
def test_an_account_that_is_not_whole_is_found(flown: Told, edit: str) -> None:
    told = flown.copy()
    change, limit = ACCOUNT[edit]
    change(told)
    assert ("record", limit) in failing(told)


def test_a_record_that_was_cut_off_does_not_hold(flown: Told) -> None:
    assert {line.limit for line in judged(flown, closed=False).failing} == {"complete"}


def test_what_no_m3r_writes_is_one_sentence(flown: Told) -> None:
    told = flown.copy()
    del told.of("plan")[0][1]["plan"]["move"]
    with pytest.raises(EvidenceError, match="it holds what no m3r writes"):
        judged(told)


@pytest.mark.soak
def test_the_judge_agrees_with_what_was_granted_in_200_flights() -> None:
    flights = [RecordedFlight(seed).told() for seed in range(100, 300)]
    judgements = [judged(told) for told in flights]
    assert [found for told in flights for found in disagreements(told).items()] == []
    assert sum(found.plans for found in judgements) > 500
    assert [line for found in judgements for line in found.failing] == []
