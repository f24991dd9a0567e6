"""The arbiter: every state against every event, and each of the design's decisions as something that happens."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from m3r_app.arbiter.context import Step
from m3r_app.arbiter.effects import FaceOperator, Fly, Hold, ImpossibleTransition, LetGo, Pair, Release, Report, Reserve
from m3r_app.arbiter.events import (
    ClaimLost,
    Ended,
    GroundWorkEnded,
    LandingAsked,
    NeighboursHeard,
    PairingAnswered,
    PairingAsked,
    Requested,
    ReservationAnswered,
    Stalled,
    TakeOffAsked,
    TelemetryArrived,
    Tick,
)
from m3r_app.arbiter.state import ArbiterState, Policy
from m3r_app.arbiter.step import step
from safety.constraints import RULES
from safety.limits import Limits
from safety.obstacles import Obstacles
from safety.vocabulary import (
    Cause,
    Command,
    FlightMode,
    Modality,
    Mode,
    Ned,
    Neighbours,
    Primitive,
    ReservedVolume,
    State,
)
from tests.m3r_app.tabletop import FLAT, MOVING, PLACE, Tabletop, ball, check_step

VOICE, GESTURE, PANEL = Modality.VOICE, Modality.GESTURE, Modality.PANEL
ASK, NEVER = Policy(return_to_anchor="ask"), Policy(return_to_anchor="never")


def wall_at(north_m: float) -> Obstacles:
    return Obstacles.of(["wall"], [shapely.box(north_m, -50.0, north_m + 1.0, 50.0)], [0.0], [40.0], 0.0)


def flying(command: Command = Command.GO_LEFT, **setting: Any) -> Tabletop:
    """A second and a half into a move."""
    table = Tabletop(**setting).paired()
    table.ask(command)
    assert table.state.state is State.EXECUTING
    return table.wait(1.5)


def held(**setting: Any) -> Tabletop:
    """In EmergencyHold: an aircraft has come at the drone."""
    table = flying(**setting)
    table.sky = ball("blue", table.position.plus(Ned(4.0, 0.0, 0.0)), Ned(-3.0, 0.0, 0.0), table.now_s)
    table.until(State.EMERGENCY_HOLD, 1.0)
    table.sky = Neighbours.none(math.inf)
    return table


def blocked() -> Tabletop:
    table = Tabletop().paired()
    table.ask(Command.GO_LEFT, confidence=0.1)
    return table


def delayed() -> Tabletop:
    table = Tabletop().paired()
    ahead = table.position.plus(Ned(0.0, -2.0, 0.0))
    table.volumes = (ReservedVolume("blue", ahead, ahead, 1.5, table.now_s, table.now_s + 1.0),)
    table.neighbours()
    table.ask(Command.GO_LEFT)
    return table


def waiting() -> Tabletop:
    """In ManeuverPlanned: the authority does not answer."""
    table = Tabletop().paired()
    table.grant = None
    table.ask(Command.GO_LEFT)
    return table


def settling() -> Tabletop:
    table = flying()
    table.ask(Command.STOP)
    return table


def facing() -> Tabletop:
    table = Tabletop()
    table.tell()
    table.ask(Command.ACTIVATE)
    return table


def pairing() -> Tabletop:
    table = Tabletop()
    table.answers_pairing = False
    table.tell()
    table.ask(Command.ACTIVATE)
    return table


def returning() -> Tabletop:
    return held().until(State.RETURN_TO_ANCHOR, 6.0).wait(0.3)


MADE: dict[State, Callable[[], Tabletop]] = {
    State.IDLE: Tabletop,
    State.PAIRING: pairing,
    State.FACING: facing,
    State.ARMED: lambda: Tabletop().paired(),
    State.SETTLING: settling,
    State.DELAYED: delayed,
    State.PLANNED: waiting,
    State.EXECUTING: flying,
    State.BLOCKED: blocked,
    State.EMERGENCY_HOLD: held,
    State.RETURN_TO_ANCHOR: returning,
}
"""Every state that lasts longer than a step, by real events."""


def every_event(table: Tabletop) -> list[Any]:
    vehicle = table.vehicle()
    nan = math.nan
    asked = [
        Requested(table.request(command, modality, confidence, colour=colour), 0.0)
        for command in Command
        for modality, confidence in ((VOICE, 0.9), (GESTURE, 0.1), (PANEL, nan))
        for colour in ("red", "blue", None)
    ]
    old = [Requested(table.request(c, ago_s=ago_s), 0.0) for c in Command for ago_s in (60.0, nan, -60.0)]
    current = (table.state.deciding.ask_id if table.state.deciding else None) or "r1"
    flown = table.state.flight.request_id if table.state.flight else "nobody"
    answers = [
        ReservationAnswered(request_id, answer)
        for request_id in (current, flown, "return", "unknown")
        for answer in ("granted", "denied", "expired")
    ]
    told = [
        vehicle,
        *(
            replace(vehicle, flight_mode=m)
            for m in (FlightMode.HOLD, FlightMode.POSITION, FlightMode.UNKNOWN, FlightMode.RETURN, FlightMode.LAND)
        ),
        replace(vehicle, in_air=False),
        replace(vehicle, position=Ned(nan, nan, nan)),
        replace(vehicle, velocity=Ned(nan, nan, nan)),
        replace(vehicle, yaw_deg=nan),
        replace(vehicle, sigma_h_m=nan),
        replace(vehicle, at_s=vehicle.at_s + 5.0),
    ]
    heard = [
        Neighbours.none(-math.inf),
        ball("blue", PLACE, Ned(0.0, 0.0, 0.0), table.now_s),
        ball("blue", Ned(nan, nan, nan), Ned(0.0, 0.0, 0.0), nan),
    ]
    return [
        *asked,
        *old,
        *answers,
        *(TelemetryArrived(v) for v in told),
        *(NeighboursHeard(n) for n in heard),
        PairingAsked("red"),
        PairingAsked("blue"),
        TakeOffAsked("green", 5.0),
        LandingAsked("green"),
        GroundWorkEnded("green"),
        PairingAnswered("red", (), table.operator, FLAT),
        PairingAnswered("red", ("no",)),
        PairingAnswered("blue", (), table.operator, FLAT),
        PairingAnswered("red", ()),
        Stalled("it stalled"),
        Tick(),
        ClaimLost("its claim is lost"),
        Ended("the run is over"),
    ]


@pytest.mark.parametrize("state", list(MADE))
def test_every_state_takes_every_event(state: State) -> None:
    """Never raises; every transition is the table's; STOP holds first; nothing flies ungranted; nothing is commanded unheld."""
    table = MADE[state]()
    assert table.state.state is state
    for event in every_event(table):
        for later_s in (0.0, 0.3, 4.0, 40.0):
            after, effects = step(table.state, event, table.now_s + later_s)
            check_step(table.state, event, after, effects)
            again, more = step(after, Tick(), table.now_s + later_s + 0.1)
            check_step(after, Tick(), again, more)


