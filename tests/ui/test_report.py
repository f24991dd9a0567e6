"""The report of a record: in a real browser, with the record's own numbers; and of records that are none, or broken."""

from __future__ import annotations

import json
import math
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from m3r_app.environment.ground import Ground
from m3r_app.record.recorder import SCHEMA_VERSION, Recorder, read_record
from ui.cli import main
from ui.report import MARK, ReportError, shown, write_report

pytestmark = pytest.mark.xdist_group("screen")  # one at a time, so that what is drawn is drawn in time

HOSTILE = "</script><script>document.title='owned'</script><img src=x onerror=alert(1)>"
METADATA: dict[str, object] = {
    "app": "0.1.0",
    "scenario": {"name": "hillside"},
    "origin": [46.679, 7.863, 580.0],
    "models": [],
}
STAGE: dict[str, object] = {
    "ground": Ground(
        np.linspace(-60, 60, 61), np.linspace(-60, 60, 61), np.add.outer(np.arange(61.0), np.arange(61.0)) / 8.0
    ),
    "obstacles": [
        {"name": "the wall", "corners_ne_m": [[12, 5], [12, 6], [16, 6], [16, 5]], "base_m": 0.0, "top_m": 8.0}
    ],
    "fence_ne_m": [[-20.0, -20.0, -20.0, 20.0], [-20.0, 20.0, 30.0, 20.0]],
    "fence_levels_m": [0.0, 60.0],
    "operator": [0.0, 0.0, 0.0],
}


def finding(constraint: str, margin: float | None, *, passed: bool, text: str = "so it is") -> dict[str, object]:
    return {
        "requirements": ["R3", "G2"],
        "constraint": constraint,
        "margin": margin,
        "unit": "m",
        "passed": passed,
        "text": text,
    }


def flight(path: Path, *, closed: bool = True, **metadata: object) -> Path:
    """A record as the app writes it, of a flight with one of every verdict."""
    recorder = Recorder(path, {**METADATA, **metadata}, lambda _: None)
    t_s = 0.0
    recorder.record("stage", t_s, STAGE)
    recorder.record("pair", t_s, {"vehicle": "red", "status": "confirmed", "reasons": []})
    recorder.record("anchor", t_s, {"position": [14.0, 0.0, -6.0], "radius_m": 5.0})
    verdicts = {"approved": (1.0, 1.0), "reduced": (1.0, 0.37), "rejected": (1.0, None)}
    for number, (verdict, (requested_m, granted_m)) in enumerate(verdicts.items(), start=1):
        for step in range(20):
            t_s += 0.1
            where = [14.0 + 0.01 * step, 0.05 * step, -6.0]
            recorder.record(
                "telemetry",
                t_s,
                {"position": where, "velocity": [0.1, 0.5, math.nan if step == 3 else 0.0], "yaw_deg": 0.0},
            )
            told = {"names": ["green"], "positions_ned_m": [[0.0, 9.0, -8.0]], "velocities_ned_m_s": [[0.0, 0.0, 0.0]]}
            recorder.record("neighbours", t_s, {"neighbours": told})
            recorder.record("margins", t_s, {"margins": {"terrain": 2.0, "neighbour": None, "battery": 70.0}})
        name = f"voice-{number}"
        recorder.record(
            "request",
            t_s,
            {
                "id": name,
                "command": "go_left",
                "modality": "voice",
                "confidence": 0.9 + 0.01 * number,
                "evidence": HOSTILE,
                "latency_ms": 100.0 * number,
            },
        )
        findings = [finding("agl", 1.25, passed=True), finding("separation", None, passed=True)]
        if verdict != "approved":
            findings.append(finding("terrain_clearance", -0.63, passed=False, text=HOSTILE))
        recorder.record(
            "decision",
            t_s,
            {
                "request": name,
                "verdict": verdict,
                "requested_m": requested_m,
                "granted_m": granted_m,
                "findings": findings,
            },
        )
        recorder.record(
            "mode",
            t_s,
            {
                "mode": "ManeuverResponseActive",
                "previous": "ManeuverResponseArmed",
                "state": "ExecutingBoundedMotion",
                "cause": "volume_granted",
            },
        )
        if granted_m is not None:
            recorder.record(
                "plan", t_s, {"primitive": "MoveLeft", "points_ned_m": [[14.0, 0.0, -6.0], [14.0, -granted_m, -6.0]]}
            )
            recorder.record(
                "motion",
                t_s,
                {
                    "request": name,
                    "status": "completed",
                    "displacement_enu_m": [-granted_m, 0.0, 0.0],
                    "yaw_deg": 0.0,
                    "min_clearance_m": 2.5,
                    "min_separation_m": None,
                    "max_speed_m_s": 0.48,
                },
            )
    recorder.record(
        "end",
        t_s,
        {
            "reason": "inputs_played",
            "requests": 3,
            "approved": 2,
            "completed": 2,
            "aborted": 0,
            "rejected": 1,
            "violations": 0,
        },
    )
    recorder.close()
    return path


