"""The inputs of one run, scripted, recorded and live: opened before anything flies, played in their own time.

A recording that is missing or unreadable, and a model that is, is bad input: nothing flies. A live device that is missing or
breaks is announced, and the rest flies. A live input never ends a run.
"""

from __future__ import annotations

import asyncio
import contextlib
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, TypeVar

from config.settings import Gesture, Settings
from m3r_app.options import STANDARD_INPUT, LiveMicrophone, RunOptions
from modalities.hands.gestures import Hand, Region
from modalities.live import Handover, LiveInput, LiveInputError
from modalities.notices import Say, SenseChange
from modalities.rooms import LIVE
from modalities.script import ScriptedRequest, read_script
from modalities.voice.push_to_talk import PushToTalk
from modalities.voice.self_speech import SelfSpeech
from safety.vocabulary import ManeuverRequest

if TYPE_CHECKING:
    from modalities.voice.sound_check import Loudness  # loads the sound libraries, which scripts alone do not need

T = TypeVar("T")
Sink = Callable[[ManeuverRequest], None]
Told = Callable[[str], None]
Clock = Callable[[], float]
CONSOLE_KEY = "m"
TAIL_S = 1.0
"""Quiet after a recording, so that its last words end."""
WHILE_SPOKEN = "heard while a cue was spoken"


class InputError(ValueError):
    """An input that broke off while it was being played; one sentence."""


class _Stream(Protocol):
    """A modality in a thread of its own."""

    def start(self) -> None: ...
    def stop(self, timeout_s: float = ...) -> bool: ...


def _nobody(_: object) -> None:
    """Nobody looks."""


@dataclass(frozen=True, slots=True)
class Senses:
    """Who is told what the modalities take in, in the event loop: it shows what is heard and seen, and decides nothing."""

    words: Told = _nobody
    """Of what is being said, so far."""
    loudness: Callable[[Loudness], None] = _nobody
    """How loud the sound is, and how far the voice stands above the noise."""
    shown: Told = _nobody
    """What the hands show, whenever it changes."""
    hands: Callable[[Sequence[Hand]], None] = _nobody
    """The hands in every picture."""


@dataclass(frozen=True, slots=True)
class Inputs:
    """What will be played. sentences: for the operator, before it begins; models: which ones, for the record."""

    script: tuple[ScriptedRequest, ...] = ()
    voice: Voice | None = None
    hands: Hands | None = None
    live: tuple[LiveInput, ...] = ()
    sentences: tuple[str, ...] = ()
    models: tuple[str, ...] = ()
    talk: PushToTalk | None = None
    """Whose key is somebody else's: the console's."""

    async def play(self, clock: Clock, sink: Sink, senses: Senses) -> str | None:
        """Hand every request to `sink` at its time, and what is heard and seen to `senses`.

        Returns when all has been played, with a live input never: what was wrong with a video that broke off, if one did. Raises
        InputError where a voice recording breaks off.
        """
        began_s = clock()
        try:
            async with asyncio.TaskGroup() as playing:
                playing.create_task(self._play_script(began_s, clock, sink))
                if self.voice is not None:
                    playing.create_task(self.voice.play(began_s, clock, sink, senses))
                if self.live:
                    playing.create_task(self._ask_live(sink))
                watching = playing.create_task(self._watch(began_s, clock, sink, senses))
        except ExceptionGroup as group:
            raise group.exceptions[0] from group
        return watching.result()

    def close(self) -> None:
        """Let the devices go, whether they were played or not; calling it again does nothing. May take seconds."""
        if self.voice is not None:
            self.voice.close()
        if self.hands is not None:
            self.hands.close()
        for one in self.live:
            one.close()

    async def _ask_live(self, sink: Sink) -> None:
        loop = asyncio.get_running_loop()
        for one in self.live:
            one.start(Handover(loop.call_soon_threadsafe, sink).put)
        await _for_ever()

    async def _watch(self, began_s: float, clock: Clock, sink: Sink, senses: Senses) -> str | None:
        return await self.hands.play(began_s, clock, sink, senses) if self.hands is not None else None

    async def _play_script(self, began_s: float, clock: Clock, sink: Sink) -> None:
        for number, scripted in enumerate(self.script, start=1):
            await asyncio.sleep(max(0.0, began_s + scripted.at_s - clock()))
            sink(scripted.request(f"script-{number}", began_s))


