"""The chain of hashes: whatever is changed, left out, added or cut off in a record is noticed."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, PublicFormat

from m3r_app.record.chain import LINK, Chain, KeyFileError, check, private_key, public_key
from m3r_app.record.recorder import Recorder, read_parts
from ui.verify import chain_line

Parts = list[tuple[str, bytes]]


def written(path: Path, chain: Chain | None = None, count: int = 40) -> Path:
    made = Recorder(path, {"app": "test"}, print, chain=chain)
    for i in range(count):
        made.record("announce", float(i), {"text": f"number {i}"})
        if i % 10 == 9:
            made._linked_ns = 0  # as if a second had passed
    made.close()
    return path


def keys(folder: Path, name: str = "key") -> tuple[Path, Path]:
    key = Ed25519PrivateKey.generate()
    private, public = folder / f"{name}.pem", folder / f"{name}.pub"
    private.write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    public.write_bytes(key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo))
    return private, public


def test_a_record_as_it_was_written_is_intact(tmp_path: Path) -> None:
    found = check(read_parts(written(tmp_path / "flight.mcap")))
    assert found.intact and found.links >= 2 and found.signed is None


def edited(parts: Parts) -> Parts:
    at = next(i for i, (kind, _) in enumerate(parts) if kind == "announce")
    return [*parts[:at], ("announce", parts[at][1].replace(b"number 0", b"number 9")), *parts[at + 1 :]]


def of_another_topic(parts: Parts) -> Parts:
    at = next(i for i, (kind, _) in enumerate(parts) if kind == "announce")
    return [*parts[:at], ("decision", parts[at][1]), *parts[at + 1 :]]


def without_one(parts: Parts) -> Parts:
    at = next(i for i, (kind, _) in enumerate(parts) if kind == "announce")
    return parts[:at] + parts[at + 1 :]


def with_one_more(parts: Parts) -> Parts:
    return [*parts, ("announce", b"{}")]


def swapped(parts: Parts) -> Parts:
    at = [i for i, (kind, _) in enumerate(parts) if kind == "announce"][:2]
    found = list(parts)
    found[at[0]], found[at[1]] = found[at[1]], found[at[0]]
    return found


def cut(parts: Parts) -> Parts:
    return parts[:-1]


def cut_to_a_link(parts: Parts) -> Parts:
    return parts[: max(i for i, (kind, _) in enumerate(parts[:-1]) if kind == LINK) + 1]


def without_a_link(parts: Parts) -> Parts:
    at = next(i for i, (kind, _) in enumerate(parts) if kind == LINK)
    return parts[:at] + parts[at + 1 :]


def with_link(content: bytes) -> Callable[[Parts], Parts]:
    def change(parts: Parts) -> Parts:
        at = next(i for i, (kind, _) in enumerate(parts) if kind == LINK)
        return [*parts[:at], (LINK, content), *parts[at + 1 :]]

    return change


def with_other_metadata(parts: Parts) -> Parts:
    assert parts[0][0] == "m3r"
    return [("m3r", parts[0][1].replace(b"test", b"tent")), *parts[1:]]


@pytest.mark.parametrize(
    "change",
    [
        edited,
        of_another_topic,
        without_one,
        with_one_more,
        swapped,
        cut,
        cut_to_a_link,
        without_a_link,
        with_other_metadata,
        with_link(b"{"),
        with_link(b"[]"),
        with_link(b"\xff"),
        with_link(b"[" * 100_000),
        lambda _: [],
    ],
)
def test_whatever_is_changed_is_noticed(tmp_path: Path, change: Callable[[Parts], Parts]) -> None:
    parts = list(read_parts(written(tmp_path / "flight.mcap")))
    assert check(parts).intact
    assert not check(change(parts)).intact


def test_who_makes_all_links_anew_needs_the_key(tmp_path: Path) -> None:
    private, public = keys(tmp_path)
    path = written(tmp_path / "flight.mcap", Chain(private_key(private)))
    assert check(read_parts(path), public_key(public)).intact
    chain, forged = Chain(Ed25519PrivateKey.generate()), []
    parts = edited(list(read_parts(path)))
    for kind, content in parts:
        if kind == LINK:
            forged.append((LINK, json.dumps(chain.link(last=json.loads(content)["last"])).encode()))
        else:
            chain.take(kind, content)
            forged.append((kind, content))
    assert check(forged).intact, "without a key to ask about, it looks whole"
    assert check(forged, public_key(public)).signed is False
    assert not check(forged, public_key(public)).intact


def test_what_is_said_of_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("m3r_app.record.recorder.CHUNK_BYTES", 256)  # several of them in a short record
    private, public = keys(tmp_path)
    _, other = keys(tmp_path, "other")
    signed = written(tmp_path / "signed.mcap", Chain(private_key(private)))
    assert chain_line(signed, public).passed
    assert "not signed with the key" in chain_line(signed, other).note
    assert "not signed with the key" in chain_line(written(tmp_path / "unsigned.mcap"), public).note
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(signed.read_bytes()[: signed.stat().st_size // 2])
    assert not chain_line(torn, None).passed


def test_a_key_that_cannot_be_used_is_one_sentence(tmp_path: Path) -> None:
    private, public = keys(tmp_path)
    for wrong in (tmp_path / "missing.pem", public):
        with pytest.raises(KeyFileError, match=str(wrong)):
            private_key(wrong)
    for wrong in (tmp_path / "missing.pem", private):
        with pytest.raises(KeyFileError, match=str(wrong)):
            public_key(wrong)