def test_only_passing_states_are_missing() -> None:
    assert set(State) - set(MADE) == {State.DETECTED, State.VALIDATED}


@pytest.mark.parametrize("state", list(MADE))
def test_ended_leaves_in_hold(state: State) -> None:
    table = MADE[state]()
    held_authority = table.state.authority
    effects = table.put(Ended("the run is over"))
    assert (LetGo("hold") in effects) == held_authority
    assert table.state.flight is table.state.deciding is table.state.pending is None
    if state is not State.PAIRING:
        assert table.state.state is State.IDLE


@pytest.mark.requirement("X3")
@pytest.mark.parametrize("state", list(MADE))
def test_a_claim_that_is_lost_ends_the_session_in_hold(state: State) -> None:
    """X3: somebody else may have the drone by now, so nothing of ours goes on."""
    table = MADE[state]()
    held_authority = table.state.authority
    effects = table.put(ClaimLost("its claim could not be renewed for 4 s"))
    assert (LetGo("hold") in effects) == held_authority
    assert table.state.flight is table.state.deciding is table.state.pending is None
    if held_authority:
        assert effects.index(Hold("claim lost")) < effects.index(LetGo("hold")) and table.state.state is State.IDLE
        assert "its claim could not be renewed for 4 s" in table.reports("pair")[-1]["reasons"][0]


def test_a_drone_that_is_not_heard_is_not_said_to_hold() -> None:
    table = Tabletop().paired()
    table.now_s += 10.0
    table.put(Ended("the run is over"))
    assert table.reports("pair")[-1]["reasons"] == ["the run is over, it is not heard, so its own failsafe has it"]


# ---------------------------------------------------------------- any sequence of events


STEPS = st.one_of(
    st.tuples(
        st.just("ask"),
        st.sampled_from([c for c in Command for _ in range(1 if c in MOVING else 2)]),
        st.sampled_from([VOICE, GESTURE, PANEL]),
        st.sampled_from([0.9, 0.95, 0.2, math.nan]),
        st.sampled_from([0.0, 0.0, 0.4, 1.5, 9.0]),
    ),
    st.tuples(st.just("wait"), st.sampled_from([0.1, 0.2, 0.5, 1.0, 3.0])),
    st.tuples(st.just("grant"), st.sampled_from(["granted", "granted", "denied", "expired", None])),
    st.tuples(st.just("late"), st.sampled_from(["granted", "denied", "expired"])),
    st.tuples(st.just("traffic"), st.booleans()),
    st.tuples(
        st.just("mode"),
        st.sampled_from([FlightMode.OFFBOARD, FlightMode.OFFBOARD, FlightMode.HOLD, FlightMode.POSITION]),
    ),
    st.tuples(st.just("silence"), st.sampled_from([0.3, 1.0])),
    st.tuples(st.just("stall"), st.just(0)),
)


@pytest.mark.requirement("P1", "X4", "X10")
@settings(max_examples=60)
@given(st.lists(STEPS, max_size=25), st.sampled_from(["auto", "ask", "never"]), st.sampled_from(["off", "offer"]))
def test_any_sequence(script: list[Any], back: Any, offer: Any) -> None:
    """Every move, turn and continue gets exactly one final decision; the tally agrees with what was reported; X4, X10, P1."""
    table = Tabletop(policy=Policy(return_to_anchor=back, replace=offer)).paired()
    asked: dict[str, Command] = {}
    for kind, *what in script:
        match kind:
            case "ask":
                command, modality, confidence, ago_s = what
                asked[table.ask(command, modality, confidence, ago_s=ago_s)] = command
            case "wait":
                table.wait(what[0])
            case "grant":
                table.grant = what[0]
            case "late":
                for request_id in list(table.reserved):
                    if what[0] != "granted":
                        table.held.discard(request_id)
                    table.put(ReservationAnswered(request_id, what[0]))
            case "traffic":
                table.sky = (
                    ball("blue", table.position.plus(Ned(5.0, 0.0, 0.0)), Ned(-2.0, 0.0, 0.0), table.now_s)
                    if what[0]
                    else Neighbours.none(math.inf)
                )
            case "mode":
                table.flight_mode = what[0]
                table.tell()
                table.flight_mode = FlightMode.OFFBOARD
            case "silence":
                for _ in range(round(what[0] / 0.1)):
                    table.tick(telemetry=False)
            case "stall":
                table.put(Stalled("it stalled"))
    table.wait(1.0)
    table.put(Ended("the run is over"))
    told = {r["id"] for r in table.reports("request")}
    for request_id, command in asked.items():
        final = [v for v in table.verdicts(request_id) if v != "delayed"]
        if command in MOVING:
            assert not table.verdicts(request_id)
        elif request_id in told:  # another's id: it confirmed that one
            assert len(final) == 1, (request_id, command, table.verdicts(request_id))
            assert table.verdicts(request_id)[:-1] in ([], ["delayed"])
    finals = [d for d in table.decisions() if d["verdict"] != "delayed"]
    tally = table.state.tally
    assert tally.approved == sum(d["verdict"] in ("approved", "reduced") for d in finals)
    assert tally.rejected == sum(d["verdict"] in ("rejected", "replaced") for d in finals)
    assert tally.requests == len(table.reports("request"))
    assert tally.completed + tally.aborted == tally.approved
    assert tally.violations == sum(v["kind"] == "actual" for v in table.reports("violation"))
    assert not table.held, "every volume is given back"
    for decision in finals:
        if decision["verdict"] not in ("approved", "reduced"):
            assert decision["granted_m"] is None
    stops_hold_still(table)


def stops_hold_still(table: Tabletop) -> None:
    """X4: after STOP nothing flies or turns that was not asked for after it."""
    stopped_at_s, since = -math.inf, set[str]()
    for _, event, _, effects in table.steps:
        if isinstance(event, Requested):
            if event.request.command is Command.STOP:
                stopped_at_s, since = event.request.captured_at_s, set()
            elif event.request.captured_at_s >= stopped_at_s:
                since.add(event.request.id)
                since |= {e.fields["id"] for e in effects if isinstance(e, Report) and e.event == "request"}  # type: ignore[misc]
        if stopped_at_s > 0.0 and any(isinstance(e, Fly) for e in effects):
            flown = [e.fields["request"] for e in effects if isinstance(e, Report) and e.event == "motion"]
            assert all(f in since or (f == "return" and since) for f in flown)


# ---------------------------------------------------------------- pairing: P1, X8


