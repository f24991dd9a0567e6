"""Speech to requests with VOSK: two grammars on the same audio, STOP from partial results, a prompt end of utterance.

One recogniser (the *commands* decoder) knows the legal phrases and next to nothing else, as the paper's does; it finds them
well but bends other speech into them. The other (the *words* decoder) knows everyday words too. What an utterance was is
decided by comparing how well each explains the audio. Source: paper section on voice-based maneuvers, design 3.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from modalities.models.catalogue import ModelError
from modalities.voice.audio import SAMPLE_RATE_HZ, Chunk, Gap, Samples, quiet
from modalities.voice.barge_in import BargeIn
from modalities.voice.gain import SlowGain
from modalities.voice.phrases import OTHER_WORDS, STOP_RIVALS, STOP_WORD, Phrase, PhraseTable, contains_stop, normalise
from modalities.voice.vad import VoiceActivityDetector
from modalities.voice.vosk_library import KaldiRecognizer, Model, SetLogLevel
from safety.vocabulary import Command

CLOSE_AFTER_S = 0.3
"""An utterance ends when the voice has been gone this long."""
CLOSE_UNFINISHED_AFTER_S = 0.7
"""... or this long while what was heard is the beginning of a phrase ("go")."""
SETTLED_S = 0.6
"""A partial result that stays the same for this long ends the utterance where noise hides the end of the voice."""
LEAD_IN_S = 0.3
"""Room noise that every utterance is preceded by: the decoder needs to have heard a room before it hears a voice in it."""
ROOM_NOISE = 10.0
"""Standard deviation (of 32768) of the noise that is added to what is decoded: the model was trained on real rooms and loses
words in digital silence, such as a noise gate's or a synthetic voice's."""
SECOND_ROOM_NOISE = 40.0
"""... and when an utterance of which little could be made is heard a second time."""
SECOND_LONGEST_S = 3.0
"""No phrase takes longer: a longer utterance is not heard again."""
SURE = 0.7
STOP_GAP = 2.0
"""A final *stop* of the commands decoder alone counts if the words decoder explains the audio better by no more than this."""
STOP_IN_NOISE = 2.0
"""In noise, *stop* counts too where the commands decoder finds it this little worse than its best guess, and that is no phrase."""
BEFORE_VOICE_S = 0.5
"""Sound missing this shortly before a voice was heard may have held the beginning of what it said."""
ALTERNATIVES = 8
UNKNOWN_WORD = "[unk]"


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """What a decoder takes the utterance for. score: log likelihood of audio and words (natural units, higher fits)."""

    text: str
    score: float


@dataclass(frozen=True, slots=True)
class Heard:
    """A request candidate. Times are those of the recording; the caller adds its clock's and its processing time.

    confidence: calibrated, 0 to 1 (see `confidence_of`). captured_at_s: the end of the voice; made_at_s: capture time of
    the chunk that completed it; began_at_s: capture time of the chunk in which the utterance began.
    """

    command: Command
    colour: str | None
    confidence: float
    text: str
    captured_at_s: float
    made_at_s: float
    began_at_s: float = -math.inf


class Decoder:
    """One VOSK recogniser over one grammar."""

    def __init__(self, model: Model, grammar: tuple[str, ...]) -> None:
        self._recognizer = KaldiRecognizer(model, float(SAMPLE_RATE_HZ), json.dumps(grammar))
        self._recognizer.SetMaxAlternatives(ALTERNATIVES)
        self._segments: list[list[Hypothesis]] = []
        self.partial = ""

    def accept(self, data: bytes) -> None:
        """Decode on; `partial` is then what the utterance has been so far."""
        if self._recognizer.AcceptWaveform(data):  # the decoder's own endpoint: the utterance may still go on
            self._keep(self._recognizer.Result())
            partial = ""
        else:
            partial = str(json.loads(self._recognizer.PartialResult()).get("partial", ""))
        self.partial = " ".join([*(best[0].text for best in self._segments), partial]).strip()

    def hear_again(self, data: bytes) -> list[Hypothesis]:
        """A whole utterance at once, between others: its hypotheses, best first."""
        self.accept(data)
        return self.close()

    def close(self) -> list[Hypothesis]:
        """End the utterance and forget it: its hypotheses, best first."""
        self._keep(self._recognizer.FinalResult())
        segments, self._segments, self.partial = self._segments, [], ""
        if len(segments) == 1:
            return segments[0]
        return [Hypothesis(" ".join(s[0].text for s in segments).strip(), sum(s[0].score for s in segments))]

    def forget(self) -> None:
        """Drop the utterance unheard."""
        self._recognizer.Reset()
        self._segments, self.partial = [], ""

    def _keep(self, result: str) -> None:
        heard = [
            Hypothesis(normalise(a["text"]), float(a["confidence"])) for a in json.loads(result).get("alternatives", [])
        ]
        if heard:
            self._segments.append(heard)


class Recognizer:
    """Both decoders and the end of the voice: chunks in, request candidates out. Synchronous, no clock; one per recording."""

    def __init__(self, model: Model, table: PhraseTable, *, in_noise: bool = False) -> None:
        """in_noise: rather a false *stop* than none. Raises ModelError if the model does not know the word *stop*."""
        known = {
            word: model.vosk_model_find_word(word) >= 0
            for word in {*table.words, *OTHER_WORDS, *STOP_RIVALS, UNKNOWN_WORD}
        }
        self.missing_words = tuple(word for word in table.words if not known[word])
        """Words of the phrases that the model lacks: no phrase with one of them can be heard."""
        if not known[STOP_WORD]:
            raise ModelError(
                f"the voice model does not know the word {STOP_WORD!r}: fetch another with `m3r models fetch`"
            )
        phrases = tuple(phrase for phrase in table.phrases if all(known[word] for word in phrase.split()))
        unknown = (UNKNOWN_WORD,) if known[UNKNOWN_WORD] else ()
        single = tuple(word for word in (*table.words, *OTHER_WORDS) if known[word] and word not in phrases)
        self._table = table
        self._in_noise = in_noise
        rivals = tuple(word for word in STOP_RIVALS if known[word])
        self._commands = Decoder(model, (*phrases, *rivals, *unknown))
        self._apart = Decoder(model, (*phrases, *rivals, *unknown))
        self._barge_in = BargeIn(self._stop_apart)
        self._words = Decoder(model, (*phrases, *single, *unknown))
        self._gain = SlowGain()
        self._voice = VoiceActivityDetector()
        self._hole_s = -math.inf
        self._began_s: float
        self._fresh: bool
        self._utterance: Samples
        self._room = np.random.default_rng(0)  # seeded: the same recording is always heard the same
        self._other_room = np.random.default_rng(1)
        self._begin_utterance()

    @property
    def partial(self) -> str:
        """What the current utterance has been so far, for the operator to see."""
        return self._words.partial

    def accept(self, chunk: Chunk, *, self_speech: bool = False) -> list[Heard]:
        """Take the next chunk (16 kHz mono 16-bit); the request candidates that it completes, usually none.

        self_speech: the app itself is speaking, through which STOP must be heard.
        """
        chunk = replace(chunk, samples=self._gain.accept(chunk.samples))
        now_s = chunk.captured_at_s
        before = self._commands.partial
        self._voice.accept(chunk.samples, now_s)
        self._keep(chunk.samples)
        data = self._in_a_room(chunk.samples)
        self._commands.accept(data)
        self._words.accept(data)
        if self._commands.partial != before:
            self._changed_s = now_s
        if not math.isfinite(self._began_s) and (self._voice.has_spoken or self.partial):
            self._began_s = now_s
        heard = [self._stop(now_s)] if self._stop_stands() or self._comes_through(chunk, self_speech) else []
        if self._is_over(now_s):
            heard += self._close(now_s)
        return heard

    def contradicts(self, other: Heard) -> bool:
        """Whether the utterance that is open here has so far been a request, and another one than `other`."""
        here = self._table.interpret(self._commands.partial)
        return here is not None and here.command not in {Command.STOP, other.command}

    def gap(self, gap: Gap) -> None:
        """Sound is missing. No request is made of half an input: what is open is forgotten if the source went away, and
        only STOP may come of it otherwise.
        """
        self._hole_s = gap.captured_at_s
        self._voice.cut()
        if gap.ended:
            self.forget()

    def forget(self) -> None:
        """Drop the utterance that is open, unheard."""
        self._commands.forget()
        self._words.forget()
        self._begin_utterance()

    def finish(self, now_s: float) -> list[Heard]:
        """The recording has ended: close what is open."""
        return self._close(now_s)

    def _keep(self, samples: Samples) -> None:
        """Keep the utterance, from shortly before its voice began, as long as it may be one to hear again."""
        if len(self._utterance) <= SECOND_LONGEST_S * SAMPLE_RATE_HZ:
            self._utterance = np.concatenate([self._utterance, samples])
        if not self._voice.has_spoken:
            self._utterance = self._utterance[-round(LEAD_IN_S * SAMPLE_RATE_HZ) :]

    def _in_a_room(self, samples: Samples, noise: float = ROOM_NOISE) -> bytes:
        """The samples as they are decoded: with room noise, and before an utterance's first ones some noise alone."""
        if self._fresh:
            samples = np.concatenate([quiet(LEAD_IN_S), samples])
            self._fresh = False
        return _noisy(samples, self._room, noise)

    def _begin_utterance(self) -> None:
        self._fresh = True
        self._utterance = quiet(0.0)
        self._stop_partials = 0
        self._stopped = False
        self._changed_s = -math.inf
        self._began_s = math.inf
        self._voice.forget()

    def _stop_stands(self) -> bool:
        """STOP: the word stands in two successive partial results, and the words decoder has nothing else in its place."""
        partial = self._commands.partial.split()
        self._stop_partials = self._stop_partials + 1 if STOP_WORD in partial else 0
        if self._stopped or self._stop_partials < 2:
            return False
        words = self._words.partial.split()
        return STOP_WORD in words or len(words) <= partial.index(STOP_WORD)

    def _comes_through(self, chunk: Chunk, self_speech: bool) -> bool:
        """STOP, said while the app speaks."""
        if not self_speech or self._stopped:
            self._barge_in.forget()
            return False
        return self._barge_in.accept(chunk.samples)

    def _stop_apart(self, samples: Samples) -> bool:
        heard = np.concatenate([quiet(LEAD_IN_S), samples])
        best = self._apart.hear_again(_noisy(heard, self._other_room, ROOM_NOISE))
        return bool(best) and contains_stop(best[0].text)

    def _stop(self, now_s: float, confidence: float = 1.0) -> Heard:
        self._stopped = True
        text = self._commands.partial
        text = text if contains_stop(text) else STOP_WORD
        return Heard(Command.STOP, None, confidence, text, self._voice_end_s(now_s), now_s, self._began_s)

    def _voice_end_s(self, now_s: float) -> float:
        """The voice's end; where the level shows none, when the partial result last changed."""
        end_s = self._voice.last_voice_s if self._voice.has_spoken else self._changed_s
        return min(end_s, now_s) if math.isfinite(end_s) else now_s

    def _is_over(self, now_s: float) -> bool:
        partial = self._commands.partial
        unfinished = self._table.begins_phrase(partial)
        if self._voice.has_spoken:
            wait_s = CLOSE_UNFINISHED_AFTER_S if unfinished else CLOSE_AFTER_S
            if now_s - self._voice.last_voice_s >= wait_s - 1e-9:
                return True
        return bool(partial) and not unfinished and now_s - self._changed_s >= SETTLED_S

    def _close(self, now_s: float) -> list[Heard]:
        end_s, began_s = self._voice_end_s(now_s), min(self._began_s, now_s)
        spoken = self._voice.has_spoken
        utterance = self._utterance
        commands, words = self._commands.close(), self._words.close()
        stopped = self._stopped
        holed = self._hole_s >= began_s - BEFORE_VOICE_S
        self._begin_utterance()
        if stopped:  # the rest of an utterance with STOP asks for nothing
            return []
        heard = self._understood(commands, words, end_s, now_s)
        again = spoken and len(utterance) <= SECOND_LONGEST_S * SAMPLE_RATE_HZ
        if again and (heard is None or heard.confidence < SURE):
            data = self._in_a_room(utterance, SECOND_ROOM_NOISE)
            self._begin_utterance()
            second = self._understood(self._commands.hear_again(data), self._words.hear_again(data), end_s, now_s)
            if second is not None and (heard is None or second.confidence > heard.confidence):
                heard = second
        if holed and heard is not None and heard.command is not Command.STOP:
            return []
        return [replace(heard, began_at_s=began_s)] if heard is not None else []

    def _understood(
        self, commands: list[Hypothesis], words: list[Hypothesis], end_s: float, now_s: float
    ) -> Heard | None:
        """What a whole utterance asks for."""
        if not commands or not words:
            return None
        near = words[0].score - commands[0].score <= STOP_GAP
        doubtful = self._in_noise and self._may_be_stop(commands)
        if contains_stop(words[0].text) or (commands[0].text == STOP_WORD and near) or doubtful:
            text = STOP_WORD if doubtful else words[0].text or STOP_WORD
            return Heard(Command.STOP, None, 1.0, text, end_s, now_s)
        phrase, text = self._phrase_in(commands, words)
        if phrase is None or phrase.command is Command.STOP:
            return None
        confidence = confidence_of(commands, words, phrase, self._table)
        return Heard(phrase.command, phrase.colour, confidence, text, end_s, now_s)

    def _may_be_stop(self, commands: list[Hypothesis]) -> bool:
        near = [one.text for one in commands if one.score >= commands[0].score - STOP_IN_NOISE]
        return bool(near[0]) and STOP_WORD in near and self._table.interpret(near[0]) is None

    def _phrase_in(self, commands: list[Hypothesis], words: list[Hypothesis]) -> tuple[Phrase | None, str]:
        """What the commands decoder heard; where that is no phrase ("down up"), what the words decoder heard if the commands decoder
        holds it possible too.
        """
        for text in (commands[0].text, words[0].text):
            phrase = self._table.interpret(text)
            if phrase is not None and any(self._table.interpret(h.text) == phrase for h in commands):
                return phrase, text
        return None, ""


