"""The product on a real PX4, headless, each of its events with the time at which it was read; judged by the truth."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

from tests.px4.sitl import Px4, place
from tests.whole import ROOT

OPERATOR_M = (-12.0, 0.0)
"""North and east of HOME."""
BASE = ("--set", "neighbours=none", "terrain=flat", "--takeoff", "10")


class Flight:
    """One run of `m3r run --headless --pair red`."""

    def __init__(self, px4: Px4, folder: Path, script: str, *more: str, port: int | None = None) -> None:
        """script: lines of "seconds modality words", counted from pairing. port: where it listens, unless the usual."""
        self.px4 = px4
        folder.mkdir(parents=True, exist_ok=True)
        said = folder / "script.txt"
        said.write_text(script, encoding="utf-8")
        command = [sys.executable, "-m", "ui.entry", "run", "--headless", "--pair", "red", "--script", str(said)]
        command += ["--vehicle", f"red=udpin://127.0.0.1:{port or px4.app_port}", "--operator", place(*OPERATOR_M)]
        self._errors = (folder / "stderr.txt").open("w+", encoding="utf-8")
        self.process = subprocess.Popen(
            [*command, *BASE, *more], cwd=ROOT, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=self._errors,
            env={**os.environ, "PYTHONUNBUFFERED": "1"}, text=True,
        )  # fmt: skip
        self.events: list[dict[str, Any]] = []
        self._news = threading.Condition()
        self._ended = False
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            event = json.loads(line)
            event["at_s"] = time.monotonic()
            with self._news:
                self.events.append(event)
                self._news.notify_all()
        with self._news:
            self._ended = True
            self._news.notify_all()

    def of(self, event: str, **fields: object) -> list[dict[str, Any]]:
        return [e for e in self.events if e["event"] == event and all(e.get(k) == v for k, v in fields.items())]

    def until(self, event: str, within_s: float = 90.0, after_s: float = 0.0, **fields: object) -> dict[str, Any]:
        """The first such event read after after_s."""
        deadline_s = time.monotonic() + within_s
        with self._news:
            while True:
                found = [e for e in self.of(event, **fields) if e["at_s"] >= after_s]
                if found:
                    return found[0]
                left_s = deadline_s - time.monotonic()
                assert left_s > 0.0 and not self._ended, f"no {event} {fields}: {self.story()}"
                self._news.wait(min(left_s, 0.5))

    def story(self) -> str:
        """What it said, for a failed assertion."""
        told = [str(e.get("text") or e.get("reasons") or e.get("event")) for e in self.events]
        self._errors.seek(0)
        return " | ".join([*told[-12:], self._errors.read()[-500:]])

    def end(self, within_s: float = 240.0) -> int:
        """Its exit status, once it has ended by itself."""
        try:
            status = self.process.wait(within_s)
        except subprocess.TimeoutExpired:
            self.close()
            raise AssertionError(f"it did not end: {self.story()}") from None
        self._thread.join(10.0)
        return status

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
            try:
                self.process.wait(20.0)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
        self._thread.join(10.0)
        self._errors.close()

    def violations(self, kind: str = "actual") -> list[dict[str, Any]]:
        return self.of("violation", kind=kind)

    def moves(self) -> list[dict[str, Any]]:
        """Of each request that was flown: command, status, granted_m, and along_m, what it truly went that way 2 s after."""
        commands = {e["id"]: e["command"] for e in self.of("request")}
        granted = {e["request"]: e.get("granted_m") for e in self.of("decision", verdict="approved")}
        granted |= {e["request"]: e.get("granted_m") for e in self.of("decision", verdict="limited")}
        found = []
        for start in self.of("motion", status="started"):
            ends = [e for e in self.of("motion", request=start["request"]) if e["status"] != "started"]
            if not ends:
                continue
            before, after = self.px4.at(start["at_s"]), self.px4.at(ends[0]["at_s"] + 2.0)
            bearing = math.atan2(before[1] - OPERATOR_M[1], before[0] - OPERATOR_M[0])
            north, east, down = (b - a for a, b in zip(before, after, strict=True))
            away = north * math.cos(bearing) + east * math.sin(bearing)
            right = east * math.cos(bearing) - north * math.sin(bearing)
            command = commands[start["request"]]
            along = {
                "go_left": -right, "go_right": right, "go_forward": away, "go_back": -away, "go_up": -down, "go_down": down,
            }.get(command)  # fmt: skip
            found.append(
                {
                    "command": command,
                    "status": ends[0]["status"],
                    "granted_m": granted.get(start["request"]),
                    "along_m": along,
                }
            )
        return found
