"""Sound out of files: by libsndfile where it can, else by the FFmpeg libraries that PyAV carries (m4a, 3gp, webm, GSM, ...)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import soundfile
from numpy.typing import NDArray

LOWEST_RATE_HZ = 8000
LONGEST_FILE_S = 4 * 3600.0

Floats = NDArray[np.float32]


class AudioError(ValueError):
    """An audio file that cannot be used; one sentence that names it and says what to do."""


@dataclass(frozen=True, slots=True)
class Sound:
    """data: (samples, channels), full scale is 1."""

    data: Floats
    rate_hz: int


def decoded(path: Path) -> Sound:
    """The whole file. Raises AudioError if it is missing, empty, too long, of too low a rate, or no audio."""
    if path.is_dir():
        raise AudioError(f"{path} is a folder: name one audio file")
    if not path.is_file():
        raise AudioError(f"audio file {path} does not exist: check its name")
    sound = _by_libsndfile(path)
    if sound is None or not len(sound.data):  # a recorder that was cut off has left a wav's length at 0
        sound = _by_ffmpeg(path)
    if not len(sound.data):
        raise AudioError(f"audio file {path} is empty: give a recording that contains sound")
    if not np.isfinite(sound.data).all():
        raise AudioError(f"audio file {path} holds samples that are not numbers: record or convert it again")
    return sound


def _by_libsndfile(path: Path) -> Sound | None:
    """None where it cannot read this. Raises AudioError for what it reads but nobody can use."""
    try:
        with soundfile.SoundFile(path) as file:
            if not file.seekable():  # GSM: its length is not known
                return None
            _check(path, int(file.samplerate), file.frames)
            return Sound(file.read(dtype="float32", always_2d=True), int(file.samplerate))
    except AudioError:
        raise
    except (soundfile.SoundFileError, OSError, RuntimeError, ValueError):
        return None


def _by_ffmpeg(path: Path) -> Sound:
    import av

    try:
        with av.open(str(path)) as container:
            if not container.streams.audio:
                raise AudioError(f"{path} holds no sound: name an audio file, or give a video to --video")
            stream = container.streams.audio[0]
            rate_hz = int(stream.rate)
            _check(path, rate_hz, 0)
            planes = av.AudioResampler(format="fltp")
            parts: list[Floats] = []
            count = 0
            for frame in container.decode(stream):
                for part in planes.resample(frame):
                    parts.append(np.asarray(part.to_ndarray(), np.float32))
                    count += part.samples
                _check(path, rate_hz, count)
    except AudioError:
        raise
    except (av.FFmpegError, OSError, RuntimeError, ValueError) as error:
        raise AudioError(
            f"audio file {path} cannot be read as audio: give a wav, flac, ogg, mp3, m4a or webm file"
        ) from error
    data = np.concatenate(parts, axis=1).T if parts else np.zeros((0, 1), np.float32)
    return Sound(np.asarray(data, np.float32), rate_hz)


def _check(path: Path, rate_hz: int, samples: int) -> None:
    if rate_hz < LOWEST_RATE_HZ:
        raise AudioError(f"audio file {path} has {rate_hz} samples a second, too few for speech: record it again")
    if samples > LONGEST_FILE_S * rate_hz:
        raise AudioError(f"audio file {path} is longer than {LONGEST_FILE_S / 3600:.0f} hours: cut it")