class Voice:
    """The operator's voice, recorded or live, and what recognises it, loaded and ready."""

    def __init__(
        self,
        source: Path | LiveMicrophone,
        colours: tuple[str, ...],
        clock: Clock,
        say: Say,
        talking: Callable[[], bool] | None = None,
        self_speech: SelfSpeech | None = None,
    ) -> None:
        """say: told, from any thread, what becomes of a microphone; talking: push-to-talk, None for a microphone that is
        always open; self_speech: when the app spoke, which a microphone hears. Raises AudioError, ModelError,
        MicrophoneError.
        """
        # Heavy, and not needed for scripts alone.
        import numpy as np

        from modalities.models.catalogue import find_model
        from modalities.voice.audio import quiet, read_audio
        from modalities.voice.decoder import load_model
        from modalities.voice.in_noise import denoiser_here, listener
        from modalities.voice.microphone import Microphone
        from modalities.voice.phrases import PhraseTable

        self._say = say
        self._self_speech = self_speech if isinstance(source, LiveMicrophone) else None
        self._stream: _Stream | None = None
        self._microphone: Microphone | None = None
        if isinstance(source, Path):
            self._samples = np.concatenate([read_audio(source), quiet(TAIL_S)])
        found = find_model()
        denoiser, denoising = denoiser_here()
        self._recognizer = listener(load_model(found.folder), PhraseTable(colours), denoiser)
        self.model = found.name
        if isinstance(source, LiveMicrophone):
            self._microphone = Microphone(source.name, clock=clock, say=say, talking=talking)
            self._microphone.open()
        missing = self._recognizer.missing_words
        self.sentences = (
            found.sentence,
            denoising,
            *([self._microphone.sentence] if self._microphone is not None else []),
            *([f"the voice model lacks {', '.join(missing)}: phrases with them cannot be heard"] if missing else []),
        )

    async def play(self, began_s: float, clock: Clock, sink: Sink, senses: Senses) -> None:
        """Listen in a thread of its own: until the recording ends, or for ever. Raises InputError if a recording breaks off."""
        from modalities.voice.audio import chunks
        from modalities.voice.stream import VoiceStream

        loop = asyncio.get_running_loop()
        ended: asyncio.Future[Exception | None] = loop.create_future()
        microphone = self._microphone

        def dropped(words: str) -> None:
            _post(loop, senses.words, f"{words} ({WHILE_SPOKEN})")
            self._say(f'"{words}" was {WHILE_SPOKEN} and does not count: say it again')

        self._stream = VoiceStream(
            chunks(self._samples) if microphone is None else microphone.chunks(),
            self._recognizer,
            clock=clock,
            began_s=began_s if microphone is None else 0.0,  # live chunks carry the app's own time
            on_request=lambda request: _post(loop, sink, request),
            on_partial=lambda words: _post(loop, senses.words, words),
            on_level=lambda loudness: _post(loop, senses.loudness, loudness),
            on_warning=self._say,
            on_end=lambda error: _post(loop, lambda e: _settle(ended, e), error),
            self_speech=self._self_speech,
            on_dropped=dropped,
        )
        error = await _played(self._stream, ended)
        if microphone is not None:
            self._say(f"voice is off ({_reason(error)}): use another way to say stop", SenseChange.VOICE_OFF)
            await _for_ever()
        elif error is not None:
            raise InputError(f"the voice can no longer be heard ({error}): start again")

    def close(self) -> None:
        """Let a microphone go and wait for the thread that listens."""
        if self._microphone is not None:
            self._microphone.close()  # first: the thread waits for sound
        if self._stream is not None:
            self._stream.stop(timeout_s=2.0)


class Hands:
    """The operator's hands in a video file or before a camera, and what finds them, loaded and ready."""

    def __init__(self, source: object, settings: Gesture, clock: Clock, say: Say) -> None:
        """source: a Path or a CameraAddress. say: told, from any thread, what becomes of a camera.

        Raises VideoError for a file that cannot be read, ModelError, and CameraMissing for a camera that gives no picture.
        """
        # Heavy, and not needed without hands.
        from modalities.hands.camera import Camera, CameraAddress
        from modalities.hands.finder import HandFinder
        from modalities.hands.video import VideoError, VideoFile
        from modalities.models.catalogue import find_hand_model

        self._say = say
        self._settings = settings
        self._stream: _Stream | None = None
        self._file = VideoFile(source) if isinstance(source, Path) else None
        found = find_hand_model()
        self._detector = HandFinder.of(found, Region(settings.region))
        self._camera: Camera | None = None
        if isinstance(source, CameraAddress):
            try:
                self._camera = Camera(source, clock=clock, say=say)
            except VideoError as error:
                self._detector.close()
                raise CameraMissing(str(error)) from error
        self.model = found.name
        name = self._file.path if self._file is not None else self._camera.name if self._camera is not None else source
        mirrored = ", mirrored" if settings.mirrored else ""
        self.sentences = (found.sentence, f"watching {name}{mirrored}: hold a gesture for {settings.hold_s:g} s")

    async def play(self, began_s: float, clock: Clock, sink: Sink, senses: Senses) -> str | None:
        """Watch in a thread of its own: until the video ends, or for ever. Returns what was wrong with a video that broke off;
        that is announced at once, and whatever else is being played goes on.
        """
        from modalities.hands.dwell import DwellFilter
        from modalities.hands.stream import HandStream
        from modalities.hands.video import PlayedFile, VideoSource

        loop = asyncio.get_running_loop()
        ended: asyncio.Future[Exception | None] = loop.create_future()
        source: VideoSource
        if self._file is not None:
            source = PlayedFile(self._file, clock=clock, began_s=began_s)
        else:
            assert self._camera is not None
            source = self._camera
        self._stream = HandStream(
            source,
            self._detector,
            clock=clock,
            on_request=lambda request: _post(loop, sink, request),
            on_seen=lambda text: _post(loop, senses.shown, text),
            on_hands=lambda hands: _post(loop, senses.hands, hands),
            on_warning=self._say,
            on_end=lambda error: _post(loop, lambda e: _settle(ended, e), error),
            hold=DwellFilter(self._settings.hold_s),
            mirrored=self._settings.mirrored,
            region=Region(self._settings.region),
        )
        error = await _played(self._stream, ended)
        if self._camera is not None:
            self._say(f"hands are off ({_reason(error)}): use another way to say stop", SenseChange.HANDS_OFF)
            await _for_ever()
        elif error is not None:
            self._say(f"hands are off: {error}", SenseChange.HANDS_OFF)
        return None if error is None else str(error)

    def close(self) -> None:
        """Let the camera and the detector go; a detector that is still being used is left to the thread that uses it."""
        if self._camera is not None:
            self._camera.close()
        if self._stream is None or self._stream.stop():
            self._detector.close()


