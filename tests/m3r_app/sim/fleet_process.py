"""The simulated fleet as its own process on free ports, for tests."""

from __future__ import annotations

import json
import select
import subprocess
from pathlib import Path

from m3r_app.ports import free_udp_block
from tests.warm import Program


class FleetProcess:
    """`python -m m3r_app.sim` until the block ends."""

    def __init__(self, scenario: Path, count: int, *options: str) -> None:
        self._words = ["--scenario", str(scenario), "--die-with-parent", "--port-base", str(free_udp_block(count))]
        self._words += options

    def __enter__(self) -> FleetProcess:
        self.process = Program("m3r_app.sim.__main__", self._words, subprocess.PIPE, subprocess.PIPE)
        ready, _, _ = select.select([self.process.stdout], [], [], 30.0)
        line = self.process.stdout.readline() if ready else b""
        if not line:
            self.process.kill()
            raise AssertionError(f"the fleet did not start: {self.process.communicate()[1].decode()}")
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
