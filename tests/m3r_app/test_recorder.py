"""The flight record: lossless, readable after a kill or at any cut, quiet when the disk fails, cheap to call."""

from __future__ import annotations

import json
import math
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from m3r_app.plain import ARRAY_LENGTH, plain, restored
from m3r_app.record import recorder as recorder_module
from m3r_app.record.foxglove_schemas import SCHEMAS
from m3r_app.record.recorder import SCHEMA_VERSION, Recorder, RecordError, read_header, read_record
from safety.vocabulary import Finding, Ned, VehicleState

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
TELEMETRY = {
    "vehicle": "red",
    "position": Ned(1.0, 2.0, -3.0),
    "yaw_deg": 90.0,
    "geodetic": (33.2, -98.3, 400.0),
    "sigma_h_m": 0.5,
    "sigma_v_m": 0.8,
}
MESSAGES: list[tuple[str, float, dict[str, Any]]] = [
    ("request", 0.5, {"id": "r1", "command": "go_left", "confidence": 0.9}),
    ("decision", 0.6, {"request": "r1", "findings": [Finding("agl", ("G5",), 1.25, "m", True, "1.25 m to spare")]}),
    ("telemetry", 0.7, TELEMETRY),
    ("setpoint", 0.8, {"position": Ned(1.0, 2.0, -3.0), "yaw_deg": 0.0}),
    ("plan", 0.9, {"points_ned_m": np.array([[0.0, 0.0, -5.0], [0.0, 1.0, -5.0]]), "length_m": 1.0}),
    ("announce", 1.0, {"text": "moved 1.0 m left"}),
    ("violation", 1.1, {"kind": "predicted", "requirements": ["R9"], "margin": -0.1}),
    ("mode", 1.2, {"mode": "Blocked", "cause": "guards"}),
]


def no_failure(sentence: str) -> None:
    raise AssertionError(sentence)


def write(path: Path, messages: list[tuple[str, float, dict[str, Any]]] = MESSAGES) -> None:
    made = Recorder(path, {"app_version": "0", "settings": {"neighbours": "none"}}, no_failure)
    for topic, t_s, data in messages:
        made.record(topic, t_s, data)
    made.close()


def as_read(messages: list[tuple[str, float, dict[str, Any]]]) -> list[tuple[str, float, dict[str, Any]]]:
    return [(topic, t_s, plain(data, lossless=True)) for topic, t_s, data in messages]


