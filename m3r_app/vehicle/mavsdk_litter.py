"""MAVSDK leaves a folder in the temporary directory for every system that it meets: here it gets one that is ours to remove."""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile

_folder: str | None = None


def begin() -> None:
    """From here on what MAVSDK writes goes to a folder of this process, which is removed at its end. Idempotent.

    Libraries read TMPDIR where they need it; Python's own `tempfile` has looked before, and keeps what it found.
    """
    global _folder  # noqa: PLW0603  (one a process)
    if _folder is None:
        _folder = tempfile.mkdtemp(prefix="m3r-")
        os.environ["TMPDIR"] = _folder
        atexit.register(shutil.rmtree, _folder, ignore_errors=True)
