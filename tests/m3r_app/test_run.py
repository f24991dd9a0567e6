"""The whole app flies the simulated fleet over real UDP; what is said is compared with the true state."""

from __future__ import annotations

import asyncio
import math
import os
import signal
import socket
import threading
import time
from collections import Counter
from itertools import pairwise
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common as mavlink

from m3r_app.record.recorder import read_header, read_record
from m3r_app.replay import replay
from m3r_app.step_record import read_flight, source_sha256
from modalities.models.catalogue import ModelError, find_hand_model, find_model
from safety.limits import Limits
from tests.whole import HILLSIDE, PLAIN, App, Ran, Simulated, m3r, simulated
from ui.verify import judge_record

STORY = """\
0.5 panel go right
1.5 panel stop
3.5 panel continue
8.5 voice go up confidence=0.3
9.0 gesture go left
9.3 voice go right
12.0 voice go left
12.4 gesture go left
17.0 panel turn right
18.5 panel go down
"""


NOBODY = ("--video", "camera:99", "--audio", "mic:nobody")
GIMBAL = '[[vehicles.red.events]]\nkind = "component"\n'


def missing_model() -> str:
    """What is missing, or empty. Without the models a camera or a microphone that is named is bad input."""
    try:
        find_hand_model()
        find_model()
    except ModelError as error:
        return f"no hand model or no voice model: {error}"
    return ""


@pytest.fixture(scope="module")
def stories() -> list[tuple[Ran, Simulated, Path]]:
    """The stories flown so far."""
    return []


@pytest.fixture
def story(
    stories: list[tuple[Ran, Simulated, Path]], request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Ran, Simulated, Path]:
    """The story, flown once for all its tests; and anew for one of them that is tried again."""
    if not stories or getattr(request.node, "execution_count", 1) > 1:
        stories.append(fly_the_story(tmp_path_factory.mktemp("story")))
    return stories[-1]


def fly_the_story(folder: Path) -> tuple[Ran, Simulated, Path]:
    """One run of a story on flat ground, recorded; beside a gimbal, and with a camera and a microphone that are not there."""
    scenario = folder / "scenario.toml"
    failsafe = "COM_OBL_RC_ACT = 5 }\n"
    plain = PLAIN.read_text()
    assert failsafe in plain
    scenario.write_text(plain.replace(failsafe, failsafe + GIMBAL, 1))
    script = folder / "story.txt"
    script.write_text(STORY)
    record = folder / "story.mcap"
    with simulated(scenario, folder) as sim:
        arguments = ["run", "--headless", "--pair", "red", "--script", str(script), "--record", str(record)]
        absent = () if missing_model() else NOBODY
        ran = m3r(*arguments, *sim.vehicles, "--scenario", str(PLAIN), *absent)
        sim.wait("red", mode="LOITER")
    return ran, sim, record


@pytest.mark.xdist_group("story")
def test_a_story_ends_normally(story: tuple[Ran, Simulated, Path]) -> None:
    """The contract: strict JSON only, `end` last, exit 0, every object stamped in order."""
    ran, _, _ = story
    assert ran.status == 0, ran.told
    assert ran.events[-1]["event"] == "end"
    assert ran.events[-1]["reason"] == "inputs_played"
    assert ran.events[-1]["violations"] == 0
    assert all(a["t"] <= b["t"] for a, b in pairwise(ran.events))


@pytest.mark.xdist_group("story")
def test_every_maneuver_request_gets_exactly_one_final_decision(story: tuple[Ran, Simulated, Path]) -> None:
    """The contract; STOP gets none."""
    ran, _, _ = story
    asked = {e["id"] for e in ran.of("request") if e["command"] != "stop"}
    decided = [e["request"] for e in ran.of("decision") if e["verdict"] != "delayed"]
    assert sorted(decided) == sorted(asked)
    verdicts = ran.verdicts()
    assert verdicts["script-1"] == "approved"
    assert verdicts["script-3"] == "approved"  # continue: what stop left
    assert verdicts["script-4"] == "rejected"  # confidence 0.3
    assert verdicts["script-6"] == "rejected"  # contradicts the gesture
    assert verdicts["script-7"] == "approved"
    assert "script-8" not in verdicts  # it confirmed script-7 and never flies twice


