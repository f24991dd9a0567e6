"""VOSK, imported without what its package would fetch models with: that costs 11 MB and 0.1 s, and nothing here calls it."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType

NOT_CALLED = ("requests", "srt", "tqdm")
"""Only `vosk.list_models`, `vosk.Model(model_name=...)` and subtitles use them."""


@contextmanager
def _stood_in_for(names: tuple[str, ...]) -> Iterator[None]:
    """Empty modules of these names, where the real ones are not yet imported; whoever imports one later gets the real one."""
    stood_in = [name for name in names if name not in sys.modules]
    for name in stood_in:
        sys.modules[name] = ModuleType(name)
        setattr(sys.modules[name], name, None)  # `from tqdm import tqdm`
    try:
        yield
    finally:
        for name in stood_in:
            del sys.modules[name]


with _stood_in_for(NOT_CALLED):
    from vosk import KaldiRecognizer, Model, SetLogLevel

__all__ = ["KaldiRecognizer", "Model", "SetLogLevel"]
