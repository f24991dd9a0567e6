"""The autopilot's log as a second witness. The logs are synthetic, written here byte by byte as PX4 writes them."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pymap3d
import pytest

from m3r_app.evidence.reading import flight_of
from m3r_app.evidence.ulog import ESTIMATE, TRUTH, ULogError, read_tracks
from m3r_app.evidence.witness import compare, witnessed
from safety.vocabulary import Geodetic
from tests.m3r_app.evidence.recorded import RecordedFlight, Told
from ui import cli

ORIGIN = Geodetic(46.9, 7.4, 500.0)
THEIRS = Geodetic(46.9003, 7.3996, 480.0)
"""Where the autopilot's own frame lies."""
AHEAD_S = 1234.5
FIELDS = "uint64_t timestamp;float x;float y;float z;double ref_lat;double ref_lon;float ref_alt;bool xy_global;bool z_global;"


@pytest.fixture(scope="module")
def flown() -> Told:
    told = RecordedFlight(11, duration_s=16.5).told()
    told.metadata["origin"] = list(ORIGIN)
    return told


def message(kind: bytes, body: bytes) -> bytes:
    return struct.pack("<HB", len(body), kind[0]) + body


def write_ulog(path: Path, topics: dict[str, list[tuple[float, list[float]]]]) -> Path:
    """topics: (time on the log's clock, place in the record's frame) of each."""
    out = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0)]
    out += [message(b"F", f"{name}:{FIELDS}".encode()) for name in topics]
    out += [message(b"A", struct.pack("<BH", 0, i) + name.encode()) for i, name in enumerate(topics)]
    for i, samples in enumerate(topics.values()):
        for t_s, place in samples:
            theirs = pymap3d.geodetic2ned(*pymap3d.ned2geodetic(*place, *ORIGIN), *THEIRS)
            body = struct.pack("<HQfffddfBB", i, round(t_s * 1e6), *theirs, THEIRS[0], THEIRS[1], THEIRS[2], 1, 1)
            out.append(message(b"D", body))
    path.write_bytes(b"".join(out))
    return path


def seen(told: Told, *, off: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> list[tuple[float, list[float]]]:
    """What the record was told, on the autopilot's clock, 0.03 s earlier than it arrived."""
    return [
        (t_s + AHEAD_S - 0.03, [p + o for p, o in zip(data["position"], off, strict=True)])
        for t_s, data in told.of("telemetry")
    ]


def flight(told: Told) -> Any:
    return flight_of(told.metadata, told.messages, closed=True)


def test_clocks_are_set_by_the_positions_and_the_difference_is_told(flown: Told, tmp_path: Path) -> None:
    path = write_ulog(tmp_path / "log.ulg", {ESTIMATE: seen(flown, off=(0.06, 0.0, 0.08))})
    (track,) = read_tracks(path, ORIGIN)
    found = compare(flight(flown), track)
    assert found is not None
    assert found.offset_s == pytest.approx(AHEAD_S - 0.03, abs=0.02)
    assert found.rms_m == pytest.approx(0.1, abs=0.01)
    assert found.worst_m == pytest.approx(0.1, abs=0.03)


def test_a_witness_that_agrees_is_status_0_and_one_that_does_not_4(
    flown: Told, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record = str(flown.write(tmp_path / "flight.mcap"))
    good = write_ulog(tmp_path / "good.ulg", {ESTIMATE: seen(flown), TRUTH: seen(flown, off=(0.2, 0.1, 0.3))})
    assert cli.main(["verify", record, "--ulog", str(good)]) == 0
    assert f"{TRUTH}" in capsys.readouterr().out
    bad = write_ulog(tmp_path / "bad.ulg", {ESTIMATE: seen(flown, off=(0.5, 0.0, 0.0))})
    assert cli.main(["verify", record, "--ulog", str(bad)]) == 4
    assert f"FAILS: witness position of {ESTIMATE}" in capsys.readouterr().out


def test_a_truth_beyond_its_stated_accuracy_is_found(flown: Told, tmp_path: Path) -> None:
    path = write_ulog(tmp_path / "log.ulg", {TRUTH: seen(flown, off=(0.0, 0.6, 0.0))})
    (line,) = [x for x in witnessed(flight(flown), read_tracks(path, ORIGIN)) if x.limit == "position"]
    assert line.margin == pytest.approx(2.0 * 0.25 - 0.6, abs=0.03)
    assert not line.passed


def test_a_truth_that_broke_a_limit_is_found_though_nobody_was_told(flown: Told, tmp_path: Path) -> None:
    samples = seen(flown)
    samples[-20][1][2] -= 6.0
    path = write_ulog(tmp_path / "log.ulg", {TRUTH: samples})
    failing = {x.limit for x in witnessed(flight(flown), read_tracks(path, ORIGIN)) if not x.passed}
    assert failing >= {"position", "workspace"}


def test_a_log_of_another_time_is_no_witness(flown: Told, tmp_path: Path) -> None:
    path = write_ulog(tmp_path / "log.ulg", {ESTIMATE: seen(flown)[:50]})
    (line,) = witnessed(flight(flown), read_tracks(path, ORIGIN))
    assert not line.passed
    assert "too little time in common" in line.note
    (line,) = witnessed(flight(flown), ())
    assert not line.passed


def test_a_bad_log_is_one_sentence(flown: Told, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    record, bad = flown.write(tmp_path / "flight.mcap"), tmp_path / "bad.ulg"
    with pytest.raises(ULogError, match="is no file"):
        read_tracks(bad, ORIGIN)
    bad.write_bytes(np.arange(100, dtype=np.uint8).tobytes())
    assert cli.main(["verify", str(record), "--ulog", str(bad)]) == 2
    assert "bad.ulg cannot be read as a log of PX4" in capsys.readouterr().err
    assert cli.main(["verify", str(record), str(record), "--ulog", str(bad)]) == 2
    assert "--ulog is the log of one flight" in capsys.readouterr().err