@pytest.mark.xdist_group("story")
def test_a_low_confidence_request_is_blocked_and_says_why(story: tuple[Ran, Simulated, Path]) -> None:
    """The paper's temporal property: detected with low confidence, so the next state is Blocked."""
    ran, _, _ = story
    decision = ran.of("decision", request="script-4")[0]
    failing = [f for f in decision["findings"] if not f["passed"]]
    assert [f["constraint"] for f in failing] == ["input_confidence"]
    states = [e["state"] for e in ran.of("mode")]
    after = {b for a, b in pairwise(states) if a == "ManeuverRequestDetected"}
    assert after == {"Blocked", "ManeuverRequestValidated"}


@pytest.mark.requirement("X4", "X12")
@pytest.mark.xdist_group("story")
def test_stop_ends_the_motion_and_continue_takes_up_the_rest(story: tuple[Ran, Simulated, Path]) -> None:
    """X4, X12."""
    ran, _, _ = story
    aborted = ran.of("motion", request="script-1", status="aborted")[0]
    decision = ran.of("decision", request="script-3")[0]
    gone_m = math.hypot(*aborted["displacement_enu_m"])
    assert decision["requested_m"] == pytest.approx(1.0 - gone_m, abs=0.05)


@pytest.mark.xdist_group("story")
def test_the_measured_motion_is_the_true_motion(story: tuple[Ran, Simulated, Path]) -> None:
    """Bounds hold on the true state: speed, turn rate, displacement."""
    ran, sim, _ = story
    states = sim.states("red")
    limits = Limits()
    assert max(math.hypot(*s["velocity_m_s"]) for s in states) <= limits.speed_m_s + 0.1
    rates = [
        abs(math.remainder(b["yaw_deg"] - a["yaw_deg"], 360.0)) / (b["t"] - a["t"])
        for a, b in zip(states[::25], states[25::25], strict=False)
        if b["t"] > a["t"]
    ]
    assert max(rates) <= limits.yaw_rate_deg_s + 2.0
    left = ran.of("motion", request="script-7", status="completed")[0]
    assert left["displacement_enu_m"][0] == pytest.approx(-1.0, abs=0.15)
    assert left["max_speed_m_s"] <= limits.speed_m_s + limits.speed_tolerance_m_s


@pytest.mark.xdist_group("story")
def test_an_interrupted_turn_is_followed_by_facing_the_operator(story: tuple[Ran, Simulated, Path]) -> None:
    """Design 13: the nose is on the operator again when the next plan has been flown."""
    ran, sim, _ = story
    assert ran.of("motion", request="script-9", status="aborted")
    assert ran.of("motion", request="script-10", status="completed")
    last = sim.last("red")
    bearing_deg = math.degrees(math.atan2(-last["ned_m"][1], -last["ned_m"][0]))
    assert abs(math.remainder(last["yaw_deg"] - bearing_deg, 360.0)) < 10.0


@pytest.mark.xdist_group("story")
def test_the_drone_is_left_in_hold(story: tuple[Ran, Simulated, Path]) -> None:
    """Contract, design 15."""
    ran, sim, _ = story
    assert ran.of("pair", status="released")
    assert sim.last("red")["mode"] == "LOITER"
    assert sim.last("red")["armed"]


@pytest.mark.requirement("X3", "X6", "X8")
@pytest.mark.xdist_group("story")
def test_a_gimbal_beside_the_autopilot_changes_nothing(story: tuple[Ran, Simulated, Path]) -> None:
    """Its messages were taken for the autopilot's."""
    ran, sim, _ = story
    assert ran.status == 0 and ran.of("motion", status="completed")
    assert sim.last("red")["mode"] == "LOITER"


