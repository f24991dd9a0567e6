"""Recognition by real VOSK on recordings that the project ships; skipped by name where no model is found."""

from __future__ import annotations

import json
import math
import os
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import vosk

from modalities.models.catalogue import ModelError, VoiceModel
from modalities.outcomes import Answer, EvaluationError, Trial, choose_threshold
from modalities.script import read_script
from modalities.voice.audio import AudioError, Chunk, Samples, chunks, quiet, read_audio
from modalities.voice.decoder import CLOSE_AFTER_S, Heard, Hypothesis, Recognizer, confidence_of
from modalities.voice.evaluation import TOLERATED_FALSE_MOVES, evaluate_voice, hear
from modalities.voice.phrases import PhraseTable
from modalities.voice.stream import VoiceStream
from safety.vocabulary import Command, ManeuverRequest, Modality

pytestmark = pytest.mark.xdist_group("busy")  # it keeps a core busy: one of them at a time

ROOT = Path(__file__).resolve().parents[2]
RECORDINGS = ROOT / "tests" / "recordings"
DEMO = ROOT / "config" / "demo"
REAL = ROOT.parent / "shared" / "data" / "speech"
TABLE = PhraseTable(("red", "green", "blue"))
THRESHOLD = 0.7


def clip(name: str) -> Samples:
    return read_audio(RECORDINGS / name)


def said(*names: str, pause_s: float = 1.0) -> Samples:
    return np.concatenate([part for name in names for part in (clip(name), quiet(pause_s))])


def heard_in(samples: Samples, model: vosk.Model) -> list[Heard]:
    return [answer.heard for answer in hear(samples, Recognizer(model, TABLE))]


def test_requests_in_a_row_are_heard_one_by_one(loaded: vosk.Model) -> None:
    samples = said("go_left/go-left_0.ogg", "go_up/fly-up_1.ogg", "activate/activate-blue_2.ogg", pause_s=1.5)
    heard = heard_in(samples, loaded)
    assert [(one.command, one.colour) for one in heard] == [
        (Command.GO_LEFT, None),
        (Command.GO_UP, None),
        (Command.ACTIVATE, "blue"),
    ]
    assert all(one.confidence >= THRESHOLD for one in heard)
    assert [one.text for one in heard] == ["go left", "fly up", "activate blue"]


def test_an_utterance_is_closed_300_ms_after_the_voice(loaded: vosk.Model) -> None:
    samples = np.concatenate([quiet(1.0), clip("go_right/go-right_0.ogg"), quiet(2.0)])
    (one,) = heard_in(samples, loaded)
    loud = np.flatnonzero(np.abs(samples) > 0.05 * np.abs(samples).max())
    assert one.captured_at_s == pytest.approx(loud[-1] / 16_000, abs=0.1)
    assert CLOSE_AFTER_S <= one.made_at_s - one.captured_at_s <= CLOSE_AFTER_S + 0.06


def test_stop_is_taken_from_partial_results_anywhere(loaded: vosk.Model) -> None:
    samples = np.concatenate([clip("stop/please-stop-now_0.ogg"), quiet(2.0)])
    heard = heard_in(samples, loaded)
    assert [one.command for one in heard] == [Command.STOP]
    assert heard[0].made_at_s < len(clip("stop/please-stop-now_0.ogg")) / 16_000 + CLOSE_AFTER_S


def test_nothing_that_follows_stop_in_an_utterance_is_a_request(loaded: vosk.Model) -> None:
    def trimmed(name: str) -> Samples:
        samples = clip(name)
        loud = np.flatnonzero(np.abs(samples) > 400)
        return samples[loud[0] : loud[-1]]

    samples = np.concatenate([quiet(0.5), trimmed("stop/stop_0.ogg"), trimmed("go_left/go-left_0.ogg"), quiet(2.0)])
    assert [one.command for one in heard_in(samples, loaded)] == [Command.STOP]


@pytest.mark.parametrize("seed", range(3))
def test_noise_and_silence_ask_for_nothing(loaded: vosk.Model, seed: int) -> None:
    rng = np.random.default_rng(seed)
    noise = (rng.normal(0.0, (30, 300, 3000)[seed], 16_000 * 4)).clip(-32768, 32767).astype(np.int16)
    assert heard_in(noise, loaded) == []
    assert heard_in(quiet(6.0), loaded) == []


def test_a_recording_gives_the_same_whatever_the_chunks(loaded: vosk.Model) -> None:
    samples = np.concatenate([clip("go_down/go-down_0.ogg"), quiet(1.0)])
    results = []
    for size in (400, 800, 1600):
        recognizer = Recognizer(loaded, TABLE)
        results.append([one.command for chunk in chunks(samples, size) for one in recognizer.accept(chunk)])
    assert results == [[Command.GO_DOWN]] * 3