class CameraMissing(ValueError):  # noqa: N818  (it is announced, the rest flies)
    """A camera that gives no picture when it is opened; one sentence."""


async def _played(stream: _Stream, ended: asyncio.Future[Exception | None]) -> Exception | None:
    """Start a stream and wait until it has ended. Returns what ended it."""
    stream.start()
    try:
        return await ended
    finally:
        stream.stop(0.0)  # waiting for a stuck device is for `close`, after the drone has been put in Hold


async def _for_ever() -> None:
    await asyncio.Event().wait()


def _reason(error: Exception | None) -> str:
    return "it ended" if error is None else str(error)


def _settle(future: asyncio.Future[T], value: T) -> None:
    if not future.done():
        future.set_result(value)


def _post(loop: asyncio.AbstractEventLoop, call: Callable[[T], None], value: T) -> None:
    """Call in the event loop, from another thread; in vain once the loop has closed."""
    with contextlib.suppress(RuntimeError):
        loop.call_soon_threadsafe(call, value)


def _key(talk: PushToTalk, options: RunOptions) -> str:
    """Give push-to-talk its key, where there is a keyboard. Returns what to tell the operator."""
    if options.console:
        return "push-to-talk: press m to speak and m again when you have spoken; until then a spoken stop is not heard"
    if sys.stdin is None or not sys.stdin.isatty() or options.script == STANDARD_INPUT:
        return "push-to-talk has no key, since standard input is no terminal: the microphone stays closed"
    talk.follow(sys.stdin.fileno())
    return (
        "push-to-talk: press Enter to speak and Enter again when you have spoken; until then a spoken stop is not heard"
    )


def open_inputs(
    options: RunOptions,
    colours: tuple[str, ...],
    settings: Settings,
    clock: Clock,
    say: Say,
    self_speech: SelfSpeech | None = None,
) -> Inputs:
    """Read and load everything that is to be played. self_speech: when the app itself spoke, by the same clock.

    Raises ScriptError, AudioError, VideoError, ModelError: one sentence.
    """
    from modalities.voice.devices import MicrophoneError

    script = read_script(options.script, colours) if options.script is not None else ()
    sentences: list[str] = []
    voice: Voice | None = None
    hands: Hands | None = None
    talk: PushToTalk | None = None
    if options.audio is not None:
        try:
            talk = (
                PushToTalk(say, CONSOLE_KEY if options.console else "Enter")
                if settings.voice.push_to_talk and isinstance(options.audio, LiveMicrophone)
                else None
            )
            voice = Voice(options.audio, colours, clock, say, talk.talking if talk is not None else None, self_speech)
            sentences += voice.sentences
            if talk is not None:
                sentences.append(_key(talk, options))
        except MicrophoneError as error:
            sentences.append(f"voice is off: {error}")
    if options.video is not None:
        try:
            hands = Hands(options.video, settings.gesture, clock, say)
            sentences += hands.sentences
        except CameraMissing as error:
            sentences.append(f"hands are off: {error}")
        except Exception:
            if voice is not None:
                voice.close()
            raise
    live: list[LiveInput] = []
    for modality in LIVE:
        if modality.name in options.live:
            try:
                live.append(modality.open(options.live[modality.name], settings, clock, say))
                sentences += live[-1].sentences
            except LiveInputError as error:
                sentences.append(f"{modality.name} is off: {error}")
    models = tuple(one.model for one in (voice, hands) if one is not None)
    return Inputs(script, voice, hands, tuple(live), tuple(sentences), models, talk)