@pytest.mark.xdist_group("story")
def test_without_the_camera_and_the_microphone_the_rest_flies(story: tuple[Ran, Simulated, Path]) -> None:
    ran, _, _ = story
    if why := missing_model():
        pytest.skip(why)
    assert ran.status == 0, ran.told
    texts = [a["text"] for a in ran.of("announce")]
    assert "hands are off: camera:99 gives no picture: check that it is there and that nothing else uses it" in texts
    assert any(text.startswith("voice is off: there is no ") for text in texts)
    assert ran.of("motion", status="completed")


@pytest.mark.requirement("R9")
@pytest.mark.xdist_group("story")
def test_an_independent_judge_finds_nothing_to_object_to(story: tuple[Ran, Simulated, Path]) -> None:
    """By a geometry of its own, over every sample of the arbiter's steps."""
    ran, _, record = story
    found = judge_record(record)
    assert found.failing == ()
    assert found.plans == len(ran.of("motion", status="started"))
    assert found.samples > 500


@pytest.mark.xdist_group("story")
def test_the_record_holds_all_of_it(story: tuple[Ran, Simulated, Path]) -> None:
    """Inputs, decisions with findings, setpoints, telemetry, modes."""
    ran, _, record = story
    assert read_header(record).complete
    topics: dict[str, int] = {}
    for topic, _, _ in read_record(record):
        topics[topic] = topics.get(topic, 0) + 1
    assert topics["decision"] == len(ran.of("decision"))
    assert topics["mode"] == len(ran.of("mode"))
    flown_s = ran.events[-1]["t"] - ran.of("pair", status="confirmed")[0]["t"]
    assert topics["setpoint"] > 40 * flown_s
    assert topics["telemetry"] > 7 * flown_s
    told = Counter(type(one.event).__name__ for one in read_flight(record).steps())
    assert told["TelemetryArrived"] > 30 * flown_s and told["Tick"] > 7 * flown_s
    assert {"input", "plan", "neighbours", "end"} <= topics.keys()


@pytest.mark.requirement("R9")
def test_the_record_is_decided_the_same_again(story: tuple[Ran, Simulated, Path]) -> None:
    """Bit for bit, every effect and every state of a whole run."""
    _, _, record = story
    found = replay(record, source_sha256())
    assert found.whole and found.same_source and found.difference is None
    assert found.steps > 500


# ---------------------------------------------------------------- ends that nobody wishes for


def flying(sim: Simulated) -> list[str]:
    """Red of the plain scenario, its script on standard input."""
    return ["run", "--headless", "--pair", "red", "--script", "-", *sim.vehicles, "--scenario", str(PLAIN)]


LONG = "0.2 panel turn right\n60 panel go left\n"


def test_ctrl_c_in_mid_maneuver_holds_and_exits_130(tmp_path: Path) -> None:
    """Contract: Hold, record closed and readable, exit 130."""
    record = tmp_path / "r.mcap"
    with simulated(PLAIN, tmp_path) as sim:
        app = App(
            [*flying(sim), "--record", str(record)],
            stdin=LONG,
        )
        app.until("motion", status="started")
        app.process.send_signal(signal.SIGINT)
        ran = app.finish()
        assert ran.status == 130
        assert ran.events[-1]["reason"] == "interrupted"
        assert ran.of("motion", status="aborted")
        sim.wait("red", mode="LOITER")
        assert sim.last("red")["armed"]
    assert read_header(record).complete
    assert "Traceback" not in ran.told


@pytest.mark.requirement("X7")
def test_a_killed_app_goes_no_further_than_its_step(tmp_path: Path) -> None:
    """X7: setpoints stop, the autopilot's own failsafe holds; the record is readable up to the kill."""
    record = tmp_path / "r.mcap"
    with simulated(PLAIN, tmp_path) as sim:
        app = App(
            [*flying(sim), "--record", str(record)],
            stdin="0.2 panel go left\n60 panel go left\n",
        )
        app.until("motion", status="started")
        start = sim.last("red")
        app.process.kill()
        app.process.communicate()
        sim.wait("red", mode="LOITER")
        end = sim.last("red")
        assert math.dist(start["ned_m"], end["ned_m"]) <= Limits().lateral_step_m + 0.3
    assert not read_header(record).complete
    assert any(topic == "telemetry" for topic, _, _ in read_record(record))


