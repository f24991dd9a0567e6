"""Two recognisers on one voice: one hears it as it is, the other freed of noise, and decides where the noise is strong.

Denoising loses a little of a clear voice and invents a little in a quiet room, so the second listens only while the voice stands
too little above the noise. STOP counts from either. Source: issue of noise beside a flying drone; Iwamoto 2022 (artefacts).
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Protocol

from modalities.models.catalogue import ModelError, find_denoiser
from modalities.voice.audio import SAMPLE_RATE_HZ, Chunk, Gap
from modalities.voice.decoder import SURE, Heard, Recognizer
from modalities.voice.denoiser import WINDOW_SAMPLES, Denoiser
from modalities.voice.phrases import PhraseTable
from modalities.voice.sound_check import SoundCheck
from modalities.voice.vosk_library import Model
from safety.vocabulary import Command

NOISY_BELOW_DB = 26.0
QUIET_ABOVE_DB = 30.0
NOISY_FROM_DBFS = -50.0
"""Where no voice has been heard yet that stands above the noise: a room this loud is taken for noisy."""
HOLD_S = 3.0
"""How long it goes on once the noise is gone: no utterance changes hands in its middle."""
SURE_ALONE = 0.9
"""What is heard through the noise counts from this confidence on."""
SAME_STOP_S = 1.5
"""STOP from both within this is one."""
DELAY_S = WINDOW_SAMPLES / SAMPLE_RATE_HZ


class Listener(Protocol):
    """What makes requests of sound: see Recognizer."""

    @property
    def partial(self) -> str: ...
    @property
    def missing_words(self) -> tuple[str, ...]: ...
    def accept(self, chunk: Chunk, *, self_speech: bool = False) -> list[Heard]: ...
    def gap(self, gap: Gap) -> None: ...
    def forget(self) -> None: ...
    def finish(self, now_s: float) -> list[Heard]: ...


class NoisyListener:
    """A Listener that hears twice while there is noise."""

    def __init__(self, plain: Recognizer, clear: Recognizer, denoiser: Denoiser) -> None:
        """plain, clear: of the same model and phrases; clear hears what the denoiser leaves."""
        self._plain = plain
        self._clear = clear
        self._denoiser = denoiser
        self._check = SoundCheck()
        self._since_s = math.inf
        """Since when the denoised voice decides; inf: it does not."""
        self._until_s = -math.inf
        self._stopped_s = self._asked_s = -math.inf
        """When STOP, and when anything else that was sure, was last heard by either."""

    @property
    def noisy(self) -> bool:
        return math.isfinite(self._since_s)

    @property
    def partial(self) -> str:
        return (self._clear if self.noisy else self._plain).partial

    @property
    def missing_words(self) -> tuple[str, ...]:
        return self._plain.missing_words

    def accept(self, chunk: Chunk, *, self_speech: bool = False) -> list[Heard]:
        """See Recognizer."""
        self._check.accept(chunk.samples)
        self._look(chunk.captured_at_s)
        plain = self._plain.accept(chunk, self_speech=self_speech)
        if not self.noisy:
            return plain
        denoised = Chunk(self._denoiser.accept(chunk.samples), chunk.captured_at_s)
        return self._together(plain, [self._in_time(one) for one in self._clear.accept(denoised)])

    def gap(self, gap: Gap) -> None:
        """See Recognizer."""
        self._plain.gap(gap)
        self._clear.gap(gap)
        self._denoiser.forget()

    def forget(self) -> None:
        """See Recognizer."""
        self._plain.forget()
        self._clear.forget()

    def finish(self, now_s: float) -> list[Heard]:
        """See Recognizer."""
        plain = self._plain.finish(now_s)
        return self._together(plain, self._clear.finish(now_s)) if self.noisy else plain

    def _look(self, now_s: float) -> None:
        """Whether there is noise now."""
        hearing = self._check.hearing
        limit_db = QUIET_ABOVE_DB if self.noisy else NOISY_BELOW_DB
        snr_db = hearing.snr_db
        if hearing.noise_dbfs > NOISY_FROM_DBFS if snr_db is None else snr_db < limit_db:
            self._until_s = now_s + HOLD_S
            self._since_s = min(self._since_s, now_s)
        elif self.noisy and now_s > self._until_s:
            self._since_s = math.inf
            self._clear.forget()
            self._denoiser.forget()

    def _together(self, plain: list[Heard], clear: list[Heard]) -> list[Heard]:
        """STOP once, whoever hears it first, and the rest of its utterance asks for nothing. Anything else once as well: of who
        decided when its utterance began, unless the other has just heard another request in its place; or of the other where that
        one is very sure and nobody was before it.
        """
        heard: list[Heard] = []
        for one in (*plain, *clear):
            if one.command is not Command.STOP:
                continue
            if one.made_at_s - self._stopped_s > SAME_STOP_S:
                heard.append(one)
            self._stopped_s = one.made_at_s
        for one in (*clear, *(one for one in plain if one.began_at_s < self._since_s or one.confidence >= SURE_ALONE)):
            if one.command is Command.STOP or one.began_at_s <= max(self._stopped_s, self._asked_s):
                continue
            if one in clear and self._plain.contradicts(one):
                continue
            if one.confidence >= SURE:
                self._asked_s = one.made_at_s
            heard.append(one)
        return heard

    @staticmethod
    def _in_time(one: Heard) -> Heard:
        """What is denoised comes out later than it was captured."""
        return replace(one, captured_at_s=one.captured_at_s - DELAY_S, began_at_s=one.began_at_s - DELAY_S)


def listener(model: Model, table: PhraseTable, denoiser: Denoiser | None) -> Listener:
    """What makes requests of one recording or microphone. denoiser: None where this machine has none."""
    plain = Recognizer(model, table)
    return plain if denoiser is None else NoisyListener(plain, Recognizer(model, table, in_noise=True), denoiser)


def denoiser_here() -> tuple[Denoiser | None, str]:
    """This machine's, loaded, and a sentence for the operator: which it is, or why there is none."""
    try:
        found = find_denoiser()
        return Denoiser(found.path), found.sentence
    except ModelError as error:
        return None, str(error)
