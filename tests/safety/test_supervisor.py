"""The safety decision: Safe as a conjunction; shortened, delayed, replaced or rejected otherwise. P2, P3, R3-R8, R11, X6, X13."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from safety.constraints import RULES
from safety.limits import Limits
from safety.obstacles import Obstacles
from safety.planner import swept
from safety.situation import Situation
from safety.supervisor import assess, decide, decide_plan, interpret, later, propose, safe
from safety.terrain import Terrain
from safety.vocabulary import (
    PRIMITIVE_OF,
    Anchor,
    Command,
    Decision,
    ManeuverRequest,
    Modality,
    Ned,
    Neighbours,
    Operator,
    Primitive,
    ReservedVolume,
    Verdict,
)  # fmt: skip
from tests.safety.scene import LIMITS, NOW_S, START, situation, sky, square_fence, vehicle, wall, world

MOVES = [Command.GO_LEFT, Command.GO_RIGHT, Command.GO_FORWARD, Command.GO_BACK, Command.GO_UP, Command.GO_DOWN]
"""The scene's operator is 10 m south of the drone, so forward is north."""


def asked(command: Command, confidence: float = 0.9) -> ManeuverRequest:
    return ManeuverRequest("r1", command, Modality.VOICE, confidence, NOW_S, NOW_S)


def decided(command: Command, about: Situation, limits: Limits = LIMITS, **how: Any) -> Decision:
    request = asked(command)
    return decide(request, interpret(request, limits), about, limits, **how)


def facing(**changes: Any) -> Situation:
    """The nose on the operator."""
    about = situation(**changes)
    return replace(about, vehicle=replace(about.vehicle, yaw_deg=180.0))


# ---------------------------------------------------------------- approved


@pytest.mark.requirement("R1", "R2")
@pytest.mark.parametrize("command", list(PRIMITIVE_OF))
def test_in_the_open_everything_is_approved_whole(command: Command) -> None:
    """R1, R2: every command is its own primitive, and yields a plan of that, judged by every rule."""
    decision = decided(command, facing())
    assert decision.verdict is Verdict.APPROVED
    assert decision.primitive is PRIMITIVE_OF[command]
    assert {f.constraint for f in decision.findings} == {rule.name for rule in RULES}
    assert decision.plan is not None
    expected = None if decision.primitive.is_scan else decision.plan.length_m
    assert decision.requested_m == decision.granted_m == expected


@pytest.mark.requirement("R1")
@pytest.mark.parametrize("command", [c for c in Command if c not in PRIMITIVE_OF])
def test_what_is_no_maneuver_is_not_interpreted(command: Command) -> None:
    with pytest.raises(KeyError):
        interpret(asked(command), LIMITS)


# ---------------------------------------------------------------- unknown is never a yes


NO = math.nan
UNKNOWN: dict[str, dict[str, Any]] = {
    "telemetry": {"vehicle": vehicle(at_s=NOW_S - 10.0)},
    "time": {"vehicle": vehicle(at_s=NO)},
    "position": {"vehicle": vehicle(position=Ned(NO, 0.0, -10.0))},
    "height": {"vehicle": vehicle(position=Ned(0.0, 0.0, NO))},
    "heading": {"vehicle": vehicle(yaw_deg=NO)},
    "level accuracy": {"vehicle": vehicle(sigma_h_m=NO)},
    "height accuracy": {"vehicle": vehicle(sigma_v_m=NO)},
    "impossible accuracy": {"vehicle": vehicle(sigma_h_m=-1.0)},
    "terrain": {"world": world(terrain=None)},
    "terrain accuracy": {"world": world(terrain=Terrain.flat(0.0, NO, 0.0))},
    "neighbours": {"neighbours": Neighbours.none(-math.inf)},
    "neighbours lately": {"neighbours": Neighbours.none(NOW_S - 1.5)},
    "a neighbour's place": {"neighbours": sky(("blue", Ned(NO, 0.0, 0.0), Ned(0.0, 0.0, 0.0), 0.1, NOW_S))},
    "a neighbour's velocity": {"neighbours": sky(("blue", Ned(50.0, 0.0, 0.0), Ned(NO, 0.0, 0.0), 0.1, NOW_S))},
    "a neighbour's accuracy": {"neighbours": sky(("blue", Ned(50.0, 0.0, 0.0), Ned(0.0, 0.0, 0.0), NO, NOW_S))},
    "operator": {"operator": Operator(Ned(NO, 0.0, 0.0), 0.1)},
    "operator's accuracy": {"operator": Operator(Ned(-10.0, 0.0, 0.0), NO)},
    "anchor": {"anchor": Anchor(Ned(NO, 0.0, 0.0), 180.0, NOW_S)},
    "session": {"session_centre": Ned(NO, 0.0, 0.0)},
    "volume": {"reservations": (ReservedVolume("blue", START, START, NO, NOW_S, NOW_S + 9.0),)},
    "authority": {"authority": False},
}


