"""What a real vehicle and other people do to a session: takeovers, falls, restarts, jumps and noise of the estimate. Pure.

Each was seen on a real PX4. Source: X3, X6, X8, R8, R10; design 4, 8.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from random import Random
from typing import Any

import pytest

from m3r_app.arbiter.effects import FaceOperator, Hold, LetGo
from m3r_app.arbiter.events import FrameMoved, TelemetryArrived
from m3r_app.arbiter.state import Policy
from m3r_app.arbiter.wording import reasons
from safety.limits import Limits
from safety.vocabulary import Command, Finding, FlightMode, Ned, State
from tests.m3r_app.tabletop import Tabletop
from tests.m3r_app.test_arbiter import delayed, facing, flying, held, settling, waiting

IN_SESSION = [facing, lambda: Tabletop().paired(), flying, held, settling, delayed, waiting]


def told(table: Tabletop, **changes: Any) -> Tabletop:
    """One more report of the drone, a moment later, with these fields."""
    table.now_s += 0.02
    table.put(TelemetryArrived(replace(table.vehicle(), **changes)))
    return table


def last_words(table: Tabletop) -> str:
    return table.reports("pair")[-1]["reasons"][0]


# ---------------------------------------------------------------- whose motion it is: X3


@pytest.mark.requirement("X3")
@pytest.mark.parametrize("made", IN_SESSION)
def test_a_hold_not_asked_for_ends_every_session(made: Callable[[], Tabletop]) -> None:
    table = told(made(), flight_mode=FlightMode.HOLD, unasked_hold=True)
    assert table.state.session is None
    assert "counts as stop" in last_words(table)
    assert table.effects(LetGo)[-1] == LetGo("hold"), "the setpoints end, and what it holds by is Hold"
    assert table.ask(Command.GO_LEFT) and table.reports("decision")[-1]["findings"][0]["constraint"] == "paired"


@pytest.mark.parametrize("made", IN_SESSION)
def test_a_hold_that_we_asked_for_ends_none(made: Callable[[], Tabletop]) -> None:
    assert told(made(), flight_mode=FlightMode.HOLD).state.session is not None


@pytest.mark.parametrize("made", IN_SESSION)
@pytest.mark.parametrize(
    ("changes", "words", "command"),
    [
        ({"armed": False}, "it was disarmed in the air by somebody else: it falls", "nothing"),
        ({"armed": False, "in_air": None}, "it was disarmed in the air by somebody else: it falls", "nothing"),
        ({"restarts": 1}, "its autopilot restarted in flight", "nothing"),
        ({"restarts": 1, "armed": False}, "its autopilot restarted in flight", "nothing"),
        ({"in_air": False}, "it is no longer in the air, so it is let go", "nothing"),
        ({"in_air": False, "armed": False}, "it was disarmed in the air by somebody else: it falls", "nothing"),
        ({"in_air": None}, "whether it flies is not told any more", "hold"),
        ({"flight_mode": FlightMode.UNKNOWN}, "its flight mode is not told any more", "hold"),
        ({"flight_mode": FlightMode.LAND}, "its autopilot or somebody else flies it (LAND)", "nothing"),
    ],
)
def test_the_end_of_a_session_is_said_as_what_it_is(
    made: Callable[[], Tabletop], changes: dict[str, Any], words: str, command: str
) -> None:
    table = made()
    for _ in range(70):  # what is told of a fall comes in several messages, so the whole is waited for
        if table.state.session is not None:
            told(table, **changes)
    assert table.state.session is None and words in last_words(table)
    assert table.effects(LetGo)[-1].command == command
    assert table.state.tally.violations == 0
    assert table.effects(LetGo)[-1].vehicle_lost == ("restarted" in words)


def test_a_landing_waits_for_what_else_is_told() -> None:
    """Disarmed in the air, PX4 calls it landed at once; its heartbeat and its time since boot come a little later."""
    for then, words in (
        ({"armed": False}, "disarmed in the air"),
        ({"armed": False, "restarts": 1}, "restarted in flight"),
        ({}, "no longer in the air"),
        ({"flight_mode": FlightMode.LAND}, "no longer in the air"),
    ):
        table = flying()
        told(table, in_air=False, armed=True)
        assert table.state.session is not None
        for _ in range(70):
            if table.state.session is not None:
                told(table, **{"in_air": False, "armed": True, **then})
        assert words in last_words(table)


def test_a_restart_before_pairing_is_no_restart_in_flight() -> None:
    table = Tabletop()
    vehicle = table.vehicle
    table.vehicle = lambda: replace(vehicle(), restarts=3)  # type: ignore[method-assign]
    assert table.paired().state.session is not None


# ---------------------------------------------------------------- between a takeover and its report: X3


def too_fast(table: Tabletop, seconds: float, **changes: Any) -> None:
    """It flies faster than its bound; its mode was last told when this begins."""
    at_s = table.now_s
    for _ in range(round(seconds / 0.02)):
        table.velocity = Ned(0.0, 0.0, 1.5)
        told(table, **{"mode_at_s": at_s, **changes})


@pytest.mark.requirement("X3")
def test_what_happens_before_a_takeover_is_told_is_no_violation_of_ours() -> None:
    """Somebody lands it: its descent is seen before its mode, which comes once a second."""
    table = flying()
    too_fast(table, 0.6)
    assert table.state.state is State.EMERGENCY_HOLD, "we abort at once all the same"
    assert not [v for v in table.reports("violation") if v["kind"] == "actual"]
    told(table, flight_mode=FlightMode.LAND)
    assert table.state.tally.violations == 0 and not [v for v in table.reports("violation") if v["kind"] == "actual"]


def test_what_is_still_ours_when_the_mode_is_told_again_is_counted() -> None:
    table = flying()
    too_fast(table, 0.6)
    told(table)
    assert table.state.tally.violations == 1
    assert [v["kind"] for v in table.reports("violation")].count("actual") == 1


@pytest.mark.requirement("R10")
def test_what_is_suspected_when_we_end_it_is_counted() -> None:
    table = flying()
    too_fast(table, 0.6)
    table.ask(Command.DISCONNECT)
    assert table.state.tally.violations == 1


# ---------------------------------------------------------------- jumps: X6


@pytest.mark.parametrize("off", [Ned(2.0, 0.0, 0.0), Ned(0.0, -3.0, 0.0), Ned(0.0, 0.0, 2.0), Ned(0.4, 0.4, 0.4)])
@pytest.mark.parametrize("made", [lambda: Tabletop().paired(), flying, held, settling, delayed, waiting])
def test_a_jump_of_the_estimate_moves_no_drone(made: Callable[[], Tabletop], off: Ned) -> None:
    table = made()
    holds = table.effects(Hold).count(Hold("estimate moved"))
    table.position = table.position.plus(off)
    told(table)
    assert table.effects(Hold).count(Hold("estimate moved")) == holds + 1, "at where it now believes to be"
    assert table.state.flight is None
    assert any("its position estimate jumped by" in text for text in table.said())
    session = table.state.session
    assert session is not None and session.anchor is not None
    assert session.anchor.position == table.position
    table.wait(0.2)
    assert table.effects(Hold).count(Hold("estimate moved")) == holds + 1, "said once"


@pytest.mark.requirement("X6")
def test_after_a_jump_nothing_is_flown_until_position_and_velocity_agree_again() -> None:
    table = Tabletop().paired()
    table.position = table.position.plus(Ned(0.0, 2.0, 0.0))
    told(table)
    assert table.failing(table.ask(Command.GO_UP)) == {"localization"}
    table.wait(5.0)
    assert table.verdicts(table.ask(Command.GO_UP)) == ["approved"]


def test_a_step_that_the_velocity_explains_is_no_jump() -> None:
    table = Tabletop().paired()
    table.velocity = Ned(2.0, 0.0, 0.0)
    told(table)
    for _ in range(10):
        table.position = table.position.plus(Ned(0.04, 0.0, 0.0))
        told(table)
    assert Hold("estimate moved") not in table.log


def test_while_it_turns_to_the_operator_a_jump_turns_it_anew() -> None:
    table = facing().wait(0.5)
    faced = len(table.effects(FaceOperator))
    table.position = table.position.plus(Ned(0.0, 3.0, 0.0))
    told(table)
    assert len(table.effects(FaceOperator)) == faced + 1


def test_a_local_frame_that_moved_is_a_jump_for_a_hovering_drone_too() -> None:
    table = Tabletop().paired()
    table.put(FrameMoved("its estimator moved its own origin"))
    assert Hold("estimate moved") in table.log
    assert any("its estimator moved its own origin" in text for text in table.said())


# ---------------------------------------------------------------- one cause, one sentence


@pytest.mark.requirement("R10", "X6")
def test_a_lost_position_is_one_sentence() -> None:
    table = flying()
    told(table, sigma_h_m=100.0, sigma_v_m=60.0)
    assert table.state.state is State.EMERGENCY_HOLD
    words = next(text for text in table.said() if "holding" in text)
    assert "position known to 100.0 m" in words
    assert "too close" not in words


def test_what_is_derived_from_a_lost_position_is_not_said_of_a_request_either() -> None:
    def failed(constraint: str, text: str) -> Finding:
        return Finding(constraint, (), None, "", passed=False, text=text)

    both = (failed("standoff", "too close to you"), failed("localization", "unknown"), failed("authority", "not ours"))
    assert reasons(both) == "unknown; not ours"
    assert reasons(both[:1]) == "too close to you"


@pytest.mark.parametrize(("chosen", "lands"), [("hold", False), ("land", True)])
def test_a_drone_without_a_position_lands_where_that_is_chosen(chosen: Any, lands: bool) -> None:
    table = flying(policy=Policy(position_lost=chosen))
    for _ in range(50):
        table.now_s += 0.1
        table.put(TelemetryArrived(replace(table.vehicle(), sigma_h_m=100.0)))
    assert (LetGo("land") in table.log) == lands
    assert (table.state.session is None) == lands


# ---------------------------------------------------------------- a noisy estimate: X6, X11


class Noisy(Tabletop):
    """A drone whose estimate wanders: velocity says one thing, position another."""

    def __init__(self, velocity_m_s: float, position_m: float, **setting: Any) -> None:
        super().__init__(**setting)
        self._random = Random(3)
        self._scale = velocity_m_s, position_m
        self._velocity, self._place = Ned(0.0, 0.0, 0.0), Ned(0.0, 0.0, 0.0)

    def vehicle(self) -> Any:
        def wander(value: float, sigma: float, tau_s: float) -> float:
            keep = math.exp(-0.1 / tau_s)
            return keep * value + self._random.gauss(0.0, sigma * math.sqrt(1.0 - keep * keep))

        said_m_s, wandered_m = self._scale
        self._velocity = Ned(*(wander(v, said_m_s, 1.5) for v in self._velocity))
        self._place = Ned(*(wander(p, wandered_m, 4.0) for p in self._place))
        true = super().vehicle()
        return replace(true, position=true.position.plus(self._place), velocity=true.velocity.plus(self._velocity))


def test_a_quiet_estimate_changes_no_limit() -> None:
    table = Tabletop().paired()
    assert table.state.limits == Limits() and table.state.noise is None


@pytest.mark.requirement("R8")
def test_a_noisy_estimate_widens_the_limits_of_its_session_and_no_other() -> None:
    table = Noisy(0.2, 0.15).paired()
    limits, noise = table.state.limits, table.state.noise
    assert noise is not None and noise.position_m > 0.1
    assert limits.tracking_m > Limits().tracking_m and limits.disagreement_m > Limits().disagreement_m
    assert any("so it keeps" in text for text in table.said())
    assert table.verdicts(table.ask(Command.GO_LEFT)) == ["approved"]
    table.until(State.ARMED, 15.0)
    assert table.motions("completed")
    table.ask(Command.DISCONNECT)
    assert table.state.limits == Limits()


@pytest.mark.requirement("X8")
def test_an_estimate_that_is_too_noisy_is_not_paired_with() -> None:
    table = Noisy(0.2, 0.5)
    table.neighbours()
    table.tell()
    table.ask(Command.ACTIVATE)
    table.until(lambda: table.state.state is State.IDLE, 25.0)
    assert "its position wanders by" in last_words(table)
    assert "m are needed" in last_words(table)


# ---------------------------------------------------------------- what completes a maneuver, and what does not


class Short(Tabletop):
    """A drone that stops off its goal, or with its nose off."""

    def __init__(self, off_m: float, off_deg: float, **setting: Any) -> None:
        super().__init__(**setting)
        self.off_m, self.off_deg = off_m, off_deg

    def vehicle(self) -> Any:
        true = super().vehicle()
        if self.plan is None:
            return true
        return replace(
            true, position=true.position.plus(Ned(0.0, 0.0, self.off_m)), yaw_deg=true.yaw_deg + self.off_deg
        )


@pytest.mark.parametrize(
    ("off_m", "off_deg", "completes"),
    [(0.0, 0.0, True), (0.29, 0.0, True), (0.0, 4.9, True), (0.0, 6.0, False), (0.0, 90.0, False)],
)
def test_a_maneuver_is_completed_there_and_facing_as_planned(off_m: float, off_deg: float, completes: bool) -> None:
    table = Short(off_m, off_deg).paired()
    table.ask(Command.GO_LEFT)
    table.wait(14.0)
    assert bool(table.motions("completed")) == completes
    assert bool(table.motions("aborted")) != completes, "what does not complete is aborted in time"


@pytest.mark.requirement("R10")
def test_a_maneuver_that_ends_elsewhere_is_not_completed() -> None:
    table = Tabletop().paired()
    table.ask(Command.GO_LEFT)
    table.wait(1.0)
    frozen = table.position
    for _ in range(140):
        table.now_s += 0.1
        table.neighbours()
        table.put(TelemetryArrived(replace(table.vehicle(), position=frozen, velocity=Ned(0.0, 0.0, 0.0))))
    assert not table.motions("completed") and table.motions("aborted")


def test_the_anchor_is_where_it_rests_by_news_of_now() -> None:
    """Neither where it still moved, nor where it was before it was told to stop."""
    table = flying()
    table.ask(Command.STOP)
    asked_s = table.now_s
    table.put(TelemetryArrived(replace(table.vehicle(), at_s=asked_s - 0.2, velocity=Ned(0.0, 0.0, 0.0))))
    assert table.state.state is State.SETTLING, "what is older than the stop says nothing of rest"
    told(table, velocity=Ned(0.5, 0.0, 0.0))
    assert table.state.state is State.SETTLING
    table.until(State.ARMED, 3.0)
    session = table.state.session
    assert session is not None and session.anchor is not None
    assert session.anchor.position == table.position and session.anchor.at_s > asked_s


def test_rest_before_the_stop_is_no_rest_after_it() -> None:
    table = Tabletop().paired()
    table.ask(Command.STOP)
    asked_s = table.now_s
    table.put(TelemetryArrived(replace(table.vehicle(), at_s=asked_s - 0.05)))
    assert table.state.state is State.SETTLING
    told(table)
    assert table.state.state is State.ARMED


def test_what_never_clears_is_delayed_once_and_then_refused() -> None:
    """Somebody's lease that always seems to be about to end."""
    table = delayed()
    name = table.decisions()[-1]["request"]
    assert table.verdicts(name) == ["delayed"]
    for _ in range(60):
        table.volumes = tuple(replace(v, until_s=table.now_s + 1.0) for v in table.volumes)
        table.tick()
    assert table.verdicts(name) == ["delayed", "rejected"]


@pytest.mark.requirement("X6", "P1")
def test_what_was_watched_before_a_gap_in_the_telemetry_arms_nobody() -> None:
    """All of the hover that was seen is older than what counts as lately: the step raised."""
    table = facing()
    operator_deg, table.turn_to_deg = table.turn_to_deg, table.yaw_deg  # the nose stays off while the hover is watched
    assert operator_deg is not None
    table.wait(3.0)
    assert table.state.state is State.FACING
    table.now_s += 4.0
    table.yaw_deg = table.turn_to_deg = operator_deg
    table.neighbours()
    table.tell()
    assert table.state.state is State.FACING
    table.wait(0.4)
    assert table.state.state is State.FACING, "nor do a few moments since"
    assert table.wait(4.0).state.state is State.ARMED