def test_words_that_the_model_lacks_are_reported_and_left_out(loaded: vosk.Model) -> None:
    recognizer = Recognizer(loaded, PhraseTable(("red", "qzxv")))
    assert recognizer.missing_words == ("qzxv",)
    assert [one.command for chunk in chunks(said("go_left/go-left_0.ogg")) for one in recognizer.accept(chunk)] == [
        Command.GO_LEFT
    ]


def test_a_model_without_the_word_stop_is_refused() -> None:
    class Deaf:
        def vosk_model_find_word(self, word: str) -> int:
            return -1 if word == "stop" else 1

    with pytest.raises(ModelError, match="'stop'"):
        Recognizer(Deaf(), TABLE)


@pytest.mark.parametrize(
    ("commands", "words", "sure"),
    [
        ([("go left", 60.0)], [("go left", 58.0)], True),
        ([("go left", 60.0)], [("come left", 66.0)], False),
        ([("go left", 60.0)], [("come left", 59.0), ("go left", 57.5)], False),
        ([("go left", 60.0)], [("house", 40.0)], False),
        ([("go left", 60.0)], [("yes", 90.0)], False),
        ([("go left", 60.0)], [("", 61.0)], False),
    ],
)
def test_confidence_follows_how_the_two_ears_agree(
    commands: list[tuple[str, float]], words: list[tuple[str, float]], *, sure: bool
) -> None:
    phrase = TABLE.interpret(commands[0][0])
    assert phrase is not None
    confidence = confidence_of([Hypothesis(*h) for h in commands], [Hypothesis(*h) for h in words], phrase, TABLE)
    assert (confidence >= THRESHOLD) is sure
    assert 0.0 < confidence < 1.0


def test_a_better_rival_never_raises_confidence() -> None:
    phrase = TABLE.interpret("go up")
    assert phrase is not None
    commands = [Hypothesis("go up", 50.0)]
    for agree in (Hypothesis("go up", 49.0), Hypothesis("blow up", 49.0)):
        rivals = [
            confidence_of(commands, [agree, Hypothesis("show up", 49.0 - d)], phrase, TABLE) for d in (3, 2, 1, 0.1)
        ]
        assert rivals == sorted(rivals, reverse=True)


def test_evaluation_of_the_shipped_recordings(voice_model: VoiceModel, tmp_path: Path) -> None:
    """One voice of three; all of them with M3R_SOAK=1."""
    soak = os.environ.get("M3R_SOAK") == "1"
    for clip in RECORDINGS.glob("*/*.ogg" if soak else "*/*_0.ogg"):
        folder = tmp_path / clip.parent.name
        folder.mkdir(exist_ok=True)
        (folder / clip.name).symlink_to(clip)
    result = evaluate_voice(tmp_path, voice_model)
    json.loads(json.dumps(result, allow_nan=False))
    commands = result["commands"]
    assert isinstance(commands, dict)
    assert set(commands) == set(Command)
    n = sum(row["n"] for row in commands.values())
    right = sum(row["right"] for row in commands.values())
    assert right / n >= 0.95, commands
    assert commands["stop"]["right"] == commands["stop"]["n"]
    none = result["none"]
    assert isinstance(none, dict)
    assert none["false_moves"] == 0
    assert none["by_folder"]["none"]["n"] == none["n"]
    for command, row in commands.items():
        assert row["n"] == row["right"] + row["wrong"] + row["missed"]
        if command != Command.STOP:
            assert 300.0 <= row["latency_ms_p50"] <= 500.0
    assert 0.1 <= result["threshold"] <= 0.95
    assert result["model"] == voice_model.name


def trial(expected: Command | None, *heard: tuple[Command, float]) -> Trial:
    answers = tuple(Answer(Heard(command, None, confidence, "", 1.0, 1.3), 0.3) for command, confidence in heard)
    return Trial("any", expected, answers)


def test_the_chosen_threshold_keeps_out_false_requests_before_it_lets_in_right_ones() -> None:
    clear = [trial(Command.GO_UP, (Command.GO_UP, 0.97)), trial(None)]
    assert choose_threshold(clear, TOLERATED_FALSE_MOVES) == 0.7
    assert choose_threshold([*clear, trial(None, (Command.GO_UP, 0.8))], TOLERATED_FALSE_MOVES) == 0.85
    assert choose_threshold([*clear, trial(Command.GO_UP, (Command.GO_UP, 0.5))], TOLERATED_FALSE_MOVES) == 0.5
    assert choose_threshold([*clear, trial(None, (Command.STOP, 1.0))], TOLERATED_FALSE_MOVES) == 0.7
    both = [*clear, trial(None, (Command.GO_UP, 0.5)), trial(Command.GO_UP, (Command.GO_UP, 0.5))]
    assert choose_threshold(both, TOLERATED_FALSE_MOVES) == 0.7