def test_what_is_recorded_is_read(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    write(path)
    assert list(read_record(path)) == as_read(MESSAGES)
    header = read_header(path)
    assert header.complete
    assert header.metadata == {
        "schema_version": SCHEMA_VERSION,
        "app_version": "0",
        "settings": {"neighbours": "none"},
    }


def test_values_that_json_lacks_come_back(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    state = VehicleState(1.0, Ned(0, 0, -5), Ned(0, 0, 0), 0.0)
    write(path, [("telemetry", 1.0, {"state": state, "feed_at_s": -math.inf, "until_s": math.inf})])
    ((_, _, data),) = read_record(path)
    assert math.isnan(data["state"]["sigma_h_m"])
    assert data["feed_at_s"] == -math.inf
    assert data["until_s"] == math.inf
    assert data["state"]["position"] == [0, 0, -5]


class Colour(StrEnum):
    RED = "red"


@dataclass
class Inner:
    where: Path
    colour: Colour


@pytest.mark.parametrize(
    ("value", "lossless", "lossy"),
    [
        (math.nan, "NaN", None),
        (np.float64("-inf"), "-Infinity", None),
        (np.float32(0.5), 0.5, 0.5),
        (np.int64(3), 3, 3),
        (np.bool_(True), True, True),
        (True, True, True),
        (Colour.RED, "red", "red"),
        (Ned(1.0, math.inf, 3.0), [1.0, "Infinity", 3.0], [1.0, None, 3.0]),
        (np.array([[1.0, math.nan]]), [[1.0, "NaN"]], [[1.0, None]]),
        (np.array([1, 2]), [1, 2], [1, 2]),
        ({Colour.RED: frozenset({"b", "a"})}, {"red": ["a", "b"]}, {"red": ["a", "b"]}),
        (Inner(Path("a/b"), Colour.RED), {"where": "a/b", "colour": "red"}, {"where": "a/b", "colour": "red"}),
    ],
)
def test_plain(value: object, lossless: object, lossy: object) -> None:
    assert plain(value, lossless=True) == lossless
    assert plain(value, lossless=False) == lossy
    json.dumps([lossless, lossy], allow_nan=False)


def test_plain_names_a_large_array_by_its_digest() -> None:
    array = np.zeros(ARRAY_LENGTH + 1)
    told = plain(array, lossless=True)
    array[7] = 1.0
    assert told["shape"] == [ARRAY_LENGTH + 1]
    assert told["sha256"] != plain(array, lossless=True)["sha256"]
    assert isinstance(plain(array[:-1], lossless=True), list)


def test_restored_touches_only_the_three_names() -> None:
    assert restored({"text": "nan", "list": ["Infinity", "-Infinity", "inf"]}) == {
        "text": "nan",
        "list": [math.inf, -math.inf, "inf"],
    }


def test_other_readers_open_it(tmp_path: Path) -> None:
    """The indexed reader, as viewers use it; the views carry what Foxglove's schemas ask for."""
    path = tmp_path / "flight.mcap"
    write(path)
    seen = {}
    with path.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            data = json.loads(message.data)
            assert set(data) == set(json.loads(schema.data)["properties"])
            seen[channel.topic] = (schema.name, data)
    assert summary is not None
    assert summary.chunk_indexes
    assert {name for name, _ in seen.values()} >= set(SCHEMAS)
    fix = seen["/view/red/fix"][1]
    assert (fix["latitude"], fix["longitude"], fix["altitude"]) == (33.2, -98.3, 400.0)
    assert fix["position_covariance"] == [0.25, 0, 0, 0, 0.25, 0, 0, 0, pytest.approx(0.64)]
    frame = seen["/view/red/frame"][1]
    assert frame["translation"] == {"x": 2.0, "y": 1.0, "z": 3.0}
    assert frame["rotation"] == {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}  # nose east is no turn from x
    north = seen["/view/setpoint"][1]["pose"]["orientation"]
    assert (north["z"], north["w"]) == (pytest.approx(math.sqrt(0.5)), pytest.approx(math.sqrt(0.5)))
    (entity,) = seen["/view/scene/plan"][1]["entities"]
    assert entity["lines"][0]["points"][1] == {"x": 1.0, "y": 0.0, "z": 5.0}
    stamp = fix["timestamp"]
    assert abs(stamp["sec"] + stamp["nsec"] / 1e9 - time.time()) < 60


def test_telemetry_without_a_place_has_no_view(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    write(path, [("telemetry", 1.0, {"vehicle": "red", "position": Ned(math.nan, 0, 0), "yaw_deg": 0.0})])
    with path.open("rb") as file:
        assert {channel.topic for _, channel, _ in make_reader(file).iter_messages()} == {"telemetry", "link"}


def test_every_cut_leaves_a_readable_beginning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("m3r_app.record.recorder.CHUNK_BYTES", 4096)  # several of them in a short record
    path, cut = tmp_path / "flight.mcap", tmp_path / "cut.mcap"
    messages = [("setpoint", i / 50, {"position": Ned(i, -i, 0.5 * i), "yaw_deg": float(i)}) for i in range(120)]
    write(path, messages)
    whole, expected = path.read_bytes(), as_read(messages)
    longest_unreadable_bytes = 0
    counts = []
    for length_bytes in range(len(whole) - 1, 0, -41):
        cut.write_bytes(whole[:length_bytes])
        try:
            read = list(read_record(cut))
        except RecordError:
            longest_unreadable_bytes = max(longest_unreadable_bytes, length_bytes)
            continue
        assert read == expected[: len(read)]
        assert not read_header(cut).complete
        counts.append(len(read))
    assert counts == sorted(counts, reverse=True)
    assert len(set(counts)) > 3  # it is written in several chunks
    assert longest_unreadable_bytes < 400  # only a cut inside the metadata leaves nothing to read


def test_damage_ends_the_reading(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("m3r_app.record.recorder.CHUNK_BYTES", 4096)  # several of them in a short record
    path = tmp_path / "flight.mcap"
    messages = [("request", float(i), {"id": f"r{i}", "evidence": "go left " * 5}) for i in range(200)]
    write(path, messages)
    damaged = bytearray(path.read_bytes())
    second_chunk = damaged.find(ZSTD_MAGIC, damaged.find(ZSTD_MAGIC) + 1)
    damaged[second_chunk + 40] ^= 0xFF
    path.write_bytes(damaged)
    read = list(read_record(path))
    assert 0 < len(read) < len(messages)
    assert read == messages[: len(read)]


KILLED = """
import sys
from pathlib import Path
from m3r_app.record.recorder import Recorder
made = Recorder(Path(sys.argv[1]), {}, print)
i = 0
while True:
    made.record("setpoint", i / 50, {"position": [i, 0, 0], "yaw_deg": 0.0})
    i += 1
    if i % 100 == 0:
        print(i, flush=True)
        sys.stdin.readline()
"""


def test_a_killed_app_leaves_its_record(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    with subprocess.Popen(
        [sys.executable, "-c", KILLED, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as app:
        assert app.stdin is not None
        assert app.stdout is not None
        for _ in range(14):
            app.stdout.readline()
            app.stdin.write("\n")
            app.stdin.flush()
        deadline = time.monotonic() + 20
        while len(list(read_record(path))) < 1150:  # of 1,500; the rest lies in the chunk being filled
            assert time.monotonic() < deadline
        app.send_signal(signal.SIGKILL)
    read = list(read_record(path))
    assert [data["position"][0] for _, _, data in read] == list(range(len(read)))
    assert len(read) >= 1150
    assert not read_header(path).complete


FULL = """
import resource, signal, sys
from pathlib import Path
from m3r_app.record.recorder import Recorder
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
made = Recorder(Path(sys.argv[1]), {}, print)
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
for i in range(5000):
    made.record("setpoint", i / 50, {"position": [i, 0, 0], "yaw_deg": 0.0})
made.close()
made.record("setpoint", 100.0, {})
made.close()
"""


def test_a_disk_that_fills_is_reported_once_and_stops_nothing(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    done = subprocess.run(
        [sys.executable, "-c", FULL, str(path)], capture_output=True, text=True, check=True, timeout=60
    )
    assert done.stderr == ""
    assert done.stdout == f"flight record {path} is incomplete from here on: File too large\n"
    read = list(read_record(path))
    assert [data["position"][0] for _, _, data in read] == list(range(len(read)))
    assert len(read) > 50


def test_a_message_that_cannot_be_written_leaves_a_gap_that_is_told(tmp_path: Path) -> None:
    told: list[str] = []
    path = tmp_path / "flight.mcap"
    made = Recorder(path, {}, told.append)
    loop: dict[str, Any] = {}
    loop["self"] = loop
    for i in range(3):
        made.record("input", float(i), loop if i == 1 else {})
    made.close()
    assert told == [f"flight record {path} has gaps: one input message could not be written (RecursionError)"]
    assert [(topic, t_s) for topic, t_s, _ in read_record(path)] == [
        ("input", 0.0),
        ("input", 2.0),
        ("record_gap", 2.0),
    ]
    assert read_header(path).complete


def test_falling_behind_is_said_in_the_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder_module, "QUEUE_LENGTH", 10)
    go_on, told = threading.Event(), []

    class Slow(dict[str, Any]):
        def keys(self) -> Any:
            assert go_on.wait(20)
            return super().keys()

        def __iter__(self) -> Any:
            return iter(self.keys())

    path = tmp_path / "flight.mcap"
    made = Recorder(path, {}, told.append)
    made.record("input", 0.0, Slow(a=1))
    for i in range(1, 101):
        made.record("input", float(i), {"a": i})
    go_on.set()
    made.close()
    topics = Counter(topic for topic, _, _ in read_record(path))
    dropped = sum(data["dropped"] for topic, _, data in read_record(path) if topic == "record_gap")
    assert topics["input"] + dropped == 101
    assert dropped >= 89
    assert told == [f"flight record {path} has gaps: writing it falls behind"]


def test_close_twice_and_from_two_threads(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    made = Recorder(path, {}, no_failure)
    made.record("announce", 0.0, {"text": "hello"})
    threads = [threading.Thread(target=made.close) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    made.close()
    assert [topic for topic, _, _ in read_record(path)] == ["announce"]
    assert read_header(path).complete


def test_recording_costs_the_caller_little(tmp_path: Path) -> None:
    made = Recorder(tmp_path / "flight.mcap", {}, no_failure)
    costs = []
    for i in range(2000):
        started = time.perf_counter()
        made.record("telemetry", i / 50, TELEMETRY)
        costs.append(time.perf_counter() - started)
    made.close()
    assert sorted(costs)[len(costs) // 2] < 50e-6


@pytest.mark.parametrize("name", ["missing/flight.mcap", "."])
def test_where_no_file_can_be_is_one_sentence(tmp_path: Path, name: str) -> None:
    with pytest.raises(RecordError, match=r"^flight record .* cannot be written: ") as caught:
        Recorder(tmp_path / name, {}, no_failure)
    assert "\n" not in str(caught.value)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_at_the_start_is_one_sentence() -> None:
    with pytest.raises(RecordError, match="cannot be written: No space left on device"):
        Recorder(Path("/dev/full"), {}, no_failure)


def test_nothing_is_written_over(tmp_path: Path) -> None:
    """Neither a file of somebody's nor an older flight, which cannot be flown again; an empty file holds nothing."""
    notes, flight = tmp_path / "notes.txt", tmp_path / "flight.mcap"
    notes.write_text("keep me")
    with pytest.raises(RecordError, match="exists already and is not written over"):
        Recorder(notes, {}, no_failure)
    assert notes.read_text() == "keep me"
    flight.write_text("")
    write(flight)
    before = flight.read_bytes()
    with pytest.raises(RecordError, match=r"flight\.mcap exists already"):
        write(flight, MESSAGES[:1])
    assert flight.read_bytes() == before


def test_what_is_no_record_is_one_sentence(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    with pytest.raises(RecordError, match="cannot be read: No such file"):
        list(read_record(path))
    for content in (b"", b"M3R", b"\x89MCAP0\r\n", b"\x89MCAP0\r\n" + b"\xff" * 100):
        path.write_bytes(content)
        with pytest.raises(RecordError, match="not a flight record"):
            list(read_record(path))


def test_a_newer_record_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "flight.mcap"
    monkeypatch.setattr(recorder_module, "SCHEMA_VERSION", SCHEMA_VERSION + 1)
    write(path)
    monkeypatch.undo()
    with pytest.raises(RecordError, match="use a newer m3r"):
        list(read_record(path))