@pytest.mark.skipif(shutil.which("chromium") is None, reason="chromium is not installed")
def test_it_renders_and_its_numbers_are_the_records(tmp_path: Path) -> None:
    from playwright.sync_api import sync_playwright

    record = flight(tmp_path / "flight.mcap")
    page_path, broken = write_report(record)
    assert broken is None
    faults: list[str] = []
    fetched: list[str] = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"),
            args=["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
        )
        page = browser.new_page(viewport={"width": 1200, "height": 900})
        page.on("console", lambda m: faults.append(m.text) if m.type == "error" else None)
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.on("dialog", lambda dialog: faults.append(dialog.message))
        page.on("request", lambda request: fetched.append(request.url))
        page.goto(page_path.as_uri())
        page.wait_for_selector("body[data-drawn=yes]")
        page.wait_for_selector("#scene canvas")
        page.wait_for_selector("#lines .scatterlayer .trace", state="attached")
        assert page.title() == "Flight flight.mcap"
        for topic, _, data in read_record(record):
            if topic == "request":
                row = page.locator(f'tbody[data-request="{data["id"]}"]')
                assert row.locator(".confidence").inner_text() == shown(data["confidence"])
                assert row.locator(".latency").inner_text() == shown(data["latency_ms"], 0)
                assert HOSTILE in row.inner_text()
            if topic == "decision":
                row = page.locator(f'tbody[data-request="{data["request"]}"]')
                assert row.locator(".verdict").inner_text() == data["verdict"]
                assert row.locator(".granted").inner_text() == shown(data["granted_m"])
                assert row.locator(".requested").inner_text() == shown(data["requested_m"])
                margins = [text.split()[0] for text in row.locator("td.margin").all_text_contents()]
                assert sorted(margins) == sorted(shown(f["margin"]) for f in data["findings"])
            if topic == "end":
                for key in ("requests", "approved", "completed", "aborted", "rejected", "violations"):
                    assert page.locator(f"#end-{key}").inner_text() == str(data[key])
        assert page.locator("#requests").evaluate("e => e.scrollWidth") <= 1200
        decided = page.evaluate(
            "figures.lines.data.filter(t => t.name.endsWith('decided')).map(t => [t.name, [...t.y]])"
        )
        assert dict(decided) == {"agl, decided": [1.25] * 3, "terrain_clearance, decided": [-0.63] * 2}
        drawn = page.evaluate("figures.scene.data.map(trace => trace.name)")
        assert {
            "ground",
            "the wall",
            "flown",
            "plans",
            "geofence at the height flown",
            "green",
            "anchors",
            "operator",
        } <= set(drawn)
        box = page.evaluate("figures.scene.layout.scene")
        spans = {axis: box[f"{axis}axis"]["range"][1] - box[f"{axis}axis"]["range"][0] for axis in "xyz"}
        scales = [spans[axis] / box["aspectratio"][axis] for axis in "xyz"]
        assert scales == pytest.approx([scales[0]] * 3, rel=0.01)  # a ball is drawn as a ball
        assert {"approved requests", "reduced requests", "rejected requests"} <= set(drawn)
        assert page.locator("#latencies tbody tr").inner_text().split() == ["voice", "3", "200", "290"]
        page.set_viewport_size({"width": 400, "height": 800})
        assert page.locator("#requests").evaluate("e => e.scrollWidth") <= 400
        assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
        browser.close()
    assert faults == []
    assert [url for url in fetched if not url.startswith(("file:", "data:", "blob:"))] == []


