"""What a run prints: strict JSON, plain sentences, and no reader that can stop the flight."""

from __future__ import annotations

import json
import math
import os
import select
import signal
import threading
from typing import TYPE_CHECKING

import pytest

from m3r_app.output import AnnounceEvent, MotionEvent, MotionStatus, Told, line
from tests.told import told
from ui import output as output_module
from ui.narrator import every_sentence, sentence
from ui.output import Output

if TYPE_CHECKING:
    from collections.abc import Iterator

EVENT = told("announce", 1.5)


@pytest.fixture
def hang_ups() -> Iterator[list[int]]:
    """The SIGHUPs that came, taken as the app takes them."""
    calls: list[int] = []
    before = signal.signal(signal.SIGHUP, lambda number, _frame: calls.append(number))
    yield calls
    signal.signal(signal.SIGHUP, before)


def drained(descriptor: int) -> str:
    """All that is in the pipe, whose writing end is closed."""
    with os.fdopen(descriptor) as file:
        return file.read()


def test_lines_are_strict_json() -> None:
    motion = MotionEvent("r1", MotionStatus.STARTED, (math.inf, -1e-12, 1.0), math.nan, None, None, 0.1)
    text = line(Told(1.23456789012, motion))
    assert text.startswith('{"t": 1.2345679, "event": "motion", "request": "r1", "status": "started", ')
    assert json.loads(text) == {
        "t": 1.2345679,
        "event": "motion",
        "request": "r1",
        "status": "started",
        "displacement_enu_m": [None, 0.0, 1.0],
        "yaw_deg": None,
        "min_clearance_m": None,
        "min_separation_m": None,
        "max_speed_m_s": 0.1,
    }
    assert "-0.0" not in text


def test_text_cannot_break_a_line() -> None:
    text = line(Told(0.0, AnnounceEvent("two\nlines \u2028 \u00e9 \ud800")))
    assert text.isascii()
    assert "\n" not in text


@pytest.mark.parametrize(
    ("event", "said"),
    [
        (EVENT, "moved 1 m left"),
        (
            told("request", modality="voice", evidence="go left", command="go_left", confidence=0.934),
            '> voice "go left": go_left (confidence 0.93)',
        ),
        (
            told("request", modality="panel", evidence="", command="stop", confidence=1.0),
            "> panel: stop (confidence 1.00)",
        ),
        (
            told("violation", kind="predicted", requirements=["R9", "X1"], action="hold"),
            "! predicted violation of R9, X1: hold",
        ),
        (told("mode", mode="Blocked"), None),
    ],
)
def test_what_a_person_reads(event: Told, said: str | None) -> None:
    assert sentence(event.event) == said


@pytest.mark.parametrize("headless", [True, False])
def test_where_it_goes(headless: bool) -> None:
    out_r, out_w = os.pipe()
    err_r, err_w = os.pipe()
    with Output(headless=headless, out=out_w, err=err_w) as output:
        output.emit(EVENT)
        output.emit(told("mode", 2.0))
    os.close(out_w)
    os.close(err_w)
    out, err = drained(out_r), drained(err_r)
    said = "   1.50 s  moved 1 m left\n"
    if headless:
        assert [json.loads(text)["event"] for text in out.splitlines()] == ["announce", "mode"]
        assert err == said
    else:
        assert (out, err) == (said, "")


def test_a_line_is_out_at_once() -> None:
    out_r, out_w = os.pipe()
    with Output(headless=True, out=out_w, err=out_w) as output:
        output.emit(EVENT)
        assert select.select([out_r], [], [], 20)[0] == [out_r]
    os.close(out_w)
    os.close(out_r)