@pytest.mark.requirement("P1", "X8")
def test_armed_only_after_pairing() -> None:
    """P1: the drone turns to the operator and rests, then Armed, and its place is anchor and session centre."""
    table = facing()
    assert table.state.state is State.FACING
    assert table.state.mode is Mode.NORMAL_AUTONOMY
    assert isinstance(table.log[-1], FaceOperator)
    table.until(State.ARMED)
    session = table.state.session
    assert session is not None
    assert session.anchor is not None
    assert session.anchor.position == session.centre == PLACE
    assert abs(abs(table.yaw_deg) - 180.0) <= 5.0
    assert [p["status"] for p in table.reports("pair")] == ["confirmed"]


@pytest.mark.requirement("P1", "X8")
@pytest.mark.parametrize("command", [c for c in Command if c not in MOVING])
def test_unpaired_requests_are_rejected(command: Command) -> None:
    table = Tabletop()
    request_id = table.ask(command)
    assert table.verdicts(request_id) == ["rejected"]
    assert table.failing(request_id) == {"paired"}
    assert not table.effects(Fly)


@pytest.mark.requirement("P1", "X8")
def test_a_refused_pairing_says_why_and_takes_no_authority() -> None:
    table = Tabletop()
    table.pairing_reasons = ("it is on the ground", "it is not healthy")
    table.tell()
    table.ask(Command.ACTIVATE)
    assert table.state.state is State.IDLE
    assert table.reports("pair")[-1]["reasons"] == ["it is on the ground", "it is not healthy"]
    assert not table.effects(LetGo)


@pytest.mark.requirement("P1", "X8")
def test_pairing_without_operator_or_telemetry_is_refused() -> None:
    table = Tabletop()
    table.ask(Command.ACTIVATE)  # nothing was ever heard from it
    assert table.state.state is State.IDLE
    assert table.effects(LetGo) == [LetGo("hold")]  # the shell had taken it
    table = pairing()
    table.put(PairingAnswered("red", (), None, FLAT))
    assert table.state.session is None


@pytest.mark.requirement("X6", "P1", "X8")
def test_not_a_number_is_not_paired() -> None:
    """X6: a yaw, place or velocity that is not finite is not facing the operator at rest."""
    good = {"yaw_deg": 180.0}
    for bad in ({"yaw_deg": math.nan}, {"position": Ned(math.nan, 0.0, 0.0)}, {"velocity": Ned(math.nan, 0.0, 0.0)}):
        table = facing()
        for _ in range(250):
            table.now_s += 0.1
            table.put(TelemetryArrived(replace(table.vehicle(), **(good | bad))))
            table.put(Tick())
            assert table.state.state in (State.FACING, State.IDLE)
        assert table.state.state is State.IDLE
        assert table.reports("pair")[-1]["status"] == "refused"


@pytest.mark.requirement("X4", "P1", "X8")
@pytest.mark.parametrize("made", [pairing, facing])
@pytest.mark.parametrize("command", [Command.STOP, Command.DISCONNECT])
def test_stop_or_disconnect_while_pairing_ends_it_unmoved(made: Callable[[], Tabletop], command: Command) -> None:
    """X4: no motion comes of a pairing that was called off, whatever the shell finds."""
    table = made()
    turns = len(table.effects(FaceOperator))
    table.ask(command)
    if made is pairing:
        table.put(PairingAnswered("red", (), table.operator, FLAT))
    assert table.state.state is State.IDLE
    assert len(table.effects(FaceOperator)) == turns
    assert table.effects(LetGo) == [LetGo("hold")]
    assert table.reports("pair")[-1]["status"] == "refused"


@pytest.mark.requirement("P1", "X8")
def test_the_answer_for_another_drone_is_nobodys() -> None:
    table = pairing()
    table.put(PairingAnswered("blue", (), table.operator, FLAT))
    assert table.state.state is State.PAIRING


@pytest.mark.requirement("P1", "X8")
def test_activate_while_paired() -> None:
    table = Tabletop().paired()
    table.ask(Command.ACTIVATE, colour="blue")
    assert table.reports("pair")[-1] == {
        "vehicle": "blue", "status": "refused", "reasons": ["red is paired; disconnect it first"],
        "operator": None, "vehicle_position": None,
    }  # fmt: skip
    table.ask(Command.ACTIVATE, colour="red")
    assert table.said()[-1] == "Red: already paired"
    assert table.state.state is State.ARMED
    assert len(table.effects(Pair)) == 1


@pytest.mark.requirement("R11", "X6", "P1", "X8")
def test_doubtful_activate_and_disconnect_do_nothing() -> None:
    """R11, X6: pairing needs confidence as a move does, and so does what may resume a mission."""
    table = Tabletop()
    table.ask(Command.ACTIVATE, confidence=0.3)
    assert not table.effects(Pair)
    assert table.reports("pair")[-1]["status"] == "refused"
    table = Tabletop().paired()
    table.ask(Command.DISCONNECT, confidence=0.3)
    assert table.state.session is not None
    assert "not disconnected" in table.said()[-1]


@pytest.mark.requirement("P1", "X8")
def test_disconnect_holds_and_lets_go() -> None:
    table = flying(policy=Policy(on_disconnect="resume"))
    table.ask(Command.DISCONNECT, colour="blue")
    assert table.state.state is State.EXECUTING
    table.ask(Command.DISCONNECT)
    assert table.log[-1] == LetGo("resume")
    assert Hold("disconnect") in table.log
    assert table.state.state is State.IDLE
    assert table.state.vehicle is None
    assert table.motions("aborted")
    assert table.reports("pair")[-1]["status"] == "released"


# ---------------------------------------------------------------- confidence: R11, P2, G1


@pytest.mark.requirement("R11", "P2", "G1")
def test_low_confidence_is_blocked_next() -> None:
    """The paper's STL property: detected with low confidence, next state Blocked; one step later Armed."""
    table = blocked()
    assert table.states()[-2:] == [State.DETECTED, State.BLOCKED]
    assert table.state.mode is Mode.BLOCKED
    table.tick()
    assert table.state.state is State.ARMED
    assert not table.effects(Fly)
    assert table.decisions()[-1]["requested_m"] == 1.0


@pytest.mark.requirement("R11", "P2", "G1")
def test_low_confidence_while_executing_holds_then_blocks() -> None:
    table = flying()
    flown = len(table.effects(Fly))
    request_id = table.ask(Command.GO_UP, confidence=0.2)
    assert Hold("interrupted") in table.steps[-1][3]
    table.until(lambda: State.BLOCKED in table.states(), 3.0)
    assert table.failing(request_id) == {"input_confidence"}
    assert len(table.effects(Fly)) == flown


@pytest.mark.requirement("X6", "R11", "P2", "G1")
@pytest.mark.parametrize("ago_s", [5.1, 60.0, -6.0, math.nan])
def test_what_was_asked_long_ago_is_refused(ago_s: float) -> None:
    """X6: a stale request is no request of now, and does not disturb what is flown."""
    table = flying()
    request_id = table.ask(Command.GO_UP, ago_s=ago_s)
    assert table.failing(request_id) == {"input_confidence"}
    assert table.state.state is State.EXECUTING


