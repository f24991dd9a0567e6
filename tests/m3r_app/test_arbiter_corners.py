"""What seldom happens to the arbiter, and must come out right all the same."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from m3r_app.arbiter import decisions, execution, wording
from m3r_app.arbiter.announcements import Announce
from m3r_app.arbiter.context import Step, impossible
from m3r_app.arbiter.effects import CallOffPairing, FaceOperator, Hold, ImpossibleTransition, LetGo
from m3r_app.arbiter.events import ClaimLost, FrameMoved, Requested, ReservationAnswered, Tick
from m3r_app.arbiter.fusion import fused
from m3r_app.arbiter.preview import WAITS, preview
from m3r_app.arbiter.state import ArbiterState, Leftover, Policy
from m3r_app.arbiter.step import step
from m3r_app.output import Notice
from safety.estimate import ASTRAY
from safety.limits import Limits
from safety.supervisor import Intent
from safety.vocabulary import (
    Cause,
    Command,
    Decision,
    Finding,
    FlightMode,
    Modality,
    Ned,
    Operator,
    Primitive,
    State,
    VehicleState,
    Verdict,
)
from tests.m3r_app.tabletop import DT_S, PLACE, Tabletop
from tests.m3r_app.test_arbiter import ball, delayed, facing, flying, held, pairing, settling, waiting, wall_at


def test_an_impossible_transition_is_an_effect() -> None:
    assert impossible(State.IDLE, Cause.STOP) == ImpossibleTransition(State.IDLE, Cause.STOP)


def test_a_step_without_session_or_telemetry_says_so() -> None:
    run = Step(ArbiterState(Limits(), Policy()), 0.0)
    with pytest.raises(RuntimeError, match="no session"):
        _ = run.session
    with pytest.raises(RuntimeError, match="no telemetry"):
        _ = run.vehicle


@pytest.mark.requirement("X6")
def test_a_request_while_nothing_was_ever_heard_is_refused() -> None:
    table = Tabletop().paired()
    table.state = replace(table.state, vehicle=None)
    name = table.ask(Command.GO_LEFT)
    assert table.verdicts(name) == ["rejected"]
    assert table.failing(name) == {"localization"}
    assert table.state.state is State.BLOCKED


def test_what_is_not_approved_is_not_reserved() -> None:
    table = Tabletop().paired()
    no = Decision("r1", Primitive.MOVE_LEFT, Verdict.REJECTED, 1.0, None, ())
    with pytest.raises(RuntimeError, match="carries its plan"):
        decisions.reserve(Step(table.state, table.now_s), None, decisions.BACK, no)


@pytest.mark.requirement("X12")
@pytest.mark.parametrize("command", [Command.TURN_LEFT, Command.GO_LEFT])
def test_of_what_is_as_good_as_done_stop_leaves_nothing(command: Command) -> None:
    table = Tabletop().paired()
    table.ask(command)
    flight = table.state.flight
    assert flight is not None
    table.until(lambda: table.now_s - flight.started_at_s >= flight.plan.duration_s - 0.05, 60.0)
    assert table.state.flight is not None
    table.ask(Command.STOP)
    assert table.state.leftover is None


@pytest.mark.requirement("X6")
def test_a_frame_that_moves_before_anything_is_paired_moves_nothing() -> None:
    table = Tabletop()
    after, effects = step(table.state, FrameMoved("its estimator moved"), table.now_s)
    assert effects == ()
    assert after == table.state


@pytest.mark.requirement("X5")
def test_a_contradiction_of_what_was_refused_refuses_both_where_it_hovers() -> None:
    table = Tabletop(world=replace(Tabletop().world, obstacles=wall_at(12.05))).paired()
    first = table.ask(Command.GO_FORWARD)
    table.tick()
    second = table.ask(Command.GO_BACK, Modality.GESTURE)
    assert table.verdicts(first) == table.verdicts(second) == ["rejected"]
    assert table.failing(second) == {"contradiction"}
    assert table.state.state is State.ARMED


@pytest.mark.requirement("R10")
def test_no_way_back_is_announced_to_where_nobody_can_face() -> None:
    table = held()
    session = table.state.session
    assert session is not None
    nowhere = Operator(Ned(math.nan, 0.0, 0.0), 0.1)
    table.state = replace(table.state, session=replace(session, operator=nowhere))
    table.wait(6.0)
    assert table.state.state is State.EMERGENCY_HOLD
    assert table.state.return_at_s is None


@pytest.mark.requirement("R10", "X13")
def test_a_limit_that_was_broken_before_and_gets_worse_is_told_once() -> None:
    """It moves away from one who is too near already, who then comes after it."""
    table = Tabletop().paired()
    near = table.position.plus(Ned(0.0, 2.6, 0.0))
    table.sky = ball("blue", near, Ned(0.0, 0.0, 0.0), table.now_s)
    table.wait(0.5)
    for command in (Command.GO_LEFT, Command.GO_RIGHT, Command.GO_BACK, Command.GO_FORWARD, Command.GO_UP):
        table.ask(command)
        if table.state.state is State.EXECUTING:
            break
    assert table.state.state is State.EXECUTING
    told = len([v for v in table.reports("violation") if v["kind"] == "actual" and v["constraint"] == "separation"])
    for _ in range(20):
        off = table.position.minus(near)
        near = near.plus(Ned(*(0.3 * c / off.norm for c in off)))
        table.sky = ball("blue", near, Ned(0.0, 0.0, 0.0), table.now_s)
        table.tick()
        if table.state.state is State.EMERGENCY_HOLD:
            break
    assert table.state.state is State.EMERGENCY_HOLD
    again = len([v for v in table.reports("violation") if v["kind"] == "actual" and v["constraint"] == "separation"])
    assert again == told


@pytest.mark.requirement("X4")
def test_pairing_is_called_off_once_however_often_stop_is_said() -> None:
    table = pairing()
    table.answers_pairing = False
    table.ask(Command.STOP)
    table.ask(Command.STOP)
    assert len(table.effects(CallOffPairing)) == 1


@pytest.mark.requirement("X6")
def test_a_drone_that_knows_again_where_it_is_is_not_told_to_land() -> None:
    table = held(policy=Policy(position_lost="land", return_to_anchor="never"))
    table.sigma_m = 50.0
    table.wait(1.0)
    assert table.state.unlocated_since_s is not None
    table.sigma_m = 0.1
    table.wait(5.0)
    assert table.state.unlocated_since_s is None
    assert table.state.state is State.EMERGENCY_HOLD


@pytest.mark.parametrize(
    ("said", "text"),
    [
        (Announce(Notice.ASKS_TO_RETURN, "red"), "Red: say continue to return to the anchor"),
        (Announce(Notice.NOTHING_TO_HOLD), "No drone: nothing to hold, this app has no authority over a drone"),
    ],
)
def test_sentences(said: Announce, text: str) -> None:
    assert said.text == text


@pytest.mark.parametrize(
    ("primitive", "verdict", "text"),
    [
        (Primitive.RETURN, Verdict.APPROVED, "Red: return to anchor 2.00 m"),
        (Primitive.MOVE_LEFT, Verdict.DELAYED, "Red: left waits a moment, "),
        (Primitive.MOVE_LEFT, Verdict.REPLACED, "Red: not left as asked, ; say continue to fly it slower"),
    ],
)
def test_decisions_in_words(primitive: Primitive, verdict: Verdict, text: str) -> None:
    decision = Decision("r1", primitive, verdict, 2.0, 2.0, ())
    assert wording.decided("red", "left", decision) == text


def test_a_preview_tells_the_answer_and_flies_nothing() -> None:
    table = Tabletop().paired()
    before = table.state
    found = preview(table.state, table.request(Command.GO_UP), table.now_s)
    assert found.decision is not None
    assert found.decision.verdict is Verdict.APPROVED
    assert found.text == "Red: up 0.50 m"
    assert not found.interrupts
    assert table.state is before


def test_a_preview_in_flight_says_that_it_interrupts_and_waits() -> None:
    table = flying()
    found = preview(table.state, table.request(Command.GO_UP), table.now_s)
    assert found.interrupts
    assert found.decision is None
    assert WAITS in found.text


def test_a_request_while_it_settles_waits() -> None:
    table = settling()
    after, _ = step(table.state, Requested(table.request(Command.GO_UP), 0.0), table.now_s)
    assert after.pending is not None


@pytest.mark.requirement("X6")
@pytest.mark.parametrize(("silent", "notice"), [(True, Notice.VEHICLE_SILENT), (False, Notice.LET_GO)])
def test_a_drone_that_fell_silent_is_told_as_that(silent: bool, notice: Notice) -> None:
    table = Tabletop().paired()
    table.put(ClaimLost("lost, silent for 5 s", silent=silent))
    assert table.effects(Announce)[-1].notice is notice
    assert table.state.state is State.IDLE


class Stuck(Tabletop):
    """From `stuck` on the position told stays what it was, on `axes`; the drone flies on as its plan's velocity says."""

    stuck: Ned | None = None
    axes = (True, True, True)

    def move(self) -> None:
        before, plan = self.position, self.plan
        super().move()
        if self.stuck is not None and plan is not None:
            until_s = min(self.now_s - self.since_s, plan.duration_s)
            since_s = min(max(0.0, self.now_s - self.since_s - DT_S), plan.duration_s)
            self.position = before.plus(plan.position(until_s).minus(plan.position(since_s)))

    def vehicle(self) -> VehicleState:
        told = super().vehicle()
        if self.stuck is None:
            return told
        axes = zip(self.axes, self.stuck, self.position, strict=True)
        return replace(told, position=Ned(*(stuck if held else true for held, stuck, true in axes)))

    def walk(self, commands: tuple[Command, ...], every_s: float) -> float:
        """Twelve requests; how far it has truly been from where its position stuck (m)."""
        start, far_m = self.stuck or self.position, 0.0
        for i in range(12):
            if self.state.session is not None:
                self.ask(commands[i % len(commands)])
            for _ in range(round(every_s / DT_S)):
                self.tick()
                far_m = max(far_m, self.position.minus(start).norm)
        return far_m


