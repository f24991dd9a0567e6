"""What is written may replace an older one of its kind, never another file."""

from __future__ import annotations

from pathlib import Path


def is_other_file(path: Path, mark: bytes, within_bytes: int) -> bool:
    """Whether `path` is a file with content that lacks our mark in its first bytes: then it may not be replaced.

    Raises OSError where it cannot be read.
    """
    if not path.is_file() or not path.stat().st_size:
        return False
    with path.open("rb") as file:
        return mark not in file.read(within_bytes)
