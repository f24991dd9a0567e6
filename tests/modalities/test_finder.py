"""Hands that are too small for the whole picture: tiles in turn, a part that goes with the hand, and others who show something."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from config.demo.drawn_hand import GESTURES, centre_of, draw, wall
from modalities.hands.dwell import DwellFilter
from modalities.hands.finder import ELSEWHERE_EVERY, LOST_S, HandFinder
from modalities.hands.gestures import DISAGREE, Hand, Region, read_hands
from modalities.hands.landmarker import HandDetector
from modalities.hands.tiles import GRID, Square, Turns, around, motion_between, tiles
from modalities.models.catalogue import HandModel
from safety.vocabulary import Command
from tests.modalities.hand_shapes import make_hand

WIDTH, HEIGHT, RATE_HZ = 1280, 720, 30.0
EMPTY = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
STILL = np.zeros(GRID, np.float32)
LEFT, RIGHT, PALM, FIST = ("-|---", 0.0), ("-|---", 180.0), ("|||||", 90.0), ("-----", 90.0)


@pytest.mark.parametrize(("width", "height"), [(1280, 720), (640, 480), (720, 1280), (1920, 1080), (100, 80)])
def test_tiles_cover_the_picture_and_lie_in_it(width: int, height: int) -> None:
    for side in {tile.side for tile in tiles(width, height)}:
        seen = np.zeros((height, width), bool)
        for tile in tiles(width, height):
            if tile.side == side:
                assert tile.of(seen).shape == (side, side)
                seen[tile.top : tile.top + side, tile.left : tile.left + side] = True
        assert seen.all()


def test_a_square_about_a_point_is_moved_into_the_picture() -> None:
    assert around(640.0, 360.0, 100.0, WIDTH, HEIGHT) == Square(590, 310, 100)
    assert around(0.0, 719.0, 100.0, WIDTH, HEIGHT) == Square(0, 620, 100)
    assert around(640.0, 360.0, 5000.0, WIDTH, HEIGHT).side == HEIGHT


def test_every_tile_has_its_turn_and_those_where_something_moves_sooner() -> None:
    count = len(tiles(WIDTH, HEIGHT))
    still = Turns(WIDTH, HEIGHT)
    assert {still.next(STILL) for _ in range(count)} == set(tiles(WIDTH, HEIGHT))
    moving = STILL.copy()
    moving[10:13, 20:24] = 5.0
    x, y = 22 / GRID[1] * WIDTH, 11 / GRID[0] * HEIGHT
    turns = Turns(WIDTH, HEIGHT)
    soon = [turns.next(moving) for _ in range(20)]
    assert sum(t.left <= x <= t.left + t.side and t.top <= y <= t.top + t.side for t in soon) >= 10
    assert {turns.next(moving) for _ in range(60 * count)} == set(tiles(WIDTH, HEIGHT)), "nobody waits for ever"


def test_a_cloud_over_all_is_no_motion() -> None:
    before = np.random.default_rng(0).uniform(0.0, 255.0, GRID).astype(np.float32)
    assert motion_between(before, before + 7.0).max() == 0.0
    moved = before.copy()
    moved[3, 4] += 100.0
    assert np.argmax(motion_between(before, moved)) == 3 * GRID[1] + 4


class Room:
    """Stands in for both landmarkers: hands with their places; the whole picture shows none that is small."""

    def __init__(self, *shown: tuple[tuple[str, float], float, float]) -> None:
        self.show(*shown)
        self.calls = 0

    def show(self, *shown: tuple[tuple[str, float], float, float]) -> None:
        self.hands = [self._hand(shape, x, y) for shape, x, y in shown]

    @staticmethod
    def _hand(shape: tuple[str, float], x: float, y: float) -> Hand:
        made = make_hand(*shape, size_px=15.0, at_px=(x, y))
        return Hand(made.points_px, made.world_m, made.score, WIDTH, HEIGHT)

    def detect(self, picture: np.ndarray, at_s: float) -> tuple[Hand, ...]:
        self.calls += 1
        return ()

    def detect_in(self, picture: np.ndarray, part: Square) -> tuple[Hand, ...]:
        self.calls += 1
        return tuple(hand for hand in self.hands if part.holds(hand.points_px))

    def forget(self) -> None:
        pass

    def close(self) -> None:
        pass


def watched(finder: HandFinder, pictures: int, begin: int = 0) -> list[tuple[Hand, ...] | None]:
    return [finder.detect(EMPTY, (begin + number) / RATE_HZ) for number in range(pictures)]


def test_a_small_hand_is_found_and_followed_with_one_call_a_picture() -> None:
    room = Room((LEFT, 300.0, 200.0))
    finder = HandFinder(room, room)
    first = next(number for number, hands in enumerate(watched(finder, 200)) if hands)
    assert first < 150
    room.calls = 0
    for number in range(90):
        room.show((LEFT, 300.0 + 8.0 * number, 200.0))
        hands = finder.detect(EMPTY, (200 + number) / RATE_HZ)
        assert hands is None or read_hands(hands).command is Command.GO_LEFT
    assert room.calls == 90


def test_a_lost_hand_is_given_up_and_nothing_is_read_meanwhile() -> None:
    room = Room((LEFT, 300.0, 200.0))
    finder = HandFinder(room, room)
    watched(finder, 200)
    room.show()
    after = watched(finder, round(LOST_S * RATE_HZ) + 5, begin=200)
    assert not any(after)
    assert finder._followed is None


@pytest.mark.requirement("X4")
def test_anothers_open_palm_is_taken_up_while_a_hand_is_followed() -> None:
    room = Room((LEFT, 300.0, 200.0))
    finder = HandFinder(room, room)
    watched(finder, 200)
    room.show((LEFT, 300.0, 200.0), (PALM, 1000.0, 500.0))
    hold = DwellFilter()
    held = [
        hold.accept(read_hands(hands), (200 + n) / RATE_HZ)
        for n, hands in enumerate(watched(finder, 600, begin=200))
        if hands is not None
    ]
    assert Command.STOP in {one.command for one in held if one is not None}


def test_another_who_points_elsewhere_objects() -> None:
    room = Room((LEFT, 300.0, 200.0))
    finder = HandFinder(room, room)
    watched(finder, 200)
    room.show((LEFT, 300.0, 200.0), (RIGHT, 1000.0, 500.0))
    seen = watched(finder, 150 * ELSEWHERE_EVERY, begin=200)
    assert DISAGREE in [read_hands(hands) for hands in seen if hands is not None]


def test_a_hand_that_was_seen_once_elsewhere_asks_for_nothing_and_is_then_looked_at() -> None:
    room = Room((FIST, 300.0, 200.0))
    finder = HandFinder(room, room)
    watched(finder, 200)
    room.show((FIST, 300.0, 200.0), (LEFT, 1000.0, 500.0))
    hold = DwellFilter()
    seen: list[tuple[Hand, ...]] = []
    for number in range(150 * ELSEWHERE_EVERY):
        hands = finder.detect(EMPTY, (200 + number) / RATE_HZ)
        seen += [hands] if hands is not None else []
        if hands is not None and hold.accept(read_hands(hands), (200 + number) / RATE_HZ) is not None:
            break
    asking = [hands for hands in seen if read_hands(hands).command is Command.GO_LEFT]
    assert len(asking) >= 10, "by as many pictures as the hold takes, of which each was a look at it"
    assert all(len(hands) == 1 for hands in asking)


def test_the_operators_own_hand_is_followed_beside_anothers() -> None:
    room = Room((LEFT, 300.0, 200.0), (RIGHT, 1000.0, 500.0))
    for region, command in ((Region.LEFT, Command.GO_LEFT), (Region.RIGHT, Command.GO_RIGHT)):
        finder = HandFinder(room, room, region)
        watched(finder, 600)
        late = [hands for hands in watched(finder, 20, begin=600) if hands is not None]
        assert {read_hands(hands, region=region).command for hands in late} == {command}


def test_a_hand_three_metres_away_is_read_where_the_whole_picture_shows_none(hand_model: HandModel) -> None:
    """A drawn hand of 70 pixels in a picture of 1280 x 720."""
    pose = GESTURES["go_left"]
    drawn = draw(wall(np.random.default_rng(2)), pose, centre_of(pose), -16.0).astype(np.uint8)
    small = cv2.resize(drawn, (160, 120), interpolation=cv2.INTER_AREA)
    picture = cv2.resize(wall(np.random.default_rng(3)), (WIDTH, HEIGHT)).astype(np.uint8)
    empty = picture.copy()
    picture[300:420, 700:860] = small
    with HandDetector(hand_model) as bare:
        assert not any(bare.detect(picture, number / RATE_HZ) for number in range(5))
    with HandFinder.of(hand_model) as finder:
        hold = DwellFilter()
        shown = [empty] * 10 + [picture] * 45
        looks = [(number / RATE_HZ, finder.detect(each, number / RATE_HZ)) for number, each in enumerate(shown)]
    held = [hold.accept(read_hands(hands), at_s) for at_s, hands in looks if hands is not None]
    assert [one.command for one in held if one is not None] == [Command.GO_LEFT]
