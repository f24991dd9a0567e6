"""Which words go into the grammars, by what the model knows, and when a doubtful *stop* counts: on a stand-in for VOSK, as no model with
`[unk]` can be had here.
"""

from __future__ import annotations

import json

import pytest

from modalities.models.catalogue import ModelError
from modalities.voice import decoder
from modalities.voice.decoder import STOP_IN_NOISE, UNKNOWN_WORD, Hypothesis, Recognizer
from modalities.voice.phrases import OTHER_WORDS, STOP_RIVALS, PhraseTable
from safety.vocabulary import Command

TABLE = PhraseTable(("red", "green", "blue"))
EVERY = frozenset((*TABLE.words, *OTHER_WORDS, *STOP_RIVALS, UNKNOWN_WORD))


class Knows:
    """A model that knows these words."""

    def __init__(self, words: frozenset[str]) -> None:
        self._words = words

    def vosk_model_find_word(self, word: str) -> int:
        return 7 if word in self._words else -1


@pytest.fixture
def grammars(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """Of every decoder that is made."""
    made: list[list[str]] = []

    class Kaldi:
        def __init__(self, _model: Knows, _rate_hz: float, grammar: str) -> None:
            made.append(json.loads(grammar))

        def SetMaxAlternatives(self, _count: int) -> None:  # noqa: N802 VOSK's name
            pass

    monkeypatch.setattr(decoder, "KaldiRecognizer", Kaldi)
    return made


def test_a_model_that_has_a_word_for_the_unknown_is_given_it(grammars: list[list[str]]) -> None:
    Recognizer(Knows(EVERY), TABLE)
    assert len(grammars) == 3
    assert all(UNKNOWN_WORD in grammar for grammar in grammars)
    assert all(set(TABLE.phrases) <= set(grammar) for grammar in grammars)


def test_one_that_has_none_is_not(grammars: list[list[str]]) -> None:
    recognizer = Recognizer(Knows(EVERY - {UNKNOWN_WORD}), TABLE)
    assert not any(UNKNOWN_WORD in grammar for grammar in grammars)
    assert recognizer.missing_words == ()


def test_a_phrase_with_a_word_that_the_model_lacks_is_left_out_and_told(grammars: list[list[str]]) -> None:
    recognizer = Recognizer(Knows(EVERY - {"forwards", "coffee"}), TABLE)
    assert recognizer.missing_words == ("forwards",)
    for grammar in grammars:
        assert not any({"forwards", "coffee"} & set(entry.split()) for entry in grammar)
        assert "go forward" in grammar
    with pytest.raises(ModelError, match="does not know the word 'stop'"):
        Recognizer(Knows(EVERY - {"stop"}), TABLE)


@pytest.mark.requirement("X4")
@pytest.mark.usefixtures("grammars")
def test_in_noise_a_stop_that_is_nearly_as_likely_as_no_phrase_counts() -> None:
    def heard(best: str, behind: float, *, in_noise: bool) -> Command | None:
        commands = [Hypothesis(best, 50.0), Hypothesis("stop", 50.0 - behind)]
        words = [Hypothesis("dog", 49.0), Hypothesis(best, 48.0)]
        found = Recognizer(Knows(EVERY), TABLE, in_noise=in_noise)._understood(commands, words, 1.0, 1.3)
        return None if found is None else found.command

    assert heard("up", STOP_IN_NOISE - 0.1, in_noise=True) is Command.STOP
    assert heard("up", STOP_IN_NOISE + 0.1, in_noise=True) is None
    assert heard("up", STOP_IN_NOISE - 0.1, in_noise=False) is None
    assert heard("", STOP_IN_NOISE - 0.1, in_noise=True) is None, "nothing was said"
    assert heard("go up", STOP_IN_NOISE - 0.1, in_noise=True) is Command.GO_UP, "a phrase is no noise"