def stuck(limits: Limits | None = None, axes: tuple[bool, bool, bool] = (True, True, True)) -> Stuck:
    table = Stuck(limits=limits)
    table.paired()
    table.stuck, table.axes = table.position, axes
    return table


SMALL = replace(Limits(), lateral_step_m=0.4, vertical_step_m=0.3)
"""Steps that are over before the disagreement within them is too great: they end by their time, or are called done."""
HEIGHT = (False, False, True)


@pytest.mark.requirement("X6", "X11")
@pytest.mark.parametrize("every_s", [0.7, 2.0, 5.0, 12.0])
@pytest.mark.parametrize(
    ("limits", "commands", "axes"),
    [
        (None, (Command.GO_LEFT,), (True, True, True)),
        (None, (Command.GO_DOWN,), HEIGHT),
        (None, (Command.GO_DOWN, Command.GO_LEFT), (True, True, True)),
        (SMALL, (Command.GO_BACK,), (True, True, True)),
        (SMALL, (Command.GO_DOWN,), HEIGHT),
    ],
)
def test_nobody_walks_a_drone_away_from_a_stuck_position(
    limits: Limits | None, commands: tuple[Command, ...], axes: tuple[bool, bool, bool], every_s: float
) -> None:
    """At rest a stuck position is as good as any: without an end each next move would be granted from the same place."""
    table = stuck(limits, axes)
    step_m = table.state.limits.lateral_step_m
    assert table.walk(commands, every_s) <= step_m + ASTRAY * Limits().disagreement_m


