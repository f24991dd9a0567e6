"""The views are pure: what is drawn where, whatever is known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from m3r_app.arbiter.state import ArbiterState, Policy, Session
from m3r_app.options import RunOptions
from m3r_app.run_setup import RunSetup, prepare
from m3r_app.snapshot import NOWHERE_M, Craft, Snapshot, margins
from m3r_app.snapshot import craft as craft_of
from m3r_app.vehicle.telemetry import NEVER_HEARD
from safety.limits import Limits
from safety.vocabulary import Anchor, FlightMode, Geodetic, Ned
from ui.console.drawing import ARROWS, Asked, Window, caption, from_above, from_side, nice_step, reach_of_all

HERE = Ned(14.0, 0.0, -6.0)


@pytest.fixture(scope="module")
def setup() -> RunSetup:
    return prepare(RunOptions())


def craft(name: str, place: Ned | None, **changes: object) -> Craft:
    whole = Craft(name, place, Ned(0.0, 0.0, 0.0), 0.0, 0.3, 0.1, 0.1, 0.8, FlightMode.HOLD, in_air=True, ours=True)
    return replace(whole, **changes)  # type: ignore[arg-type]


def snapshot(setup: RunSetup, *others: Craft, **changes: object) -> Snapshot:
    operator = setup.operator
    assert operator is not None
    session = Session("red", operator, setup.world, 0.0, Anchor(HERE, 180.0, 0.0), HERE)
    state = ArbiterState(Limits(), Policy(), session=session)
    return Snapshot(10.0, state, setup, (craft("red", HERE, **changes), *others))


def test_the_map_shows_drone_operator_anchor_obstacles_fence_and_ground(setup: RunSetup) -> None:
    drawing = from_above(snapshot(setup, craft("green", Ned(10.0, 5.0, -8.0))), 15.0, 2.0)
    kinds = {stroke.kind for stroke in drawing.strokes}
    assert {"anchor", "fence", "obstacle", "contour", "heading"} <= kinds
    signs = {mark.kind: mark for mark in drawing.marks}
    assert (signs["operator"].x, signs["operator"].y) == pytest.approx((0.0, 0.0))
    assert (signs["drone"].x, signs["drone"].y, signs["drone"].sign) == (0.0, 14.0, ARROWS[0])
    assert (signs["neighbour"].sign, signs["neighbour"].name) == ("G", "green")
    ball = next(stroke for stroke in drawing.strokes if stroke.kind == "anchor")
    assert np.hypot(ball.xs, ball.ys - 14.0) == pytest.approx(np.full(ball.xs.size, 5.0))


def test_the_side_shows_the_height_over_the_ground(setup: RunSetup) -> None:
    drawing = from_side(snapshot(setup), 10.0, 2.0)
    drone = next(mark for mark in drawing.marks if mark.kind == "drone")
    ground = next(stroke for stroke in drawing.strokes if stroke.kind == "ground")
    assert drone.y == pytest.approx(6.0)
    below = float(np.interp(drone.x, ground.xs, ground.ys))
    assert 6.0 - below == pytest.approx(float(setup.world.terrain.agl_m(np.array([HERE]))[0]), abs=0.1)
    assert drawing.window.y_min < below < 6.0 < drawing.window.y_max


@pytest.mark.parametrize(
    ("yaw_deg", "sign"), [(0.0, "↑"), (90.0, "→"), (180.0, "↓"), (-90.0, "←"), (44.9, "↗"), (math.nan, "?")]
)
def test_the_arrow_is_the_heading(setup: RunSetup, yaw_deg: float, sign: str) -> None:
    drawing = from_above(snapshot(setup, yaw_deg=yaw_deg), 15.0, 2.0)
    assert next(mark.sign for mark in drawing.marks if mark.kind == "drone") == sign


def test_a_silent_neighbour_is_drawn_stale_with_where_it_could_be(setup: RunSetup) -> None:
    silent = craft("courier", Ned(20.0, 5.0, -6.0), velocity=Ned(2.0, 0.0, 0.0), age_s=3.0, ours=False)
    shown = snapshot(setup, silent)
    drawing = from_above(shown, 15.0, 2.0)
    assert "stale" in {mark.kind for mark in drawing.marks}
    spread = next(stroke for stroke in drawing.strokes if stroke.kind == "spread")
    assert np.hypot(spread.xs - 5.0, spread.ys - 20.0) == pytest.approx(np.full(spread.xs.size, 6.0))
    assert "C courier" in caption(shown)
    assert "3.0 s" in caption(shown)


@given(
    north=st.floats(-NOWHERE_M, NOWHERE_M),
    east=st.floats(-NOWHERE_M, NOWHERE_M),
    down=st.floats(-NOWHERE_M, NOWHERE_M),
    yaw_deg=st.floats(allow_nan=True, allow_infinity=True),
    age_s=st.floats(allow_nan=True, allow_infinity=True),
    known=st.booleans(),
)
def test_whatever_a_drone_tells_there_is_a_picture(
    setup: RunSetup, north: float, east: float, down: float, yaw_deg: float, age_s: float, known: bool
) -> None:
    """Unknown and absurd places are left out, never a crash."""
    place = Ned(north, east, down) if known else None
    told = {"yaw_deg": yaw_deg, "age_s": age_s, "link_age_s": age_s}
    shown = snapshot(setup, craft("green", place, **told), **told)
    lost = replace(shown, craft=(replace(shown.craft[0], position=place), *shown.craft[1:]))
    for one in (shown, lost):
        reach_m = reach_of_all(one)
        assert math.isfinite(reach_m) and reach_m > 0.0
        for view in (from_above, from_side):
            drawing = view(one, reach_m, 2.0, Asked(1.0, None))
            assert isinstance(drawing.window, Window)
        margins(one.state, one.paired, one.at_s)
        assert caption(one)


@pytest.mark.parametrize(
    "place", [Geodetic(math.nan, 0.0, 0.0), Geodetic(0.0, 0.0, math.inf), Geodetic(-80.0, 170.0, 0.0), None]
)
def test_who_tells_to_be_nowhere_is_nowhere(setup: RunSetup, place: Geodetic | None) -> None:
    told = craft_of("green", replace(NEVER_HEARD, geodetic=place), setup.frame, 0.0, ours=True)
    assert told.position is None


@pytest.mark.parametrize(("least", "step"), [(0.3, 0.5), (1.0, 1.0), (1.1, 2.0), (7.0, 10.0), (0.02, 0.02)])
def test_steps_are_nice(least: float, step: float) -> None:
    assert nice_step(least) == pytest.approx(step)
