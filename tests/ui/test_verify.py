"""`m3r verify`: its table, its JSON, its exit status; a bad file is one sentence."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.m3r_app.evidence.recorded import RecordedFlight, Told
from ui import cli


@pytest.fixture(scope="module")
def flown() -> Told:
    return RecordedFlight(11, duration_s=16.5).told()


def test_a_flight_in_order_is_a_table_and_status_0(
    flown: Told, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["verify", str(flown.write(tmp_path / "good.mcap"))]) == 0
    first, header, *rows = capsys.readouterr().out.splitlines()
    assert first.startswith("good.mcap: 2 plans, ")
    assert first.endswith(" 4 requests: everything holds")
    assert header.split() == ["judged", "limit", "lines", "worst", "about", "at"]
    assert all(row.endswith("holds") for row in rows)
    assert any(row.split()[:3] == ["plan", "standoff", "2"] for row in rows)


def test_an_edited_record_is_status_4_and_says_what_does_not_hold(
    flown: Told, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = flown.copy()
    told.of("plan")[1][1]["plan"]["move"]["distance"] = 1.5
    edited, good = told.write(tmp_path / "edited.mcap"), flown.write(tmp_path / "good.mcap")
    assert cli.main(["verify", str(good), str(edited)]) == 4
    out = capsys.readouterr().out
    assert "FAILS: plan envelope of r4 at 14.66 s: -0.50 m sideways step" in out
    assert "FAILS: record grant of r4 at 14.66 s: flies +0.500 m other than granted" in out


def test_json_holds_every_line(flown: Told, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["verify", "--json", str(flown.write(tmp_path / "good.mcap"))]) == 0
    (found,) = json.loads(capsys.readouterr().out)
    assert found["file"] == "good.mcap"
    assert found["passed"]
    assert {line["subject"] for line in found["lines"] if line["part"] == "plan"} == {"r3", "r4"}
    assert all(line["passed"] for line in found["lines"])


@pytest.mark.parametrize(
    ("content", "told"),
    [(None, "is no file"), (b"hello", "is not a flight record")],
)
def test_a_bad_file_is_one_sentence_and_status_2(
    content: bytes | None, told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "bad.mcap"
    if content is not None:
        path.write_bytes(content)
    assert cli.main(["verify", str(path)]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1
    assert "bad.mcap" in said.err
    assert told in said.err


def test_a_record_of_something_else_is_one_sentence(
    flown: Told, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = flown.copy()
    told.metadata["world"] = {"terrain": 3}
    path = told.write(tmp_path / "steps.mcap", steps=[{"n": 1}])
    assert cli.main(["verify", str(path)]) == 2
    assert "steps.mcap cannot be judged" in capsys.readouterr().err
    assert cli.main(["verify", str(told.write(tmp_path / "odd.mcap"))]) == 2
    assert "cannot be judged: it holds what no m3r writes" in capsys.readouterr().err