@pytest.mark.requirement("X6", "X11")
def test_a_stuck_height_is_found_out_between_moves_that_are_followed() -> None:
    """A move to the side that the position shows says nothing of the height."""
    table = stuck(axes=HEIGHT)
    table.walk((Command.GO_DOWN, Command.GO_LEFT), 5.0)
    assert table.state.session is None
    assert table.position.down - PLACE.down <= 2.0 * Limits().vertical_step_m + 0.1


@pytest.mark.requirement("X6", "X11")
def test_what_a_stuck_position_missed_ends_the_session_in_hold() -> None:
    table = stuck()
    table.walk((Command.GO_LEFT,), 5.0)
    assert table.state.state is State.IDLE
    assert any("look after its GPS" in reason for reason in table.reports("pair")[-1]["reasons"])
    assert LetGo("hold") in table.log


@pytest.mark.requirement("X6")
def test_a_move_and_its_way_back_that_were_missed_are_no_walk() -> None:
    """What was missed one way and then the other leaves the drone where its position says."""
    table = stuck()
    assert table.walk((Command.GO_LEFT, Command.GO_RIGHT), 5.0) <= Limits().lateral_step_m
    assert len(table.motions("aborted")) >= 2
    assert table.state.session is not None
    assert table.state.session.astray.norm <= ASTRAY * Limits().disagreement_m


