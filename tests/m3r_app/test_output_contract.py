"""The output contract: its documents are what the types say, and events come back as they were told."""

from __future__ import annotations

import importlib.util
import json
import math
from pathlib import Path
from types import ModuleType

import jsonschema
import pytest

from m3r_app.output import (
    EVENT_TYPES,
    AnnounceEvent,
    MotionEvent,
    MotionStatus,
    Notice,
    OutputEvent,
    Told,
    fields_of,
    known,
    line,
)
from m3r_app.output_schema import EventError, event_of, schema
from modalities.notices import SenseChange
from tests.told import USUAL, told

ROOT = Path(__file__).resolve().parents[2]


def script() -> ModuleType:
    spec = importlib.util.spec_from_file_location("output_contract", ROOT / "scripts" / "output_contract.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_documents_are_what_the_types_say() -> None:
    """Changed the types? `python scripts/output_contract.py` writes both anew."""
    for path, text in script().files().items():
        assert path.read_text(encoding="utf-8") == text, path.name


def test_the_schema_is_one() -> None:
    jsonschema.Draft202012Validator.check_schema(schema())


@pytest.mark.parametrize("name", [kind.name for kind in EVENT_TYPES])
def test_every_event_is_told_as_the_schema_says_and_read_back(name: str) -> None:
    findings = [{}, {"passed": True, "margin": None, "subject": "blue"}] if name == "decision" else None
    event = told(name, 2.5, **({"findings": findings} if findings else {})).event
    values = json.loads(line(Told(2.5, event)))
    jsonschema.validate(values, schema())
    assert event_of(name, values) == event
    assert event_of(name, fields_of(event)) == event


@pytest.mark.parametrize("name", [kind.name for kind in EVENT_TYPES])
def test_the_schema_knows_what_is_none(name: str) -> None:
    values = json.loads(line(told(name)))
    for wrong in ({**values, "more": 1}, {k: v for k, v in values.items() if k != "t"}, {**values, "event": "other"}):
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(wrong, schema())


def test_numbers_that_do_not_exist_are_null() -> None:
    event = MotionEvent("r1", MotionStatus.STARTED, (math.nan, 0.0, math.inf), math.nan, None, math.inf, 0.1)
    expected: OutputEvent = MotionEvent("r1", MotionStatus.STARTED, (None, 0.0, None), None, None, None, 0.1)
    assert known(event) == expected
    jsonschema.validate(json.loads(line(Told(0.0, event))), schema())


@pytest.mark.parametrize(
    ("name", "values", "said"),
    [
        ("weather", {}, "weather is no event of the output"),
        ("pair", {"vehicle": "red"}, "pair: status: Field required"),
        ("request", {**USUAL["request"], "command": "fly_home"}, "request: command: Input should be"),
    ],
)
def test_what_is_no_event_is_said_in_one_sentence(name: str, values: dict[str, object], said: str) -> None:
    with pytest.raises(EventError) as caught:
        event_of(name, values)
    assert str(caught.value).startswith(said)
    assert "\n" not in str(caught.value)


def test_every_change_of_a_sense_is_a_notice() -> None:
    assert [Notice(change.value) for change in SenseChange]


def test_a_record_from_before_notices_is_read() -> None:
    assert event_of("announce", {"text": "a sentence"}) == AnnounceEvent("a sentence", Notice.INFORMATION)