def test_a_record_that_breaks_off_is_told_as_far_as_it_goes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("m3r_app.record.recorder.CHUNK_BYTES", 1024)  # several of them in a short record
    whole = flight(tmp_path / "whole.mcap").read_bytes()
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(whole[: len(whole) * 2 // 3])
    assert main(["report", str(torn)]) == 0
    told = capsys.readouterr()
    assert "breaks off after" in told.err
    page = Path(told.out.strip()).read_text()
    assert 'id="broken"' in page
    assert '<dd id="end-reason">not known</dd>' in page


def test_gaps_are_told(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "gaps.mcap", METADATA, lambda _: None)
    recorder.record("announce", 1.0, {"text": "hello"})
    recorder.record("record_gap", 2.0, {"dropped": 7})
    recorder.close()
    page, _ = write_report(tmp_path / "gaps.mcap")
    assert "7 messages are missing" in page.read_text()


@pytest.mark.parametrize("kind", ["missing", "folder", "empty", "text", "newer", "eventless", "foreign"])
def test_bad_records_are_one_sentence(tmp_path: Path, kind: str, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "record.mcap"
    if kind == "folder":
        path.mkdir()
    elif kind in ("empty", "text"):
        path.write_text("" if kind == "empty" else "no record")
    elif kind == "newer":
        flight(path, schema_version=SCHEMA_VERSION + 1)
    elif kind == "eventless":
        Recorder(path, METADATA, lambda _: None).close()
    elif kind == "foreign":
        recorder = Recorder(path, METADATA, lambda _: None)
        recorder.record("request", 1.0, {"nothing": "that we know"})
        recorder.close()
    assert main(["report", str(path)]) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.count("\n") == 1
    assert "record.mcap" in told.err
    assert not path.with_suffix(".html").exists()


def test_only_a_report_is_overwritten(tmp_path: Path) -> None:
    record = flight(tmp_path / "flight.mcap")
    mine = tmp_path / "mine.html"
    mine.write_text("<p>mine</p>")
    with pytest.raises(ReportError, match="no report"):
        write_report(record, mine)
    assert mine.read_text() == "<p>mine</p>"
    with pytest.raises(ReportError, match="folder"):
        write_report(record, tmp_path)
    with pytest.raises(ReportError, match="cannot be written"):
        write_report(record, tmp_path / "no" / "such" / "folder.html")
    page, _ = write_report(record)
    assert MARK in page.read_text()
    write_report(record)


def test_a_record_without_ground_world_or_telemetry_has_a_page(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "bare.mcap", {"app": "0"}, lambda _: None)
    recorder.record("announce", 1.0, {"text": "hello"})
    recorder.close()
    page, broken = write_report(tmp_path / "bare.mcap")
    assert broken is None
    assert "Nothing was asked for." in page.read_text()


@pytest.mark.parametrize(
    ("topic", "wrong"),
    [
        ("decision", {"findings": None}),
        ("decision", {"findings": "x"}),
        ("motion", {"displacement_enu_m": None}),
        ("motion", {"displacement_enu_m": []}),
        ("request", {"confidence": "x"}),
        ("margins", {"margins": None}),
        ("stage", {"ground": {}}),
        ("end", {}),
    ],
)
def test_a_message_of_another_shape_is_one_sentence(
    tmp_path: Path, topic: str, wrong: dict[str, object], capsys: pytest.CaptureFixture[str]
) -> None:
    right: dict[str, dict[str, object]] = {
        "request": {"id": "a", "command": "stop", "modality": "voice", "confidence": 0.8, "latency_ms": 1.0},
        "decision": {"request": "a", "verdict": "rejected", "requested_m": 1.0, "granted_m": None, "findings": []},
        "motion": {"request": "a", "status": "completed"},
    }
    recorder = Recorder(tmp_path / "odd.mcap", METADATA, lambda _: None)
    if topic != "request":
        recorder.record("request", 1.0, right["request"])
    recorder.record(topic, 2.0, right.get(topic, {}) | wrong)
    recorder.close()
    assert main(["report", str(tmp_path / "odd.mcap")]) == 2
    err = capsys.readouterr().err
    assert "odd.mcap holds a message that no m3r writes" in err
    assert err.count("\n") == 1
    assert not (tmp_path / "odd.html").exists()


def test_a_number_that_is_none_is_a_dash() -> None:
    assert [shown(value) for value in (None, math.nan, -0.001, 1.005, "x")] == ["–", "–", "0.00", "1.00", "–"]
    assert json.dumps(shown(1.0)) == '"1.00"'


def test_what_is_no_file_is_told_and_not_waited_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nobody writes into this pipe."""
    pipe = tmp_path / "flight.mcap"
    os.mkfifo(pipe)
    assert main(["report", str(pipe)]) == 2
    assert f"{pipe} is no file: name a flight record" in capsys.readouterr().err
