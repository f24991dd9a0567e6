"""A record as a story: what is in it, and nothing that is not."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from m3r_app.record.flight_summary import Story, story_of


def told(*messages: tuple[str, float, Mapping[str, Any]]) -> Story:
    return story_of(messages)


def request(name: str, modality: str = "voice", **fields: object) -> dict[str, object]:
    return {
        "id": name,
        "command": "go_left",
        "modality": modality,
        "confidence": 0.8,
        "latency_ms": 5.0,
        "evidence": "",
        **fields,
    }


def test_a_confirmation_is_no_second_request() -> None:
    story = told(("request", 1.0, request("voice-1")), ("request", 1.4, request("voice-1", "fused", confidence=0.97)))
    assert [(r.modality, r.confidence, r.confirmed) for r in story.requests] == [("voice", 0.8, 0.97)]


def test_the_last_decision_is_final() -> None:
    delayed = {"request": "voice-1", "verdict": "delayed", "requested_m": 1.0, "granted_m": None, "findings": []}
    story = told(
        ("request", 1.0, request("voice-1")),
        ("decision", 1.0, delayed),
        ("decision", 2.0, {**delayed, "verdict": "approved"}),
    )
    assert story.requests[0].verdict == "approved"
    assert len(story.requests[0].decisions) == 2


def test_what_is_no_place_is_in_no_track() -> None:
    nan = math.nan
    bad = [[nan, 0, 0], None, [1, 2], ["a", 1, 2], [math.inf, 0, 0]]
    story = told(*(("telemetry", float(i), {"position": place, "velocity": None}) for i, place in enumerate(bad)))
    assert story.track.places == []


def test_latencies_are_by_modality_and_rising() -> None:
    messages = [
        ("request", float(i), request(f"v-{i}", latency_ms=ms)) for i, ms in enumerate([30.0, 10.0, None, 20.0])
    ]
    assert told(*messages).latencies_ms() == {"voice": [10.0, 20.0, 30.0]}


def test_margins_of_decisions_are_those_in_metres() -> None:
    findings = [
        {"requirements": [], "text": "", "constraint": "agl", "margin": 1.5, "unit": "m", "passed": True},
        {"requirements": [], "text": "", "constraint": "agl", "margin": math.nan, "unit": "m", "passed": False},
        {"requirements": [], "text": "", "constraint": "input_confidence", "margin": -0.2, "unit": "", "passed": False},
    ]
    decision = {
        "request": "voice-1",
        "verdict": "rejected",
        "requested_m": 1.0,
        "granted_m": None,
        "findings": findings,
    }
    assert told(("request", 1.0, request("voice-1")), ("decision", 1.5, decision)).decided_m() == {
        "agl": [(1.5, 1.5, True)]
    }


def test_a_decision_about_nothing_that_was_asked_is_only_an_event() -> None:
    story = told(
        (
            "decision",
            1.0,
            {"request": "ghost", "verdict": "approved", "requested_m": None, "granted_m": None, "findings": []},
        )
    )
    assert story.requests == []
    assert len(story.events) == 1


def test_an_empty_record_is_an_empty_story() -> None:
    story = told()
    assert (story.length_s, story.end, story.requests, story.latencies_ms()) == (0.0, None, [], {})