@pytest.mark.requirement("X6", "X11")
def test_a_request_that_interrupts_is_refused_where_the_position_has_missed_too_much() -> None:
    """It is decided in the step in which the drone comes to rest, before the session's end is looked at."""
    table = Tabletop().paired()
    session = table.state.session
    assert session is not None
    table.state = replace(table.state, session=replace(session, astray=Ned(0.0, 0.8, 0.0)))
    request_id = table.ask(Command.GO_LEFT)
    assert table.verdicts(request_id) == ["rejected"]
    assert "localization" in table.failing(request_id)


# ---------------------------------------------------------------- where a maneuver is over


def over(
    command: Command = Command.GO_LEFT, *, off_m: float = 0.0, off_deg: float = 0.0, late_s: float = 1.0
) -> Tabletop:
    """At rest late_s after the move's time is over, this far off its goal and its heading."""
    table = Tabletop().paired()
    table.ask(command)
    flight = table.state.flight
    assert flight is not None
    plan = flight.plan
    table.until(lambda: table.now_s - flight.started_at_s >= plan.duration_s - 0.05, 60.0)
    table.plan = None
    table.position = plan.goal.plus(Ned(0.0, 0.0, -off_m))
    table.yaw_deg = plan.yaw_deg(plan.duration_s) + off_deg
    return table.wait(late_s)


@pytest.mark.requirement("R8")
@pytest.mark.parametrize(
    ("off_m", "off_deg", "late_s", "done"),
    [
        (0.0, 0.0, 1.0, True),
        (0.09, 4.0, 1.0, True),
        (0.12, 0.0, 1.0, False),  # off the goal, but within the tube: only after lingering
        (0.28, 0.0, 1.5, False),
        (0.28, 0.0, 3.0, True),
        (0.0, 6.0, 1.0, False),
        (0.0, -6.0, 3.0, False),
    ],
)
def test_a_move_is_done_at_its_goal_facing_as_planned(off_m: float, off_deg: float, late_s: float, done: bool) -> None:
    """Within 0.1 m and 5 degrees; 2 s later within the tube of 0.3 m."""
    table = over(off_m=off_m, off_deg=off_deg, late_s=late_s)
    assert (len(table.motions("completed")) == 1) == done
    assert (table.state.state is State.ARMED) == done
    assert table.motions("aborted") == []


def test_a_move_begins_where_it_stands_and_unmeasured() -> None:
    table = Tabletop().paired()
    table.ask(Command.GO_LEFT)
    (started,) = table.motions("started")
    assert tuple(started["displacement_enu_m"]) == (0.0, 0.0, 0.0)
    assert started["yaw_deg"] == 0.0 and started["max_speed_m_s"] == 0.0
    assert started["min_clearance_m"] is started["min_separation_m"] is None


@pytest.mark.requirement("X7")
@pytest.mark.parametrize(("gap_s", "dropped"), [(0.45, False), (0.55, True)])
def test_the_news_that_ends_a_gap_drops_what_is_flown(gap_s: float, dropped: bool) -> None:
    """No tick in between has told of the gap."""
    table = flying()
    table.now_s += gap_s
    table.move()
    table.tell()
    assert (table.state.flight is None) == dropped
    assert (table.state.state is State.SETTLING) == dropped


@pytest.mark.requirement("X4")
def test_a_pairing_refused_while_facing_leaves_nothing_behind() -> None:
    table = facing()
    assert table.state.session is not None
    table.ask(Command.STOP)
    state = table.state
    assert (state.session, state.pairing, state.vehicle, state.authority) == (None, None, None, False)
    assert table.log.count(LetGo("hold")) == 1


