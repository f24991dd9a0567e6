"""What the app itself says: when it spoke, what is dropped because of it, and that real recognition makes nothing of it."""

from __future__ import annotations

import math
import os
import random
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import vosk
from hypothesis import given
from hypothesis import strategies as st

from modalities.voice.audio import SAMPLE_RATE_HZ, Chunk, Gap, Samples, chunks, quiet, read_audio
from modalities.voice.barge_in import WINDOW_S, BargeIn
from modalities.voice.decoder import Heard, Recognizer
from modalities.voice.phrases import PhraseTable
from modalities.voice.self_speech import TAIL_S, SelfSpeech
from modalities.voice.stream import VoiceStream
from safety.vocabulary import Command, ManeuverRequest
from tests.ui.all_cues import all_cues
from ui.speaker import PROGRAM, WORDS

RECORDINGS = Path(__file__).resolve().parents[1] / "recordings"
SOAK = os.environ.get("M3R_SOAK") == "1"
TABLE = PhraseTable(("red", "green", "blue"))
SAMPLE = (
    "Red: left, forty centimetres, wall ahead", "Red: up refused, ground too near", "Red: holding, Blue too near",
    "Red: left turn", "Red: going on, fifteen centimetres", "Red: back, one metre", "Red: not sure what you said",
    "Blue: forward in a moment, others too near",
)  # fmt: skip
SUREST_MOVE = 0.3
"""Even if it were not dropped, what is made of a cue must be far below the confidence that a move needs (0.7)."""
MOST_FALSE_STOPS = 0.01
"""Share of all cues (and one): a false stop is safe, but the drone would hold for its own voice."""


def test_nothing_is_spoken_before_during_and_after() -> None:
    own = SelfSpeech()
    assert not own.overlaps(-math.inf, math.inf)
    own.begins(10.0)
    assert own.overlaps(9.0, 10.0) and own.overlaps(50.0, 50.0)
    assert not own.overlaps(8.0, 9.99)
    own.ends(12.0)
    assert own.overlaps(12.0 + TAIL_S, 20.0)
    assert not own.overlaps(12.01 + TAIL_S, 20.0)
    own.ends(30.0)  # nothing was being spoken
    assert not own.overlaps(13.0, 40.0)


@pytest.mark.parametrize("times", [(math.nan, 5.0), (5.0, math.nan), (math.nan, math.nan)])
def test_an_unknown_time_overlaps_what_was_spoken(times: tuple[float, float]) -> None:
    own = SelfSpeech()
    own.begins(10.0)
    own.ends(12.0)
    assert own.overlaps(*times) or not math.isnan(times[1])
    assert own.overlaps(math.nan, math.nan)


@given(
    st.lists(st.tuples(st.floats(0.0, 2.0), st.floats(0.01, 3.0)), min_size=1, max_size=20),
    st.floats(0.0, 60.0),
    st.floats(0.0, 3.0),
)
def test_it_overlaps_as_intervals_do(utterances: list[tuple[float, float]], from_s: float, lasts_s: float) -> None:
    own, now_s, spoken = SelfSpeech(), 0.0, []
    for pause_s, length_s in utterances:
        own.begins(now_s + pause_s)
        spoken.append((now_s + pause_s, now_s + pause_s + length_s + TAIL_S))
        now_s += pause_s + length_s
        own.ends(now_s)
    assert own.overlaps(from_s, from_s + lasts_s) == any(a <= from_s + lasts_s and from_s <= b for a, b in spoken)


class Ears:
    """A recogniser that hears what it is told to, at the end of each chunk."""

    partial = ""

    def __init__(self, heard: dict[float, Heard]) -> None:
        self._heard = heard
        self.self_speech: list[bool] = []

    def accept(self, chunk: Chunk, *, self_speech: bool) -> list[Heard]:
        self.self_speech.append(self_speech)
        return [heard for at_s, heard in self._heard.items() if abs(at_s - chunk.captured_at_s) < 0.01]

    def gap(self, _gap: Gap) -> None: ...

    def finish(self, _now_s: float) -> list[Heard]:
        return []


def utterance(command: Command, from_s: float, to_s: float) -> Heard:
    return Heard(command, None, 0.99, command.value, to_s, to_s + 0.3, from_s)


@pytest.mark.parametrize(
    ("command", "from_s", "to_s", "counts"),
    [
        (Command.GO_LEFT, 1.0, 1.9, True),  # before it
        (Command.GO_LEFT, 1.5, 2.5, False),  # into it
        (Command.GO_LEFT, 2.2, 2.8, False),
        (Command.GO_LEFT, 3.2, 3.9, False),  # begun while the room still rings
        (Command.GO_LEFT, 3.4, 3.9, True),
        (Command.STOP, 2.2, 2.8, True),
        (Command.ACTIVATE, 2.2, 2.8, False),
        (Command.CONTINUE, 2.2, 2.8, False),
        (Command.GO_LEFT, -math.inf, 4.0, False),  # nobody knows when it began
    ],
)
def test_what_is_heard_while_the_app_speaks_counts_only_if_it_is_stop(
    command: Command, from_s: float, to_s: float, counts: bool
) -> None:
    own = SelfSpeech()
    own.begins(102.0)
    own.ends(103.0)
    requests: list[ManeuverRequest] = []
    dropped: list[str] = []
    ears = Ears({4.5: utterance(command, from_s, to_s)})
    stream = VoiceStream(
        chunks(quiet(5.0)),
        ears,
        clock=lambda: 200.0,
        began_s=100.0,
        on_request=requests.append,
        self_speech=own,
        on_dropped=dropped.append,
    )
    stream._run()
    assert [request.command for request in requests] == ([command] if counts else [])
    assert dropped == ([] if counts else [command.value])
    told_s = [0.05 * (i + 1) for i, self_speech in enumerate(ears.self_speech) if self_speech]
    assert (told_s[0], told_s[-1]) == (pytest.approx(2.0), pytest.approx(3.0 + TAIL_S))