@pytest.mark.requirement("X7")
def test_a_frozen_app_is_ended_and_the_drone_holds(tmp_path: Path) -> None:
    """X7: the interpreter itself stuck (here: stopped); the outer guard ends it, the autopilot's failsafe holds."""
    with simulated(PLAIN, tmp_path) as sim:
        app = App(
            flying(sim),
            stdin=LONG,
        )
        app.until("motion", status="started")
        os.kill(app.process.pid, signal.SIGSTOP)
        app.process.wait(10.0)
        assert app.process.returncode == -signal.SIGKILL
        sim.wait("red", mode="LOITER")


def other_station_lands(address: str) -> None:
    """A second ground station commands AUTO.LAND. MAVLink: COMMAND_LONG, MAV_CMD_DO_SET_MODE."""
    host, port = address.removeprefix("udpout://").split(":")
    station = mavlink.MAVLink(None, srcSystem=250, srcComponent=190)
    command = station.command_long_encode(1, 1, mavlink.MAV_CMD_DO_SET_MODE, 0, 1, 4, 6, 0, 0, 0, 0)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.sendto(command.pack(station), (host, int(port)))


@pytest.mark.requirement("X3")
def test_a_takeover_ends_the_session_and_is_not_fought(tmp_path: Path) -> None:
    """X3: another ground station lands the drone; nothing of ours brings it back."""
    with simulated(PLAIN, tmp_path) as sim:
        app = App(
            flying(sim),
            stdin="0.2 panel turn right\n2.5 panel stop\n3 panel go left\n",
        )
        app.until("motion", status="started")
        other_station_lands(sim.also["red"])
        released = app.until("pair", status="released")
        assert "LAND" in released["reasons"][0]
        ran = app.finish()
        assert sim.last("red")["mode"] == "LAND"
        assert ran.verdicts()["script-3"] == "rejected"
        assert [f["constraint"] for f in ran.of("decision", request="script-3")[0]["findings"]] == ["paired"]


def test_a_vehicle_that_falls_silent_ends_the_run(tmp_path: Path) -> None:
    """Exit 3, reason vehicle_lost."""
    with simulated(PLAIN, tmp_path) as sim:
        app = App(
            flying(sim),
            stdin=LONG,
        )
        app.until("motion", status="started")
        os.kill(sim.process.pid, signal.SIGSTOP)
        try:
            ran = app.finish()
        finally:
            os.kill(sim.process.pid, signal.SIGCONT)
    assert ran.status == 3
    assert ran.events[-1]["reason"] == "vehicle_lost"
    assert ran.of("motion", status="aborted")


AIMED = """
name = "aimed"
[origin]
lat_deg = 46.9480
lon_deg = 7.4474
ground_amsl_m = 540.0
[operator]
lat_deg = 46.9480
lon_deg = 7.4474
amsl_m = 540.0
sigma_m = 0.2
[terrain]
flat_amsl_m = 540.0
sigma_m = 0.1
[vehicles.red]
north_m = 14.0
east_m = 0.0
height_m = 6.0
heading_deg = 180.0
state = "hold"
params = { COM_OF_LOSS_T = 0.5, COM_OBL_RC_ACT = 5 }
[traffic.rogue]
waypoints = [[15.0, -18.0, 6.0], [15.0, 18.0, 6.0]]
speed_m_s = 3.0
loop = false
start_delay_s = 2.0
"""


