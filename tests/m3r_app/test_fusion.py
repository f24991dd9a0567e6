"""Fusion: what a request is to those shortly before it. X5, design 6."""

from __future__ import annotations

import math

import pytest

from m3r_app.arbiter.fusion import Relation, Remembered, fused, relate, remember
from safety.vocabulary import Command, ManeuverRequest, Modality

VOICE, GESTURE = Modality.VOICE, Modality.GESTURE


def made(
    command: Command, modality: Modality, at_s: float, confidence: float = 0.8, name: str = "a"
) -> ManeuverRequest:
    return ManeuverRequest(name, command, modality, confidence, at_s, at_s + 0.4, str(command))


@pytest.mark.requirement("X5")
@pytest.mark.parametrize(("command", "modality", "at_s", "relation"), [
    (Command.GO_LEFT, GESTURE, 11.0, Relation.CONFIRMS),
    (Command.GO_LEFT, GESTURE, 11.001, Relation.NEW),
    (Command.GO_LEFT, GESTURE, 9.0, Relation.CONFIRMS),  # slower to be understood, captured before
    (Command.GO_UP, GESTURE, 11.0, Relation.CONTRADICTS),
    (Command.GO_UP, GESTURE, 11.001, Relation.NEW),
    (Command.GO_LEFT, VOICE, 10.5, Relation.NEW),  # the same modality says it again
    (Command.GO_UP, VOICE, 10.5, Relation.NEW),  # or changes its mind
    (Command.GO_UP, GESTURE, math.nan, Relation.NEW),
])  # fmt: skip
def test_relation_by_capture_time(command: Command, modality: Modality, at_s: float, relation: Relation) -> None:
    recent = (Remembered(made(Command.GO_LEFT, VOICE, 10.0)),)
    assert relate(made(command, modality, at_s, name="b"), recent, 1.0)[0] is relation


@pytest.mark.requirement("X5")
def test_the_latest_of_the_other_modality_counts() -> None:
    """Who changes their mind by voice is not contradicted by a gesture that follows the change."""
    recent = (Remembered(made(Command.GO_LEFT, VOICE, 10.0)), Remembered(made(Command.GO_UP, VOICE, 10.5, name="b")))
    relation, other = relate(made(Command.GO_UP, GESTURE, 10.9, name="c"), recent, 1.0)
    assert relation is Relation.CONFIRMS
    assert other is recent[1]


def test_both_are_surer_than_either() -> None:
    first, second = made(Command.GO_LEFT, VOICE, 10.0, 0.5), made(Command.GO_LEFT, GESTURE, 10.4, 0.6, "b")
    both = fused(second, first, "a")
    assert both.confidence == pytest.approx(0.8)
    assert (both.id, both.modality) == ("a", Modality.FUSED)
    assert "voice" in both.evidence
    assert "gesture" in both.evidence


@pytest.mark.parametrize("bad", [math.nan, -0.1, 1.1, math.inf])
def test_no_confidence_stays_none(bad: float) -> None:
    good = made(Command.GO_LEFT, VOICE, 10.0)
    assert math.isnan(fused(made(Command.GO_LEFT, GESTURE, 10.0, bad), good, "a").confidence)
    assert math.isnan(fused(good, made(Command.GO_LEFT, GESTURE, 10.0, bad), "a").confidence)


@pytest.mark.requirement("X5")
def test_memory_is_short_and_keeps_one_of_each() -> None:
    recent: tuple[Remembered, ...] = ()
    for i in range(50):
        now_s = 10.0 + 0.5 * i
        recent = remember(recent, made(Command.GO_LEFT, VOICE, now_s, name=f"r{i}"), now_s - 2.0)
    assert [r.request.id for r in recent] == ["r45", "r46", "r47", "r48", "r49"]
    again = remember(recent, recent[-1].request, 0.0, refused=True)
    assert [r.request.id for r in again] == ["r45", "r46", "r47", "r48", "r49"]
    assert again[-1].refused


@pytest.mark.requirement("X5")
def test_whoever_disagrees_outweighs_whoever_agrees() -> None:
    """X5: a third modality that confirms the second does not overrule the first."""
    recent = (
        Remembered(made(Command.GO_LEFT, Modality.PANEL, 10.0, name="a"), refused=True),
        Remembered(made(Command.GO_RIGHT, VOICE, 10.3, name="b"), refused=True),
    )
    relation, other = relate(made(Command.GO_RIGHT, GESTURE, 10.6, name="c"), recent, 1.0)
    assert relation is Relation.CONTRADICTS
    assert other is recent[0]


@pytest.mark.requirement("X5")
def test_what_nobody_was_sure_of_contradicts_nobody() -> None:
    """Noise in one modality does not veto the other."""
    recent = (Remembered(made(Command.GO_UP, GESTURE, 10.0), refused=True),)
    relation, _ = relate(
        made(Command.GO_LEFT, Modality.PANEL, 10.3, name="b"), recent, 1.0, lambda r: r.command is not Command.GO_UP
    )
    assert relation is Relation.NEW


@pytest.mark.requirement("X5")
def test_doubt_contradicts_nobody() -> None:
    """What its own modality is not sure of vetoes nothing, however sure the other was."""
    recent = (Remembered(made(Command.GO_UP, GESTURE, 10.0)),)
    relation, other = relate(
        made(Command.GO_LEFT, Modality.PANEL, 10.3, 0.2, "b"), recent, 1.0, lambda r: r.confidence >= 0.5
    )
    assert (relation, other) == (Relation.NEW, None)
