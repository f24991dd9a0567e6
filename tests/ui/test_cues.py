"""What is spoken: for every event the right few words, never a request, never the same again while nothing changes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from m3r_app.output import Notice, Told
from modalities.voice.phrases import STOP_WORD, PhraseTable, normalise
from safety.constraints import DECLARED
from safety.separation import neighbour_age, separation
from safety.situation import Situation
from safety.spatial import geofence, obstacle_clearance
from safety.vocabulary import Finding, Ned
from tests.safety.scene import EXACT, NOW_S, START, situation, sky, square_fence, straight, wall, world
from tests.told import told
from tests.ui.all_cues import CONSTRAINTS, all_cues, decision, finding, pair, paired, request
from ui.cues import AGAIN_S, Cue, Cues, metres, number

ROOT = Path(__file__).resolve().parents[2]
COLOURS = ("red", "green", "blue")
TABLE = PhraseTable(COLOURS)
STILL = Ned(0.0, 0.0, 0.0)
AHEAD = START.plus(Ned(2.0, 0.0, 0.0))


def violation(constraint: str = "obstacle_clearance", action: str = "abort", t: float = 2.0, **fields: Any) -> Told:
    return told("violation", t, action=action, **finding(constraint, **{"subject": "the wall", **fields}))


def mode(cause: str, to: str = "Blocked", t: float = 2.0) -> Told:
    return told("mode", t, mode=to, cause=cause)


def announce(notice: Notice) -> Told:
    return told("announce", 2.0, notice=notice, text="any sentence")


def completed(number: str = "r1") -> Told:
    return told("motion", 2.0, request=number)


def last(*events: Told, **options: bool) -> Cue | None:
    """The cue of the last event."""
    cues = paired(**options)
    return [cues.of(event) for event in events][-1]


WALL = finding("obstacle_clearance", "the wall")
BLUE = finding("separation", "blue")


@pytest.mark.parametrize(
    ("events", "text", "urgent"),
    [
        ([request("go_left"), decision("approved", granted_m=1.0)], "Red: left, one metre", False),
        ([request("go_left"), decision("reduced", WALL, granted_m=0.4)], "Red: left, forty centimetres, wall ahead", False),
        ([request("go_up"), decision("reduced", WALL, granted_m=0.4)], "Red: up, forty centimetres, wall above", False),
        ([request("go_down"), decision("reduced", finding("terrain_clearance"), granted_m=0.25)],
         "Red: down, twenty-five centimetres, ground below", False),
        ([request("go_back"), decision("reduced", BLUE, granted_m=0.1)], "Red: back, ten centimetres, Blue too near", False),
        ([request("go_left"), decision("rejected", WALL, BLUE)], "Red: left refused, wall too near", True),
        ([request("go_forward"), decision("rejected", finding("agl", margin=None))], "Red: forward refused, ground unknown", True),
        ([request("go_left"), decision("rejected", finding("input_confidence"))], "Red: not sure what you said", True),
        ([request("go_left", "gesture"), decision("rejected", finding("input_confidence"))], "Red: not sure what you showed", True),
        ([request("go_left", "fused"), decision("rejected", finding("input_confidence"))], "Red: not sure what you asked", True),
        ([request("go_left"), decision("rejected", finding("input_confidence", margin=None))], "Red: ask again", True),
        ([request("turn_left"), decision("approved")], "Red: left turn", False),
        ([request("turn_right"), decision("rejected", finding("authority", margin=None))], "Red: right turn refused, not yours", True),
        ([request("go_right"), decision("delayed", finding("reservation"))], "Red: right in a moment, held by others", False),
        ([request("go_right"), decision("replaced", finding("envelope"))],
         "Red: right refused, over its limits, slower is offered", False),
        ([request("continue"), decision("reduced", WALL, granted_m=0.15)], "Red: going on, fifteen centimetres, wall ahead", False),
        ([request("go_left"), decision("rejected", finding("contradiction", requirements=["X5"]))],
         "Red: holding, two different requests", True),
        ([request("continue"), decision("rejected", finding("contradiction", requirements=["X12"]))],
         "Red: nothing to go on with", True),
        ([request("go_left"), completed()], "Red: left done", False),
        ([request("turn_right"), completed()], "Red: right turn done", False),
        ([completed("return")], "Red: at the anchor again", False),
        ([request("stop")], "Red: holding", True),
        ([violation()], "Red: holding, wall too near", True),
        ([violation("separation", "hold")], "Red: holding, Wall too near", True),
        ([violation(action="none, the plan mends it")], "Red: wall too near", True),
        ([violation("neighbour_age", margin=None)], "Red: holding, others silent", True),
        ([mode("stalled")], "Red: holding, ask again", True),
        ([mode("return_approved")], "Red: returning", False),
        ([mode("authority_lost")], "Red: no longer yours", True),
        ([pair("released", t=2.0)], "Red: released", False),
        ([pair("refused", "blue", 2.0)], "Blue: not paired", True),
        ([pair("refused", "red", 2.0)], "Red: already paired, ask again", True),
        ([announce(Notice.RETURNING_SOON)], "Red: returning soon", True),
        ([announce(Notice.VOICE_GONE)],
         "You are not heard", True),
    ],
)  # fmt: skip
def test_what_is_spoken(events: list[Told], text: str, urgent: bool) -> None:
    assert last(*events) == Cue(text, urgent)


@pytest.mark.parametrize(
    "events",
    [
        [request("go_left")],  # its decision follows
        [told("motion", status="started")],
        [told("motion", status="aborted")],
        [
            request("go_left"),
            decision("rejected", finding("contradiction", requirements=["X4"])),
        ],  # STOP said "holding"
        [request("go_left"), decision("rejected", finding("contradiction", requirements=["X14"]))],
        [mode("guards_failed")],  # the decision has told
        [announce(Notice.INFORMATION)],
        [mode("authority_lost"), pair("released", t=2.0)],
        [told("end", 9.0, reason="timeout")],
    ],
)
def test_what_is_not_spoken(events: list[Told]) -> None:
    assert last(*events) is None


def test_pairing_and_no_drone() -> None:
    cues = Cues()
    assert cues.of(request("stop")) == Cue("Nothing to hold", urgent=True)
    assert cues.of(request("go_left")) is None
    assert cues.of(decision("rejected", finding("paired", margin=None))) == Cue("No drone is paired", urgent=True)
    assert cues.of(pair("requested")) == Cue("Red: pairing")
    assert cues.of(request("stop")) == Cue("Red: holding", urgent=True)
    assert cues.of(pair("refused")) == Cue("Red: not paired", urgent=True)
    assert cues.of(request("stop")) == Cue("Nothing to hold", urgent=True)
    cues.of(pair("requested", "blue"))
    assert cues.of(pair("confirmed", "blue")) == Cue("Blue: paired")


def test_a_dry_run_says_so() -> None:
    assert last(request("go_left"), decision("approved", granted_m=1.0), dry_run=True) == Cue(
        "Red: dry run, left, one metre"
    )


def test_nothing_is_repeated_while_nothing_changes() -> None:
    cues = paired()
    assert cues.of(violation(t=2.0)) is not None
    assert cues.of(violation(t=5.0)) is None
    assert cues.of(violation("separation", t=6.0)) is not None
    assert cues.of(violation(t=7.0)) is None
    assert cues.of(violation(t=2.0 + AGAIN_S)) is not None  # it is there again
    cues.of(request("go_left"))
    assert cues.of(violation(t=13.0)) is not None
    assert cues.of(mode("settled", to="ManeuverResponseArmed", t=14.0)) is None  # no other mode than before
    assert cues.of(violation(t=15.0)) is None
    cues.of(mode("completed", t=16.0))
    assert cues.of(violation(t=17.0)) is not None


def test_two_refusals_are_two_answers() -> None:
    cues = paired()
    for name in ("r1", "r2"):
        cues.of(request("go_left", number=name))
        assert cues.of(decision("rejected", WALL, number=name)) == Cue("Red: left refused, wall too near", urgent=True)


def test_of_violations_at_once_the_first_is_spoken() -> None:
    cues = paired()
    assert cues.of(violation(t=2.0)) is not None
    assert cues.of(violation("agl", t=2.1)) is None
    assert cues.of(violation("agl", t=2.4)) is not None


def test_only_the_latest_requests_are_remembered() -> None:
    cues = paired()
    for i in range(100):
        cues.of(request("go_left", number=f"r{i}"))
    assert len(cues._asked) <= 32
    assert cues.of(decision("approved", granted_m=1.0, number="r0")) == Cue("Red: move, one metre")


def told_by_the_rules(rule: Any, scene: Situation) -> dict[str, Any]:
    found: Finding = rule(straight(START.plus(Ned(1.0, 0.0, 0.0))), scene, EXACT)
    assert not found.passed
    return finding(found.constraint, found.subject, found.margin)


@pytest.mark.parametrize(
    ("found", "why"),
    [
        (told_by_the_rules(obstacle_clearance, situation(world=world(obstacles=wall(2.0, "the wall")))), "wall too near"),
        (told_by_the_rules(obstacle_clearance, situation(world=world(obstacles=wall(2.0, "Bus stop 4")))), "something too near"),
        (told_by_the_rules(obstacle_clearance, situation(world=world(obstacles=wall(2.0, "go left")))), "something too near"),
        (told_by_the_rules(obstacle_clearance, situation(world=world(obstacles=wall(2.0, "a {very} old oak tree")))), "something too near"),
        (told_by_the_rules(separation, situation(neighbours=sky(("blue", AHEAD, STILL, 0.0, NOW_S)))), "Blue too near"),
        (told_by_the_rules(separation, situation(neighbours=sky(("stop", AHEAD, STILL, 0.0, NOW_S)))), "others too near"),
        (told_by_the_rules(neighbour_age, situation(neighbours=sky(("blue", START, STILL, 0.0, NOW_S - 2.0)))), "Blue silent"),
        (told_by_the_rules(neighbour_age, situation(neighbours=sky(feed_at_s=NOW_S - 2.0))), "others silent"),
        (told_by_the_rules(geofence, situation(world=world(geofence=square_fence(0.5)))), "border too near"),
    ],
)  # fmt: skip
def test_names_come_from_the_rules(found: dict[str, Any], why: str) -> None:
    assert last(request("go_left"), decision("rejected", found)) == Cue(f"Red: left refused, {why}", urgent=True)


def test_every_constraint_has_its_words() -> None:
    assert set(DECLARED) == set(CONSTRAINTS)
    assert all(each.spoken.broken and each.spoken.unknown for each in DECLARED.values())


def is_no_request(text: str, table: PhraseTable) -> bool:
    """Neither as a whole, nor any of its words in a row: wherever a listener hears an end, it is no phrase."""
    said = f" {normalise(text)} "
    return table.interpret(text) is None and not any(f" {phrase} " in said for phrase in table.phrases)


def test_no_cue_is_a_request() -> None:
    cues = all_cues()
    assert len(cues) > 1000
    assert [text for text in cues if not is_no_request(text, TABLE)] == []
    assert [text for text in cues if STOP_WORD in text.lower()] == []
    assert [text for text in cues if len(normalise(text).split()) > 12] == []


@pytest.mark.parametrize("colour", ["stop", "left", "go", "fly", "turn", "activate", "continue", "back"])
def test_a_drone_whose_name_is_half_a_request_is_just_a_drone(colour: str) -> None:
    table = PhraseTable((*COLOURS, colour))
    assert [text for text in all_cues((colour,)) if not is_no_request(text, table)] == []


SAID = st.lists(st.sampled_from([*TABLE.words, "the", "tree", "two"]), min_size=1, max_size=4).map(" ".join)


@given(st.one_of(SAID, st.text(max_size=30)), st.sampled_from(CONSTRAINTS), st.sampled_from(["go_left", "turn_left"]))
def test_nobodys_name_makes_a_request_of_a_cue(name: str, constraint: str, command: str) -> None:
    found = finding(constraint, name)
    for event in (
        decision("rejected", found),
        decision("reduced", found, granted_m=0.4),
        violation(constraint, subject=name),
    ):
        cue = last(request(command), event)
        assert cue is None or is_no_request(cue.text, TABLE), cue


@pytest.mark.parametrize(
    ("length_m", "said"),
    [
        (0.0, "zero centimetres"), (0.01, "one centimetre"), (0.4, "forty centimetres"), (0.994, "ninety-nine centimetres"),
        (0.996, "one metre"), (1.0, "one metre"), (1.5, "one point five metres"), (1.96, "two metres"), (5.0, "five metres"),
    ],
)  # fmt: skip
def test_lengths_in_words(length_m: float, said: str) -> None:
    assert metres(length_m) == [said]


def test_a_length_that_does_not_exist_is_not_spoken() -> None:
    assert metres(None) == []


def test_numbers_in_words() -> None:
    assert [number(n) for n in (0, 7, 12, 19, 20, 21, 40, 99, 100, -1)] == [
        "zero", "seven", "twelve", "nineteen", "twenty", "twenty-one", "forty", "ninety-nine", "100", "-1",
    ]  # fmt: skip
    assert len({number(n) for n in range(100)}) == 100