def test_an_actual_violation_is_told_and_exits_4(tmp_path: Path) -> None:
    """Somebody flies through the drone's separation while it hovers: nothing of ours, but a violation all the same."""
    scenario = tmp_path / "aimed.toml"
    scenario.write_text(AIMED)
    ran = m3r(
        "run", "--headless", "--pair", "red", "--script", "-", "--scenario", str(scenario), "--timeout", "40",
        stdin="9 panel stop\n",
    )  # fmt: skip
    assert ran.status == 4, ran.told
    violation = ran.of("violation", kind="actual")[0]
    assert "R6" in violation["requirements"]
    assert violation["margin"] < 0.0
    assert ran.events[-1]["violations"] >= 1


@pytest.mark.requirement("X8")
def test_a_drone_with_default_failsafes_is_refused_with_the_remedy(tmp_path: Path) -> None:
    """X8: read back, refused with the list; --apply-failsafe and --takeoff make it fly."""
    ran = m3r("run", "--headless", "--pair", "blue", "--scenario", str(HILLSIDE))
    assert ran.status == 3
    reasons = " ".join(ran.of("pair", status="refused")[0]["reasons"])
    assert "COM_OBL_RC_ACT" in reasons
    assert "--apply-failsafe" in reasons
    assert "not in the air" in reasons


@pytest.mark.requirement("X8")
def test_apply_failsafe_and_takeoff_make_a_drone_on_the_ground_fit(tmp_path: Path) -> None:
    """X8, design 12, 15: what was refused above, with the remedy applied; left in Hold at the end."""
    with simulated(HILLSIDE, tmp_path) as sim:
        ran = m3r(
            "run", "--headless", "--pair", "blue", "--apply-failsafe", "--takeoff", "6", "--script", "-", *sim.vehicles,
            "--scenario", str(HILLSIDE), stdin="0.5 panel go up\n",
        )  # fmt: skip
        assert ran.verdicts() == {"script-1": "approved"}, ran.told
        assert ran.of("motion", status="completed")
        assert sim.last("blue")["mode"] == "LOITER"


@pytest.mark.requirement("X4")
def test_stop_ends_a_take_off_before_pairing(tmp_path: Path) -> None:
    """X4: whatever this app has set in motion is held."""
    with simulated(HILLSIDE, tmp_path) as sim:
        app = App(
            ["run", "--headless", "--apply-failsafe", "--takeoff", "20", "--script", "-", *sim.vehicles,
             "--scenario", str(HILLSIDE)],
            stdin="0.2 panel activate blue\n3.5 panel stop\n",
        )  # fmt: skip
        app.until("request", command="stop")
        low = sim.last("blue")
        ran = app.finish()
        assert ran.of("pair", vehicle="blue", status="refused")
        assert sim.last("blue")["mode"] == "LOITER"
        climbed_m = sim.states("blue")[0]["ned_m"][2] - sim.last("blue")["ned_m"][2]
        assert climbed_m < 15.0, low


# ---------------------------------------------------------------- bad input

BAD: list[tuple[list[str], str]] = [
    (["--pair", "purple"], "purple"),
    (["--script", "/nowhere/at/all"], "/nowhere/at/all"),
    (["--audio", "/nowhere/at/all.wav"], "/nowhere/at/all.wav"),
    (["--scenario", "/nowhere/at/all.toml"], "/nowhere/at/all.toml"),
    (["--set", "envelope.speed=1"], "envelope.speed"),
    (["--set", "envelope.speed_m_s=99"], "envelope.speed_m_s"),
    (["--config", "/nowhere/at/all.toml"], "/nowhere/at/all.toml"),
    (["--operator", "95,0,0"], "95"),
    (["--timeout", "-1"], "-1"),
    (["--nonsense"], "--nonsense"),
    (["--record", "/nowhere/at/all.mcap"], "/nowhere/at/all.mcap"),
]


@pytest.mark.parametrize(("arguments", "named"), BAD, ids=[" ".join(a) for a, _ in BAD])
def test_bad_input_is_one_sentence_that_names_it(arguments: list[str], named: str) -> None:
    """Exit 2, no traceback, nothing flown."""
    ran = m3r("run", "--headless", *arguments)
    assert ran.status == 2
    sentences = [line for line in ran.told.splitlines() if line.startswith("m3r: ")]
    assert len(sentences) == 1, ran.told
    assert named in sentences[0]
    assert "Traceback" not in ran.told


