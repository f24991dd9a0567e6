"""Standard error while a native library loads: MediaPipe, PortAudio and OpenCV write to it from C++, and have no setting for it."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def discarded_stderr() -> Iterator[None]:
    """Whatever this process writes to descriptor 2 meanwhile is lost, so use it only before anything flies.

    Where there is no standard error nothing is done.
    """
    if sys.stderr is not None:
        sys.stderr.flush()
    try:
        kept = os.dup(2)
    except OSError:
        yield
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
