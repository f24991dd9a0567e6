"""The product on a real PX4, judged by PX4's own ground truth: its moves, and what others do to it in flight.

Needs loopback alone, and M3R_PX4 (see sitl.py). M3R_PX4_ROUNDS=34 asks for 200 requests. What PX4 did here the simulated
fleet does too (tests/m3r_app/sim/test_happenings.py, tests/m3r_app/test_others_run.py). Source: X1, X3, X6, X8; design 4.
"""

from __future__ import annotations

import math
import os
import signal
import statistics
import time
from collections.abc import Callable

import pytest

from m3r_app.ports import free_udp_block
from tests.px4.flight import Flight
from tests.px4.sitl import Px4, Relay, place

pytestmark = [pytest.mark.px4, pytest.mark.xdist_group("px4"), pytest.mark.timeout(600)]

Fly = Callable[..., Flight]
ROUNDS = int(os.environ.get("M3R_PX4_ROUNDS", "2"))
"""How often the story of moves is flown with stock noise."""
ROUND = ("go left", "go right", "go forward", "go back", "go up", "go down")
WANDER_M = 0.4
"""1 sigma, one axis: what stock SIH's true place wanders by in minutes, in two flights of 99 requests; 8 s show less of it."""
MOVE = "1.0 panel go left\n14.0 panel go right\n"
OFFBOARD = "OFFBOARD"


def rounds(count: int, every_s: float = 10.0) -> str:
    words = ROUND * count
    return "".join(f"{1.0 + every_s * i:.1f} panel {word}\n" for i, word in enumerate(words))


def mid_move(flight: Flight) -> float:
    """Waits until it is well under way; when."""
    started = flight.until("motion", status="started", within_s=150.0)
    flight.px4.until(lambda: time.monotonic() > started["at_s"] + 1.5, "time stands still")
    return time.monotonic()


def released(flight: Flight, after_s: float, within_s: float = 10.0) -> tuple[str, float]:
    """Why it let go, and how long after after_s."""
    event = flight.until("pair", within_s, status="released")
    return "; ".join(event["reasons"]), event["at_s"] - after_s


def test_quiet_moves_are_as_long_as_granted(quiet_px4: Px4, fly: Fly) -> None:
    flight = fly(quiet_px4, rounds(1))
    assert flight.end() == 0, flight.story()
    moves = flight.moves()
    assert len(moves) == len(ROUND), moves
    for move in moves:
        assert move["status"] == "completed", move
        assert 0.8 * move["granted_m"] - 0.1 <= move["along_m"] <= 1.05 * move["granted_m"] + 0.1, move
    assert not flight.violations()


@pytest.mark.timeout(3600)
def test_stock_noise_is_flown_with(px4: Px4, fly: Fly) -> None:
    count = ROUNDS
    flight = fly(px4, rounds(count), "--timeout", str(120 + 70 * count))
    paired = flight.until("pair", status="confirmed", within_s=180.0)
    assert flight.end(300.0 + 70.0 * count) in (0, 1), flight.story()
    moves = flight.moves()
    assert len(moves) >= 0.5 * 6 * count, (moves, flight.story())
    completed = [move for move in moves if move["status"] == "completed"]
    assert len(moves) - len(completed) <= max(1, 0.05 * len(moves)), moves
    assert not flight.violations(), flight.violations()
    # What the drone truly wanders by while it hovers before pairing, one axis; a move is the difference of two places.
    hovered = [row.ned_m for row in px4.truth if paired["at_s"] - 8.0 < row.at_s < paired["at_s"]]
    sigma_m = max(WANDER_M, *(statistics.pstdev(axis) for axis in zip(*hovered, strict=True)))
    bound_m = 2.0 * math.sqrt(2.0) * sigma_m
    over = [move for move in completed if move["along_m"] > 1.05 * move["granted_m"] + bound_m]
    assert len(over) <= max(1, 0.05 * len(completed)), (over, sigma_m)


@pytest.mark.requirement("X3")
@pytest.mark.parametrize("mode", ["HOLD", "RTL", "LAND"])
def test_another_station_takes_over_in_hover(px4: Px4, fly: Fly, mode: str) -> None:
    flight = fly(px4, "20.0 panel go left\n")
    flight.until("pair", within_s=150.0, status="confirmed")
    told_s = px4.order(mode)
    why, after_s = released(flight, told_s)
    assert ("counts as stop" if mode == "HOLD" else "flies it") in why
    assert after_s < 1.5
    assert flight.end() == 0, flight.story()
    assert OFFBOARD not in px4.mode_since(told_s + 0.5)
    assert not flight.of("motion") and not flight.violations()


@pytest.mark.requirement("X3")
@pytest.mark.parametrize("mode", ["HOLD", "POSCTL", "RTL", "LAND"])
def test_another_station_takes_over_in_mid_move(px4: Px4, fly: Fly, mode: str) -> None:
    flight = fly(px4, MOVE)
    if mode == "POSCTL":
        flight.until("pair", status="confirmed", within_s=150.0)
        px4.hold_sticks()
    mid_move(flight)
    told_s = px4.order(mode)
    why, after_s = released(flight, told_s)
    assert after_s < 1.5, (why, after_s)
    flight.end()
    assert OFFBOARD not in px4.mode_since(told_s + 0.5), px4.mode_since(told_s)
    assert mode in px4.mode_since(told_s)
    assert not flight.violations(), flight.violations()