# ---------------------------------------------------------------- STOP and CONTINUE: X4, X12


@pytest.mark.requirement("X4", "X12")
def test_what_was_asked_before_stop_does_not_fly_after_it() -> None:
    table = Tabletop().paired().wait(2.0)
    table.ask(Command.STOP, PANEL)
    table.wait(0.5)
    request_id = table.ask(Command.GO_LEFT, VOICE, ago_s=0.8)
    assert table.verdicts(request_id) == ["rejected"]
    assert "before stop" in table.decisions(request_id)[-1]["findings"][0]["text"]
    assert not table.effects(Fly)


@pytest.mark.requirement("X4", "X12")
def test_a_refused_request_is_not_confirmed_after_stop() -> None:
    table = Tabletop().paired()
    table.ask(Command.GO_LEFT, VOICE, 0.5)
    table.ask(Command.STOP, PANEL)
    table.wait(0.3)
    second = table.ask(Command.GO_LEFT, GESTURE, 0.6)
    table.wait(1.0)
    assert table.failing(second) == {"input_confidence"}
    assert not table.effects(Fly)


@pytest.mark.requirement("X4", "X12")
def test_stop_in_every_wait_rejects_what_waited() -> None:
    for made in (delayed, waiting):
        table = made()
        table.ask(Command.STOP)
        assert table.decisions()[-1]["verdict"] == "rejected"
        assert table.decisions()[-1]["findings"][0]["requirements"] == ["X4"]
        table.wait(5.0)
        assert not table.effects(Fly)


@pytest.mark.requirement("X4", "X12")
def test_stop_anchors_where_motion_has_stopped_and_continue_flies_the_rest_once() -> None:
    table = flying()
    moved_m = abs(table.position.east)
    table.ask(Command.STOP)
    table.ask(Command.STOP)  # twice is once
    table.until(State.ARMED)
    session = table.state.session
    assert session is not None
    assert session.anchor is not None
    assert session.anchor.position == table.position
    request_id = table.ask(Command.CONTINUE)
    decision = table.decisions(request_id)[-1]
    assert decision["granted_m"] == pytest.approx(1.0 - moved_m, abs=0.01)
    assert decision["requested_m"] == decision["granted_m"]
    table.until(State.ARMED)
    again = table.ask(Command.CONTINUE)
    assert table.verdicts(again) == ["rejected"], "it has been flown"


@pytest.mark.requirement("X12", "X4")
@pytest.mark.parametrize("spoil", ["another", "late", "refused"])
def test_continue_is_refused(spoil: str) -> None:
    """X12: nothing left, another request since, or more than 30 s."""
    table = flying()
    table.ask(Command.STOP)
    table.until(State.ARMED)
    if spoil == "another":
        table.ask(Command.GO_UP)
        table.until(State.ARMED)
    elif spoil == "refused":
        table.ask(Command.GO_UP, confidence=0.1)
    else:
        table.wait(30.2)
    request_id = table.ask(Command.CONTINUE)
    assert table.verdicts(request_id) == ["rejected"]
    assert table.said()[-1].startswith("Red: cannot continue, ")


@pytest.mark.requirement("X9", "X4", "X12")
def test_a_stopped_turn_continues_to_the_operators_bearing() -> None:
    """X9."""
    table = flying(Command.TURN_LEFT)
    table.wait(3.0)
    table.ask(Command.STOP)
    turned_deg = table.motions("aborted")[-1]["yaw_deg"]
    table.until(State.ARMED)
    request_id = table.ask(Command.CONTINUE)
    decision = table.decisions(request_id)[-1]
    assert decision["requested_m"] is decision["granted_m"] is None
    table.until(State.ARMED)
    assert turned_deg + table.motions("completed")[-1]["yaw_deg"] == pytest.approx(360.0, abs=6.0)
    assert abs(abs(table.yaw_deg) - 180.0) < 0.1


# ---------------------------------------------------------------- fusion: X5


@pytest.mark.requirement("X5")
def test_a_second_modality_confirms_and_never_flies_twice() -> None:
    table = Tabletop().paired()
    first = table.ask(Command.GO_LEFT, VOICE)
    table.tick()
    table.ask(Command.GO_LEFT, GESTURE)
    table.until(State.ARMED).wait(2.0)
    assert len(table.effects(Fly)) == 1
    assert table.reports("request")[-1]["id"] == first
    assert table.reports("request")[-1]["modality"] is Modality.FUSED
    assert table.verdicts(first) == ["approved"]


@pytest.mark.requirement("X5")
@pytest.mark.parametrize(("first", "second"), [(0.5, 0.6), (0.69, 0.69), (0.1, 0.65)])
def test_two_doubtful_ones_make_no_sure_one(first: float, second: float) -> None:
    """Nothing measured says that they would be independent: what is refused alone is refused together."""
    table = Tabletop().paired()
    names = [table.ask(Command.GO_LEFT, VOICE, first)]
    table.tick()
    names.append(table.ask(Command.GO_LEFT, GESTURE, second))
    table.wait(3.0)
    assert [table.verdicts(name) for name in names] == [["rejected"], ["rejected"]]
    assert not table.effects(Fly)


@pytest.mark.requirement("X5")
def test_two_doubtful_ones_that_wait_for_rest_make_no_sure_one_either() -> None:
    table = flying(Command.GO_RIGHT)
    names = [table.ask(Command.GO_LEFT, VOICE, 0.5), table.ask(Command.GO_LEFT, GESTURE, 0.6)]
    table.wait(4.0)
    assert [table.verdicts(name)[-1] for name in names] == ["rejected", "rejected"]
    assert len(table.effects(Fly)) == 1


@pytest.mark.requirement("X5")
def test_a_sure_one_after_a_doubtful_one_is_judged_by_itself() -> None:
    for doubtful, sure in ((0.1, 0.7), (0.69, 0.95)):
        table = Tabletop().paired()
        first = table.ask(Command.GO_LEFT, VOICE, doubtful)
        table.tick()
        second = table.ask(Command.GO_LEFT, GESTURE, sure)
        assert (table.verdicts(first), table.verdicts(second)) == (["rejected"], ["approved"])
        assert table.reports("request")[-1]["modality"] is GESTURE


@pytest.mark.requirement("X5")
def test_a_doubtful_one_after_a_sure_one_neither_flies_twice_nor_lifts_it() -> None:
    table = Tabletop().paired()
    first = table.ask(Command.GO_LEFT, VOICE, 0.75)
    table.tick()
    table.ask(Command.GO_LEFT, GESTURE, 0.2)
    table.wait(8.0)
    assert len(table.effects(Fly)) == 1
    assert table.reports("request")[-1]["id"] == first
    assert table.reports("request")[-1]["confidence"] == 0.75