def test_a_vehicle_that_never_answers_is_exit_3() -> None:
    """The link is fine, nobody is there."""
    from m3r_app.ports import free_udp_block

    url = f"udpin://127.0.0.1:{free_udp_block(1)}"
    began_s = time.monotonic()
    ran = m3r("run", "--headless", "--pair", "red", "--vehicle", f"red={url}", "--set", "pairing.answer_s=1")
    assert ran.status == 3
    assert ran.events[-1]["reason"] == "vehicle_lost"
    assert url in ran.told
    assert time.monotonic() - began_s < 20.0


async def test_models_load_while_the_fleet_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each takes a second or more; neither waits for the other."""
    from m3r_app import run
    from m3r_app.options import RunOptions

    looking, given_up = threading.Event(), asyncio.Event()

    async def connect(*_: object) -> None:
        looking.set()
        try:
            await asyncio.Event().wait()
        finally:
            given_up.set()

    def load(*_: object) -> None:
        raise ValueError("loaded meanwhile" if looking.wait(5.0) else "the fleet was not looked for")

    monkeypatch.setattr(run.Run, "_connect", connect)
    monkeypatch.setattr(run, "open_inputs", load)
    with pytest.raises(ValueError, match="loaded meanwhile"):
        await run.Run(RunOptions(), lambda _told: None).whole()
    assert given_up.is_set()


def test_bad_input_does_not_wait_for_a_vehicle_that_never_answers(tmp_path: Path) -> None:
    """Inputs are loaded while the vehicle is looked for: what is wrong with them ends the search."""
    from m3r_app.ports import free_udp_block

    url = f"udpin://127.0.0.1:{free_udp_block(1)}"
    began_s = time.monotonic()
    ran = m3r(
        "run", "--headless", "--pair", "red", "--vehicle", f"red={url}", "--set", "pairing.answer_s=60",
        "--script", str(tmp_path / "none.txt"),
    )  # fmt: skip
    assert ran.status == 2
    assert "none.txt" in ran.told
    assert url not in ran.told
    assert time.monotonic() - began_s < 20.0


def test_a_port_that_somebody_holds_is_exit_2(tmp_path: Path) -> None:
    """MAVSDK would share it silently and lose telemetry."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as held:
        held.bind(("127.0.0.1", 0))
        port = held.getsockname()[1]
        ran = m3r("run", "--headless", "--pair", "red", "--vehicle", f"red=udpin://127.0.0.1:{port}")
    assert ran.status == 2
    assert str(port) in ran.told


def test_a_dry_run_told_plainly_flies_nothing(tmp_path: Path) -> None:
    """Every event is a sentence; requests are decided, and the drone stays where it was paired."""
    with simulated(PLAIN, tmp_path) as sim:
        script = tmp_path / "story.txt"
        script.write_text("0.5 panel go right\n1.5 voice go up confidence=0.3\n2.5 panel turn left\n")
        asked = ["run", "--dry-run", "--plain", "--pair", "red", "--script", str(script), "--scenario", str(PLAIN)]
        app = App([*asked, *sim.vehicles])
        out, told = (text.decode() for text in app.process.communicate(timeout=60.0))
        assert app.process.returncode == 0, told
        before, after = sim.states("red")[0]["ned_m"], sim.last("red")["ned_m"]
        assert math.dist(before, after) < 0.5
    said = [line.partition(" s  ")[2] for line in out.splitlines()]
    assert "request script-1 is approved, 1.00 m of 1.00 m" in said
    assert "dry run, Red: right 1.00 m" in said
    assert any(line.startswith("request script-2 is rejected; voice confidence 0.30, 0.70 needed") for line in said)
    assert "dry run, Red: turn left" in said
    assert not any(line.startswith("request script-") and ("started" in line or "completed" in line) for line in said)
    assert said[-1].startswith("ended (inputs_played): 3 requests, 2 approved, 1 rejected, 0 completed, 0 aborted")