def _noisy(samples: Samples, room: np.random.Generator, noise: float) -> bytes:
    noisy = samples + room.normal(0.0, noise, len(samples))
    return np.clip(np.rint(noisy), -32768, 32767).astype(np.int16).tobytes()


# How sure to be: logistic regression of "this phrase was said" on what the two decoders say, fitted on single-word and joined
# recordings of 94 people and on synthetic voices saying every phrase and near misses ("come back", "blow up"), and checked
# on people left out of the fit. Log odds per unit; scores are natural log likelihoods.
_BIAS = -0.66
_PER_MARGIN = 0.53
"""Per unit by which the words decoder prefers the phrase to everything else that it could have been."""
_PER_GAP = -0.105
"""Per unit by which the words decoder explains the audio better than the commands decoder does with the phrase."""
_AGREE = 2.36
"""Where the words decoder takes it for the same request."""
_MARGIN_LIMIT = 3.0
_GAP_LIMIT = 12.0
_FAR_APART = -4.0
"""The words decoder explaining the audio much *worse* without the phrase means that it lost track: that is no support."""


def confidence_of(commands: list[Hypothesis], words: list[Hypothesis], phrase: Phrase, table: PhraseTable) -> float:
    """How likely it is that the phrase was said, 0 to 1, by what both decoders made of the utterance. Measured, see above."""

    def score(hypotheses: list[Hypothesis], *, of_phrase: bool) -> float:
        fitting = [h.score for h in hypotheses if (table.interpret(h.text) == phrase) is of_phrase]
        return max(fitting, default=-math.inf)

    gap = words[0].score - score(commands, of_phrase=True)
    margin = score(words, of_phrase=True) - score(words, of_phrase=False)
    agree = table.interpret(words[0].text) == phrase
    margin = max(-_MARGIN_LIMIT, min(_MARGIN_LIMIT, margin))
    if gap < _FAR_APART and not agree:
        margin, gap = -_MARGIN_LIMIT, _GAP_LIMIT
    log_odds = _BIAS + _PER_MARGIN * margin + _PER_GAP * min(gap, _GAP_LIMIT) + _AGREE * agree
    return 1.0 / (1.0 + math.exp(-log_odds))


def load_model(folder: Path) -> Model:
    """A VOSK model, its log silenced. Raises ModelError."""
    SetLogLevel(-2)  # its warnings too: missing words are reported by the recogniser
    try:
        return Model(str(folder))
    except Exception as error:  # vosk raises nothing narrower
        raise ModelError(f"{folder} is not a voice model: run `m3r models fetch` or set M3R_MODELS") from error