@pytest.mark.requirement("X5")
def test_what_waits_for_rest_is_confirmed_in_place() -> None:
    table = flying(Command.GO_RIGHT)
    first = table.ask(Command.GO_LEFT, VOICE, 0.75)
    table.ask(Command.GO_LEFT, GESTURE, 0.8)
    table.until(State.EXECUTING, 3.0)
    assert table.verdicts(first) == ["approved"]


@pytest.mark.requirement("X5")
@pytest.mark.parametrize("ago_s", [math.nan, math.inf, -math.inf, -0.6, -3.0, -60.0, 5.1, 1e9])
@pytest.mark.parametrize("command", [Command.GO_UP, Command.GO_LEFT, Command.CONTINUE, Command.TURN_LEFT])
def test_what_was_not_asked_now_changes_nothing(ago_s: float, command: Command) -> None:
    """Neither what is flown nor what fusion remembers: a duplicate after it still flies once."""
    table = Tabletop().paired()
    table.ask(Command.GO_LEFT, VOICE)
    table.tick()
    before = table.state
    odd = table.ask(command, PANEL, ago_s=ago_s)
    assert table.verdicts(odd) == ["rejected"]
    assert replace(table.state, tally=before.tally) == before
    table.ask(Command.GO_LEFT, GESTURE)
    table.wait(8.0)
    assert len(table.effects(Fly)) == 1


@pytest.mark.requirement("X5")
@pytest.mark.parametrize("made", [flying, delayed, waiting])
def test_contradiction_aborts_and_refuses_both(made: Callable[[], Tabletop]) -> None:
    table = made()
    last = table.state.recent[-1].request
    first = last.id
    ago_s = max(table.now_s - last.captured_at_s - 0.9, 0.0)
    second = table.ask(Command.GO_UP, GESTURE, ago_s=ago_s)
    assert table.failing(second) == {"contradiction"}
    assert table.state.mode is Mode.ARMED
    assert table.state.flight is None
    if made is flying:
        assert Hold("contradiction") in table.log
        assert table.motions("aborted")[-1]["request"] == first
    else:
        assert table.verdicts(first)[-1] == "rejected"
    table.until(State.ARMED).wait(1.0)
    assert table.state.state is State.ARMED


@pytest.mark.requirement("X5")
def test_a_contradicted_way_back_ends() -> None:
    """Design 6, 14: what runs is aborted, even if it is the way back that was asked for."""
    table = held(policy=ASK)
    table.wait(0.5)
    table.ask(Command.CONTINUE, VOICE)
    assert table.state.state is State.RETURN_TO_ANCHOR
    table.tick()
    table.ask(Command.GO_LEFT, GESTURE)
    table.until(State.ARMED, 3.0)


@pytest.mark.requirement("X5")
def test_a_later_change_of_mind_is_no_contradiction() -> None:
    table = flying()  # 1.5 s ago
    request_id = table.ask(Command.GO_UP, GESTURE)
    table.until(State.EXECUTING, 3.0)
    assert table.verdicts(request_id) == ["approved"]


# ---------------------------------------------------------------- interruption: X14


@pytest.mark.requirement("X14")
def test_a_new_request_interrupts_and_the_newest_wins() -> None:
    table = flying()
    second = table.ask(Command.GO_UP)
    third = table.ask(Command.GO_RIGHT)
    assert table.verdicts(second) == ["rejected"]
    assert table.motions("aborted")
    table.until(State.EXECUTING, 3.0)
    assert table.verdicts(third) == ["approved"]
    session = table.state.session
    assert session is not None
    assert session.anchor is not None
    assert session.anchor.position.minus(PLACE).norm > 0.1, "re-anchored where motion stopped"


@pytest.mark.requirement("X14")
def test_a_request_does_not_wait_for_rest_for_ever() -> None:
    """Every request gets its decision: here the drone never comes to rest."""
    table = flying()
    request_id = table.ask(Command.GO_UP)
    for _ in range(120):
        table.now_s += 0.1
        table.put(TelemetryArrived(replace(table.vehicle(), velocity=Ned(0.3, 0.0, 0.0))))
        table.put(Tick())
    assert table.verdicts(request_id) == ["rejected"]


# ---------------------------------------------------------------- delay, reservation, revalidation: X10


@pytest.mark.requirement("X10")
def test_delayed_then_flown_as_soon_as_it_clears() -> None:
    table = delayed()
    request_id = table.decisions()[-1]["request"]
    assert table.verdicts(request_id) == ["delayed"]
    started_s = table.now_s
    table.until(State.EXECUTING, 3.2)
    assert table.verdicts(request_id) == ["delayed", "approved"]
    assert table.now_s - started_s < 1.5, "not only at the deadline"


@pytest.mark.requirement("X10")
def test_delayed_and_still_hindered_is_rejected_at_the_deadline() -> None:
    table = delayed()
    request_id = table.decisions()[-1]["request"]
    held_by = table.volumes[0]
    table.volumes = (replace(held_by, until_s=table.now_s + 60.0),)
    started_s = table.now_s
    table.until(lambda: State.BLOCKED in table.states(), 4.0)
    assert 2.9 < table.now_s - started_s < 3.3
    assert table.verdicts(request_id) == ["delayed", "rejected"]
    assert table.failing(request_id) == {"reservation"}


@pytest.mark.requirement("X10")
@pytest.mark.parametrize("answer", ["denied", "expired"])
def test_a_denied_volume_blocks_with_all_findings(answer: Any) -> None:
    table = Tabletop().paired()
    table.grant = answer
    request_id = table.ask(Command.GO_LEFT)
    assert table.state.state is State.BLOCKED
    assert table.failing(request_id) == {"reservation"}
    told = [finding["constraint"] for finding in table.decisions(request_id)[-1]["findings"]]
    assert told == [rule.name for rule in RULES], "every rule's finding is told"
    assert not table.effects(Fly)


@pytest.mark.requirement("X10")
def test_no_answer_is_no_and_a_late_grant_is_given_back() -> None:
    table = waiting()
    table.until(lambda: State.BLOCKED in table.states(), 1.5)
    request_id = table.decisions()[-1]["request"]
    assert table.failing(request_id) == {"reservation"}
    released = len(table.effects(Release))
    table.put(ReservationAnswered(request_id, "granted"))
    assert len(table.effects(Release)) == released + 1
    assert not table.effects(Fly)


@pytest.mark.requirement("X10")
def test_a_grant_is_refused_if_the_situation_got_worse() -> None:
    table = waiting()
    ask_id = next(iter(table.reserved))
    table.sky = ball("blue", table.position.plus(Ned(0.0, -4.0, 0.0)), Ned(0.0, 0.0, 0.0), table.now_s)
    table.neighbours()
    table.put(ReservationAnswered(ask_id, "granted"))
    assert table.failing(table.decisions()[-1]["request"]) == {"separation"}
    assert table.states()[-1] is State.BLOCKED
    assert table.log[-1] is not Fly
    assert Release(ask_id) in table.log