@pytest.mark.requirement("X6")
@pytest.mark.parametrize("missing", list(UNKNOWN))
@pytest.mark.parametrize("command", [Command.GO_LEFT, Command.GO_DOWN, Command.TURN_LEFT])
def test_what_is_unknown_is_never_a_yes(missing: str, command: Command) -> None:
    """X6: each input missing in turn, and it does not raise either."""
    decision = decided(command, replace(facing(), **UNKNOWN[missing]), may_delay=False)
    assert decision.verdict is Verdict.REJECTED
    assert decision.plan is None
    assert decision.failing
    assert all(f.text and "nan" not in f.text for f in decision.failing)


@pytest.mark.requirement("P2", "G1")
@pytest.mark.parametrize("confidence", [0.69999, 0.0, -0.1, 1.1, NO])
def test_doubtful_input_is_rejected(confidence: float) -> None:
    """P2, G1."""
    request = asked(Command.GO_LEFT, confidence)
    decision = decide(request, interpret(request, LIMITS), facing(), LIMITS)
    assert decision.verdict is Verdict.REJECTED
    assert [f.constraint for f in decision.failing] == ["input_confidence"]


@pytest.mark.requirement("P2")
def test_every_failing_rule_is_told() -> None:
    about = facing(
        world=world(obstacles=wall(1.0), geofence=square_fence(0.5)),
        anchor=Anchor(Ned(-4.5, 0.0, -10.0), 180.0, NOW_S),
        authority=False,
    )
    failing = {f.constraint for f in decided(Command.GO_FORWARD, about).failing}
    assert {"obstacle_clearance", "geofence", "authority", "workspace"} <= failing


# ---------------------------------------------------------------- shorter


def is_safe(command: Command, length_m: float, about: Situation, limits: Limits = LIMITS) -> bool:
    request = asked(command)
    intent = replace(interpret(request, limits), amount=length_m)
    return safe(assess(propose(intent, about, limits), request, about, limits))


@pytest.mark.requirement("P3")
@settings(max_examples=25)
@given(st.floats(1.5, 5.0), st.floats(0.0, 0.5))
def test_reduced_is_the_longest_safe_one_at_a_wall(wall_m: float, sigma_m: float) -> None:
    """P3: as safe as what it replaces in every rule, and within a bisection step of the longest, by brute force."""
    about = facing(world=world(obstacles=wall(wall_m)), vehicle=vehicle(sigma_h_m=sigma_m, sigma_v_m=sigma_m))
    about = replace(about, vehicle=replace(about.vehicle, yaw_deg=180.0))
    decision = decided(Command.GO_FORWARD, about)
    lengths = np.arange(LIMITS.shortest_m, 1.0 + 1e-9, 0.01)
    longest_m = max((float(m) for m in lengths if is_safe(Command.GO_FORWARD, float(m), about)), default=None)
    if decision.granted_m is None:
        assert decision.verdict is Verdict.REJECTED
        assert longest_m is None
        return
    assert longest_m is not None
    assert longest_m - LIMITS.bisection_m - 0.01 <= decision.granted_m <= longest_m + 0.01
    assert decision.granted_m >= LIMITS.shortest_m
    no_less_safe(decision)


