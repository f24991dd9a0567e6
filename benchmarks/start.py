"""From the start of the process until a drone is Armed, and the memory that takes, beside loading the same libraries by hand.

    python benchmarks/start.py

The app starts on its built-in simulated fleet with the demonstration's recordings and pairs at once. The rival is a bare
script that starts the same fleet, loads VOSK's model, MediaPipe's hand landmarker and MAVSDK one after the other, and waits
for the first heartbeat of one drone: it checks nothing, pairs with nothing and turns nobody. In the timed runs the drone faces
the operator already; the last row is the shipped scenario, where it first turns by 90 degrees at no more than 30 degrees/s.
Memory is the peak of the resident set (VmHWM) of the app and its guard; the simulated fleet, a vehicle's stand-in, is a row
of its own.
"""

from __future__ import annotations

import json
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

from m3r_app.environment.scenario import SHIPPED
from m3r_app.ports import free_udp_block
from modalities.models.catalogue import ModelError, find_hand_model, find_model

ROOT = Path(__file__).resolve().parent.parent
DEMO = ROOT / "config" / "demo"
VOICE = ("--audio", str(DEMO / "operator.ogg"))
HANDS = ("--video", str(DEMO / "operator.mp4"))
TIMES = 3
GOES_ON_S = 3.0
"""After Armed, so that recognition itself is in the peak of memory."""
LONGEST_S = 60.0
ARMED_BAR_S = 5.0
VOICE_BAR_MB, BOTH_BAR_MB = 300.0, 600.0
SIMULATOR = "m3r_app.sim"
AIRCRAFT = 8
"""At least as many as the scenario has: each has a port of its own."""
RIVAL = """
import asyncio, json, subprocess, sys, threading
voice, port, hands, scenario = sys.argv[1:]
fleet = subprocess.Popen([sys.executable, "-m", "m3r_app.sim", "--scenario", scenario, "--die-with-parent", "--port-base", port],
                         stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
import vosk
vosk.SetLogLevel(-1)
recognizer = vosk.KaldiRecognizer(vosk.Model(voice), 16000)
if hands:
    from mediapipe.tasks.python import BaseOptions, vision
    landmarker = vision.HandLandmarker.create_from_options(vision.HandLandmarkerOptions(
        base_options=BaseOptions(model_asset_path=hands), running_mode=vision.RunningMode.VIDEO, num_hands=2))
from mavsdk import ComponentType, Configuration, Mavsdk
url = json.loads(fleet.stdout.readline())["vehicles"]["red"]
mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
mavsdk.add_any_connection_with_handle(url)
heard = threading.Event()
mavsdk.first_autopilot_async(10.0, lambda system: heard.set())
heard.wait(10.0)
print(json.dumps({"event": "mode", "mode": "heard"}), flush=True)
sys.stdin.readline()
import os; os._exit(0)
"""


@dataclass(frozen=True)
class Started:
    """One start. after_s: until Armed (the rival: until a heartbeat); memory in MB."""

    after_s: float
    memory_mb: float
    fleet_mb: float


