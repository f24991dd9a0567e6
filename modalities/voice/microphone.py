"""A live microphone as a source of chunks: captured by PortAudio, survived when it overflows, is unplugged, comes back.

Three threads touch it. PortAudio's calls `_Ring.put` and nothing else: it copies and returns. The one that iterates over
`chunks()` (the voice's own) opens, listens, and waits for a lost device. Any thread may call `close` and read the figures.
"""

from __future__ import annotations

import math
import queue
import random
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from modalities.notices import Say, SenseChange, nothing_said
from modalities.voice.audio import SAMPLE_RATE_HZ, Chunk, Gap
from modalities.voice.capture import FLOOR_DBFS, Block, Converter, level_dbfs
from modalities.voice.devices import (
    NO_DEVICE_REMEDY,
    InputDevice,
    MicrophoneError,
    choose_device,
    input_devices,
    look_again,
    plain,
    portaudio,
)

Clock = Callable[[], float]

BLOCK_S = 0.05
LATENCY_S = 0.1
"""How much the device may hold back. Sound servers stutter with less, and stop is heard later with more."""
RING_S = 2.0
"""Sound that may wait to be recognised; older is dropped, because a request that old is of no use."""
FIRST_SOUND_S = 3.0
"""How long a device may take to deliver its first block: sound servers wake a sleeping source in a second or two."""
SILENT_S = 1.0
"""A device that delivers no block for this long is gone. (A quiet one delivers silence.)"""
BACK_OFF_S = (0.25, 4.0)
"""Shortest and longest wait before looking for a lost device again, doubled each time, times 0.5 to 1.5 at random."""
REPEAT_S = 10.0
"""Lost sound is announced no more often than this."""
TALK_TAIL_S = 0.25
"""How long the operator is still heard after push-to-talk ends: the key is often released before the last syllable is
over."""
_WRONG_SHAPE = (-9998, -9997)
"""PortAudio's codes for a number of channels or a rate that the device does not have: others may be tried."""


@dataclass(frozen=True, slots=True)
class Lost:
    """How often sound went missing. device: the device overflowed; ours: recognition did not keep up; unplugged: it went."""

    device: int
    ours: int
    unplugged: int


class _Ring:
    """Blocks on their way from the device's thread to ours: bounded, the oldest dropped and counted, never waiting."""

    def __init__(self, clock: Clock, talking: Callable[[], bool] | None) -> None:
        self._clock = clock
        self._talking = talking
        self._talked_s = -math.inf
        self._number = 0
        self._blocks: queue.SimpleQueue[Block | None] = queue.SimpleQueue()
        self._waiting_most = round(RING_S / BLOCK_S)
        self.rate_hz = SAMPLE_RATE_HZ
        self.overflows = 0
        self.dropped = 0

    def put(self, data: Any, frames: int, time: Any, status: Any) -> None:
        """PortAudio's callback. Copies and returns: nothing here waits for another thread."""
        arrived_s = self._clock()
        if status.input_overflow:
            self.overflows += 1
            self._number += 1
        talking = self._talking is None or self._talking()
        if talking:
            self._talked_s = arrived_s
        age_s = float(time.currentTime) - float(time.inputBufferAdcTime) - frames / self.rate_hz
        heard = talking or arrived_s - self._talked_s <= TALK_TAIL_S
        block = Block(bytes(data), arrived_s, age_s, self._number, heard)
        self._number += 1
        if self._blocks.qsize() >= self._waiting_most:
            try:
                self._blocks.get_nowait()
                self.dropped += 1
            except queue.Empty:
                pass  # taken by the other thread just now
        self._blocks.put(block)

    def end(self) -> None:
        """Nothing more will come."""
        self._blocks.put(None)

    def take(self, timeout_s: float) -> Block | None:
        """The next block; None where there is none within timeout_s or nothing more will come."""
        try:
            return self._blocks.get(timeout=timeout_s)
        except queue.Empty:
            return None