@pytest.mark.requirement("X3")
def test_a_cut_link_ends_in_hold_and_no_setpoint_leaves_after_letting_go(px4: Px4, fly: Fly) -> None:
    with Relay(px4.app_port) as relay:
        flight = fly(px4, "1.0 panel turn left\n25.0 panel go right\n", port=relay.app_port)
        mid_move(flight)
        relay.cut(3.0)
        why, _ = released(flight, time.monotonic(), 20.0)
        let_go_s = time.monotonic()
        assert "in the air" not in why
        flight.end()
        assert [at_s for at_s in relay.setpoints_s if at_s > let_go_s + 0.2] == []
    assert px4.mode_since(let_go_s + 1.0)[-1] == "HOLD"
    assert not flight.violations()


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT], ids=lambda how: how.name)
def test_ended_in_mid_move_it_stops_and_holds(px4: Px4, fly: Fly, how: signal.Signals) -> None:
    flight = fly(px4, MOVE)
    at_s = mid_move(flight)
    flight.process.send_signal(how)
    px4.until(lambda: px4.mode_since(at_s)[-1] == "HOLD", "not in Hold", 5.0)
    px4.until(lambda: time.monotonic() > at_s + 6.0, "time stands still")
    assert px4.farthest_m(at_s, at_s + 6.0) < 2.0  # of which up to 1 m is the noise's
    assert px4.mode_since(at_s)[-1] == "HOLD"


@pytest.mark.requirement("X6")
def test_without_gps_it_says_one_thing(px4: Px4, fly: Fly) -> None:
    flight = fly(px4, "1.0 panel turn left\n25.0 panel go right\n", "--timeout", "60")
    at_s = mid_move(flight)
    px4.shell("param", "set", "SIM_GPS_USED", "0")
    flight.end()
    told = [e["text"] for e in flight.of("announce") if e["at_s"] > at_s]
    assert not any("too close" in text for text in told), told
    assert any("position" in text or "where it is" in text for text in told), told
    assert not flight.violations()


def test_an_autopilot_that_restarts_in_flight_is_lost(px4: Px4, fly: Fly) -> None:
    flight = fly(px4, MOVE)
    at_s = mid_move(flight)
    px4.kill()
    px4.start()
    why, _ = released(flight, at_s, 60.0)
    status = flight.end()
    assert "no longer in the air" not in why, why
    assert status == 3, (status, why)


def test_disarmed_in_the_air_is_said_as_what_it_is(px4: Px4, fly: Fly) -> None:
    flight = fly(px4, MOVE)
    mid_move(flight)
    told_s = px4.disarm()
    why, after_s = released(flight, told_s)
    assert "disarmed in the air by somebody else" in why
    assert after_s < 2.5  # landed is told before disarmed: what is told is waited for
    flight.end()
    assert not flight.violations()


@pytest.mark.parametrize("trouble", [{"delay_s": 0.3}, {"loss": (3, 7)}], ids=["300 ms", "20 % lost"])
def test_a_bad_link_is_flown_or_refused(px4: Px4, fly: Fly, trouble: dict[str, object]) -> None:
    with Relay(px4.app_port, **trouble) as relay:  # type: ignore[arg-type]
        flight = fly(px4, MOVE, port=relay.app_port)
        flight.end()
    told = " ".join(e["text"] for e in flight.of("announce"))
    assert flight.of("pair", status="confirmed") or flight.of("pair", status="refused"), flight.story()
    assert "does not exist" not in told
    assert not flight.violations()


@pytest.mark.requirement("X3")
def test_two_apps_do_not_fly_one_drone(px4: Px4, fly: Fly) -> None:
    port = free_udp_block(1)
    px4.link(14880 + px4.instance, port)
    first = fly(px4, "1.0 panel go left\n30.0 panel go right\n45.0 panel go left\n")
    first.until("motion", status="started", within_s=150.0)
    second = fly(px4, "2.0 panel go forward\n", "--timeout", "60", port=port)
    refused = second.until("pair", 80.0, status="refused")
    assert any("somebody" in reason or "OFFBOARD" in reason.upper() for reason in refused["reasons"]), refused
    second.end()
    assert not second.of("motion")
    assert first.end() == 0, first.story()
    assert [move["status"] for move in first.moves()].count("completed") >= 2, first.moves()


@pytest.mark.requirement("X8")
def test_a_take_off_is_judged_before_it_begins(px4: Px4, fly: Fly) -> None:
    """The operator too near, too low a height, heights that disagree."""
    for more, reason in (
        (("--operator", place(-2.0, 0.0)), "nearer than"),
        (("--takeoff", "1.2"), "too low"),
        (("--operator", place(-12.0, 0.0, -30.0)), "above the terrain model"),
    ):
        flight = fly(px4, "1.0 panel go left\n", *more)
        assert flight.end() == 3, flight.story()
        refused = flight.of("pair", status="refused")[0]["reasons"]
        assert any(reason in found for found in refused), refused
    assert not any(armed for _, _, armed in px4.modes)
    assert px4.here_m[2] > -0.5, "it left the ground"


def test_take_off_leaves_its_parameter_as_it_was(px4: Px4, fly: Fly) -> None:
    px4.shell("param", "set", "MIS_TAKEOFF_ALT", "3.5")
    flight = fly(px4, "1.0 panel go left\n")
    flight.end()  # paired or, where the noise of the day is too much for that, not
    assert min(row.ned_m[2] for row in px4.truth) < -8.0
    assert "3.5000" in px4.shell("param", "show", "MIS_TAKEOFF_ALT")