# ---------------------------------------------------------------- what is left, what is measured, what waits


@pytest.mark.requirement("X12")
@pytest.mark.parametrize("command", [Command.GO_UP, Command.GO_DOWN, Command.GO_FORWARD, Command.GO_RIGHT])
def test_stop_leaves_what_was_not_flown(command: Command) -> None:
    table = Tabletop().paired()
    table.ask(command)
    flight = table.wait(1.0).state.flight
    assert flight is not None
    flown_m = table.position.minus(flight.origin).norm
    table.ask(Command.STOP)
    left = table.state.leftover
    assert left is not None and 0.1 < flown_m < flight.plan.length_m - 0.1
    assert left.left == pytest.approx(flight.plan.length_m - flown_m)
    assert (left.primitive, left.slowness) == (flight.plan.primitive, 1.0)


@pytest.mark.requirement("X12")
@pytest.mark.parametrize("command", [Command.TURN_LEFT, Command.TURN_RIGHT])
def test_stop_leaves_what_was_not_turned(command: Command) -> None:
    table = Tabletop().paired()
    table.ask(command)
    turned_deg = 0.0
    for _ in range(60):
        before = table.yaw_deg
        table.tick()
        turned_deg += abs(math.remainder(table.yaw_deg - before, 360.0))
    table.ask(Command.STOP)
    left = table.state.leftover
    assert left is not None and turned_deg > 90.0
    assert left.left == pytest.approx(360.0 - turned_deg)


@pytest.mark.requirement("X12")
def test_what_is_left_is_continued_also_where_the_way_back_must_be_asked_for() -> None:
    table = flying(policy=Policy(return_to_anchor="ask"))
    table.ask(Command.STOP)
    left = table.until(State.ARMED).state.leftover
    table.ask(Command.CONTINUE)
    flight = table.state.flight
    assert left is not None and flight is not None
    assert flight.plan.primitive is Primitive.MOVE_LEFT and flight.plan.length_m == pytest.approx(left.left)


def test_how_near_a_flight_came_is_the_least_of_all_that_was_measured() -> None:
    """Down half a metre over flat ground, past somebody who stands 6 m beside and 0.25 m lower."""
    table = Tabletop().paired()
    other = table.position.plus(Ned(6.0, 0.0, 0.25))
    table.ask(Command.GO_DOWN)
    heights, apart = [], []
    while table.state.flight is not None:
        heights.append(-table.position.down)
        apart.append(table.position.minus(other).norm)
        table.sky = ball("blue", other, Ned(0.0, 0.0, 0.0), table.now_s + 0.1)
        table.tick()
    (done,) = table.motions("completed")
    assert done["min_clearance_m"] == pytest.approx(min(heights), abs=1e-6)
    assert done["min_separation_m"] == pytest.approx(min(apart), abs=1e-6)
    assert 0.2 < done["max_speed_m_s"] <= 0.25 + 1e-6


@pytest.mark.requirement("X6")
def test_a_delay_that_ends_unheard_is_not_blamed_on_the_authority() -> None:
    table = delayed()
    name = table.decisions()[-1]["request"]
    table.now_s += 3.1
    table.put(Tick())
    assert table.verdicts(name) == ["delayed", "rejected"]
    assert "localization" in table.failing(name)


@pytest.mark.requirement("X10")
def test_a_drone_that_has_drifted_by_more_than_the_tube_is_told_by_how_much() -> None:
    table = waiting()
    name = table.decisions()
    assert name == []
    table.position = table.position.plus(Ned(0.0, 0.0, -0.4))
    table.tell()
    table.put(ReservationAnswered("r2", "granted"))
    off = next(f for f in table.decisions("r2")[-1]["findings"] if "from where the plan starts" in f["text"])
    assert (off["constraint"], off["passed"]) == ("envelope", False)
    assert off["margin"] == pytest.approx(-0.1) and "0.40 m" in off["text"]


@pytest.mark.requirement("X10")
def test_every_way_back_asks_for_its_own_airspace() -> None:
    table = held().until(State.RETURN_TO_ANCHOR, 6.0)
    assert [name for name in table.reserved if name.startswith("return")] == ["return-1"]
    assert table.motions("started")[-1]["request"] == "return"
    assert table.state.tally.approved == 1, "nobody asked for it"
    table.until(State.ARMED, 20.0)
    assert table.state.tally.completed == 0 and table.state.tally.aborted == 1


