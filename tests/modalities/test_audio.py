"""Audio files of every common kind become the same 16 kHz mono 16-bit chunks."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np
import pytest
import soundfile

from modalities.voice.audio import CHUNK_SAMPLES, SAMPLE_RATE_HZ, AudioError, chunks, read_audio


def tone(rate_hz: int, duration_s: float = 0.5, amplitude: float = 0.25) -> np.ndarray:
    return amplitude * np.sin(2 * np.pi * 440.0 * np.arange(round(rate_hz * duration_s)) / rate_hz)


@pytest.mark.parametrize("rate_hz", [8_000, 11_025, 16_000, 22_050, 44_100, 48_000, 96_000])
@pytest.mark.parametrize(("suffix", "subtype"), [("wav", "PCM_16"), ("wav", "FLOAT"), ("flac", "PCM_24")])
def test_any_rate_and_format(tmp_path: Path, rate_hz: int, suffix: str, subtype: str) -> None:
    path = tmp_path / f"tone.{suffix}"
    soundfile.write(path, tone(rate_hz), rate_hz, subtype=subtype)
    samples = read_audio(path)
    assert samples.dtype == np.int16
    assert len(samples) == pytest.approx(0.5 * SAMPLE_RATE_HZ, abs=4)
    middle = samples[1000:-1000].astype(float) / 32768.0
    assert middle.std() == pytest.approx(0.25 / np.sqrt(2), rel=0.02)
    crossings = np.count_nonzero(np.diff(np.signbit(middle)))
    assert crossings / 2 / (len(middle) / SAMPLE_RATE_HZ) == pytest.approx(440.0, rel=0.01)


@pytest.mark.parametrize(
    ("suffix", "options"), [("ogg", {"subtype": "VORBIS"}), ("ogg", {"subtype": "OPUS"}), ("mp3", {})]
)
def test_compressed_files(tmp_path: Path, suffix: str, options: dict[str, str]) -> None:
    path = tmp_path / f"tone.{suffix}"
    soundfile.write(path, tone(48_000, 1.0), 48_000, **options)
    samples = read_audio(path)
    assert samples[4000:-4000].astype(float).std() / 32768.0 == pytest.approx(0.25 / np.sqrt(2), rel=0.1)


def encoded(path: Path, codec: str, rate_hz: int) -> None:
    """A second of a tone, by the FFmpeg libraries."""
    pcm = av.AudioFrame.from_ndarray((tone(16_000, 1.0)[None] * 32767).astype(np.int16), format="s16", layout="mono")
    pcm.sample_rate = 16_000
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=rate_hz, layout="mono")
        convert = av.AudioResampler(format=stream.codec_context.format, layout="mono", rate=rate_hz)
        for frame in (*convert.resample(pcm), *convert.resample(None)):
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


@pytest.mark.parametrize(
    ("name", "codec", "rate_hz"),
    [("a.m4a", "aac", 16_000), ("a.3gp", "aac", 16_000), ("a.webm", "libopus", 48_000), ("a.mov", "aac", 44_100)],
)
def test_what_telephones_record_is_played(tmp_path: Path, name: str, codec: str, rate_hz: int) -> None:
    encoded(tmp_path / name, codec, rate_hz)
    samples = read_audio(tmp_path / name)
    assert len(samples) == pytest.approx(SAMPLE_RATE_HZ, abs=2200)
    assert samples[4000:-4000].astype(float).std() / 32768.0 == pytest.approx(0.25 / np.sqrt(2), rel=0.1)


def test_a_gsm_wav_is_played(tmp_path: Path) -> None:
    soundfile.write(tmp_path / "gsm.wav", tone(8_000, 1.0), 8_000, subtype="GSM610")
    samples = read_audio(tmp_path / "gsm.wav")
    assert samples.astype(float).std() / 32768.0 == pytest.approx(0.25 / np.sqrt(2), rel=0.1)


@pytest.mark.parametrize("stated_bytes", [0, 0xFFFFFFFF])
def test_a_wav_whose_recorder_was_cut_off_is_played_whole(tmp_path: Path, stated_bytes: int) -> None:
    path = tmp_path / "cut.wav"
    soundfile.write(path, tone(16_000, 1.0), 16_000)
    content = bytearray(path.read_bytes())
    at = content.index(b"data") + 4
    content[at : at + 4] = stated_bytes.to_bytes(4, "little")
    path.write_bytes(content)
    assert len(read_audio(path)) == SAMPLE_RATE_HZ


def test_a_right_channel_in_opposite_phase_takes_nothing_away(tmp_path: Path) -> None:
    path = tmp_path / "stereo.wav"
    left = np.concatenate([np.zeros(4000), tone(16_000), np.zeros(4000)])
    soundfile.write(path, np.stack([left, -left], axis=1), SAMPLE_RATE_HZ)
    assert np.allclose(read_audio(path), left * 32768, atol=1)


def test_the_channel_that_holds_the_voice_is_taken(tmp_path: Path) -> None:
    path = tmp_path / "stereo.wav"
    voice = np.concatenate([np.zeros(4000), tone(16_000), np.zeros(4000)])
    noise = np.random.default_rng(3).normal(0.0, 0.1, len(voice))
    soundfile.write(path, np.stack([noise, voice], axis=1), SAMPLE_RATE_HZ)
    assert np.allclose(read_audio(path), voice * 32768, atol=1)


def test_a_video_without_sound_is_named_as_one(tmp_path: Path) -> None:
    path = tmp_path / "mute.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=10)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        container.mux(stream.encode(av.VideoFrame.from_ndarray(np.zeros((48, 64, 3), np.uint8))))
        container.mux(stream.encode(None))
    with pytest.raises(AudioError, match="holds no sound"):
        read_audio(path)


def test_stereo_is_mixed(tmp_path: Path) -> None:
    path = tmp_path / "stereo.wav"
    left, right = np.full(1600, 0.5), np.full(1600, -0.25)
    soundfile.write(path, np.stack([left, right], axis=1), SAMPLE_RATE_HZ)
    assert np.allclose(read_audio(path), 0.125 * 32768, atol=1)


def test_loud_float_files_are_clipped_not_wrapped(tmp_path: Path) -> None:
    path = tmp_path / "loud.wav"
    soundfile.write(path, np.array([2.0, -2.0] * 100), SAMPLE_RATE_HZ, subtype="FLOAT")
    assert set(read_audio(path).tolist()) == {32767, -32768}


def test_time_is_counted_from_the_data() -> None:
    samples = np.arange(2 * CHUNK_SAMPLES + 16, dtype=np.int16)
    parts = list(chunks(samples))
    assert [part.captured_at_s for part in parts] == pytest.approx([0.05, 0.1, 0.101])
    assert np.array_equal(np.concatenate([part.samples for part in parts]), samples)


def broken(path: Path, kind: str) -> None:
    if kind == "folder":
        path.mkdir()
    elif kind == "empty":
        path.write_bytes(b"")
    elif kind == "text":
        path.write_text("this is no audio\n" * 50)
    elif kind == "cut":
        whole = path.with_name("whole.flac")
        soundfile.write(whole, tone(16_000), 16_000)
        path.write_bytes(whole.read_bytes()[:30])
    elif kind == "silent of samples":
        soundfile.write(path, np.zeros(0), 16_000, format="WAV")
    elif kind == "nan":
        soundfile.write(path, np.array([0.0, np.nan] * 100), 16_000, format="WAV", subtype="FLOAT")


@pytest.mark.parametrize("kind", ["missing", "folder", "empty", "text", "cut", "silent of samples", "nan"])
def test_a_file_that_cannot_be_used_is_one_sentence_that_names_it(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "clip.wav"
    broken(path, kind)
    with pytest.raises(AudioError) as error:
        read_audio(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)