def start(words: list[str], goal: str) -> Started:
    """Start these words and wait for the `mode` event whose mode ends in `goal`."""
    began_s = time.monotonic()
    process = subprocess.Popen(
        words, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        for text in process.stdout:
            if not text.startswith("{"):
                continue  # MAVSDK's own words
            event = json.loads(text)
            if event["event"] == "mode" and event["mode"].endswith(goal):
                after_s = time.monotonic() - began_s
                time.sleep(GOES_ON_S)
                return Started(after_s, *_memory_mb(process.pid))
            if event["event"] == "end" or time.monotonic() - began_s > LONGEST_S:
                break
        process.kill()
        assert process.stderr is not None
        raise SystemExit(f"the run failed: {process.stderr.read().strip()[-500:]}")
    finally:
        process.terminate()
        process.communicate(timeout=20.0)


def _memory_mb(pid: int) -> tuple[float, float]:
    """The peaks of the process with its children, and of the simulated fleet apart."""
    ours_mb = fleet_mb = 0.0
    for one in (pid, *_children(pid)):
        status = Path(f"/proc/{one}/status").read_text(encoding="ascii")
        peak_mb = next(int(line.split()[1]) / 1024.0 for line in status.splitlines() if line.startswith("VmHWM"))
        if SIMULATOR in Path(f"/proc/{one}/cmdline").read_text(encoding="utf-8").split("\0"):
            fleet_mb += peak_mb
        else:
            ours_mb += peak_mb
    return ours_mb, fleet_mb


def _children(pid: int) -> list[int]:
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            parent = int(stat.read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()[1])
        except OSError:
            continue  # it has ended
        if parent == pid:
            child = int(stat.parent.name)
            found += [child, *_children(child)]
    return found


def facing(folder: Path) -> Path:
    """The shipped scenario in `folder`, but red faces the operator."""
    shutil.copytree(SHIPPED, folder / "scenarios")
    path = folder / "scenarios" / "hillside.toml"
    text = path.read_text(encoding="utf-8")
    turned = text.replace("heading_deg = 90.0", "heading_deg = 180.0", 1)
    assert turned != text
    path.write_text(turned, encoding="utf-8")
    return path


def main() -> int:
    try:
        voice_model, hand_model = find_model(), find_hand_model()
    except ModelError as error:
        print(error, file=sys.stderr)
        return 2
    app = [sys.executable, "-m", "ui.entry", "run", "--headless", "--pair", "red"]
    rival = [sys.executable, "-c", RIVAL, str(voice_model.folder), str(free_udp_block(AIRCRAFT))]
    runs: dict[str, list[Started]] = {}
    with tempfile.TemporaryDirectory() as name:
        scenario = str(facing(Path(name)))
        for _ in range(TIMES):
            for what, words, goal in (
                ("voice", [*app, "--scenario", scenario, *VOICE], "Armed"),
                ("voice, by hand", [*rival, "", scenario], "heard"),
                ("voice and hands", [*app, "--scenario", scenario, *VOICE, *HANDS], "Armed"),
                ("voice and hands, by hand", [*rival, str(hand_model.path), scenario], "heard"),
            ):
                runs.setdefault(what, []).append(start(words, goal))
        runs["voice and hands, turning by 90 degrees"] = [start([*app, *VOICE, *HANDS], "Armed")]
    table = Table(
        title=f"start to Armed (bar: {ARMED_BAR_S:g} s), memory (bars: {VOICE_BAR_MB:g} MB, with hands {BOTH_BAR_MB:g} MB)"
    )
    for column in ("", "starts", "Armed after, s", "slowest, s", "memory, MB", "fleet, MB"):
        table.add_column(column, justify="right")
    for what, each in runs.items():
        table.add_row(
            what,
            str(len(each)),
            f"{_median_s(each):.2f}",
            f"{max(one.after_s for one in each):.2f}",
            f"{_most_mb(each):.0f}",
            f"{max(one.fleet_mb for one in each):.0f}",
        )
    for what in ("voice", "voice and hands"):
        ours, by_hand = runs[what], runs[f"{what}, by hand"]
        table.add_row(
            f"{what} beside by hand",
            "",
            f"{_median_s(ours) / _median_s(by_hand):.2f} x",
            "",
            f"{_most_mb(ours) / _most_mb(by_hand):.2f} x",
            "",
        )
    Console(width=110).print(table)
    kept = (
        _median_s(runs["voice and hands"]) <= ARMED_BAR_S
        and _most_mb(runs["voice"]) <= VOICE_BAR_MB
        and _most_mb(runs["voice and hands"]) <= BOTH_BAR_MB
    )
    return 0 if kept else 1


def _median_s(each: list[Started]) -> float:
    return statistics.median(one.after_s for one in each)


def _most_mb(each: list[Started]) -> float:
    return max(one.memory_mb for one in each)


if __name__ == "__main__":
    sys.exit(main())