# ---------------------------------------------------------------- exactly at a limit


def exact(table: Tabletop, **changes: Any) -> tuple[Step, VehicleState]:
    """The flight in progress, begun at 64 s, seen at 72 s: numbers that have no rounding."""
    flight = table.state.flight
    assert flight is not None
    vehicle = replace(table.vehicle(), at_s=72.0, **changes)
    return Step(replace(table.state, vehicle=vehicle, flight=replace(flight, started_at_s=64.0)), 72.0), vehicle


@pytest.mark.requirement("X7", "X8")
def test_a_flight_is_dropped_only_beyond_its_limits() -> None:
    run, vehicle = exact(flying())
    for gap_s, dropped in ((0.5, False), (0.5078125, True)):
        assert (execution.trouble(run, vehicle, replace(vehicle, at_s=72.0 - gap_s)) is not None) == dropped
    assert execution.trouble(run, vehicle, None) is None
    elsewhere = replace(vehicle, flight_mode=FlightMode.HOLD)
    for flown_s, dropped in ((1.0, False), (1.0078125, True)):
        flight = replace(run.state.flight, started_at_s=72.0 - flown_s)  # type: ignore[type-var]
        begun = Step(replace(run.state, flight=flight), 72.0)
        assert (execution.trouble(begun, elsewhere, vehicle) is not None) == dropped
        assert execution.trouble(begun, vehicle, vehicle) is None
    assert (
        execution.trouble(run, replace(vehicle, healthy=False), vehicle) == "the drone reports that it is not healthy"
    )


@pytest.mark.requirement("X6")
@pytest.mark.parametrize(
    ("captured_at_s", "now"),
    [(95.0, True), (94.9921875, False), (100.5, True), (100.5078125, False), (math.nan, False)],
)
def test_what_is_of_now_was_asked_within_5_s_and_not_half_a_second_ahead(captured_at_s: float, now: bool) -> None:
    request = replace(Tabletop().request(Command.GO_LEFT), captured_at_s=captured_at_s)
    assert decisions.is_of_now(request, 100.0, Limits()) == now


@pytest.mark.requirement("X12")
@pytest.mark.parametrize(("ago_s", "goes_on"), [(30.0, True), (30.0078125, False)])
def test_what_stop_left_is_kept_half_a_minute(ago_s: float, goes_on: bool) -> None:
    table = Tabletop().paired()
    left = Leftover(Primitive.MOVE_LEFT, 0.5, 200.0 - ago_s, 2.0)
    run = Step(replace(table.state, leftover=left), 200.0)
    found = decisions.intended(run, table.request(Command.CONTINUE))
    assert (found == Intent(Primitive.MOVE_LEFT, 0.5, 2.0)) == goes_on
    assert isinstance(found, Intent | Finding)


@pytest.mark.requirement("X6")
@pytest.mark.parametrize(("age_s", "hears"), [(0.5, True), (0.5078125, False)])
def test_telemetry_is_heard_for_half_a_second(age_s: float, hears: bool) -> None:
    table = Tabletop().paired()
    state = replace(table.state, vehicle=replace(table.vehicle(), at_s=200.0 - age_s))
    assert Step(state, 200.0).hears == hears
    assert not Step(replace(state, vehicle=None), 200.0).hears


@pytest.mark.requirement("R10", "X10")
def test_a_way_back_that_gets_no_airspace_is_judged_again_after_a_delay() -> None:
    table = held()
    table.grant = "denied"
    table.until(lambda: bool(table.reserved and "return-1" in table.reserved), 8.0)
    state = table.state
    assert state.return_at_s is None and state.may_return
    assert state.return_judged_from_s == pytest.approx(table.now_s + 3.1)
    table.wait(4.8)
    assert "return-2" not in table.reserved, "announced anew first"
    table.wait(0.6)
    assert "return-2" in table.reserved


