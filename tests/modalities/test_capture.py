"""From a device's blocks to chunks: capture times by counting, mixing and resampling without seams, the level."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
import soxr
from hypothesis import given
from hypothesis import strategies as st

from modalities.voice.audio import SAMPLE_RATE_HZ, Samples
from modalities.voice.capture import FLOOR_DBFS, ORIGIN_WINDOW_S, Block, CaptureClock, Converter, level_dbfs


def blocks_of(
    samples: np.ndarray, rate_hz: int, size: int, *, began_s: float = 100.0, late_s=lambda _n: 0.0
) -> list[Block]:
    """(n, channels) int16 in blocks that arrive when their last sample was taken, plus late_s(number)."""
    found = []
    for number, start in enumerate(range(0, len(samples), size)):
        part = samples[start : start + size]
        taken_s = began_s + (start + len(part)) / rate_hz
        found.append(Block(part.astype(np.int16).tobytes(), taken_s + late_s(number), 0.0, number, open=True))
    return found


def sine(rate_hz: int, duration_s: float, hz: float, amplitude: float = 8000.0) -> np.ndarray:
    return np.rint(amplitude * np.sin(2 * math.pi * hz * np.arange(int(rate_hz * duration_s)) / rate_hz)).astype(
        np.int16
    )


def joined(converter: Converter, blocks: list[Block]) -> Samples:
    return np.concatenate([chunk.samples for block in blocks for chunk in converter.accept(block)])


@pytest.mark.parametrize("rate_hz", [44_100, 48_000, 8_000])
@pytest.mark.parametrize("size", [37, 480, 4096])
def test_streaming_resampling_has_no_seams(rate_hz: int, size: int) -> None:
    left, right = sine(rate_hz, 2.0, 440.0), sine(rate_hz, 2.0, 1000.0)
    got = joined(Converter(rate_hz, 2), blocks_of(np.stack([left, right], axis=1), rate_hz, size)).astype(np.float64)
    whole = soxr.resample((left.astype(np.float32) + right) / 2, rate_hz, SAMPLE_RATE_HZ).astype(np.float64)
    assert len(got) > 1.8 * SAMPLE_RATE_HZ
    assert np.abs(got - whole[: len(got)]).max() <= 1.0  # one step of 16 bits: rounding


def test_a_mono_16_khz_device_is_passed_on_bit_by_bit() -> None:
    samples = np.random.default_rng(1).integers(-32768, 32768, SAMPLE_RATE_HZ).astype(np.int16)
    got = joined(Converter(SAMPLE_RATE_HZ, 1), blocks_of(samples[:, None], SAMPLE_RATE_HZ, 333))
    assert np.array_equal(got, samples[: len(got)])
    assert len(got) == SAMPLE_RATE_HZ


@given(st.lists(st.floats(0.0, 0.6), min_size=45, max_size=60))
def test_capture_time_is_counted_whatever_the_delays(delays_s: list[float]) -> None:
    delays_s[:4] = [min(delay_s, 0.05 * (3 - n)) for n, delay_s in enumerate(delays_s[:4])]
    # the fourth block came at once: from it on, for the window, the time is exact
    converter = Converter(SAMPLE_RATE_HZ, 1)
    last_s, arrived_s = 0.0, 0.0
    for number, block in enumerate(blocks_of(np.zeros((len(delays_s) * 800, 1)), SAMPLE_RATE_HZ, 800)):
        taken_s = block.arrived_s
        arrived_s = max(arrived_s, taken_s + delays_s[number])
        (chunk,) = converter.accept(dataclasses.replace(block, arrived_s=arrived_s))
        assert taken_s - 1e-6 <= chunk.captured_at_s <= arrived_s
        assert chunk.captured_at_s >= last_s
        last_s = chunk.captured_at_s
        if number >= 3 and arrived_s <= 100.2 + ORIGIN_WINDOW_S:
            assert chunk.captured_at_s == pytest.approx(taken_s, abs=1e-6)


def test_a_stall_whose_sound_is_delivered_later_moves_no_time() -> None:
    late = {20: 1.0, 21: 0.95, 22: 0.9}
    blocks = blocks_of(np.zeros((40 * 800, 1)), 16_000, 800, late_s=lambda n: late.get(n, 0.001))
    converter = Converter(SAMPLE_RATE_HZ, 1)
    times = [chunk.captured_at_s for block in blocks for chunk in converter.accept(block)]
    assert times == pytest.approx([100.001 + 0.05 * (n + 1) for n in range(40)], abs=1e-6)


def test_a_slow_device_clock_is_followed() -> None:
    """A card that gives 15,984 samples in a second (0.1 % slow) is never behind by more than the window's drift."""
    clock = CaptureClock(SAMPLE_RATE_HZ)
    for number in range(1, 12_001):  # ten minutes
        arrived_s = number * 0.05 * 1.001
        clock.accept(800, arrived_s, 0.0)
        assert 0.0 <= arrived_s - clock.captured_at_s(number * 0.05) <= 0.003


@pytest.mark.parametrize("age_s", [math.nan, math.inf, -0.2, 30.0])
def test_nonsense_from_the_driver_counts_as_nothing(age_s: float) -> None:
    clock = CaptureClock(SAMPLE_RATE_HZ)
    clock.accept(800, 5.0, age_s)
    assert clock.captured_at_s(0.05) == pytest.approx(5.0)


def test_the_drivers_word_on_the_age_is_taken() -> None:
    clock = CaptureClock(SAMPLE_RATE_HZ)
    clock.accept(800, 5.0, 0.12)
    assert clock.captured_at_s(0.05) == pytest.approx(4.88)


def test_a_closed_gate_is_silence_that_takes_its_time() -> None:
    loud = sine(SAMPLE_RATE_HZ, 0.1, 440.0)
    converter = Converter(SAMPLE_RATE_HZ, 1)
    (one, two) = [
        chunk
        for number, is_open in enumerate((True, False))
        for chunk in converter.accept(Block(loud[:800].tobytes(), 10.0 + 0.05 * number, 0.0, number, is_open))
    ]
    assert one.samples.any()
    assert not two.samples.any()
    assert two.captured_at_s == pytest.approx(one.captured_at_s + 0.05)


def test_an_empty_block_is_nothing() -> None:
    assert Converter(48_000, 2).accept(Block(b"", 1.0, 0.0, 0, open=True)) == []


def test_the_level_is_that_of_the_signal() -> None:
    assert level_dbfs(sine(SAMPLE_RATE_HZ, 1.0, 440.0, 32767.0)) == pytest.approx(-3.01, abs=0.01)
    assert level_dbfs(np.zeros(800, np.int16)) == FLOOR_DBFS
    assert level_dbfs(np.full(800, 9000, np.int16)) == FLOOR_DBFS  # an offset is no sound
    assert level_dbfs(np.zeros(0, np.int16)) == FLOOR_DBFS
