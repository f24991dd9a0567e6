"""The simulated fleet as a process: it says where to listen, keeps real time, ends when told, and when its parent ends."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from m3r_app.environment.scenario import SHIPPED, load_scenario
from m3r_app.sim.__main__ import main
from m3r_app.sim.fleet import LATE_S, SETTLE_S, Fleet
from m3r_app.sim.guidance import TICK_S
from tests.m3r_app.sim.fleet_process import FleetProcess
from tests.whole import ROOT

PLAIN = (SHIPPED / "plain.toml").read_text(encoding="utf-8")


def test_says_where_to_listen_and_ends_when_told() -> None:
    with FleetProcess(SHIPPED / "hillside.toml", 4) as fleet:
        assert list(fleet.vehicles) == ["red", "green", "blue"]
        assert list(fleet.traffic) == ["courier"]
        urls = [*fleet.vehicles.values(), *fleet.traffic.values()]
        assert all(re.fullmatch(r"udpin://127\.0\.0\.1:\d+", url) for url in urls)
        assert len(set(urls)) == 4
        fleet.process.terminate()
        assert fleet.process.wait(10.0) == 0


def test_ends_when_its_parents_end_of_the_pipe_closes() -> None:
    with FleetProcess(SHIPPED / "plain.toml", 3) as fleet:
        assert fleet.process.stdin is not None
        fleet.process.stdin.close()
        assert fleet.process.wait(10.0) == 0
        fleet.process.stdin = None


@pytest.mark.parametrize(
    ("old", "new", "options", "reason"),
    [
        ("seed", "sead", [], "sead: there is no such key"),
        ("COM_OF_LOSS_T", "COM_OF_LOS_T", [], "vehicles.red.params: there is no parameter COM_OF_LOS_T"),
        ("flat_amsl_m = 540.0", 'dem = "none.tif"', [], "none.tif does not exist"),
        ("seed", "seed", ["--port-base", "80"], "--port-base 80"),
        ("seed", "seed", ["--port-base", "65534"], "--port-base 65534"),
        ("seed", "seed", ["--truth", "/nowhere/truth.jsonl"], "/nowhere/truth.jsonl"),
    ],
    ids=lambda value: str(value)[:30],
)
def test_bad_input_is_one_sentence_and_status_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, options: list[str], reason: str
) -> None:
    path = tmp_path / "scenario.toml"
    path.write_text(PLAIN.replace(old, new, 1))
    assert main(["--scenario", str(path), *options]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert reason in said.err and len(said.err.splitlines()) == 1


def test_a_missing_scenario_file_ends_the_process_with_status_2(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "m3r_app.sim", "--scenario", str(tmp_path / "none.toml")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60.0, cwd=ROOT, check=False)
    assert done.returncode == 2 and done.stdout == ""
    assert "none.toml cannot be read" in done.stderr and len(done.stderr.splitlines()) == 1


def test_the_truth_is_written_for_every_drone_and_tick(tmp_path: Path) -> None:
    path = tmp_path / "truth.jsonl"
    with path.open("w") as truth:
        fleet = Fleet(load_scenario(SHIPPED / "plain.toml"), 40000, truth)
        for _ in range(5):
            fleet.tick()
        fleet.close()
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    assert [line["vehicle"] for line in lines[:3]] == ["red", "green", "blue"]
    assert [line["t"] for line in lines[::3]] == pytest.approx([TICK_S * i for i in range(1, 6)])
    red = fleet.links["red"].autopilot
    assert lines[-3]["ned_m"] == pytest.approx(list(red.drone.position), abs=1e-3)
    assert lines[-3]["ned_m"] != pytest.approx(lines[-3]["estimate_ned_m"], abs=1e-3)


def test_the_truth_tells_when_what_happened(tmp_path: Path) -> None:
    scenario, path = tmp_path / "scenario.toml", tmp_path / "truth.jsonl"
    event = '[[vehicles.red.events]]\nat_s = 0.1\nkind = "kill"\n'
    scenario.write_text(PLAIN.replace("COM_OBL_RC_ACT = 5 }", f"COM_OBL_RC_ACT = 5 }}\n{event}", 1))
    with path.open("w") as truth:
        fleet = Fleet(load_scenario(scenario), 40000, truth)
        for _ in range(10):
            fleet.tick()
        fleet.close()
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    red = [line for line in lines if line["vehicle"] == "red"]
    assert [line["events"] for line in red] == [[]] * 4 + [["kill"]] * 6
    assert [line["armed"] for line in red] == [True] * 4 + [False] * 6
    assert all("events" not in line for line in lines if line["vehicle"] != "red")


def test_the_same_seed_flies_the_same_flight_and_another_does_not() -> None:
    scenario = load_scenario(SHIPPED / "plain.toml")

    def flown(seed: int) -> tuple[float, ...]:
        fleet = Fleet(scenario.model_copy(update={"seed": seed}), 40000)
        for _ in range(50):
            fleet.step()
        fleet.close()
        return tuple(fleet.links["red"].autopilot.drone.position)

    assert flown(1) == flown(1)
    assert flown(1) != flown(2)


def test_it_keeps_real_time_and_does_not_catch_up_on_a_long_stall() -> None:
    fleet = Fleet(load_scenario(SHIPPED / "plain.toml"), 40000)
    red = fleet.links["red"].autopilot
    start_s, stalled = time.monotonic(), False

    def stopped() -> bool:
        nonlocal stalled
        if not stalled and red.now_s > SETTLE_S + 0.5:
            stalled = True
            # The process is held up, as by a debugger; not a wait for anything.
            time.sleep(5 * LATE_S)
        return time.monotonic() - start_s > 2.0 + 5 * LATE_S

    before_s = red.now_s
    fleet.run(stopped)
    fleet.close()
    assert red.now_s - before_s == pytest.approx(2.0, abs=LATE_S + 0.1)


def test_a_drone_that_starts_off_the_map_is_refused(tmp_path: Path) -> None:
    far = tmp_path / "far.toml"
    text = (SHIPPED / "hillside.toml").read_text().replace("north_m = 14.0", "north_m = 450.0")
    for name in ("hillside.tif", "hillside_obstacles.geojson", "hillside_fence.geojson"):
        text = text.replace(f'"{name}"', f'"{SHIPPED / name}"')
    far.write_text(text)
    with pytest.raises(ValueError, match=r"vehicles\.red starts where the terrain model has no data"):
        Fleet(load_scenario(far), 40000)