@pytest.mark.requirement("R10")
def test_a_way_back_that_has_begun_is_announced_no_more() -> None:
    table = held().until(State.RETURN_TO_ANCHOR, 6.0)
    assert table.state.return_at_s is None and not table.state.may_return
    flight, session = table.state.flight, table.state.session
    assert flight is not None and session is not None and session.anchor is not None
    assert flight.plan.goal == pytest.approx(session.anchor.position)


@pytest.mark.requirement("R10")
def test_the_way_back_ends_as_the_anchor_faced() -> None:
    table = held()
    session = table.state.session
    assert session is not None and session.anchor is not None
    turned = replace(session.anchor, yaw_deg=session.anchor.yaw_deg + 40.0)
    table.state = replace(table.state, session=replace(session, anchor=turned))
    flight = table.until(State.RETURN_TO_ANCHOR, 6.0).state.flight
    assert flight is not None
    off_deg = math.remainder(flight.plan.yaw_deg(flight.plan.duration_s) - turned.yaw_deg, 360.0)
    assert off_deg == pytest.approx(0.0, abs=1e-6)


@pytest.mark.requirement("X10")
@pytest.mark.parametrize(("reason", "says"), [("blue holds it", "blue holds it"), ("", "the volume was denied")])
def test_why_the_airspace_is_not_ours_is_told(reason: str, says: str) -> None:
    table = waiting()
    table.put(ReservationAnswered("r2", "denied", reason))
    found = [f for f in table.decisions("r2")[-1]["findings"] if f["constraint"] == "reservation"]
    assert [f["text"] for f in found] == [f"the airspace is not ours: {says}"]


@pytest.mark.parametrize(
    ("command", "asked_m"),
    [(Command.GO_LEFT, 1.0), (Command.GO_UP, 0.5), (Command.TURN_LEFT, None), (Command.CONTINUE, None)],
)
def test_a_refusal_tells_what_was_asked(command: Command, asked_m: float | None) -> None:
    table = Tabletop()
    name = table.ask(command)
    (made,) = table.decisions(name)
    assert (made["requested_m"], made["granted_m"]) == (asked_m, None)
    assert table.state.tally.rejected == 1 and table.state.tally.approved == 0


@pytest.mark.requirement("X5")
def test_requests_are_remembered_for_two_windows_and_their_age() -> None:
    table = Tabletop().paired()
    first = table.ask(Command.GO_LEFT, confidence=0.1)
    table.wait(6.8)
    table.ask(Command.GO_UP, confidence=0.1)
    assert next(r.request.id for r in table.state.recent) == first
    table.wait(0.4)
    table.ask(Command.GO_UP, confidence=0.1)
    assert first not in [r.request.id for r in table.state.recent]


@pytest.mark.requirement("X6")
def test_a_jump_while_it_turns_to_the_operator_begins_its_hover_anew() -> None:
    table = facing()
    table.wait(0.6)
    session = table.state.session
    assert session is not None and session.hover
    table.position = table.position.plus(Ned(0.8, 0.0, 0.0))
    table.now_s += 0.1
    table.tell()
    assert table.state.session is not None and table.state.session.hover == ()
    assert len(table.effects(FaceOperator)) == 2 and Hold("estimate moved") in table.log


@pytest.mark.requirement("X6")
def test_a_jump_moves_the_place_of_pairing_with_it() -> None:
    table = Tabletop().paired()
    before = table.state.session
    table.position = table.position.plus(Ned(0.8, -0.3, 0.1))
    table.now_s += 0.1
    table.tell()
    after = table.state.session
    assert before is not None and after is not None and before.centre is not None and after.centre is not None
    assert after.centre.minus(before.centre) == pytest.approx((0.8, -0.3, 0.1), abs=1e-6)
    assert after.anchor is not None and after.anchor.position == table.position
    assert table.said()[-1] == "Red: its position estimate jumped by 0.9 m: it holds at where it now believes to be"


@pytest.mark.parametrize("low", [0.0, 1.0])
def test_a_confidence_at_either_end_is_one(low: float) -> None:
    table = Tabletop()
    one, other = table.request(Command.GO_LEFT, confidence=low), table.request(Command.GO_LEFT, confidence=0.5)
    for a, b in ((one, other), (other, one)):
        assert fused(a, b, "x").confidence == pytest.approx(1.0 - (1.0 - low) * 0.5)
