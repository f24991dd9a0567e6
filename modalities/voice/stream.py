"""Voice as a modality of the running app: a thread of its own that turns chunks into maneuver requests as time passes."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from modalities.threaded_stream import ThreadedStream
from modalities.voice.audio import Chunk, Gap
from modalities.voice.capture import level_dbfs
from modalities.voice.decoder import Heard
from modalities.voice.in_noise import Listener
from modalities.voice.self_speech import SelfSpeech
from modalities.voice.sound_check import Loudness, SoundCheck
from safety.vocabulary import Command, ManeuverRequest, Modality

Clock = Callable[[], float]


class VoiceStream(ThreadedStream):
    """Hears chunks at their own time and hands over requests, from its own thread.

    A recording's second s is the app's time began_s + s; no chunk is heard before its last sample would have been
    captured. A live microphone's chunks carry the app's own time, so began_s is 0 there. The callbacks run in this thread, so an asyncio app passes ones that use `call_soon_threadsafe`.
    """

    def __init__(
        self,
        chunks: Iterable[Chunk | Gap],
        recognizer: Listener,
        *,
        clock: Clock,
        began_s: float,
        on_request: Callable[[ManeuverRequest], None],
        on_partial: Callable[[str], None] = lambda _text: None,
        on_level: Callable[[Loudness], None] = lambda _loudness: None,
        on_warning: Callable[[str], None] = lambda _sentence: None,
        on_end: Callable[[Exception | None], None] = lambda _error: None,
        self_speech: SelfSpeech | None = None,
        on_dropped: Callable[[str], None] = lambda _text: None,
    ) -> None:
        """clock: the app's monotonic seconds. on_partial: the words so far, whenever they change.
        on_level: how loud each chunk is, and how far the voice stands above the noise. on_warning: what is wrong with the sound, each once. on_end: called last,
        once, with the error that ended the stream, or None where the recording was played or `stop` was called.

        self_speech: when the app itself spoke. What was heard while it did is no request, STOP excepted (X4): its words go
        to on_dropped.
        """
        super().__init__("voice", on_end)
        self._chunks = chunks
        self._recognizer = recognizer
        self._clock = clock
        self._began_s = began_s
        self._on_request = on_request
        self._on_partial = on_partial
        self._on_level = on_level
        self._on_warning = on_warning
        self._check = SoundCheck()
        self._self_speech = self_speech
        self._on_dropped = on_dropped
        self._made = 0

    def _recognise(self) -> None:
        heard_s = 0.0
        partial = ""
        for chunk in self._chunks:
            heard_s = chunk.captured_at_s
            if self._stopping.wait(max(0.0, self._began_s + heard_s - self._clock())):
                return
            if isinstance(chunk, Gap):
                self._recognizer.gap(chunk)
            else:
                for warning in self._check.accept(chunk.samples):
                    self._on_warning(warning)
                self._on_level(Loudness(level_dbfs(chunk.samples), self._check.hearing.snr_db))
                self._hand_over(self._recognizer.accept(chunk, self_speech=self._speaks(heard_s, heard_s)))
            if self._recognizer.partial != partial:
                partial = self._recognizer.partial
                self._on_partial(partial)
        if not self._stopping.is_set():
            self._hand_over(self._recognizer.finish(heard_s))

    def _hand_over(self, heard: list[Heard]) -> None:
        for one in heard:
            if self._is_own(one):
                self._on_dropped(one.text)
                continue
            self._made += 1
            self._on_request(
                ManeuverRequest(
                    id=f"voice-{self._made}",
                    command=one.command,
                    modality=Modality.VOICE,
                    confidence=one.confidence,
                    captured_at_s=self._began_s + one.captured_at_s,
                    made_at_s=self._clock(),
                    evidence=one.text,
                    colour=one.colour,
                )
            )

    def _is_own(self, one: Heard) -> bool:
        """Whether it may be what the app itself said. The app never says *stop*, so STOP is the operator's."""
        return one.command is not Command.STOP and self._speaks(one.began_at_s, one.captured_at_s)

    def _speaks(self, from_s: float, to_s: float) -> bool:
        """Whether the app itself spoke then, in the chunks' time."""
        own = self._self_speech
        return own is not None and own.overlaps(self._began_s + from_s, self._began_s + to_s)
