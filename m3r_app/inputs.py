"""The recorded and scripted inputs of one run: opened before anything flies, played in their own time."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from m3r_app.options import LiveMicrophone, RunOptions
from modalities.script import ScriptedRequest, read_script
from safety.vocabulary import ManeuverRequest

T = TypeVar("T")
Sink = Callable[[ManeuverRequest], None]
Clock = Callable[[], float]
TAIL_S = 1.0
"""Quiet after a recording, so that its last words end."""


class InputError(ValueError):
    """An input that broke off while it was being played; one sentence."""


@dataclass(frozen=True, slots=True)
class Inputs:
    """What will be played. sentences: for the operator, before it begins; model: which voice model, for the record."""

    script: tuple[ScriptedRequest, ...] = ()
    voice: Voice | None = None
    sentences: tuple[str, ...] = ()
    model: str | None = None

    async def play(self, clock: Clock, sink: Sink, heard: Callable[[str], None]) -> None:
        """Hand every request to `sink` at its time, and partial words to `heard`; returns when all has been played."""
        began_s = clock()
        async with asyncio.TaskGroup() as playing:
            playing.create_task(self._play_script(began_s, clock, sink))
            if self.voice is not None:
                playing.create_task(self.voice.play(began_s, clock, sink, heard))

    async def _play_script(self, began_s: float, clock: Clock, sink: Sink) -> None:
        for number, scripted in enumerate(self.script, start=1):
            await asyncio.sleep(max(0.0, began_s + scripted.at_s - clock()))
            sink(scripted.request(f"script-{number}", began_s))


class Voice:
    """A recording of the operator's voice and what recognises it, loaded and ready."""

    def __init__(self, options: RunOptions, colours: tuple[str, ...], clock: Clock, say: Callable[[str], None]) -> None:
        """say: told, from any thread, what becomes of a microphone. Raises AudioError, ModelError, MicrophoneError."""
        # Heavy, and not needed for scripts alone.
        import numpy as np

        from modalities.audio import quiet, read_audio
        from modalities.microphone import Microphone
        from modalities.models import find_model
        from modalities.phrases import PhraseTable
        from modalities.voice import Recognizer, load_model

        assert options.audio is not None
        self._say = say
        self._microphone: Microphone | None = None
        if isinstance(options.audio, LiveMicrophone):
            self._microphone = Microphone(options.audio.name, clock=clock, say=say)
            self._microphone.open()
        else:
            self._samples = np.concatenate([read_audio(options.audio), quiet(TAIL_S)])
        found = find_model()
        self._recognizer = Recognizer(load_model(found.folder), PhraseTable(colours))
        self.model = found.name
        missing = self._recognizer.missing_words
        self.sentences = (
            found.sentence,
            *([self._microphone.sentence] if self._microphone is not None else []),
            *([f"the voice model lacks {', '.join(missing)}: phrases with them cannot be heard"] if missing else []),
        )

    async def play(self, began_s: float, clock: Clock, sink: Sink, heard: Callable[[str], None]) -> None:
        """Listen in a thread of its own until the recording ends. Raises InputError if listening breaks off."""
        from modalities.audio import chunks
        from modalities.voice_stream import VoiceStream

        loop = asyncio.get_running_loop()
        ended: asyncio.Future[Exception | None] = loop.create_future()

        def end(error: Exception | None) -> None:
            if not ended.done():
                ended.set_result(error)

        microphone = self._microphone
        stream = VoiceStream(
            chunks(self._samples) if microphone is None else microphone.chunks(),
            self._recognizer,
            clock=clock,
            began_s=began_s if microphone is None else 0.0,  # live chunks carry the app's own time
            on_request=lambda request: _post(loop, sink, request),
            on_partial=lambda words: _post(loop, heard, words),
            on_end=lambda error: _post(loop, end, error),
        )
        stream.start()
        try:
            error = await ended
        finally:
            if microphone is not None:
                microphone.close()  # first: the stream's thread waits for sound
            await asyncio.to_thread(stream.stop)
        if error is not None and microphone is not None:
            self._say(f"voice is off ({error}): use another way to say stop")
        elif error is not None:
            raise InputError(f"the voice can no longer be heard ({error}): start again")


def _post(loop: asyncio.AbstractEventLoop, call: Callable[[T], None], value: T) -> None:
    """Call in the event loop, from another thread; in vain once the loop has closed."""
    with contextlib.suppress(RuntimeError):
        loop.call_soon_threadsafe(call, value)


def open_inputs(options: RunOptions, colours: tuple[str, ...], clock: Clock, say: Callable[[str], None]) -> Inputs:
    """Read and load everything that is to be played. Raises ScriptError, AudioError, ModelError: one sentence."""
    script = read_script(options.script, colours) if options.script is not None else ()
    if options.audio is None:
        return Inputs(script)
    from modalities.audio_devices import MicrophoneError

    try:
        voice = Voice(options, colours, clock, say)
    except MicrophoneError as error:
        return Inputs(script, sentences=(f"voice is off: {error}",))
    return Inputs(script, voice, voice.sentences, voice.model)
