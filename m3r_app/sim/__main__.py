"""`python -m m3r_app.sim`: the simulated fleet as a process of its own.

When ready it prints one JSON line with the addresses to listen at ("also": where a second station may connect to, to
give commands), and flies until it is told to end (SIGTERM, SIGINT)
or, with --die-with-parent, until its standard input is closed, which happens however its parent ends.
"""

from __future__ import annotations

import argparse
import json
import os
import select
import signal
import sys
from pathlib import Path
from types import FrameType

from m3r_app.environment.scenario import SHIPPED, load_scenario
from m3r_app.exit_status import ExitStatus
from m3r_app.sim.fleet import Fleet

FIRST_PORT = 14540
"""PX4's own first offboard port."""


def main(arguments: list[str] | None = None) -> int:
    """Run the fleet; 0 when told to end, 2 on bad input."""
    parser = argparse.ArgumentParser(prog="m3r sim", description="Fly a simulated fleet for other tools.")
    parser.add_argument("--scenario", type=Path, default=SHIPPED / "hillside.toml", help="scenario file (TOML)")
    parser.add_argument(
        "--port-base", type=int, default=FIRST_PORT, help="UDP port of the first drone's ground station (14540)"
    )
    parser.add_argument("--truth", type=Path, help="write every drone's true state there, JSON lines")
    parser.add_argument("--broker", help="tell this MQTT broker where the drones are")
    parser.add_argument("--credentials", type=Path, help="of an operator who flies them")
    parser.add_argument("--die-with-parent", action="store_true", help="end when standard input closes")
    options = parser.parse_args(arguments)
    truth = None
    if (options.broker is None) != (options.credentials is None):
        print("--broker and --credentials are given together or not at all", file=sys.stderr)
        return ExitStatus.BAD_INPUT
    try:
        scenario = load_scenario(options.scenario)
        count = len(scenario.vehicles) + len(scenario.traffic)
        if not 1024 <= options.port_base <= 65536 - count:
            raise ValueError(f"--port-base {options.port_base}: {count} ports from 1024 to 65535 are needed")
        truth = options.truth.open("w", buffering=1, encoding="utf-8") if options.truth else None
        fleet = Fleet(scenario, options.port_base, truth)
        if options.broker is not None:
            _tell(fleet, options.broker, options.credentials)
    except OSError as error:
        print(f"{error.filename or 'network'}: {error.strerror or error}", file=sys.stderr)
        return ExitStatus.BAD_INPUT
    except ValueError as error:
        print(error, file=sys.stderr)
        return ExitStatus.BAD_INPUT
    ended = False

    def end(_signal: int, _frame: FrameType | None) -> None:
        nonlocal ended
        ended = True

    def stopped() -> bool:
        return ended or (options.die_with_parent and _input_closed())

    signal.signal(signal.SIGTERM, end)
    signal.signal(signal.SIGINT, end)
    ready = {"vehicles": fleet.vehicles, "traffic": fleet.traffic, "also": fleet.also}
    print(json.dumps(ready), flush=True)
    fleet.run(stopped)
    fleet.close()
    if truth is not None:
        truth.close()
    return ExitStatus.ENDED


def _tell(fleet: Fleet, broker: str, credentials: Path) -> None:
    """Raises ValueError with one sentence."""
    from m3r_app.airspace.credentials import AirError
    from m3r_app.sim.telling import start_telling

    try:
        start_telling(fleet, broker, credentials)
    except AirError as error:
        raise ValueError(str(error)) from None


def _input_closed() -> bool:
    """Standard input has reached its end."""
    readable, _, _ = select.select([0], [], [], 0.0)
    return bool(readable) and not os.read(0, 4096)


if __name__ == "__main__":
    sys.exit(main())
