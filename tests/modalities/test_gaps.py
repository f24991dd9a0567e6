"""No request is made of half an input: what missing sound does to recognition by real VOSK."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import vosk

from modalities.voice.audio import SAMPLE_RATE_HZ, Gap, Samples, chunks, quiet, read_audio
from modalities.voice.decoder import Recognizer
from modalities.voice.phrases import PhraseTable
from safety.vocabulary import Command

RECORDINGS = Path(__file__).resolve().parents[1] / "recordings"
TABLE = PhraseTable(("red", "green", "blue"))


def clip(name: str) -> Samples:
    return read_audio(RECORDINGS / name)


def voice_of(samples: Samples) -> tuple[float, float]:
    loud = np.flatnonzero(np.abs(samples.astype(int)) > 0.05 * np.abs(samples.astype(int)).max())
    return loud[0] / SAMPLE_RATE_HZ, loud[-1] / SAMPLE_RATE_HZ


def commands_with_gap(model: vosk.Model, samples: Samples, gap_s: float, *, ended: bool = False) -> list[Command]:
    """What is heard when 20 ms are missing at gap_s, or the source goes away there and comes back."""
    recognizer = Recognizer(model, TABLE)
    heard, told = [], False
    for chunk in chunks(samples):
        if chunk.captured_at_s > gap_s and not told:
            told = True
            recognizer.gap(Gap(gap_s, ended=ended))
            assert not ended or recognizer.partial == ""
        heard += recognizer.accept(chunk)
    assert told
    return [one.command for one in heard + recognizer.finish(len(samples) / SAMPLE_RATE_HZ)]


@pytest.fixture(scope="module")
def utterance() -> Samples:
    return np.concatenate([quiet(1.5), clip("go_left/go-left_0.ogg"), quiet(1.5)])


@pytest.mark.parametrize("ended", [False, True])
@pytest.mark.parametrize("share", [0.1, 0.5, 0.95])
def test_a_move_with_a_hole_in_it_is_not_asked_for(
    loaded: vosk.Model, utterance: Samples, share: float, ended: bool
) -> None:
    begin_s, end_s = voice_of(utterance)
    assert commands_with_gap(loaded, utterance, begin_s + share * (end_s - begin_s), ended=ended) == []


def test_sound_missing_just_before_the_voice_may_have_been_its_beginning(
    loaded: vosk.Model, utterance: Samples
) -> None:
    assert commands_with_gap(loaded, utterance, voice_of(utterance)[0] - 0.2) == []


@pytest.mark.parametrize("ended", [False, True])
def test_sound_missing_long_before_or_after_takes_nothing(loaded: vosk.Model, utterance: Samples, ended: bool) -> None:
    begin_s, end_s = voice_of(utterance)
    assert commands_with_gap(loaded, utterance, begin_s - 1.0, ended=ended) == [Command.GO_LEFT]
    assert commands_with_gap(loaded, utterance, end_s + 0.8, ended=ended) == [Command.GO_LEFT]


def test_stop_is_heard_in_spite_of_a_hole(loaded: vosk.Model) -> None:
    samples = np.concatenate([quiet(1.5), clip("stop/please-stop-now_0.ogg"), quiet(1.5)])
    begin_s, end_s = voice_of(samples)
    assert commands_with_gap(loaded, samples, (begin_s + end_s) / 2) == [Command.STOP]


def test_what_follows_a_holed_utterance_is_heard(loaded: vosk.Model, utterance: Samples) -> None:
    both = np.concatenate([utterance, clip("go_up/go-up_0.ogg"), quiet(1.5)])
    begin_s, end_s = voice_of(utterance)
    assert commands_with_gap(loaded, both, (begin_s + end_s) / 2) == [Command.GO_UP]