def through(found: list[bool], chunk_s: float = 0.05) -> list[int]:
    """At which of the chunks *stop* is heard, when successive looks find it or not."""
    answers = iter(found)
    barge_in = BargeIn(lambda samples: len(samples) <= WINDOW_S * SAMPLE_RATE_HZ and next(answers))
    heard = []
    for i in range(60):
        try:
            if barge_in.accept(quiet(chunk_s)):
                heard.append(i)
        except StopIteration:
            break
    return heard


def test_stop_comes_through_when_two_looks_in_a_row_find_it() -> None:
    assert through([False] * 10) == []
    assert through([True, False] * 5) == []
    assert through([False, True, True, False]) == [11]  # looks begin once half the window is there, every 0.1 s
    assert through([True, True]) == [9]


def test_what_was_heard_before_is_forgotten() -> None:
    looks: list[int] = []
    barge_in = BargeIn(lambda samples: bool(looks.append(len(samples))) or True)
    for _ in range(9):
        assert not barge_in.accept(quiet(0.05))
    barge_in.forget()
    for _ in range(9):
        assert not barge_in.accept(quiet(0.05))
    assert barge_in.accept(quiet(0.05))
    assert max(looks) <= WINDOW_S * SAMPLE_RATE_HZ


@pytest.mark.skipif(shutil.which(PROGRAM) is None, reason=f"no {PROGRAM} here (apt: {PROGRAM})")
def test_stop_is_heard_through_a_cue(loaded: vosk.Model, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Twice as loud as the cue. Only what looking again and again finds: the partial results find some of it too."""
    monkeypatch.setattr(Recognizer, "_stop_stands", lambda _self: False)
    cue = 0.4 * spoken("Red: up refused, ground too near", tmp_path)

    def heard_at_s(clip: Path, *, self_speech: bool) -> float:
        voice = read_audio(clip)
        begins, both = round(0.9 * SAMPLE_RATE_HZ), cue.copy()
        voice = voice[: len(cue) - begins] * (2.0 * np.abs(cue).max() / np.abs(voice.astype(float)).max())
        both[begins : begins + len(voice)] += voice
        recognizer = Recognizer(loaded, TABLE)
        found = (one for c in chunks(both.astype(np.int16)) for one in recognizer.accept(c, self_speech=self_speech))
        return next((one.made_at_s for one in found if one.command is Command.STOP), math.inf)

    for clip in sorted((RECORDINGS / "stop").glob("please*.ogg")):
        told_s, untold_s = heard_at_s(clip, self_speech=True), heard_at_s(clip, self_speech=False)
        assert told_s < math.inf
        assert told_s < untold_s  # at once, not when the cue is over


def test_an_utterance_knows_when_it_began(loaded: vosk.Model) -> None:
    samples = np.concatenate([quiet(1.0), read_audio(RECORDINGS / "go_left/go-left_0.ogg"), quiet(1.0)])
    recognizer = Recognizer(loaded, TABLE)
    (heard,) = (one for chunk in chunks(samples) for one in recognizer.accept(chunk))
    first_s = float(np.flatnonzero(np.abs(samples) > 0.05 * np.abs(samples).max())[0]) / 16_000
    assert heard.began_at_s == pytest.approx(first_s, abs=0.15)


def spoken(text: str, folder: Path) -> Samples:
    """As the speaker has it spoken."""
    file = folder / "cue.wav"
    subprocess.run([PROGRAM, *WORDS, "-w", str(file)], input=text.encode(), check=True)
    return np.concatenate([quiet(0.5), read_audio(file), quiet(0.8)])


def made_of(text: str, model: vosk.Model, folder: Path) -> list[Heard]:
    """What recognition makes of a cue that comes back undamped."""
    recognizer = Recognizer(model, TABLE)
    samples = spoken(text, folder)
    found = [one for chunk in chunks(samples) for one in recognizer.accept(chunk)]
    return found + recognizer.finish(len(samples) / 16_000)


@pytest.mark.skipif(shutil.which(PROGRAM) is None, reason=f"no {PROGRAM} here (apt: {PROGRAM})")
def test_real_recognition_makes_no_request_of_a_cue(loaded: vosk.Model, tmp_path: Path) -> None:
    cues = random.Random(1).sample(all_cues(), 600) if SOAK else SAMPLE
    heard = {text: made_of(text, loaded, tmp_path) for text in cues}
    moves = [(text, one) for text, all_of in heard.items() for one in all_of if one.command is not Command.STOP]
    assert [(text, one) for text, one in moves if one.confidence >= SUREST_MOVE] == []
    stops = [text for text, all_of in heard.items() if any(one.command is Command.STOP for one in all_of)]
    assert len(stops) <= 1 + MOST_FALSE_STOPS * len(cues), stops