class Microphone:
    """One microphone. `open` it, iterate over `chunks()` in a thread that may wait, `close` it from any."""

    def __init__(
        self,
        name: str | None = None,
        *,
        clock: Clock,
        say: Say = nothing_said,
        talking: Callable[[], bool] | None = None,
        shapes: tuple[tuple[int, int], ...] = (),
    ) -> None:
        """name: its name or a part of it; None: the system's default. clock: the app's monotonic seconds, any thread.

        say: told in one sentence when the device goes, comes back, or loses sound; called in the thread of `chunks()`.
        talking: push-to-talk, whether the operator is to be heard now; None: always. It is called in the device's thread
        and must do no more than read (`threading.Event.is_set`). Otherwise silence is heard, so that what was said ends.
        shapes: (rate in Hz, channels) to try in turn instead of the usual ones.
        """
        self._name = name
        self._clock = clock
        self._say = say
        self._talking = talking
        self._shapes = shapes
        self._device: InputDevice | None = None
        self._stream: Any = None
        self._ring = _Ring(clock, talking)
        self._shape = (SAMPLE_RATE_HZ, 1)
        self._closing = threading.Event()
        self._lock = threading.Lock()
        self._listening = False
        self._away = False
        self._told_s = -math.inf
        self._lost = Lost(0, 0, 0)
        self._level_dbfs = FLOOR_DBFS

    @property
    def level_dbfs(self) -> float:
        """Level of the last 50 ms, dB below full scale; FLOOR_DBFS: nothing at all, or the device is gone."""
        return self._level_dbfs

    @property
    def lost(self) -> Lost:
        return Lost(
            self._lost.device + self._ring.overflows, self._lost.ours + self._ring.dropped, self._lost.unplugged
        )

    @property
    def sentence(self) -> str:
        """Which microphone it is and how it is captured, for the operator."""
        if self._device is None:
            return "no microphone is open"
        rate_hz, channels = self._shape
        resampled = "" if rate_hz == SAMPLE_RATE_HZ else f", resampled to {SAMPLE_RATE_HZ / 1000:g} kHz"
        return f"microphone {self._device.name} ({channels} channel{'s'[: channels > 1]}, {rate_hz / 1000:g} kHz{resampled})"

    def open(self) -> None:
        """Find the device and open it, not yet listening. Raises MicrophoneError: one sentence."""
        self._open(choose_device(self._name, input_devices()))

    def chunks(self) -> Iterator[Chunk | Gap]:
        """What it hears, with capture times on the app's clock, until `close`. Waits for sound; once only.

        Every interruption is a Gap. A device that goes away is announced and waited for; the same one is taken again.
        """
        with self._lock:
            self._listening = True
        try:
            wait_s = BACK_OFF_S[0]
            while not self._closing.is_set():
                if self._stream is None and not self._came_back():
                    self._closing.wait(wait_s * random.uniform(0.5, 1.5))
                    wait_s = min(2.0 * wait_s, BACK_OFF_S[1])
                    continue
                for heard in self._listen():
                    wait_s = BACK_OFF_S[0]
                    yield heard
                self._gone()
                yield Gap(self._clock(), ended=True)
        finally:
            self._release()

    def close(self) -> None:
        """End it. The thread of `chunks()` sees a Gap, so that nothing is made of what was half said, then the end."""
        with self._lock:
            self._closing.set()
            listening = self._listening
        self._ring.end()
        if not listening:
            self._release()

    def _open(self, device: InputDevice) -> None:
        sounddevice = portaudio()
        usual_hz = round(device.rate_hz)
        shapes = self._shapes or ((SAMPLE_RATE_HZ, 1), (SAMPLE_RATE_HZ, 2), (usual_hz, 1), (usual_hz, 2), (48_000, 2))
        reason = "it has neither one channel nor two"
        for rate_hz, channels in shapes:
            if channels > device.channels:
                continue
            ring = _Ring(self._clock, self._talking)
            ring.rate_hz = rate_hz
            try:
                self._stream = sounddevice.RawInputStream(
                    device=device.number,
                    samplerate=rate_hz,
                    channels=channels,
                    dtype="int16",
                    blocksize=round(BLOCK_S * rate_hz),
                    latency=LATENCY_S,
                    callback=ring.put,
                    finished_callback=ring.end,
                )
            except sounddevice.PortAudioError as error:
                reason = plain(error)
                if len(error.args) > 1 and error.args[1] in _WRONG_SHAPE:
                    continue
                break
            self._lost = self.lost
            self._ring, self._shape, self._device = ring, (rate_hz, channels), device
            return
        raise MicrophoneError(
            f"microphone {device.name} cannot be opened ({reason})",
            f"close other programs that use it, or {NO_DEVICE_REMEDY}",
        )

    def _listen(self) -> Iterator[Chunk | Gap]:
        """What the open stream gives, until it ends, falls silent or is closed."""
        ring = self._ring
        try:
            self._stream.start()
        except portaudio().PortAudioError:
            return  # as if it had ended at once
        converter = Converter(*self._shape)
        expected = 0
        patience_s = FIRST_SOUND_S
        while (block := ring.take(patience_s)) is not None and not self._closing.is_set():
            patience_s = SILENT_S
            if self._away:
                self._away = False
                self._say(f"{self._label} is back: you are heard again", SenseChange.VOICE_BACK)
            if (
                block.number != expected and expected > 0
            ):  # the first blocks after a start may overflow: nothing was said yet
                converter = Converter(*self._shape)
                self._tell_lost_sound()
                yield Gap(block.arrived_s, ended=False)
            expected = block.number + 1
            for chunk in converter.accept(block):
                self._level_dbfs = level_dbfs(chunk.samples)
                yield chunk

    @property
    def _label(self) -> str:
        assert self._device is not None
        return f"the microphone {self._device.lasting_name}"

    def _gone(self) -> None:
        self._release()
        if self._closing.is_set() or self._away:
            return
        self._away = True
        self._lost = Lost(self._lost.device, self._lost.ours, self._lost.unplugged + 1)
        self._say(
            f"{self._label} is gone: you are not heard until it is back, so use another way to say stop",
            SenseChange.VOICE_GONE,
        )

    def _tell_lost_sound(self) -> None:
        now_s = self._clock()
        if now_s - self._told_s >= REPEAT_S:
            self._told_s = now_s
            lost = self.lost
            cause = "the device overflowed" if lost.device >= lost.ours else "this computer is too busy"
            times = lost.device + lost.ours
            self._say(
                f"{self._label} lost some sound ({cause}, {times} so far): what was just said does not count, say it again"
            )

    def _came_back(self) -> bool:
        """Whether the same device is there again and open."""
        assert self._device is not None
        try:
            look_again()
            self._open(choose_device(self._device.lasting_name, input_devices()))
        except MicrophoneError:
            return False  # it has been announced; the next look is after the back-off
        return True

    def _release(self) -> None:
        with self._lock:
            stream, self._stream = self._stream, None
        self._level_dbfs = FLOOR_DBFS
        if stream is not None:
            stream.close(ignore_errors=True)
