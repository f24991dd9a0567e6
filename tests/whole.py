"""The whole app as a user runs it: real processes, real UDP on loopback, the true state beside it."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jsonschema

from m3r_app.output import EVENT_TYPES
from m3r_app.ports import free_udp_block
from tests.warm import Program

ROOT = Path(__file__).resolve().parent.parent
PLAIN = ROOT / "config/scenarios/plain.toml"
HILLSIDE = ROOT / "config/scenarios/hillside.toml"
PATIENCE_S = 60.0


_CONTRACT = jsonschema.Draft202012Validator(json.loads((ROOT / "docs/output.schema.json").read_text(encoding="utf-8")))
_OF_EVENT = {
    kind.name: _CONTRACT.evolve(schema={**_CONTRACT.schema, "oneOf": [{"$ref": f"#/$defs/{kind.__name__}"}]})
    for kind in EVENT_TYPES
}


def check_against_the_contract(found: dict[str, Any]) -> None:
    """Whether a line of the output is what docs/output.schema.json says."""
    _OF_EVENT[found["event"]].validate(found)


@dataclass
class Ran:
    """One finished run."""

    status: int
    events: list[dict[str, Any]]
    told: str

    def of(self, event: str, **fields: object) -> list[dict[str, Any]]:
        return [e for e in self.events if e["event"] == event and all(e.get(k) == v for k, v in fields.items())]

    def verdicts(self) -> dict[str, str]:
        """Final verdict by request."""
        return {e["request"]: e["verdict"] for e in self.of("decision") if e["verdict"] != "delayed"}


class App:
    """A running `m3r`."""

    def __init__(
        self,
        arguments: Sequence[str],
        stdin: str | None = None,
        terminal: int | None = None,
        program: str = "ui.entry",
    ) -> None:
        """stdin: what is written to it; terminal: a file descriptor to be it instead."""
        nothing = subprocess.DEVNULL if terminal is None else terminal
        self.process = Program(program, arguments, subprocess.PIPE if stdin is not None else nothing, subprocess.PIPE)
        self._unread = b""
        self.events: list[dict[str, Any]] = []
        if stdin is not None:
            assert self.process.stdin is not None
            self.process.stdin.write(stdin.encode())
            self.process.stdin.close()
            self.process.stdin = None

    def until(self, event: str, **fields: object) -> dict[str, Any]:
        """Read the output up to the first such event."""
        while (line := self._line()) is not None:
            found = _strict(line)
            self.events.append(found)
            if found["event"] == event and all(found.get(k) == v for k, v in fields.items()):
                return found
        raise AssertionError(f"no {event} {fields} before the end: {self.finish().told}")

    def _line(self) -> str | None:
        """The next line of its output; None at the end."""
        while b"\n" not in self._unread:
            more = self.process.stdout.read(65536)
            if not more:
                return None
            self._unread += more
        line, _, self._unread = self._unread.partition(b"\n")
        return line.decode()

    def finish(self) -> Ran:
        out, err = self.process.communicate(timeout=PATIENCE_S)
        lines = (self._unread + out).decode().splitlines()
        self.events += [_strict(line) for line in lines]
        return Ran(self.process.returncode, self.events, err.decode())


def _strict(line: str) -> dict[str, Any]:
    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is not JSON: {line}")

    found = json.loads(line, parse_constant=refuse)
    assert isinstance(found, dict) and "t" in found and "event" in found, line
    check_against_the_contract(found)
    return found


def m3r(*arguments: str, stdin: str | None = None) -> Ran:
    """Run the command line to its end."""
    return App(arguments, stdin).finish()


@dataclass
class Simulated:
    """A running `m3r sim`."""

    process: Program
    urls: dict[str, str]
    also: dict[str, str]
    truth: Path
    _read: int = field(default=0)

    @property
    def vehicles(self) -> list[str]:
        """--vehicle options for everybody in it."""
        return ["--vehicle", *(f"{name}={url}" for name, url in self.urls.items())]

    def states(self, vehicle: str) -> list[dict[str, Any]]:
        """The true states so far."""
        lines = self.truth.read_text().splitlines()
        found = [json.loads(line) for line in lines if line.endswith("}")]
        return [state for state in found if state["vehicle"] == vehicle]

    def last(self, vehicle: str) -> dict[str, Any]:
        return self.states(vehicle)[-1]

    def wait(self, vehicle: str, **fields: object) -> dict[str, Any]:
        """Until the true state has these fields."""
        deadline_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline_s:
            state = self.last(vehicle)
            if all(state[k] == v for k, v in fields.items()):
                return state
            self.process.poll()
            time.sleep(0.05)
        raise AssertionError(f"{vehicle} never had {fields}: {self.last(vehicle)}")


@contextmanager
def simulated(scenario: Path, tmp_path: Path, *words: str) -> Iterator[Simulated]:
    """The simulated fleet as a process of its own, its truth written down."""
    truth = tmp_path / "truth.jsonl"
    words = ("--scenario", str(scenario), "--truth", str(truth), "--port-base", str(free_udp_block(6)), *words)
    process = Program("m3r_app.sim.__main__", words)
    try:
        ready = json.loads(process.stdout.readline())
        urls = {**ready["vehicles"], **ready["traffic"]}
        yield Simulated(process, urls, ready["also"], truth)
    finally:
        process.terminate()
        process.wait(PATIENCE_S)
