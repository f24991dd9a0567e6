"""UDP ports: one that another process holds is refused by us, because MAVSDK would take it over silently.

MAVSDK binds with the address-reuse flag set, and two sockets so bound share a port with all datagrams going to one of
them: the first process would lose its telemetry without a word. So we bind first, without the flag, and let go again.
"""

from __future__ import annotations

import errno
import random
import socket
from urllib.parse import urlsplit

PORTS = (20000, 32000)
"""What we take by ourselves: below what the system hands out."""
PORT_TRIES = 100
SCHEMES = (
    "udpin",
    "udpout",
    "tcpin",
    "tcpout",
    "serial",
)
"""How vehicles are linked to; `m3r_app.vehicle.fleet.CONNECTS` says by what."""


class LinkError(Exception):
    """A link address that cannot be used; the message is one sentence that names it and says what to do."""


def check_link(url: str) -> None:
    """Raise LinkError for a MAVLink link address that is malformed or whose local port somebody else holds."""
    scheme, separator, rest = url.partition("://")
    if not separator or scheme not in SCHEMES or not rest:
        raise LinkError(
            f"{url!r} is not a vehicle's link: write udpin://0.0.0.0:14540, udpout://HOST:PORT, tcpout://HOST:PORT "
            "or serial:///dev/ttyACM0:57600."
        )
    if scheme == "serial":
        device, _, baud = rest.rpartition(":")
        if not device.startswith("/") or not baud.isdecimal():
            raise LinkError(
                f"{url!r} does not name a serial device and its baud rate: write serial:///dev/ttyACM0:57600."
            )
        return
    if not scheme.startswith(("udp", "tcp")):
        return  # whoever connects to it knows what else it needs
    host, port = _host_port(url)
    if scheme == "udpin":
        require_free(host, port, socket.SOCK_DGRAM)
    elif scheme == "tcpin":
        require_free(host, port, socket.SOCK_STREAM)


def require_free(
    host: str, port: int, kind: int = socket.SOCK_DGRAM, otherwise: str = "give the vehicle another port"
) -> None:
    """Raise LinkError if the local port cannot be bound exclusively. otherwise: what else a person can do."""
    name = "UDP" if kind == socket.SOCK_DGRAM else "TCP"
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, kind) as probe:
        try:
            probe.bind((host, port))
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                raise LinkError(
                    f"{name} port {port} is held by another program: end that program (another m3r, a ground "
                    f"station) or {otherwise}."
                ) from None
            raise LinkError(f"{name} port {port} on {host} cannot be opened: {error.strerror}.") from None
        except OverflowError:
            raise LinkError(f"{port} is not a port: give a number from 1 to 65535.") from None


def _host_port(url: str) -> tuple[str, int]:
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError:
        host, port = None, None
    if not host or not port:
        raise LinkError(f"{url!r} does not name a host and a port from 1 to 65535, as in udpin://0.0.0.0:14540.")
    return host, port


def free_udp_block(count: int) -> int:
    """The first of `count` UDP ports in a row that nobody on this computer holds. Raises LinkError."""
    for _ in range(PORT_TRIES):
        base = random.randrange(*PORTS)
        try:
            for port in range(base, base + count):
                require_free("127.0.0.1", port)
        except LinkError:
            continue
        return base
    raise LinkError(f"there are no {count} free UDP ports in a row")
