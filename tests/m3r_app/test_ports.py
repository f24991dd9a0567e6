"""A port that another process holds, and addresses that are none (X6)."""

from __future__ import annotations

import socket
import subprocess
import sys

import pytest

from m3r_app.ports import LinkError, check_link, require_free

HOLDER = """
import socket, sys
held = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
if sys.argv[1] == "shared":
    held.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
held.bind(("127.0.0.1", 0))
print(held.getsockname()[1], flush=True)
sys.stdin.read()
"""


@pytest.mark.parametrize("sharing", ["shared", "alone"])
@pytest.mark.parametrize("host", ["127.0.0.1", "0.0.0.0"])
def test_a_udp_port_of_another_process_is_refused_by_name_even_if_that_process_shares_it(
    sharing: str, host: str
) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", HOLDER, sharing], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as holder:
        assert holder.stdout is not None
        port = int(holder.stdout.readline())
        with pytest.raises(LinkError, match=f"UDP port {port} is held by another program"):
            check_link(f"udpin://{host}:{port}")
        holder.communicate()
    check_link(f"udpin://{host}:{port}")


def test_checking_leaves_the_port_free() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    for _ in range(3):
        check_link(f"udpin://127.0.0.1:{port}")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as again:
        again.bind(("127.0.0.1", port))


def test_a_tcp_port_in_use_is_refused() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        with pytest.raises(LinkError, match=f"TCP port {port} is held"):
            check_link(f"tcpin://127.0.0.1:{port}")


@pytest.mark.parametrize(
    "url",
    ["", "red", "udpin://", "udpin://127.0.0.1", "udpin://:14540", "udpin://127.0.0.1:0", "udpin://127.0.0.1:65536",
     "udpin://127.0.0.1:port", "udp://127.0.0.1:14540", "http://127.0.0.1:14540", "serial://ttyACM0:57600",
     "serial:///dev/ttyACM0", "serial:///dev/ttyACM0:fast", "udpin://[::1:14540"],
)  # fmt: skip
def test_what_is_no_address_is_refused_in_one_sentence_that_shows_how(url: str) -> None:
    with pytest.raises(LinkError) as refusal:
        check_link(url)
    text = str(refusal.value)
    assert repr(url) in text
    assert "write" in text or "as in" in text
    assert "\n" not in text


@pytest.mark.parametrize(
    "url", ["udpout://127.0.0.1:14540", "tcpout://192.168.0.7:5760", "serial:///dev/ttyACM0:57600"]
)
def test_addresses_without_a_local_port_pass(url: str) -> None:
    check_link(url)


def test_a_host_that_is_not_ours_is_refused() -> None:
    with pytest.raises(LinkError, match=r"192\.0\.2\.1 cannot be opened"):
        require_free("192.0.2.1", 14540)
