"""Who somebody is in the air: one JSON file per operator, drone or authority, made by `scripts/make_airspace.py`."""

from __future__ import annotations

import re
import ssl
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal
from urllib.parse import urlsplit

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from m3r_app.airspace.topics import NAME

LOOPBACK = ("127.0.0.1", "localhost", "::1")
PORTS = {"mqtt": 1883, "mqtts": 8883}

Key = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
KeyId = Annotated[str, Field(pattern=rf"^(operator|drone|airspace)\.{NAME}$")]


class AirError(Exception):
    """The shared airspace cannot be used; one sentence that says why and what to do."""


class Credentials(BaseModel):
    """Broker login, certificate of the broker's maker, and the keys by which messages are signed."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    user: KeyId
    password: Annotated[str, Field(min_length=1, max_length=200)]
    area: Annotated[str, Field(pattern=f"^{NAME}$")]
    ca: str | None
    """PEM; None: no TLS, which only a broker on this computer may do without."""
    flies: list[Annotated[str, Field(pattern=f"^{NAME}$")]]
    """The drones whose state this user may tell and, an operator, claim."""
    keys: dict[KeyId, Key]
    """Own ones and those whose messages are to be verified."""

    @property
    def name(self) -> str:
        return self.user.partition(".")[2]

    @property
    def role(self) -> str:
        return self.user.partition(".")[0]

    def key(self, key_id: str) -> bytes | None:
        written = self.keys.get(key_id)
        return bytes.fromhex(written) if written is not None else None


@dataclass(frozen=True, slots=True)
class Broker:
    """Where the broker is."""

    host: str
    port: int
    tls: bool

    def __str__(self) -> str:
        return f"{'mqtts' if self.tls else 'mqtt'}://{self.host}:{self.port}"


def parse_broker(text: str) -> Broker:
    """mqtts://HOST[:PORT], or mqtt:// for this computer itself. Raises AirError."""
    shape = "write mqtts://HOST:8883, or mqtt://127.0.0.1:1883 for a broker on this computer"
    try:
        parts = urlsplit(text)
        host, port = parts.hostname, parts.port
    except ValueError:
        host, port = None, None
        parts = urlsplit("")
    if (
        parts.scheme not in PORTS
        or not host
        or not re.fullmatch(r"[A-Za-z0-9._:-]+", host)
        or parts.path not in ("", "/")
        or parts.query
        or parts.fragment
    ):
        raise AirError(f"{text!r} is no broker's address: {shape}")
    if parts.username or parts.password:
        raise AirError(
            "a password in the broker's address can be seen by everybody on this computer: leave it out, it stands in the credentials"
        )
    if parts.scheme == "mqtt" and host not in LOOPBACK:
        raise AirError(f"{text} would send the password unprotected through the network: use mqtts://{host}")
    return Broker(host, port if port is not None else PORTS[parts.scheme], parts.scheme == "mqtts")


Role = Literal["operator", "drone", "airspace"]
_WHOSE = {"operator": "an operator's", "drone": "a drone's", "airspace": "an authority's"}


def load_credentials(path: Path, *roles: Role) -> Credentials:
    """Read the file, of one of these roles. Raises AirError with one sentence."""
    made = "make it with scripts/make_airspace.py"
    try:
        mode = path.stat().st_mode
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "it is not text"
        raise AirError(f"credentials {path} cannot be read: {why}; {made}") from None
    if mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise AirError(f"credentials {path} can be read by others on this computer: chmod 600 {path}")
    try:
        found = Credentials.model_validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(map(str, first["loc"])) or "the file"
        raise AirError(f"credentials {path} are not usable: {where}: {first['msg']}; {made}") from None
    if found.role not in roles:
        wanted = " or ".join(_WHOSE[role] for role in roles)
        raise AirError(f"credentials {path} are {_WHOSE[found.role]}, and {wanted} are needed here; {made}")
    if found.user not in found.keys:
        raise AirError(f"credentials {path} lack the key of {found.user} itself; {made}")
    return found


def tls_context(credentials: Credentials, broker: Broker) -> ssl.SSLContext | None:
    """What the broker's certificate is checked by. Raises AirError."""
    if not broker.tls:
        return None
    if credentials.ca is None:
        raise AirError(
            f"the credentials of {credentials.user} have no certificate to check {broker} by: make them with TLS"
        )
    try:
        return ssl.create_default_context(cadata=credentials.ca)
    except (ssl.SSLError, ValueError) as error:
        why = re.sub(r"\s+", " ", str(error))
        raise AirError(f"the certificate in the credentials of {credentials.user} cannot be read: {why}") from None