@pytest.mark.requirement("X10")
def test_a_grant_is_refused_if_the_drone_has_drifted_from_the_start() -> None:
    table = waiting()
    table.position = table.position.plus(Ned(0.0, 0.5, 0.0))
    table.tell()
    table.put(ReservationAnswered(next(iter(table.reserved)), "granted"))
    assert table.failing(table.decisions()[-1]["request"]) == {"envelope"}


@pytest.mark.requirement("X10")
def test_a_volume_taken_back_in_flight_ends_the_flight_and_a_second_grant_does_not() -> None:
    table = flying()
    flight = table.state.flight
    assert flight is not None
    table.put(ReservationAnswered(flight.request_id, "granted"))
    assert table.state.state is State.EXECUTING
    assert Release(flight.request_id) not in table.log
    table.put(ReservationAnswered(flight.request_id, "expired"))
    assert Hold("stalled") in table.log
    assert table.state.state is State.SETTLING


# ---------------------------------------------------------------- monitoring and the way back: R9, R10, design 14


@pytest.mark.requirement("R9", "R10")
def test_an_approaching_aircraft_aborts_into_emergency_hold() -> None:
    table = held(policy=NEVER)
    assert Hold("violation") in table.log
    violation = table.reports("violation")[0]
    assert violation["kind"] == "predicted"
    assert violation["constraint"] == "separation"
    assert violation["action"] == "abort"
    session = table.state.session
    assert session is not None
    assert session.anchor is not None
    assert session.anchor.position == PLACE, "the anchor is kept"


@pytest.mark.requirement("R9", "R10")
def test_the_way_back_is_announced_two_seconds_ahead_and_ends_at_the_anchor() -> None:
    table = held()
    table.until(lambda: any("returning to the anchor" in text for text in table.said()), 3.0)
    announced_s = table.now_s
    table.until(State.RETURN_TO_ANCHOR, 3.0)
    assert 1.9 <= table.now_s - announced_s <= 2.3
    table.until(State.ARMED)
    assert table.position.minus(PLACE).norm < 0.15
    assert table.motions("completed")[-1]["request"] == "return"
    assert table.state.tally.completed == 0


@pytest.mark.requirement("R9", "R10")
def test_ask_returns_only_when_told_to_continue() -> None:
    table = held(policy=ASK)
    table.wait(6.0)
    assert table.state.state is State.EMERGENCY_HOLD
    request_id = table.ask(Command.CONTINUE)
    assert table.state.state is State.RETURN_TO_ANCHOR
    assert table.state.flight is not None
    assert table.state.flight.plan.primitive is Primitive.RETURN
    table.until(State.ARMED)
    assert table.verdicts(request_id) == ["approved"]
    assert table.position.minus(PLACE).norm < 0.15


@pytest.mark.requirement("R9", "R10")
def test_never_stays_until_a_new_request() -> None:
    table = held(policy=NEVER)
    table.wait(8.0)
    assert table.state.state is State.EMERGENCY_HOLD
    table.ask(Command.GO_UP)
    assert table.state.state is State.EXECUTING


@pytest.mark.requirement("R9", "R10")
def test_stop_in_emergency_hold_cancels_the_way_back() -> None:
    table = held()
    table.wait(1.0)
    table.ask(Command.STOP)
    table.wait(8.0)
    assert table.state.state is State.EMERGENCY_HOLD
    assert len(table.effects(Fly)) == 1


@pytest.mark.requirement("R9", "R10")
def test_stop_and_requests_end_the_way_back() -> None:
    for command in (Command.STOP, Command.GO_UP):
        table = returning()
        table.ask(command)
        assert table.state.state is State.SETTLING
        assert table.state.flight is None


@pytest.mark.requirement("R9", "R10")
def test_a_request_cancels_a_way_back_that_waits_for_airspace() -> None:
    """The grant that comes after a newer request flies nothing: not what was asked then, and not what is asked next."""
    table = held()
    table.grant = None
    table.until(lambda: table.state.deciding is not None, 6.0)
    late = table.effects(Reserve)[-1].request_id
    table.ask(Command.GO_UP, confidence=0.1)
    table.put(ReservationAnswered(late, "granted"))
    assert len(table.effects(Fly)) == 1
    table.until(lambda: table.effects(Reserve)[-1].request_id != late, 6.0)
    table.put(ReservationAnswered(late, "granted"))
    assert len(table.effects(Fly)) == 1
    assert Release(late) in table.log


@pytest.mark.requirement("R9", "R10")
@pytest.mark.parametrize("made", [waiting, flying, held])
def test_nobody_elses_grant_flies(made: Callable[[], Tabletop]) -> None:
    table = made()
    flights = len(table.effects(Fly))
    for name in ("r1", "r3", "return", "", "r2-1", "return-0", "return-9"):
        if name not in table.reserved:
            table.put(ReservationAnswered(name, "granted"))
            assert Release(name) in table.log, "what nobody waits for is given back"
    assert len(table.effects(Fly)) == flights


@pytest.mark.requirement("R9", "R10")
def test_every_ask_for_airspace_has_its_own_id() -> None:
    table = held()
    table.grant = "denied"
    table.wait(20.0)
    asks = [e.request_id for e in table.effects(Reserve)]
    assert len(asks) == len(set(asks)) >= 3


# ---------------------------------------------------------------- EmergencyHold is left by an approval alone: R10, design 14


def refused_by_doubt(table: Tabletop) -> str:
    return table.ask(Command.GO_LEFT, confidence=0.1)


def refused_by_a_rule(table: Tabletop) -> str:
    table.sky = ball("blue", table.position.plus(Ned(0.0, -4.0, 0.0)), Ned(0.0, 0.0, 0.0), table.now_s)
    table.neighbours()
    return table.ask(Command.GO_LEFT)


def refused_by_the_authority(table: Tabletop) -> str:
    table.grant = "denied"
    name = table.ask(Command.GO_UP)
    table.grant = "granted"
    return name


def refused_by_silence(table: Tabletop) -> str:
    table.grant = None
    name = table.ask(Command.GO_UP)
    table.wait(1.2)
    table.grant = "granted"
    return name


def refused_as_nothing_to_continue(table: Tabletop) -> str:
    return table.ask(Command.CONTINUE)


def refused_as_stale(table: Tabletop) -> str:
    return table.ask(Command.GO_UP, ago_s=60.0)


def refused_as_contradiction(table: Tabletop) -> str:
    table.grant = None
    table.ask(Command.GO_UP, VOICE)
    name = table.ask(Command.GO_LEFT, GESTURE)
    table.grant = "granted"
    return name


