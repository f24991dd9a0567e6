"""The phrase table and the paper's three checks, on whole utterances."""

from __future__ import annotations

import pytest

from modalities.voice.phrases import OTHER_WORDS, Phrase, PhraseTable, contains_stop
from safety.vocabulary import Command

TABLE = PhraseTable(("red", "green"))


@pytest.mark.parametrize("verb", ["go", "fly"])
@pytest.mark.parametrize(
    ("way", "command"),
    [
        ("left", Command.GO_LEFT),
        ("right", Command.GO_RIGHT),
        ("forward", Command.GO_FORWARD),
        ("forwards", Command.GO_FORWARD),
        ("back", Command.GO_BACK),
        ("backward", Command.GO_BACK),
        ("backwards", Command.GO_BACK),
        ("up", Command.GO_UP),
        ("down", Command.GO_DOWN),
    ],
)
def test_every_natural_variant_maps_to_one_direction(verb: str, way: str, command: Command) -> None:
    assert TABLE.interpret(f"{verb} {way}") == Phrase(command)
    assert f"{verb} {way}" in TABLE.phrases


@pytest.mark.parametrize(
    ("text", "phrase"),
    [
        ("turn left", Phrase(Command.TURN_LEFT)),
        ("turn right", Phrase(Command.TURN_RIGHT)),
        ("stop", Phrase(Command.STOP)),
        ("continue", Phrase(Command.CONTINUE)),
        ("activate red", Phrase(Command.ACTIVATE, "red")),
        ("disconnect green", Phrase(Command.DISCONNECT, "green")),
        ("  Go LEFT. ", Phrase(Command.GO_LEFT)),
    ],
)
def test_the_other_phrases(text: str, phrase: Phrase) -> None:
    assert TABLE.interpret(text) == phrase


@pytest.mark.parametrize(
    "text",
    [
        "", "left", "go", "go left now", "please go left", "don't go left", "go go left", "go left right", "turn around",
        "turn back", "activate", "activate blue", "activate red now", "[unk] go left", "go left [unk]", "continue please",
        "unstoppable", "nonstop flight",
    ],
)  # fmt: skip
def test_only_a_whole_utterance_is_a_request(text: str) -> None:
    assert TABLE.interpret(text) is None


@pytest.mark.parametrize("text", ["please stop now", "go left stop", "stop stop", "[unk] stop", "continue stop"])
def test_stop_counts_anywhere(text: str) -> None:
    assert TABLE.interpret(text) == Phrase(Command.STOP)
    assert contains_stop(text)


@pytest.mark.parametrize(
    ("text", "begins"), [("go", True), ("activate", True), ("go left", False), ("", False), ("yes", False)]
)
def test_an_unfinished_phrase_is_known_as_one(text: str, *, begins: bool) -> None:
    assert TABLE.begins_phrase(text) is begins


def test_no_everyday_word_is_a_command() -> None:
    assert not [word for word in OTHER_WORDS if TABLE.interpret(word)]
    assert len(set(OTHER_WORDS)) == len(OTHER_WORDS)


@pytest.mark.parametrize("colour", ["", "dark red", "r3d", "\u0440\u0435\u0434"])
def test_a_colour_that_cannot_be_said_is_an_error_that_names_it(colour: str) -> None:
    with pytest.raises(ValueError, match="not a colour that can be said"):
        PhraseTable(("red", colour))
