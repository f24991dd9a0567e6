"""From landmarks to one of nine gestures or nothing: grammar, directions, size, side, mirror, doubt (R1, X4)."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from modalities.hands.gestures import (
    DISAGREE,
    ELSEWHERE,
    LEAST_CONFIDENCE,
    MOST_HANDS,
    NO_HAND,
    TOO_MANY,
    Hand,
    Region,
    finger_states,
    read_hand,
    read_hands,
)
from safety.vocabulary import Command
from tests.modalities.hand_shapes import HEIGHT_PX, WIDTH_PX, make_hand

UP, DOWN, PICTURES_RIGHT, PICTURES_LEFT = 90.0, -90.0, 0.0, 180.0
NINE = [
    ("-|---", UP, Command.GO_UP),
    ("-|---", DOWN, Command.GO_DOWN),
    ("-|---", PICTURES_RIGHT, Command.GO_LEFT),
    ("-|---", PICTURES_LEFT, Command.GO_RIGHT),
    ("-||--", UP, Command.GO_FORWARD),
    ("-||--", DOWN, Command.GO_BACK),
    ("-||--", PICTURES_RIGHT, Command.TURN_LEFT),
    ("-||--", PICTURES_LEFT, Command.TURN_RIGHT),
    ("|||||", UP, Command.STOP),
]
MIRROR = {
    Command.GO_LEFT: Command.GO_RIGHT,
    Command.GO_RIGHT: Command.GO_LEFT,
    Command.TURN_LEFT: Command.TURN_RIGHT,
    Command.TURN_RIGHT: Command.TURN_LEFT,
}
MEANT = {"-|---", "-||--", "|||||"}


@pytest.mark.requirement("R1")
@pytest.mark.parametrize("left_hand", [False, True])
@pytest.mark.parametrize("size_px", [25.0, 110.0])
@pytest.mark.parametrize("tilt_deg", [-20.0, 0.0, 20.0])
@pytest.mark.parametrize(("stretched", "angle_deg", "command"), NINE)
def test_nine_gestures_of_any_size_side_and_tilt(
    stretched: str, angle_deg: float, command: Command, tilt_deg: float, size_px: float, left_hand: bool
) -> None:
    reading = read_hand(make_hand(stretched, angle_deg + tilt_deg, size_px=size_px, left_hand=left_hand))
    assert reading.command is command
    assert reading.confidence >= 0.7


@pytest.mark.parametrize(("stretched", "angle_deg", "command"), NINE)
def test_a_mirrored_camera_swaps_left_and_right_and_nothing_else(
    stretched: str, angle_deg: float, command: Command
) -> None:
    hand = make_hand(stretched, angle_deg)
    assert read_hand(hand, mirrored=True).command is MIRROR.get(command, command)
    flipped = replace(
        hand,
        points_px=hand.points_px * (-1.0, 1.0, 1.0) + (WIDTH_PX, 0.0, 0.0),
        world_m=hand.world_m * (-1.0, 1.0, 1.0),
    )
    mirrored = read_hand(flipped, mirrored=True)
    assert mirrored.command is command
    assert mirrored.text == read_hand(hand).text


@pytest.mark.requirement("R1")
@pytest.mark.parametrize("angle_deg", [UP, DOWN, PICTURES_RIGHT, PICTURES_LEFT])
@pytest.mark.parametrize(
    "stretched", ["".join(shape) for shape in product("|-", repeat=5) if "".join(shape) not in MEANT]
)
def test_every_other_shape_asks_for_nothing(stretched: str, angle_deg: float) -> None:
    reading = read_hand(make_hand(stretched, angle_deg))
    assert reading.command is None
    assert reading.confidence == 0.0
    assert reading.text


@pytest.mark.requirement("X4")
@pytest.mark.parametrize("angle_deg", [UP, DOWN, PICTURES_RIGHT])
def test_an_open_palm_stops_however_it_is_turned(angle_deg: float) -> None:
    assert read_hand(make_hand("|||||", angle_deg)).command is Command.STOP


@pytest.mark.parametrize("folded", [0.25, 0.35, 0.5])
def test_a_relaxed_hand_never_moves_the_drone(folded: float) -> None:
    reading = read_hand(make_hand("-----", folded=folded))
    assert reading.command in (None, Command.STOP)
    assert folded < 0.35 or reading.command is None


@pytest.mark.parametrize("stretched", ["-|---", "-||--"])
@pytest.mark.parametrize("angle_deg", [45.0, 135.0, -45.0, -135.0])
def test_between_two_directions_is_nothing_above_the_threshold(stretched: str, angle_deg: float) -> None:
    for off_deg in (-6.0, 0.0, 6.0):
        assert read_hand(make_hand(stretched, angle_deg + off_deg)).command is None


@pytest.mark.requirement("R1")
@given(angle_deg=st.floats(-180.0, 180.0), stretched=st.sampled_from(["-|---", "-||--"]))
def test_never_a_wrong_direction_above_the_threshold(angle_deg: float, stretched: str) -> None:
    reading = read_hand(make_hand(stretched, angle_deg))
    if reading.confidence >= 0.7:
        meant = {(shape, angle): command for shape, angle, command in NINE}
        nearest = min(
            (UP, DOWN, PICTURES_RIGHT, PICTURES_LEFT), key=lambda a: abs((angle_deg - a + 180.0) % 360.0 - 180.0)
        )
        assert reading.command is meant[stretched, nearest]


def test_confidence_falls_with_tilt_with_the_detectors_score_and_with_half_folded_fingers() -> None:
    def confidence(**how: float) -> float:
        return read_hand(make_hand("-|---", how.pop("angle_deg", 90.0), **how)).confidence  # type: ignore[arg-type]

    straight = confidence()
    assert straight > 0.9
    assert straight > confidence(angle_deg=65.0) > confidence(angle_deg=57.0)
    assert confidence(score=0.6) == pytest.approx(straight * 0.6 / 0.98)
    assert straight > confidence(folded=0.45)


def test_pointing_at_the_camera_points_nowhere() -> None:
    assert read_hand(make_hand("-|---", towards_camera_deg=20.0)).command is Command.GO_UP
    assert read_hand(make_hand("-|---", towards_camera_deg=70.0)).command is None


@pytest.mark.requirement("R1")
def test_two_hands_that_disagree_ask_for_nothing() -> None:
    left = make_hand("-|---", PICTURES_RIGHT, at_px=(450.0, 240.0))
    right = make_hand("-|---", PICTURES_LEFT, at_px=(200.0, 240.0))
    assert read_hands([left, right]) == DISAGREE
    assert read_hands([left, left]).command is Command.GO_LEFT
    assert read_hands([left, make_hand("-----")]).command is Command.GO_LEFT
    assert read_hands([make_hand("|||||"), left]).command is Command.STOP, "a false stop is safe"


@pytest.mark.requirement("X4")
def test_others_hands_count_for_nothing_but_stop() -> None:
    mine = make_hand("-|---", PICTURES_RIGHT, at_px=(450.0, 240.0))
    theirs = make_hand("-|---", PICTURES_LEFT, at_px=(220.0, 240.0))
    palm = make_hand("|||||", at_px=(220.0, 240.0))
    assert read_hands([mine, theirs], region=Region.RIGHT).command is Command.GO_LEFT
    assert read_hands([mine, theirs], region=Region.LEFT).command is Command.GO_RIGHT
    assert read_hands([theirs], region=Region.RIGHT) == ELSEWHERE
    assert read_hands([mine, palm], region=Region.RIGHT).command is Command.STOP
    assert read_hands([], region=Region.RIGHT) == NO_HAND


@pytest.mark.requirement("X4")
def test_where_as_many_hands_are_seen_as_can_be_only_a_palm_counts() -> None:
    left = make_hand("-|---", PICTURES_RIGHT)
    assert read_hands([left] * (MOST_HANDS - 1)).command is Command.GO_LEFT
    assert read_hands([left] * MOST_HANDS) == TOO_MANY
    assert read_hands([left] * (MOST_HANDS - 1) + [make_hand("|||||")]).command is Command.STOP
    assert read_hands([]) == NO_HAND
    assert read_hands([make_hand("-----"), make_hand("|----")]).command is None


@pytest.mark.parametrize("where", ["points_px", "world_m"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_landmarks_that_are_no_numbers_are_no_hand(where: str, value: float) -> None:
    hand = make_hand("|||||")
    broken = getattr(hand, where).copy()
    broken[3, 1] = value
    assert read_hand(replace(hand, **{where: broken})).command is None


def test_a_hand_without_size_or_cut_off_by_the_pictures_edge_is_no_hand() -> None:
    hand = make_hand("-|---")
    assert read_hand(replace(hand, points_px=np.zeros((21, 3)))).command is None
    assert read_hand(replace(hand, points_px=hand.points_px[:20])).command is None
    assert read_hand(make_hand("-|---", at_px=(320.0, 100.0))).command is None, "the fingertip is only guessed"
    assert read_hand(make_hand("-|---", at_px=(320.0, HEIGHT_PX + 10.0))).command is Command.GO_UP, "the wrist may be"


def test_a_score_that_is_no_number_is_no_gesture() -> None:
    assert read_hand(make_hand("|||||", score=float("nan"))).command is None
    assert read_hand(make_hand("|||||", score=LEAST_CONFIDENCE / 2.0)).command is None


@given(
    arrays(np.float64, (21, 3), elements=st.floats(-1e4, 1e4)),
    arrays(np.float64, (21, 3), elements=st.floats(-1.0, 1.0)),
)
def test_whatever_the_landmarks_the_reading_is_sound(points_px: np.ndarray, world_m: np.ndarray) -> None:
    reading = read_hand(Hand(points_px, world_m, 1.0, WIDTH_PX, HEIGHT_PX))
    assert 0.0 <= reading.confidence <= 1.0
    assert (reading.command is None) == (reading.confidence == 0.0)


def test_each_finger_is_seen_by_itself() -> None:
    for number in range(5):
        stretched = "".join("|" if i == number else "-" for i in range(5))
        assert finger_states(make_hand(stretched)).extended == tuple(i == number for i in range(5))