def test_a_reader_that_does_not_read_stops_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(output_module, "CLOSE_S", 0.1)
    out_r, out_w = os.pipe()
    with Output(headless=True, out=out_w, err=out_w) as output:
        for i in range(5000):  # far more than a pipe holds
            output.emit(told("announce", float(i)))
        stuck = next(thread for thread in threading.enumerate() if thread.name == "m3r-output")
    assert stuck.is_alive()
    reader = os.fdopen(out_r)
    numbers = [json.loads(text)["t"] for text in (reader.readline() for _ in range(10_000)) if text.startswith("{")]
    stuck.join(20)
    assert not stuck.is_alive()
    assert numbers == list(range(5000))  # late, not lost
    reader.close()
    os.close(out_w)


def test_a_reader_that_is_gone_hangs_up_once(hang_ups: list[int]) -> None:
    out_r, out_w = os.pipe()
    err_r, err_w = os.pipe()
    os.close(out_r)
    with Output(headless=True, out=out_w, err=err_w) as output:
        for _ in range(3):
            output.emit(EVENT)
    os.close(out_w)
    os.close(err_w)
    assert hang_ups == [signal.SIGHUP]
    assert drained(err_r).count("\n") == 3  # sentences still go where somebody reads


def test_missing_sentences_are_no_reason_to_end(hang_ups: list[int]) -> None:
    out_r, out_w = os.pipe()
    err_r, err_w = os.pipe()
    os.close(err_r)
    with Output(headless=True, out=out_w, err=err_w) as output:
        output.emit(EVENT)
        output.emit(EVENT)
    os.close(out_w)
    os.close(err_w)
    assert drained(out_r).count("\n") == 2
    assert hang_ups == []


@pytest.mark.parametrize("handler", [signal.SIG_IGN, signal.SIG_DFL])
def test_nobody_to_hang_up_to(handler: signal.Handlers) -> None:
    before = signal.signal(signal.SIGHUP, handler)
    try:
        output_module.hang_up()  # with SIG_DFL a signal would end the tests
    finally:
        signal.signal(signal.SIGHUP, before)


MOTION = told("motion", request="r1", status="completed", displacement_enu_m=[0.9, -0.1, -0.001], yaw_deg=0.4, min_clearance_m=4.25, min_separation_m=None, max_speed_m_s=0.48)  # fmt: skip
FAILED = {
    "passed": False,
    "text": "0.1 m too close to the wall",
    "constraint": "obstacle_clearance",
    "requirements": ["R3"],
}


@pytest.mark.parametrize(
    ("event", "said"),
    [
        (told("announce", text="Red: left"), "Red: left"),
        (
            told("request", id="r1", command="go_left", modality="voice", evidence="go left", confidence=None, latency_ms=301.2),
            "request r1 by voice, go left: go_left, confidence unknown, after 301 ms",
        ),
        (
            told("decision", request="r1", verdict="reduced", requested_m=1.0, granted_m=0.4, findings=[FAILED, {**FAILED, "passed": True}]),
            "request r1 is reduced, 0.40 m of 1.00 m; 0.1 m too close to the wall (obstacle_clearance, R3)",
        ),
        (
            told("decision", request="r1", verdict="approved", requested_m=None, granted_m=None, findings=[]),
            "request r1 is approved",
        ),
        (
            told("mode", mode="Blocked", previous="ManeuverResponseArmed", state="Blocked", cause="guards_failed"),
            "mode Blocked, Blocked, because of guards_failed; before: ManeuverResponseArmed",
        ),
        (
            MOTION,
            ("request r1 completed: 0.90 m east, -0.10 m north, 0.00 m up, turned 0 degrees, least clearance 4.25 m, "
            "at most 0.48 m/s"),
        ),
        (told("pair", vehicle="red", status="refused", reasons=["a", "b"]), "pairing with red refused: a; b"),
        (
            told("violation", kind="predicted", requirements=["R5", "R10"], action="abort"),
            "predicted violation of R5, R10: abort",
        ),
    ],
)  # fmt: skip
def test_in_plain_mode_every_event_is_one_sentence(event: Told, said: str) -> None:
    assert every_sentence(event.event) == said
