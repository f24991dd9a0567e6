"""The chain of hashes in a flight record: each link covers all that was written since the last one, and carries its hash.

A link is a message of the topic `link`: its number, the sha256 of the last link's sha256 and of every message and metadata
since (attachments are named in messages by their sha256), and, where a key was given, an Ed25519 signature of that sha256.
Whoever edits a record without the key breaks the chain; without any key, whoever makes all links anew does not. Source: RFC 8032
(Ed25519).
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import load_pem_private_key, load_pem_public_key

LINK = "link"
LINK_S = 1.0
"""So often a link is written; what a cut record has after its last link is not covered."""
FIRST = "0" * 64


class KeyFileError(ValueError):
    """A key that cannot be used; one sentence that names its file."""


class Chain:
    """Makes the links, as the record is written."""

    def __init__(self, key: Ed25519PrivateKey | None = None) -> None:
        self._key = key
        self._last = FIRST
        self._number = 0
        self._since = hashlib.sha256()

    def take(self, kind: str, content: bytes) -> None:
        """One part of the record. kind: the topic of a message, or what else it is."""
        _add(self._since, kind, content)

    def link(self, *, last: bool = False) -> dict[str, object]:
        """The next link. last: the record ends with it."""
        self._number += 1
        digest = _linked(self._last, self._since, last=last)
        self._last, self._since = digest, hashlib.sha256()
        made: dict[str, object] = {"n": self._number, "sha256": digest, "last": last}
        return made if self._key is None else {**made, "signature": self._key.sign(digest.encode()).hex()}


def _add(digest: hashlib._Hash, kind: str, content: bytes) -> None:
    name = kind.encode()
    digest.update(len(name).to_bytes(4, "big") + name + len(content).to_bytes(8, "big") + content)


def _linked(previous: str, since: hashlib._Hash, *, last: bool) -> str:
    return hashlib.sha256(f"{previous} {since.hexdigest()} {'last' if last else 'more'}".encode()).hexdigest()


@dataclass(frozen=True)
class ChainCheck:
    """What the chain of a record says. broken: the sentence of the first link that does not hold; empty: all hold.

    uncovered: parts after the last link; ended: the last link says that it is the last; signed: every link carries a
    signature by the key that was asked about; None: none was.
    """

    links: int
    broken: str
    uncovered: int
    ended: bool
    signed: bool | None

    @property
    def intact(self) -> bool:
        """Nothing was changed, nothing is missing at its end, and it is signed where that was asked."""
        return not self.broken and self.links > 0 and self.ended and not self.uncovered and self.signed is not False


def check(parts: Iterable[tuple[str, bytes]], key: Ed25519PublicKey | None = None) -> ChainCheck:
    """The chain of a record's parts, (kind, content) in their order as `recorder.read_parts` gives them."""
    last, since, links, uncovered, ended = FIRST, hashlib.sha256(), 0, 0, False
    signed = None if key is None else True
    for kind, content in parts:
        if kind != LINK:
            _add(since, kind, content)
            uncovered += 1
            continue
        link = _link(content)
        if link is None:
            return ChainCheck(links, f"link {links + 1} cannot be read", uncovered, ended, signed)
        if ended or link.get("n") != links + 1:
            return ChainCheck(links, f"link {link.get('n')} follows link {links}", uncovered, ended, signed)
        digest = _linked(last, since, last=bool(link.get("last")))
        if link.get("sha256") != digest:
            why = f"what link {links + 1} covers (up to {link.get('t')} s) was changed"
            return ChainCheck(links, why, uncovered, ended, signed)
        if key is not None and not _is_signed(link, key):
            signed = False
        last, since, links, uncovered, ended = digest, hashlib.sha256(), links + 1, 0, bool(link.get("last"))
    return ChainCheck(links, "", uncovered, ended, signed)


def _link(content: bytes) -> Mapping[str, object] | None:
    """What a link says; None: nothing that can be read."""
    try:
        link = json.loads(content)
    except (ValueError, RecursionError):
        return None
    return link if isinstance(link, dict) else None


def _is_signed(link: Mapping[str, object], key: Ed25519PublicKey) -> bool:
    try:
        key.verify(bytes.fromhex(str(link.get("signature", ""))), str(link["sha256"]).encode())
    except (InvalidSignature, ValueError):
        return False
    return True


def private_key(path: Path) -> Ed25519PrivateKey:
    """What records are signed with: an Ed25519 key in PEM without a password. Raises KeyFileError."""
    try:
        key = load_pem_private_key(path.read_bytes(), None)
    except OSError as error:
        raise KeyFileError(f"key {path} cannot be read: {error.strerror}") from None
    except (ValueError, TypeError, UnsupportedAlgorithm):
        raise KeyFileError(f"{path} holds no private key in PEM without a password: {_MAKE}") from None
    if not isinstance(key, Ed25519PrivateKey):
        raise KeyFileError(f"{path} is no Ed25519 key: {_MAKE}")
    return key


def public_key(path: Path) -> Ed25519PublicKey:
    """What signatures are checked with, in PEM. Raises KeyFileError."""
    try:
        key = load_pem_public_key(path.read_bytes())
    except OSError as error:
        raise KeyFileError(f"key {path} cannot be read: {error.strerror}") from None
    except (ValueError, UnsupportedAlgorithm):
        raise KeyFileError(f"{path} holds no public key in PEM: {_GIVE}") from None
    if not isinstance(key, Ed25519PublicKey):
        raise KeyFileError(f"{path} is no Ed25519 key: {_GIVE}")
    return key


_MAKE = "make one with `openssl genpkey -algorithm ed25519 -out FILE`"
_GIVE = "`openssl pkey -in KEY -pubout -out FILE` makes it from the private one"