REFUSALS = [
    refused_by_doubt,
    refused_by_a_rule,
    refused_by_the_authority,
    refused_by_silence,
    refused_as_nothing_to_continue,
    refused_as_stale,
]


@pytest.mark.requirement("R10")
@pytest.mark.parametrize("refuse", REFUSALS)
def test_a_refused_request_stays_in_emergency_hold_and_keeps_the_way_back(refuse: Callable[[Tabletop], str]) -> None:
    table = held().wait(1.0)
    anchor = table.state.session.anchor if table.state.session else None
    name = refuse(table)
    table.tick()
    assert table.verdicts(name) == ["rejected"]
    assert table.state.state is State.EMERGENCY_HOLD
    assert table.state.session is not None and table.state.session.anchor is anchor
    table.sky = Neighbours.none(math.inf)
    table.until(State.RETURN_TO_ANCHOR, 10.0)


@pytest.mark.requirement("R10")
def test_a_contradiction_in_emergency_hold_stays_there_and_ends_the_way_back() -> None:
    table = held().wait(1.0)
    name = refused_as_contradiction(table)
    table.wait(10.0)
    assert table.verdicts(name) == ["rejected"]
    assert table.state.state is State.EMERGENCY_HOLD
    assert len(table.effects(Fly)) == 1


@pytest.mark.requirement("R10")
def test_stop_while_a_request_is_decided_in_emergency_hold_stays_there() -> None:
    table = held().wait(1.0)
    table.grant = None
    table.ask(Command.GO_UP)
    table.ask(Command.STOP)
    table.grant = "granted"
    table.wait(10.0)
    assert table.state.state is State.EMERGENCY_HOLD
    assert len(table.effects(Fly)) == 1


@pytest.mark.requirement("R10", "X14")
def test_a_newer_request_in_emergency_hold_is_decided_at_once() -> None:
    """The one before still waits for its airspace; nothing is waited for that never comes."""
    table = held().wait(1.0)
    table.grant = None
    first = table.ask(Command.GO_UP)
    assert table.state.state is State.PLANNED
    table.grant = "granted"
    second = table.ask(Command.GO_RIGHT)
    assert table.verdicts(first) == ["rejected"]
    assert table.verdicts(second) == ["approved"]
    assert table.state.state is State.EXECUTING


@pytest.mark.requirement("P1")
def test_a_transition_that_the_table_lacks_is_told_and_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    """In flight: the tests put an exception in the place of what tells it."""
    monkeypatch.setattr("m3r_app.arbiter.context.impossible", ImpossibleTransition)
    table = Tabletop().paired()
    run = Step(table.state, table.now_s)
    run.go(Cause.COMPLETED)
    assert run.state is table.state
    assert run.effects == [ImpossibleTransition(State.ARMED, Cause.COMPLETED)]


@pytest.mark.requirement("R10")
def test_dry_run_leaves_no_emergency_hold() -> None:
    table = held().wait(1.0)
    table.state = replace(table.state, policy=replace(table.state.policy, dry_run=True))
    table.ask(Command.GO_UP)
    assert table.state.state is State.EMERGENCY_HOLD


@pytest.mark.requirement("X10", "R10")
def test_a_way_back_without_airspace_is_announced_anew_later() -> None:
    """X10: denied, it stays where it is and says why; granted later, it flies."""
    table = held()
    table.grant = "denied"
    table.until(lambda: any("not returning yet, the airspace is not ours" in text for text in table.said()), 6.0)
    assert table.state.state is State.EMERGENCY_HOLD
    assert len(table.effects(Fly)) == 1
    assert not table.decisions("return")
    table.grant = "granted"
    table.until(State.RETURN_TO_ANCHOR, 3.0 + table.state.limits.delay_s)
    assert len([text for text in table.said() if "returning to the anchor in" in text]) == 2


@pytest.mark.requirement("R10")
def test_an_announced_way_back_waits_until_it_is_safe_again() -> None:
    """Somebody reserves the airspace between: the two seconds begin anew once it is free."""
    table = held()
    table.until(lambda: table.state.return_at_s is not None, 3.0)
    anchor = PLACE
    table.volumes = (ReservedVolume("blue", anchor, anchor, 0.5, table.now_s, table.now_s + 60.0),)
    table.wait(4.0)
    assert table.state.state is State.EMERGENCY_HOLD
    assert table.state.return_at_s is None
    table.volumes = ()
    freed_s = table.now_s
    table.until(State.RETURN_TO_ANCHOR, 4.0)
    assert table.now_s - freed_s >= table.state.limits.return_after_s


@pytest.mark.requirement("R10")
def test_a_failed_way_back_is_not_tried_for_ever() -> None:
    table = returning()
    table.sky = ball("blue", table.position.plus(Ned(4.0, 0.0, 0.0)), Ned(-3.0, 0.0, 0.0), table.now_s)
    table.until(State.EMERGENCY_HOLD, 1.0)
    table.sky = Neighbours.none(math.inf)
    table.wait(10.0)
    assert table.state.state is State.EMERGENCY_HOLD


@pytest.mark.requirement("X6", "R10")
def test_a_dead_feed_in_flight_aborts() -> None:
    """X6: neighbours that cannot be known cannot be kept apart from."""
    table = Tabletop()
    table.sky = Neighbours.none(table.now_s + 3.0)
    table.paired()
    table.sky = Neighbours.none(table.now_s)
    table.neighbours()
    table.ask(Command.GO_LEFT)
    table.until(State.EMERGENCY_HOLD, 2.0)
    assert table.reports("violation")[-1]["constraint"] == "neighbour_age"


# ---------------------------------------------------------------- loss: X3, X7


@pytest.mark.requirement("X3", "X7")
@pytest.mark.parametrize("state", [s for s in MADE if s not in (State.IDLE, State.PAIRING)])
@pytest.mark.parametrize("mode", [FlightMode.POSITION, FlightMode.RETURN, FlightMode.LAND])
def test_a_takeover_is_never_fought(state: State, mode: str) -> None:
    """X3: nothing is commanded any more, whatever comes, until a new pairing."""
    table = MADE[state]()
    table.flight_mode = mode
    effects = table.put(TelemetryArrived(table.vehicle()))
    assert table.state.state is State.IDLE
    assert not [e for e in effects if isinstance(e, Hold | Fly | FaceOperator)]
    assert LetGo("nothing") in effects
    mark = len(table.log)
    for command in (Command.STOP, Command.GO_LEFT, Command.CONTINUE, Command.DISCONNECT):
        table.ask(command)
    table.put(Ended("the run is over"))
    table.wait(1.0)
    assert not [e for e in table.log[mark:] if isinstance(e, Hold | Fly | FaceOperator | LetGo)]


