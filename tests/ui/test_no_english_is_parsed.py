"""Rewording a sentence changes no behaviour: every sentence is shuffled, and what is done and spoken stays the same in kind."""

from __future__ import annotations

import itertools
import random
from collections.abc import Iterator
from typing import Any

import pytest

from m3r_app.arbiter.announcements import Announce
from m3r_app.arbiter.effects import Effect, Report
from m3r_app.arbiter.step import step
from m3r_app.output import AnnounceEvent, DecisionEvent, Notice, OutputEvent, Told, known
from safety.vocabulary import State, Verdict
from tests.m3r_app.test_arbiter import MADE, every_event
from ui.console.story import toast
from ui.cues import Cue, Cues

SENTENCES = (
    "m3r_app.arbiter.announcements.sentence",
    "m3r_app.arbiter.wording.reasons",
    "m3r_app.arbiter.wording.told",
    "m3r_app.arbiter.wording.decided",
    "m3r_app.arbiter.announcements.decided",
    "safety.confidence.amount",
    "safety.envelope.amount",
    "safety.findings.amount",
    "safety.separation.amount",
)
"""Where sentences are made of what is known."""


def shuffled(seed: int) -> Any:
    """In the place of a sentence: words of other sentences in any order, never twice the same."""
    words = (
        "lost silent for taking off to returning the anchor in not yet disconnected you are heard again voice is hands "
        "too close wall last stop m/s m : ; , dry run abort hold"
    ).split()
    chance = random.Random(seed)
    number = itertools.count()

    def sentence(*_: object, **__: object) -> str:
        chance.shuffle(words)
        return " ".join((*words[: chance.randrange(3, 20)], str(next(number))))

    return sentence


def flown(state: State) -> Iterator[tuple[State, list[Effect]]]:
    """What every event does in this state, and what the arbiter is then in."""
    table = MADE[state]()
    for event in every_event(table):
        after, effects = step(table.state, event, table.now_s + 0.3)
        yield after.state, list(effects)


def events_of(effects: list[Effect]) -> list[OutputEvent]:
    told: list[OutputEvent] = []
    for effect in effects:
        match effect:
            case Report():
                told.append(known(effect.told))
            case Announce():
                told.append(AnnounceEvent(effect.text, effect.notice))
    return told


def spoken(effects: list[Effect]) -> list[Cue | None]:
    cues = Cues()
    return [cues.of(Told(float(number), event)) for number, event in enumerate(events_of(effects))]


def toasted(effects: list[Effect]) -> list[bool]:
    return [toast(event, "red") is not None for event in events_of(effects)]


def kinds(state: State) -> list[tuple[object, ...]]:
    """All that a program could act on, without a single sentence."""
    return [
        (after, [type(effect) for effect in effects], spoken(effects), toasted(effects))
        for after, effects in flown(state)
    ]


@pytest.mark.parametrize("state", list(MADE))
def test_shuffled_sentences_change_nothing_but_what_is_read(state: State, monkeypatch: pytest.MonkeyPatch) -> None:
    before = kinds(state)
    for number, place in enumerate(SENTENCES):
        monkeypatch.setattr(place, shuffled(number))
    assert kinds(state) == before


def test_the_shuffling_is_seen_in_what_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else the test above would hold whatever looked at sentences."""

    def read() -> list[str]:
        effects = [effect for _, each in flown(State.ARMED) for effect in each]
        return [effect.text for effect in effects if isinstance(effect, Announce)]

    before = read()
    for number, place in enumerate(SENTENCES):
        monkeypatch.setattr(place, shuffled(number))
    assert len(before) > 50
    assert not set(before) & set(read())


def test_the_story_has_all_that_the_arbiter_tells() -> None:
    told = [event for state in MADE for _, effects in flown(state) for event in events_of(effects)]
    notices = {event.notice for event in told if isinstance(event, AnnounceEvent)}
    verdicts = {event.verdict for event in told if isinstance(event, DecisionEvent)}
    assert {
        Notice.DECIDED,
        Notice.HOLDING,
        Notice.NOT_PAIRED,
        Notice.LET_GO,
        Notice.DROPPED,
        Notice.HELD_ANEW,
    } <= notices
    assert {Verdict.APPROVED, Verdict.REJECTED} <= verdicts
