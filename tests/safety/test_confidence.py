"""Context and confidence: input, localisation, terrain model, authority."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from safety.confidence import authority, confidence_of, input_confidence, localization, terrain_confidence
from safety.limits import Limits
from safety.terrain import Terrain
from safety.vocabulary import Command, ManeuverRequest, Modality, Ned
from tests.safety.scene import LIMITS, NOW_S, hover, number, situation, straight, vehicle, world

DIFFERENT = replace(LIMITS, confidence_voice=0.7, confidence_gesture=0.6, confidence_panel=0.5)


def asked(modality: Modality, confidence: float) -> ManeuverRequest:
    return ManeuverRequest("1", Command.GO_LEFT, modality, confidence, NOW_S, NOW_S)


@pytest.mark.parametrize("offset", [-0.3, -1e-6, 0.0, 1e-6, 0.3])
@pytest.mark.parametrize(
    ("modality", "threshold"),
    [(Modality.VOICE, 0.7), (Modality.GESTURE, 0.6), (Modality.PANEL, 0.5), (Modality.FUSED, 0.7)],
)
def test_each_modality_has_its_threshold(modality: Modality, threshold: float, offset: float) -> None:
    found = input_confidence(asked(modality, threshold + offset), DIFFERENT)
    assert number(found) == pytest.approx(offset)
    assert found.passed == (offset >= 0.0)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -0.1, 1.1])
def test_a_confidence_that_is_none_is_refused(bad: float) -> None:
    found = input_confidence(asked(Modality.VOICE, bad), LIMITS)
    assert not found.passed
    assert found.margin is None


@given(st.floats(0.0, 50.0), st.floats(0.0, 50.0))
def test_confidence_falls_with_sigma(a: float, b: float) -> None:
    small, large = sorted((a, b))
    assert 0.0 < confidence_of(large, 2.0) <= confidence_of(small, 2.0) <= 1.0


def test_confidence_is_a_half_at_its_half() -> None:
    assert confidence_of(0.0, 2.0) == 1.0
    assert confidence_of(2.0, 2.0) == 0.5
    assert math.isnan(confidence_of(math.nan, 2.0))
    assert math.isnan(confidence_of(-1.0, 2.0))


@pytest.mark.parametrize(
    ("sigma_m", "passed"), [(0.0, True), (1.999, True), (2.0, True), (2.001, False), (10.0, False)]
)
def test_localization_and_terrain_confidence_at_their_threshold(sigma_m: float, passed: bool) -> None:
    limits = Limits(localization_min=0.5, localization_half_m=2.0, terrain_confidence_min=0.5, terrain_half_m=2.0)
    known = situation(world=world(terrain=Terrain.flat(0.0, sigma_m, 0.0)))
    assert terrain_confidence(hover(), known, limits).passed == passed
    for sigmas in ((sigma_m, 0.1), (0.1, sigma_m)):
        seen = situation(vehicle=vehicle(sigma_h_m=sigmas[0], sigma_v_m=sigmas[1]))
        assert localization(hover(), seen, limits).passed == passed


@pytest.mark.parametrize("bad", [math.nan, -1.0])
def test_an_accuracy_that_is_none_is_refused(bad: float) -> None:
    for found in (
        localization(hover(), situation(vehicle=vehicle(sigma_h_m=bad, sigma_v_m=bad)), LIMITS),
        terrain_confidence(hover(), situation(world=world(terrain=Terrain.flat(0.0, bad, 0.0))), LIMITS),
        terrain_confidence(hover(), situation(world=world(terrain=None)), LIMITS),
    ):
        assert not found.passed
        assert found.margin is None


def test_an_infinite_sigma_is_no_confidence() -> None:
    lost = situation(vehicle=vehicle(sigma_h_m=math.inf, sigma_v_m=0.1))
    assert not localization(hover(), lost, LIMITS).passed


@pytest.mark.parametrize(
    ("age_s", "passed"),
    [(0.0, True), (0.5, True), (0.5001, False), (-0.6, False), (math.inf, False), (math.nan, False)],
)
def test_an_old_position_is_no_position(age_s: float, passed: bool) -> None:
    found = localization(hover(), situation(vehicle=vehicle(at_s=NOW_S - age_s)), LIMITS)
    assert found.passed == passed
    assert passed or "old" in found.text


def test_an_unknown_position_is_refused() -> None:
    lost = situation(vehicle=vehicle(position=Ned(math.nan, 0.0, -10.0)))
    assert not localization(hover(), lost, LIMITS).passed


def test_only_who_holds_authority_commands() -> None:
    assert authority(hover(), situation(), LIMITS).passed
    found = authority(hover(), situation(authority=False), LIMITS)
    assert not found.passed
    assert "pair again" in found.text


def test_a_confidence_of_nothing_is_a_number_and_too_low() -> None:
    assert number(input_confidence(asked(Modality.VOICE, 0.0), LIMITS)) == pytest.approx(-0.7)
    assert number(input_confidence(asked(Modality.VOICE, 1.0), LIMITS)) == pytest.approx(0.3)


@pytest.mark.requirement("X6")
@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"at_s": NOW_S - 2.0}, "the drone's position is 2.0 s old"),
        ({"at_s": math.nan}, "the drone's position is an unknown time old"),
        ({"velocity": Ned(20.0, 0.0, 0.0)}, None),
        ({"velocity": Ned(20.01, 0.0, 0.0)}, "the drone's velocity of 20.0 m/s is not plausible"),
        ({"velocity": Ned(math.nan, 0.0, 0.0)}, "the drone's velocity is unknown"),
        ({"disagreement": Ned(0.0, 0.5, 0.0)}, None),
        ({"disagreement": Ned(0.0, 0.51, 0.0)}, "the drone's position does not move as its velocity says"),
    ],
)
def test_why_a_position_is_not_believed(changes: dict[str, object], says: str | None) -> None:
    found = localization(hover(), situation(vehicle=vehicle(**changes)), LIMITS)
    assert found.passed == (says is None) and (found.margin is None) == (says is not None)
    assert says is None or found.text == says


@pytest.mark.requirement("X6")
@pytest.mark.parametrize(("up_m", "passed"), [(0.5, True), (-1.99, True), (-2.01, False)])
def test_under_the_model_counts_where_the_path_starts(up_m: float, passed: bool) -> None:
    """Twice 0.3 m upright, half of 0.8 m sideways over the slope of a half, and 0.3 m of the model explain 2 m."""
    ground = Terrain(0.5 * np.arange(9.0)[:, None] + np.zeros((9, 9)), (-4.0, -4.0), ((1.0, 0.0), (0.0, 1.0)), 0.3, 2.0)
    seen = vehicle(position=Ned(0.0, 0.0, -up_m), sigma_h_m=0.8, sigma_v_m=0.3)
    path = straight(Ned(0.0, 0.0, -up_m - 30.0), start=Ned(0.0, 0.0, -up_m), n=2)
    assert terrain_confidence(path, situation(vehicle=seen, world=world(terrain=ground)), LIMITS).passed == passed


@pytest.mark.requirement("X3", "X8")
@pytest.mark.parametrize(
    ("changes", "held", "says"),
    [
        ({}, True, "this station commands the drone"),
        ({"healthy": False}, False, "this station does not command the drone: pair again"),
        ({"healthy": False}, True, "the drone reports that it is not healthy"),
        ({"battery": math.nan}, True, "its battery is unknown"),
        ({"battery": 0.1}, True, "its battery is at 10 %, 20 % needed"),
    ],
)
def test_who_commands_what_is_said_as_it_is(changes: dict[str, object], held: bool, says: str) -> None:
    assert authority(hover(), situation(vehicle=vehicle(**changes), authority=held), LIMITS).text == says
