"""The flight envelope: each bound of it, dense about its value."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from safety.envelope import envelope
from safety.planner import plan_return, plan_scan, plan_translation
from safety.vocabulary import Ned, Plan, Primitive, Profile
from tests.safety.scene import LIMITS, START, number, situation

OPERATOR = Ned(-10.0, 0.0, 0.0)
OFFSETS = (-0.2, -1e-3, -1e-5, 0.0, 1e-5, 1e-3, 0.2)
"""Offsets from a bound: positive breaks it."""


def move(primitive: Primitive = Primitive.MOVE_FORWARD, length_m: float = 0.5) -> Plan:
    return plan_translation(primitive, START, 180.0, OPERATOR, length_m, LIMITS)


def judged(plan: Plan) -> tuple[bool, float, str]:
    found = envelope(plan, situation(), LIMITS)
    return found.passed, number(found), found.text


@pytest.mark.parametrize("primitive", [p for p in Primitive if p is not Primitive.RETURN])
def test_every_plan_of_the_planner_is_inside(primitive: Primitive) -> None:
    if primitive.is_scan:
        plan = plan_scan(primitive, START, 170.0, OPERATOR, 360.0, LIMITS)
    else:
        upright = primitive in (Primitive.ASCEND, Primitive.DESCEND)
        plan = move(primitive, LIMITS.vertical_step_m if upright else LIMITS.lateral_step_m)
    assert judged(plan)[0]


@pytest.mark.parametrize("offset", OFFSETS)
def test_steps(offset: float) -> None:
    for primitive, bound in (
        (Primitive.MOVE_LEFT, LIMITS.lateral_step_m),
        (Primitive.MOVE_BACKWARD, LIMITS.lateral_step_m),
        (Primitive.ASCEND, LIMITS.vertical_step_m),
        (Primitive.DESCEND, LIMITS.vertical_step_m),
    ):
        passed, margin, text = judged(move(primitive, bound + offset))
        assert passed == (offset <= 0.0)
        if offset > 0.0:
            assert margin == pytest.approx(-offset)
            assert "step" in text


@pytest.mark.parametrize("offset", OFFSETS)
@pytest.mark.parametrize(
    ("primitive", "what", "bound"),
    [
        (Primitive.MOVE_FORWARD, "speed", LIMITS.speed_m_s),
        (Primitive.ASCEND, "speed", LIMITS.speed_m_s),
        (Primitive.DESCEND, "descent speed", LIMITS.descend_speed_m_s),
    ],
)
def test_speeds(primitive: Primitive, what: str, bound: float, offset: float) -> None:
    plan = move(primitive, 0.5)
    faster = replace(plan, move=Profile(0.5, bound + offset, LIMITS.acceleration_m_s2))
    if faster.peak_speed_m_s < bound + offset:
        faster = replace(faster, move=Profile(0.5, bound + offset, 10.0))
        passed, _, text = judged(faster)
        assert not passed
        assert "acceleration" in text
        return
    passed, margin, text = judged(faster)
    assert passed == (offset <= 0.0)
    if offset > 0.0:
        assert margin == pytest.approx(-offset)
        assert text.startswith(what)


@pytest.mark.parametrize("offset", OFFSETS)
def test_acceleration_turn_rate_and_duration(offset: float) -> None:
    harder = replace(move(), move=Profile(0.3, 0.2, LIMITS.acceleration_m_s2 + offset), max_duration_s=2.0)
    scan = plan_scan(Primitive.SCAN_LEFT, START, 180.0, OPERATOR, 360.0, LIMITS)
    swifter = replace(scan, turn=Profile(360.0, LIMITS.yaw_rate_deg_s + offset, LIMITS.yaw_acceleration_deg_s2))
    patient = move()
    longer = replace(
        patient, max_duration_s=patient.duration_s * LIMITS.duration_factor + LIMITS.duration_extra_s + offset
    )
    for plan, what in ((harder, "acceleration"), (swifter, "turn rate"), (longer, "duration")):
        passed, margin, text = judged(plan)
        tolerance = 1e-6 * 60.0
        if abs(offset) > tolerance or offset == 0.0:
            assert passed == (offset <= 0.0), what
        if offset > tolerance:
            assert margin == pytest.approx(-offset)
            assert text.startswith(what)


def test_the_way_back_may_be_as_long_as_the_workspace_is_wide() -> None:
    def back(away_m: float) -> Plan:
        return plan_return(START, 180.0, OPERATOR, START.plus(Ned(away_m, 0.0, 0.0)), LIMITS)

    assert judged(back(LIMITS.workspace_m))[0]
    assert not judged(back(LIMITS.workspace_m + 0.01))[0]
    not_home = replace(back(LIMITS.workspace_m), primitive=Primitive.MOVE_FORWARD)
    assert not judged(not_home)[0]


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_plan_that_is_no_number_is_refused(bad: float) -> None:
    for broken in (
        replace(move(), start=Ned(bad, 0.0, -10.0)),
        replace(move(), direction=Ned(bad, 0.0, 0.0)),
        replace(move(), max_duration_s=bad),
        replace(move(), move=Profile(0.5, 0.5, bad)),
    ):
        found = envelope(broken, situation(), LIMITS)
        assert not found.passed
        assert found.margin is None