def no_less_safe(decision: Decision) -> None:
    before = {f.constraint: f.margin for f in decision.findings}
    assert all(f.passed for f in decision.granted_findings)
    assert {f.constraint for f in decision.granted_findings} == set(before)
    for f in decision.granted_findings:
        margin = before[f.constraint]
        # Rules of time (separation) may differ by what others fly meanwhile; what stands still may not.
        if f.margin is not None and margin is not None and f.constraint not in ("separation", "envelope"):
            assert f.margin >= margin - 1e-6, f.constraint


@pytest.mark.requirement("R4", "P3")
@settings(max_examples=25)
@given(st.floats(2.0, 3.6), st.floats(0.0, 0.3))
def test_reduced_is_the_longest_safe_one_above_the_ground(height_m: float, sigma_m: float) -> None:
    start = Ned(0.0, 0.0, -height_m)
    about = facing(
        vehicle=vehicle(position=start, sigma_h_m=sigma_m, sigma_v_m=sigma_m, yaw_deg=180.0),
        anchor=Anchor(start, 180.0, NOW_S),
    )
    about = replace(about, vehicle=replace(about.vehicle, yaw_deg=180.0))
    decision = decided(Command.GO_DOWN, about)
    lengths = np.arange(LIMITS.shortest_m, 0.5 + 1e-9, 0.01)
    longest_m = max((float(m) for m in lengths if is_safe(Command.GO_DOWN, float(m), about)), default=None)
    assert (decision.granted_m is None) == (longest_m is None)
    if decision.granted_m is not None and longest_m is not None:
        assert longest_m - LIMITS.bisection_m - 0.01 <= decision.granted_m <= longest_m + 0.01
        no_less_safe(decision)


@pytest.mark.requirement("X11")
@settings(max_examples=25)
@given(st.floats(0.0, 0.6), st.floats(0.0, 0.6), st.floats(1.6, 4.5), st.sampled_from(MOVES))
def test_more_uncertainty_never_permits_more(a: float, b: float, wall_m: float, command: Command) -> None:
    """X11."""
    low, high = sorted((a, b))
    granted = []
    for sigma_m in (low, high):
        drone = vehicle(sigma_h_m=sigma_m, sigma_v_m=sigma_m, yaw_deg=180.0)
        about = situation(world=world(obstacles=wall(wall_m)), vehicle=drone)
        # Where a limit is broken already, more doubt may turn "fits" into "mends": only what begins inside is compared.
        if sigma_m == high and any(
            f.margin is not None and f.margin < 0.0 and f.passed for f in decided(command, about).granted_findings
        ):
            return
        granted.append(decided(command, about).granted_m or 0.0)
    assert granted[1] <= granted[0] + LIMITS.bisection_m


@settings(max_examples=25)
@given(st.floats(1.2, 4.0), st.floats(-1e-4, 1e-4))
def test_margins_are_continuous(wall_m: float, shift_m: float) -> None:
    """A hair's breadth in the world is a hair's breadth in every margin."""
    pair = [
        {f.constraint: f.margin for f in decided(Command.GO_FORWARD, facing(world=world(obstacles=wall(m)))).findings}
        for m in (wall_m, wall_m + shift_m)
    ]
    for name, margin in pair[0].items():
        other = pair[1][name]
        assert (margin is None) == (other is None)
        if margin is not None and other is not None:
            assert abs(margin - other) <= abs(shift_m) + 1e-9


@pytest.mark.parametrize(("spare_m", "verdict"), [(-0.005, Verdict.REJECTED), (0.005, Verdict.REDUCED)])
def test_a_tenth_of_a_metre_must_fit(spare_m: float, verdict: Verdict) -> None:
    least = propose(replace(interpret(asked(Command.GO_FORWARD), LIMITS), amount=LIMITS.shortest_m), facing(), LIMITS)
    needed_m = LIMITS.shortest_m + least.stop_m + LIMITS.obstacle_clearance_m + LIMITS.tracking_m
    assert decided(Command.GO_FORWARD, facing(world=world(obstacles=wall(needed_m + spare_m)))).verdict is verdict