@pytest.mark.requirement("X3", "X6", "X7")
@pytest.mark.parametrize("state", [s for s in MADE if s not in (State.IDLE, State.PAIRING)])
def test_a_mode_that_is_not_told_any_more_is_held_and_let_go(state: State) -> None:
    """X3, X6: nobody is known to have taken over, so the drone is not left on the last setpoint."""
    table = MADE[state]()
    table.flight_mode = FlightMode.UNKNOWN
    effects = table.put(TelemetryArrived(table.vehicle()))
    assert table.state.state is State.IDLE
    assert LetGo("hold") in effects


@pytest.mark.requirement("X8", "X3", "X7")
def test_an_unfit_drone_drops_the_plan_and_flies_no_other() -> None:
    """X8: health and battery are looked at after pairing too."""
    for unfit in ({"healthy": False}, {"battery": 0.1}):
        table = flying()
        vehicle = replace(table.vehicle(), **unfit)
        effects = table.put(TelemetryArrived(vehicle))
        assert Hold("stalled") in effects
        assert table.state.flight is None


@pytest.mark.requirement("X6", "X3", "X7")
def test_a_frozen_position_stops_the_motion() -> None:
    """X6: the velocity says it flies, the position says it does not; one of them is wrong."""
    table = flying()
    frozen = table.vehicle()
    for i in range(1, 100):
        table.now_s += 0.02
        table.put(TelemetryArrived(replace(frozen, at_s=frozen.at_s + 0.02 * i, velocity=Ned(0.0, 0.5, 0.0))))
        if table.state.flight is None:
            break
    assert table.state.state is State.EMERGENCY_HOLD
    assert 0.02 * i < 1.8


@pytest.mark.requirement("X3", "X7")
def test_on_the_ground_is_let_go() -> None:
    table = flying()
    table.in_air = False
    table.until(lambda: table.state.session is None, 2.0)
    assert table.effects(LetGo) == [LetGo("nothing")]


@pytest.mark.requirement("X3", "X7")
def test_a_telemetry_gap_drops_the_plan() -> None:
    table = flying()
    for _ in range(6):
        table.tick(telemetry=False)
    assert table.state.state is State.SETTLING
    assert Hold("stalled") in table.log
    table = flying()
    table.now_s += 2.0  # the app itself was stopped: telemetry is the first thing it sees
    table.tell()
    assert table.state.flight is None
    table.wait(3.0)
    assert len(table.effects(Fly)) == 1, "the rest is asked for anew"


@pytest.mark.requirement("X3", "X7")
def test_the_autopilot_leaving_offboard_drops_the_plan() -> None:
    table = flying()
    table.flight_mode = FlightMode.HOLD
    table.tell()
    assert table.state.state is State.SETTLING


@pytest.mark.requirement("X3", "X7")
def test_a_stall_in_flight_settles_and_while_facing_refuses() -> None:
    table = flying()
    table.put(Stalled("the guard commanded Hold"))
    assert table.state.state is State.SETTLING
    table = facing()
    table.put(Stalled("it refuses Offboard"))
    assert table.state.state is State.IDLE
    assert table.reports("pair")[-1]["reasons"] == ["it refuses Offboard"]


# ---------------------------------------------------------------- shorter, slower, recovering: P3, design 7, 8


@pytest.mark.requirement("P3")
def test_reduced_says_both_lengths_and_why() -> None:
    limits = Limits(tracking_m=0.0, lag_s=0.0)
    table = Tabletop(world=replace(FLAT, obstacles=wall_at(12.5)), limits=limits).paired()
    request_id = table.ask(Command.GO_FORWARD)
    decision = table.decisions(request_id)[-1]
    assert decision["verdict"] == "reduced"
    assert decision["requested_m"] == 1.0
    assert 0.1 <= decision["granted_m"] < 1.0
    assert f"{decision['granted_m']:.2f} m of 1.00 m" in table.said()[-1]
    assert "wall" in table.said()[-1]


@pytest.mark.requirement("P3")
@pytest.mark.parametrize("wall_m", [12.5, 40.0])
def test_a_dry_run_decides_as_ever_and_flies_nothing(wall_m: float) -> None:
    """The same decision as when it is flown, then Armed again."""
    limits, world = Limits(tracking_m=0.0, lag_s=0.0), replace(FLAT, obstacles=wall_at(wall_m))
    flown = Tabletop(world=world, limits=limits).paired()
    real = flown.decisions(flown.ask(Command.GO_FORWARD))
    table = Tabletop(world=world, limits=limits, policy=Policy(dry_run=True)).paired()
    before = table.state.tally
    dry = table.decisions(table.ask(Command.GO_FORWARD))
    ours = {"request": None}
    assert [{**d, **ours} for d in dry] == [{**d, **ours} for d in real]
    assert table.said()[-1] == f"dry run, {flown.said()[-1]}"
    assert table.state.state is State.ARMED
    assert table.state.flight is None
    assert table.state.tally == replace(before, requests=before.requests + 1, approved=before.approved + 1)
    table.ask(Command.STOP)
    assert table.wait(1.0).state.state is State.ARMED


@pytest.mark.requirement("P3")
def test_an_offer_flies_only_after_continue() -> None:
    """Design 7: replaced is a suggestion."""
    world, limits = replace(FLAT, obstacles=wall_at(12.25)), Limits(lateral_step_m=0.1)
    rejected = Tabletop(world=world, limits=limits).paired()
    request_id = rejected.ask(Command.GO_FORWARD)
    assert rejected.verdicts(request_id) == ["rejected"]
    table = Tabletop(world=world, policy=Policy(replace="offer"), limits=limits).paired()
    offered = table.ask(Command.GO_FORWARD)
    assert table.verdicts(offered) == ["replaced"], table.said()[-1]
    assert table.decisions(offered)[-1]["granted_m"] is None
    table.wait(2.0)
    assert not table.effects(Fly)
    request_id = table.ask(Command.CONTINUE)
    assert table.verdicts(request_id) == ["approved"]
    (fly,) = table.effects(Fly)
    assert fly.plan.move.speed < table.state.limits.speed_m_s


@pytest.mark.requirement("X13", "P3")
def test_a_plan_that_mends_is_flown_out_of_the_violation() -> None:
    """X13: hovering too close to a wall, away from it is allowed, and the monitor lets it."""
    table = Tabletop(world=replace(FLAT, obstacles=wall_at(11.4))).paired().wait(0.3)
    assert [v["kind"] for v in table.reports("violation")] == ["actual"]
    away = table.ask(Command.GO_BACK)
    assert table.verdicts(away) == ["approved"]
    table.until(State.ARMED)
    assert table.motions("completed")
    towards = table.ask(Command.GO_FORWARD)
    assert table.verdicts(towards) == ["reduced"]


@pytest.mark.requirement("P3")
def test_states_are_frozen() -> None:
    before = Tabletop().paired().state
    copy = replace(before)
    step(before, Tick(), 200.0)
    assert before == copy
    assert isinstance(before, ArbiterState)
