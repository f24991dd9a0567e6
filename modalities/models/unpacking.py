"""Unpacking an archive that nobody has vouched for but its checksum: nothing lands outside its folder, and an
incomplete one is removed.
"""

from __future__ import annotations

import contextlib
import shutil
import tarfile
import tempfile
import zipfile
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import IO

from modalities.models.catalogue import ModelError, missing_parts

BLOCK_BYTES = 1 << 18
LARGEST_BYTES = 2 << 30
"""No archive unpacks to more than this."""


def unpack_zip(archive: Path, folder: Path) -> Path:
    """A zip whose single top folder is the model, unpacked as `folder`. Raises ModelError for one that is unsafe."""
    with _new_folder(folder) as fresh:
        try:
            with zipfile.ZipFile(archive) as file:
                _check_size(sum(info.file_size for info in file.infolist()), archive)
                for info in file.infolist():
                    parts = _safe_parts(info.filename, archive)[1:]
                    if parts and not info.is_dir():
                        with file.open(info) as data:
                            _write(fresh.joinpath(*parts), data)
        except zipfile.BadZipFile as error:
            raise ModelError(f"{archive.name} is not a zip file") from error
    return folder


def unpack_tar(archive: Path, member: str, folder: Path) -> Path:
    """The folder `member` of a tarball, unpacked as `folder`. Raises ModelError for one that is unsafe."""
    inside = PurePosixPath(member).parts
    with _new_folder(folder) as fresh:
        try:
            with tarfile.open(archive) as file:
                unpacked_bytes = 0
                for info in file:
                    parts = PurePosixPath(info.name).parts
                    if parts[: len(inside)] != inside or info.isdir():
                        continue
                    rest = _safe_parts(info.name, archive)[len(inside) :]
                    data = file.extractfile(info) if info.isfile() else None
                    if data is None or not rest:
                        raise ModelError(f"{archive.name} holds a link where a file should be")
                    unpacked_bytes += info.size
                    _check_size(unpacked_bytes, archive)
                    _write(fresh.joinpath(*rest), data)
        except tarfile.TarError as error:
            raise ModelError(f"{archive.name} is not a tar file") from error
    return folder


@contextlib.contextmanager
def _new_folder(folder: Path) -> Iterator[Path]:
    """A folder to fill that becomes `folder` in one step, if it turned out to be a model."""
    fresh = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    try:
        yield fresh
        missing = missing_parts(fresh)
        if missing:
            raise ModelError(f"what was fetched lacks {', '.join(missing)}")
        fresh.chmod(0o755)
        if folder.exists():  # an incomplete one, or nothing would have been fetched
            shutil.rmtree(folder)
        fresh.rename(folder)
    finally:
        shutil.rmtree(fresh, ignore_errors=True)


def _write(path: Path, data: IO[bytes]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:
        shutil.copyfileobj(data, file, BLOCK_BYTES)


def _safe_parts(name: str, archive: Path) -> tuple[str, ...]:
    path = PurePosixPath(name)
    if path.is_absolute() or ".." in path.parts or "\\" in name:
        raise ModelError(f"{archive.name} would write outside its folder ({name})")
    return path.parts


def _check_size(unpacked_bytes: int, archive: Path) -> None:
    if unpacked_bytes > LARGEST_BYTES:
        raise ModelError(f"{archive.name} unpacks to more than {LARGEST_BYTES >> 30} GB")
