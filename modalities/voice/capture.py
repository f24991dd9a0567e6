"""What lies between a sound card's blocks and the recogniser's chunks: capture time, mixing, resampling, level. No device.

A live block reaches us late by an amount that varies; its samples were taken at a steady rate. So capture time is counted
in samples from an origin, and the origin is the earliest one that any block of the last seconds was consistent with.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
import soxr

from modalities.voice.audio import CHUNK_SAMPLES, SAMPLE_RATE_HZ, Chunk, Samples
from modalities.voice.channels import LiveMix

ORIGIN_WINDOW_S = 2.0
LONGEST_AGE_S = 1.0
"""A block said to be older than this on arrival is one whose age is not known: some drivers state nonsense."""
FLOOR_DBFS = -100.0
"""What is quieter counts as this: digital silence."""


@dataclass(frozen=True, slots=True)
class Block:
    """What the device handed over at once. data: 16-bit samples, channels interleaved. open: the operator is to be heard.

    arrived_s: the app's clock in the device's callback. age_s: how long before that the last sample was taken, as far as
    the driver says, else 0. number: counts up; one left out is sound that is missing before this block.
    """

    data: bytes
    arrived_s: float
    age_s: float
    number: int
    open: bool


class CaptureClock:
    """Maps samples in a row to the app's clock. Times never run backwards and never lie after the samples' arrival."""

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self._count = 0
        self._origins: deque[tuple[float, float]] = deque()

    def accept(self, frames: int, arrived_s: float, age_s: float) -> None:
        """`frames` more samples (per channel) arrived at arrived_s, the last of them taken age_s before."""
        self._count += frames
        age_s = age_s if math.isfinite(age_s) and 0.0 <= age_s <= LONGEST_AGE_S else 0.0
        origin_s = arrived_s - age_s - self._count / self._rate_hz
        self._origins.append((arrived_s, origin_s))
        while self._origins[0][0] < arrived_s - ORIGIN_WINDOW_S:
            self._origins.popleft()

    def captured_at_s(self, sample_s: float) -> float:
        """When the moment `sample_s` seconds after the first sample was, on the app's clock."""
        return min(origin_s for _, origin_s in self._origins) + sample_s


class Converter:
    """Blocks of one stream, in a row, to chunks of 16 kHz mono 16-bit with their capture times. Use a new one for each
    unbroken row.
    """

    def __init__(self, rate_hz: int, channels: int, chunk_samples: int = CHUNK_SAMPLES) -> None:
        self._channels = channels
        self._chunk_samples = chunk_samples
        self._clock = CaptureClock(rate_hz)
        self._mix = LiveMix(rate_hz)
        self._resampler = (
            soxr.ResampleStream(rate_hz, SAMPLE_RATE_HZ, 1, dtype="float32") if rate_hz != SAMPLE_RATE_HZ else None
        )
        self._rest: Samples = np.zeros(0, np.int16)
        self._given = 0
        self._last_s = -math.inf

    def accept(self, block: Block) -> list[Chunk]:
        """The chunks that this block completes. While push-to-talk is closed they are silent."""
        frames = np.frombuffer(block.data, np.int16).reshape(-1, self._channels)
        if not len(frames):
            return []
        self._clock.accept(len(frames), block.arrived_s, block.age_s)
        mono = self._mix.accept(frames.astype(np.float32))
        if not block.open:
            mono = np.zeros_like(mono)
        if self._resampler is not None:
            mono = self._resampler.resample_chunk(mono)
        samples = np.clip(np.rint(mono), -32768, 32767).astype(np.int16)
        self._rest = np.concatenate([self._rest, samples])
        chunks: list[Chunk] = []
        while len(self._rest) >= self._chunk_samples:
            part, self._rest = self._rest[: self._chunk_samples], self._rest[self._chunk_samples :]
            self._given += len(part)
            captured_at_s = self._clock.captured_at_s(self._given / SAMPLE_RATE_HZ)
            self._last_s = max(self._last_s, min(captured_at_s, block.arrived_s))
            chunks.append(Chunk(part, self._last_s))
        return chunks


def level_dbfs(samples: Samples) -> float:
    """Root mean square without the constant offset, dB below a full-scale square wave; FLOOR_DBFS for silence."""
    if not len(samples):
        return FLOOR_DBFS
    power = float(np.var(samples.astype(np.float64) / 32768.0))
    return max(FLOOR_DBFS, 10.0 * math.log10(power)) if power > 0 else FLOOR_DBFS