@pytest.mark.requirement("X9")
@pytest.mark.parametrize("command", [Command.TURN_LEFT, Command.TURN_RIGHT])
def test_scans_are_never_shortened(command: Command) -> None:
    coming = sky(("blue", Ned(14.0, 0.0, -10.0), Ned(-2.0, 0.0, 0.0), 0.0, NOW_S))
    decision = decided(command, facing(neighbours=coming))
    assert decision.verdict is Verdict.REJECTED
    assert decision.requested_m is decision.granted_m is decision.plan is None


@pytest.mark.requirement("P3")
def test_a_shorter_one_keeps_the_direction() -> None:
    decision = decided(Command.GO_FORWARD, facing(world=world(obstacles=wall(3.0))))
    assert decision.verdict is Verdict.REDUCED
    assert decision.plan is not None
    assert decision.plan.direction == pytest.approx(Ned(1.0, 0.0, 0.0))


# ---------------------------------------------------------------- recovery: X13


@pytest.mark.requirement("X13")
@settings(max_examples=25)
@given(st.floats(0.1, 1.7), st.sampled_from(MOVES))
def test_out_of_a_violation_only_by_mending_it(wall_m: float, command: Command) -> None:
    """Design 8: too close to a wall already; what is granted never comes closer, and nothing else fails."""
    about = facing(world=world(obstacles=wall(wall_m)))
    decision = decided(command, about)
    if decision.plan is None:
        assert decision.failing
        return
    plan, obstacles = decision.plan, about.world.obstacles
    points = np.array([plan.position(t) for t in np.linspace(0.0, plan.duration_s, 40)])
    distances = obstacles.distance_m(points)[:, 0]
    assert (np.diff(distances) >= -1e-6).all()
    assert all(f.passed for f in decision.granted_findings)


@pytest.mark.requirement("X13")
def test_mending_one_limit_does_not_excuse_another() -> None:
    obstacles = Obstacles.of(
        ["wall", "fence"],
        [_slab(1.0), _slab(-3.0)],
        [0.0, 0.0],
        [30.0, 30.0],
        0.0,
    )
    decision = decided(Command.GO_BACK, facing(world=world(obstacles=obstacles)))
    assert decision.verdict in (Verdict.REDUCED, Verdict.REJECTED)


def _slab(north_m: float) -> Any:
    return shapely.box(north_m, -50.0, north_m + 1.0, 50.0)


# ---------------------------------------------------------------- delay: design 7


def lease(until_s: float) -> ReservedVolume:
    ahead = Ned(2.0, 0.0, -10.0)
    return ReservedVolume("blue", ahead, ahead, 1.6, NOW_S, until_s)


@pytest.mark.parametrize(("ends_s", "verdict"), [(1.0, Verdict.DELAYED), (2.9, Verdict.DELAYED)])
def test_a_lease_about_to_end_delays(ends_s: float, verdict: Verdict) -> None:
    about = facing(reservations=(lease(NOW_S + ends_s),))
    assert decided(Command.GO_FORWARD, about).verdict is verdict
    assert decided(Command.GO_FORWARD, about, may_delay=False).verdict is not Verdict.DELAYED


def test_a_longer_lease_does_not_delay() -> None:
    assert decided(Command.GO_FORWARD, facing(reservations=(lease(NOW_S + 60.0),))).verdict is not Verdict.DELAYED


def test_a_lease_without_times_is_a_lease() -> None:
    about = facing(reservations=(replace(lease(NOW_S), from_s=NO, until_s=NO),))
    assert decided(Command.GO_FORWARD, about).verdict in (Verdict.REDUCED, Verdict.REJECTED)


def test_only_one_passing_hindrance_delays() -> None:
    """Two failing, or one that does not pass by itself: no delay."""
    both = facing(reservations=(lease(NOW_S + 1.0),), world=world(obstacles=wall(1.9)))
    assert decided(Command.GO_FORWARD, both).verdict is not Verdict.DELAYED
    assert decided(Command.GO_FORWARD, facing(world=world(obstacles=wall(1.9)))).verdict is not Verdict.DELAYED


