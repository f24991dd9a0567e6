"""The simulated fleet as its own process on free ports, for tests."""

from __future__ import annotations

import json
import select
import socket
import subprocess
import sys
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[3]


def free_ports(count: int) -> int:
    """The first of `count` consecutive UDP ports that nobody holds on the loopback address."""
    for _ in range(50):
        held = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM)]
        try:
            held[0].bind(("127.0.0.1", 0))
            first = held[0].getsockname()[1]
            for i in range(1, count):
                held.append(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
                held[-1].bind(("127.0.0.1", first + i))
        except OSError:
            continue
        finally:
            for one in held:
                one.close()
        return int(first)
    raise AssertionError("no free UDP ports")


class FleetProcess:
    """`python -m m3r_app.sim` until the block ends."""

    def __init__(self, scenario: Path, count: int, *options: str) -> None:
        self._command = [sys.executable, "-m", "m3r_app.sim", "--scenario", str(scenario), "--die-with-parent"]
        self._command += ["--port-base", str(free_ports(count)), *options]

    def __enter__(self) -> FleetProcess:
        self.process = subprocess.Popen(
            self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=PROJECT
        )
        assert self.process.stdout is not None
        ready, _, _ = select.select([self.process.stdout], [], [], 30.0)
        line = self.process.stdout.readline() if ready else ""
        if not line:
            self.process.kill()
            raise AssertionError(f"the fleet did not start: {self.process.communicate()[1]}")
        addresses = json.loads(line)
        self.vehicles: dict[str, str] = addresses["vehicles"]
        self.traffic: dict[str, str] = addresses["traffic"]
        self.also: dict[str, str] = addresses["also"]
        """Where a second ground station may send commands."""
        return self

    def __exit__(self, *_: object) -> None:
        self.process.terminate()
        try:
            self.process.communicate(timeout=10.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.communicate()