@pytest.mark.skipif(not REAL.is_dir(), reason="no real recordings here: ../shared/data/speech")
@pytest.mark.parametrize("folder", ["go_left", "go_up", "stop"])
def test_a_sample_of_real_people(loaded: vosk.Model, folder: str) -> None:
    clips = sorted((REAL / folder).glob("*.wav"))[::4]
    right = 0
    for path in clips:
        heard = heard_in(np.concatenate([read_audio(path), quiet(2.0)]), loaded)
        sure = {one.command.value for one in heard if one.confidence >= THRESHOLD or one.command is Command.STOP}
        right += sure == {folder}
    assert right >= 0.9 * len(clips)


def test_what_cannot_be_evaluated_is_named(tmp_path: Path, voice_model: VoiceModel) -> None:
    with pytest.raises(EvaluationError, match="nothing-here"):
        evaluate_voice(tmp_path / "nothing-here", voice_model)
    with pytest.raises(EvaluationError, match=str(tmp_path)):
        evaluate_voice(tmp_path, voice_model)
    (tmp_path / "go_left").mkdir()
    (tmp_path / "go_left" / "broken.wav").write_bytes(b"RIFFnothing")
    with pytest.raises(AudioError, match=r"broken\.wav"):
        evaluate_voice(tmp_path, voice_model)


class FastClock:
    """A clock that a test can turn forward; the stream's waits end at once as it is always late."""

    def __call__(self) -> float:
        return 1000.0


def test_the_stream_hands_over_requests_on_the_apps_clock(loaded: vosk.Model) -> None:
    requests: list[ManeuverRequest] = []
    partials: list[str] = []
    ended: list[Exception | None] = []
    over = threading.Event()

    def on_end(error: Exception | None) -> None:
        ended.append(error)
        over.set()

    samples = said("go_left/go-left_0.ogg", "stop/stop_0.ogg")
    stream = VoiceStream(
        chunks(samples),
        Recognizer(loaded, TABLE),
        clock=FastClock(),
        began_s=900.0,
        on_request=requests.append,
        on_partial=partials.append,
        on_end=on_end,
    )
    stream.start()
    assert over.wait(30.0)
    assert stream.stop()
    assert ended == [None]
    assert [(r.id, r.command, r.modality) for r in requests] == [
        ("voice-1", Command.GO_LEFT, Modality.VOICE),
        ("voice-2", Command.STOP, Modality.VOICE),
    ]
    assert all(900.0 < r.captured_at_s < 900.0 + len(samples) / 16_000 and r.made_at_s == 1000.0 for r in requests)
    assert "go left" in partials


def test_a_stream_that_waits_for_its_time_stops_at_once(loaded: vosk.Model) -> None:
    stream = VoiceStream(
        chunks(quiet(60.0)),
        Recognizer(loaded, TABLE),
        clock=lambda: 0.0,
        began_s=1000.0,
        on_request=lambda _request: None,
    )
    stream.start()
    assert stream.alive
    began = time.monotonic()
    assert stream.stop(5.0)
    assert time.monotonic() - began < 1.0


def test_an_error_in_the_stream_is_told(loaded: vosk.Model) -> None:
    def torn() -> object:
        yield Chunk(quiet(0.05), 0.05)
        raise OSError("the microphone was unplugged")

    ended: list[Exception | None] = []
    stream = VoiceStream(
        torn(),  # type: ignore[arg-type]
        Recognizer(loaded, TABLE),
        clock=lambda: math.inf,
        began_s=0.0,
        on_request=lambda _request: None,
        on_end=ended.append,
    )
    stream.start()
    stream._thread.join(10.0)
    assert [str(error) for error in ended] == ["the microphone was unplugged"]


def test_the_demonstration_is_heard_as_its_script_says(loaded: vosk.Model) -> None:
    story = [r for r in read_script(DEMO / "operator.script", TABLE.colours) if r.modality is Modality.VOICE]
    heard = heard_in(read_audio(DEMO / "operator.ogg"), loaded)
    sure = [one for one in heard if one.confidence >= THRESHOLD or one.command is Command.STOP]
    assert [(one.command, one.colour) for one in sure] == [(one.command, one.colour) for one in story]
    assert [one.captured_at_s for one in sure] == pytest.approx([one.at_s for one in story], abs=0.3)
