"""A voice freed of steady noise by GTCRN, a small neural network, as the sound comes in: 32 ms late, 5 % of a core.

Source: Rong et al., "GTCRN: A Speech Enhancement Model Requiring Ultralow Computational Resources", ICASSP 2024 (MIT).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modalities.models.catalogue import ModelError
from modalities.voice.audio import Samples

WINDOW_SAMPLES = 512
HOP_SAMPLES = 256
_CACHES = {"conv_cache": (2, 1, 16, 16, 33), "tra_cache": (2, 3, 1, 1, 16), "inter_cache": (2, 1, 33, 16)}


class Denoiser:
    """Samples (16 kHz, 16-bit) in, as many out, WINDOW_SAMPLES later; `remix` of the original is left in them."""

    def __init__(self, model: Path, remix: float = 0.0) -> None:
        """Raises ModelError for a file that is no such network."""
        try:
            import onnxruntime

            options = onnxruntime.SessionOptions()
            options.intra_op_num_threads = options.inter_op_num_threads = 1
            options.log_severity_level = 4
            self._session: Any = onnxruntime.InferenceSession(str(model), options, providers=["CPUExecutionProvider"])
            self._remix = remix
            self.forget()
            # The first run takes longest, and fails for another network.
            self.accept(np.zeros(WINDOW_SAMPLES, np.int16))
        except Exception as error:  # onnxruntime raises nothing narrower
            raise ModelError(f"{model} is not a usable denoiser: delete it and run `m3r models fetch`") from error
        self.forget()

    def forget(self) -> None:
        """What comes next does not follow what came before."""
        self._window = np.sqrt(np.hanning(WINDOW_SAMPLES + 1)[:-1])
        self._caches = {name: np.zeros(shape, np.float32) for name, shape in _CACHES.items()}
        self._last = np.zeros(WINDOW_SAMPLES)
        self._tail = np.zeros(WINDOW_SAMPLES)
        self._waiting = np.zeros(0)
        self._ready = np.zeros(HOP_SAMPLES)

    def accept(self, samples: Samples) -> Samples:
        """The next samples."""
        self._waiting = np.concatenate([self._waiting, samples / 32768.0])
        ready: list[NDArray[np.float64]] = [self._ready]
        while len(self._waiting) >= HOP_SAMPLES:
            hop, self._waiting = self._waiting[:HOP_SAMPLES], self._waiting[HOP_SAMPLES:]
            self._last = np.concatenate([self._last[HOP_SAMPLES:], hop])
            ready.append(self._frame())
        done = np.concatenate(ready)
        out, self._ready = done[: len(samples)], done[len(samples) :]
        return np.clip(np.rint(out * 32768.0), -32768, 32767).astype(np.int16)

    def _frame(self) -> NDArray[np.float64]:
        """The next HOP_SAMPLES, complete once the frame after the one they began in has been added."""
        spectrum = np.fft.rfft(self._last * self._window)
        mix = np.stack([spectrum.real, spectrum.imag], axis=-1)[None, :, None, :].astype(np.float32)
        clean, *caches = self._session.run(None, {"mix": mix, **self._caches})
        self._caches = dict(zip(_CACHES, caches, strict=True))
        spectrum = (1.0 - self._remix) * (clean[0, :, 0, 0] + 1j * clean[0, :, 0, 1]) + self._remix * spectrum
        self._tail = np.concatenate([self._tail[HOP_SAMPLES:], np.zeros(HOP_SAMPLES)])
        self._tail += np.fft.irfft(spectrum, WINDOW_SAMPLES) * self._window
        return self._tail[:HOP_SAMPLES].copy()