@pytest.mark.requirement("R11")
@pytest.mark.parametrize(("age_s", "verdict"), [
    (0.9, Verdict.APPROVED), (1.1, Verdict.DELAYED), (3.9, Verdict.DELAYED), (4.1, Verdict.REJECTED),
    (math.inf, Verdict.REJECTED),
])  # fmt: skip
def test_a_feed_may_come_back(age_s: float, verdict: Verdict) -> None:
    assert decided(Command.GO_LEFT, facing(neighbours=Neighbours.none(NOW_S - age_s))).verdict is verdict


def test_an_aircraft_that_flies_away_delays() -> None:
    leaving = sky(("blue", Ned(4.0, 0.0, -10.0), Ned(4.0, 0.0, 0.0), 0.0, NOW_S))
    about = facing(neighbours=leaving)
    decision = decided(Command.GO_LEFT, about)
    assert decision.verdict in (Verdict.APPROVED, Verdict.DELAYED)
    assert later(about, 2.0).neighbours.positions_ned_m[0, 0] == pytest.approx(12.0)


# ---------------------------------------------------------------- replace: design 7


def test_a_slower_one_is_offered_only_if_asked_for() -> None:
    limits = replace(LIMITS, lateral_step_m=0.1)
    least = propose(interpret(asked(Command.GO_FORWARD), limits), facing(), limits)
    at_m = limits.lateral_step_m + least.stop_m + limits.obstacle_clearance_m + limits.tracking_m - 0.05
    about = facing(world=world(obstacles=wall(at_m)))
    assert decided(Command.GO_FORWARD, about, limits).verdict is Verdict.REJECTED
    offered = decided(Command.GO_FORWARD, about, limits, offer=True)
    assert offered.verdict is Verdict.REPLACED
    assert offered.plan is None, "an offer is not to be flown"
    assert offered.granted_m is None
    request = asked(Command.CONTINUE)
    intent = replace(interpret(asked(Command.GO_FORWARD), limits), slowness=offered.slowness)
    assert decide(request, intent, about, limits).verdict is Verdict.APPROVED


def test_a_slower_one_is_not_offered_into_the_way_of_who_comes_later() -> None:
    """It lasts longer than the faster plan, and somebody who did not matter to that one meets it."""
    limits = replace(LIMITS, lateral_step_m=0.1, horizon_s=0.0)
    intent = interpret(asked(Command.GO_FORWARD), limits)
    fast = propose(intent, facing(), limits)
    slow = propose(replace(intent, slowness=4.0), facing(), limits)
    at_m = limits.lateral_step_m + fast.stop_m + limits.obstacle_clearance_m + limits.tracking_m - 0.05
    here = facing().vehicle.position
    ends_s = swept(slow, limits).times_s[-1]
    assert ends_s > swept(fast, limits).times_s[-1] + 0.1

    def offered(arrives_s: float) -> Verdict:
        others = sky(
            ("hovering", here.plus(Ned(0.0, 9.0, 0.0)), Ned(0.0, 0.0, 0.0), 0.0, NOW_S),
            ("coming", here.plus(Ned(0.0, -100.0 * arrives_s, 0.0)), Ned(0.0, 100.0, 0.0), 0.0, NOW_S),
        )
        about = facing(world=world(obstacles=wall(at_m)), neighbours=others)
        return decided(Command.GO_FORWARD, about, limits, offer=True).verdict

    assert offered(ends_s + 0.1) is Verdict.REPLACED
    assert offered(ends_s - 0.02) is Verdict.REJECTED


# ---------------------------------------------------------------- one plan, all or nothing


def test_a_return_needs_no_input_and_is_not_shortened() -> None:
    about = facing(anchor=Anchor(Ned(2.0, 0.0, -10.0), 180.0, NOW_S))
    plan = propose(replace(interpret(asked(Command.GO_LEFT), LIMITS), primitive=Primitive.RETURN), about, LIMITS)
    decision = decide_plan("return", plan, None, about, LIMITS)
    assert decision.verdict is Verdict.APPROVED
    assert "input_confidence" not in {f.constraint for f in decision.findings}
    walled = replace(about, world=world(obstacles=wall(1.9)))
    assert decide_plan("return", plan, None, walled, LIMITS).verdict is Verdict.REJECTED
