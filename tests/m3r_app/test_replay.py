"""Steps in a record: the same values come back, a replay is the same bit for bit, and what was edited is noticed."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from random import Random

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import CompressionType

from config.settings import load_settings
from m3r_app.arbiter.effects import Effect
from m3r_app.arbiter.events import Event
from m3r_app.arbiter.state import ArbiterState, Policy
from m3r_app.arbiter.step import step
from m3r_app.record.recorder import Recorder
from m3r_app.replay import fates, replay
from m3r_app.step_record import START, STEP, StateDigest, StepWriter, codec, provenance, read_flight, source_sha256
from m3r_app.typed_json import TypedJson, TypedJsonError
from safety.constraints import RULES
from safety.geofence import Geofence
from safety.limits import Limits
from safety.obstacles import Obstacles
from safety.situation import World
from safety.terrain import Terrain
from safety.vocabulary import Command, Ned
from tests.m3r_app.tabletop import OPERATOR, Tabletop
from ui import cli
from ui.verify import property_lines

FUZZED = int(os.environ.get("M3R_FUZZED", "3"))
NUMBERS = st.floats(allow_nan=True, allow_infinity=True)
WORLD = World(
    Terrain(np.linspace(0.0, 9.0, 64).reshape(8, 8) / 3.0, (-20.0, -20.0), ((6.0, 0.0), (0.0, 6.0)), 0.1, 0.0),
    Obstacles.of(["wall"], [shapely.box(0.1, 3.2, 30.0, 3.6)], [-20.0], [20.0], 0.0),
    Geofence.of(shapely.box(-50.0, -50.0, 50.0, 50.0), -20.0, 40.0, 0.0),
)


class Timed(Tabletop):
    """Remembers when each step was taken."""

    def __init__(self) -> None:
        super().__init__(world=WORLD)
        self.at_s: list[float] = []

    def put(self, event: Event) -> tuple[Effect, ...]:
        self.at_s.append(self.now_s)
        return super().put(event)


@lru_cache
def story() -> tuple[tuple[float, Event], ...]:
    """A flight with three requests: flown, refused, stopped."""
    table = Timed()
    table.paired().ask(Command.GO_UP)
    table.wait(5.0).ask(Command.GO_RIGHT, confidence=0.5)
    table.wait(1.0).ask(Command.GO_BACK)
    table.wait(1.0).ask(Command.STOP)
    table.wait(2.0)
    assert table.motions("completed") and table.motions("aborted")
    return tuple(zip(table.at_s, (event for _, event, _, _ in table.steps), strict=True))


def record(path: Path, change: Callable[[ArbiterState], ArbiterState] = lambda state: state) -> Path:
    """change: what somebody else's arbiter makes of each state."""
    steps = StepWriter()
    failures: list[str] = []
    told = {"app": "0", "settings": load_settings((), ()).model_dump(), "operator": OPERATOR, "world": WORLD}
    made = Recorder(path, {**told, **provenance()}, failures.append, {START: steps, STEP: steps})
    state = ArbiterState(Limits(), Policy())
    made.record(START, 0.0, {"state": state})
    for now_s, event in story():
        state, effects = step(state, event, now_s)
        state = change(state)
        made.record(STEP, now_s, {"now_s": now_s, "event": event, "effects": effects, "state": state})
    made.close()
    assert not failures
    return path


def test_a_replay_is_the_same_bit_for_bit(tmp_path: Path) -> None:
    found = replay(record(tmp_path / "flight.mcap"), source_sha256())
    assert found.difference is None
    assert found.whole and found.same_source
    assert found.steps == len(story())


def test_the_events_come_back_as_they_were(tmp_path: Path) -> None:
    text = codec()
    steps = list(read_flight(record(tmp_path / "flight.mcap")).steps())
    for read, (now_s, event) in zip(steps, story(), strict=True):
        assert read.now_s == now_s
        assert text.text(read.event) == text.text(event)


def test_another_decision_is_named(tmp_path: Path) -> None:
    """An arbiter that had other limits than those it recorded."""
    other = record(tmp_path / "other.mcap", lambda state: replace(state, may_return=not state.may_return))
    found = replay(other, "other source")
    assert found.difference is not None and found.difference.number == 1
    assert found.same_source is False


def test_a_gap_ends_the_replay_and_is_told(tmp_path: Path) -> None:
    path = tmp_path / "gap.mcap"
    steps = StepWriter()
    made = Recorder(path, provenance(), print, {START: steps, STEP: steps})
    state = ArbiterState(Limits(), Policy())
    made.record(START, 0.0, {"state": state})
    for number, (now_s, event) in enumerate(story()):
        state, effects = step(state, event, now_s)
        line = {"now_s": now_s, "event": event, "effects": effects, "state": state}
        if number == 50:
            steps.line(STEP, line)  # made, and lost
            continue
        made.record(STEP, now_s, line)
        if number == 49:
            while made._messages.waiting:
                pass
    made.close()
    found = replay(path, source_sha256())
    assert found.missing >= 1 and not found.whole


def test_other_limits_tell_what_would_have_become_of_each_request(tmp_path: Path) -> None:
    path = record(tmp_path / "flight.mcap")
    was = {fate.request: fate for fate in fates(path)}
    strict = {fate.request: fate for fate in fates(path, replace(Limits(), workspace_m=0.3))}
    assert was["r2"].verdict == "approved" and was["r2"].granted_m is not None
    assert strict["r2"].verdict in ("reduced", "rejected")
    assert was["r3"].verdict == strict["r3"].verdict == "rejected"
    assert "input_confidence" in was["r3"].failed


@pytest.mark.parametrize(
    ("edit", "into"),
    [(b'["VehicleState",104.', b'["VehicleState",103.'), (b'"VOICE"', b'"PANEL"'), (b"10.0],", b"10.5],")],
)
def test_an_edited_record_is_noticed(tmp_path: Path, edit: bytes, into: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where chunks are not packed, so that the edit is a plain one, and their checksums are none."""
    monkeypatch.setattr("m3r_app.record.recorder.COMPRESSION", CompressionType.NONE)
    monkeypatch.setattr("zlib.crc32", lambda *_: 0)
    path = record(tmp_path / "flight.mcap")
    data = path.read_bytes()
    assert edit in data
    path.write_bytes(data.replace(edit, into, 1))
    found = replay(path, source_sha256())
    assert found.difference is not None


EDITS = (b"0", b"9", b"-", b'"', b"[", b"]", b"{", b"}", b",", b":", b"e9", b"null", b"\xff", b"[" * 5000)


def test_whatever_bytes_are_edited_is_one_sentence_or_a_finding(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Never a traceback, nor a fault in m3r. Chunks are not packed and their checksums none, so that an edit gets through."""
    monkeypatch.setattr("m3r_app.record.recorder.COMPRESSION", CompressionType.NONE)
    monkeypatch.setattr("zlib.crc32", lambda *_: 0)
    path = record(tmp_path / "flight.mcap")
    whole, rng = path.read_bytes(), Random(7)
    # Where values stand: the first state, the first steps, and anywhere.
    for first, last in ((b'"t":0.0,"state":', b'"n":1,'), (b'"n":1,', b'"n":9,'), (b'"n":1,', b'"n":900000,')):
        begin = whole.index(first)
        end = whole.find(last, begin) if last in whole else len(whole)
        for _ in range(FUZZED):
            at, edit = rng.randrange(begin, end), rng.choice(EDITS)
            path.write_bytes(whole[:at] + edit + whole[at + len(edit) :])
            for command in ("replay", "verify"):
                status = cli.main([command, str(path)])
                said = capsys.readouterr().err
                assert status in (0, 2, 4), (at, edit, said)
                assert "Traceback" not in said and "fault" not in said and said.count("\n") <= 1, (at, edit, said)


@pytest.mark.parametrize("command", ["replay", "verify"])
@pytest.mark.parametrize(
    "content", [b"{]", b"[1]", b'{"n":1,"t":"x"}', b"[" * 100_000], ids=["no json", "no object", "no time", "too deep"]
)
def test_a_step_that_is_no_json_is_one_sentence(
    command: str, content: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    texts = Recorder._add_text

    def add(self: Recorder, topic: str, schema: str, like: object, text: str, log_ns: int) -> None:
        texts(self, topic, schema, like, content.decode() if topic == STEP else text, log_ns)  # type: ignore[arg-type]

    monkeypatch.setattr(Recorder, "_add_text", add)
    path = record(tmp_path / "edited.mcap")
    assert cli.main([command, str(path)]) == 2
    assert capsys.readouterr().err.endswith("edited.mcap is damaged: a step message cannot be read\n")


def test_a_record_of_another_version_is_one_failing_line_of_properties(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = record(tmp_path / "old.mcap")
    monkeypatch.setattr(TypedJson, "shapes", lambda _: {})
    assert cli.main(["replay", str(path)]) == 2
    capsys.readouterr()
    (line,) = property_lines(path)
    assert not line.passed and line.note.startswith("cannot be judged: ")
    assert "use the version that made it" in line.note
    assert cli.main(["verify", str(path)]) == 4
    assert capsys.readouterr().out.count("cannot be judged") == 1


def test_a_record_without_steps_is_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "old.mcap"
    Recorder(path, {}, print).close()
    assert cli.main(["replay", str(path)]) == 2
    assert "it holds no steps of the arbiter" in capsys.readouterr().err


def test_the_command_tells_and_exits(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = record(tmp_path / "flight.mcap")
    assert cli.main(["replay", str(path)]) == 0
    assert "bit for bit" in capsys.readouterr().out
    other = record(tmp_path / "other.mcap", lambda state: replace(state, may_return=not state.may_return))
    assert cli.main(["replay", "--json", str(other)]) == 4
    assert json.loads(capsys.readouterr().out)["difference"]["number"] == 1
    config = tmp_path / "strict.toml"
    config.write_text("[confidence]\nconfidence_voice = 0.3\n")
    assert cli.main(["replay", str(path), "--config", str(config), "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["requests"]
    changed = [row for row in rows if row["was"] != row["would_be"]]
    assert [row["was"]["request"] for row in changed] == ["r3"]
    assert "input_confidence" in changed[0]["was"]["failed"]
    assert "input_confidence" not in changed[0]["would_be"]["failed"]


@given(st.lists(st.one_of(NUMBERS, st.integers(), st.text(), st.none(), st.booleans())), NUMBERS)
def test_every_value_has_one_text_and_comes_back(items: list[object], number: float) -> None:
    text = codec()
    for value in (tuple(items), items, {"a": items, number: number}, Ned(number, 1.0, -0.0), np.array([number, 2.0])):
        written = text.text(value)
        again = text.value(json.loads(json.dumps(json.loads(written))))
        assert text.text(again) == written
        assert type(again) is type(value)


def test_a_world_stands_apart_and_comes_back(tmp_path: Path) -> None:
    text = codec()
    written = text.text(WORLD)
    assert len(written) < 100 and len(text.documents) == 1
    other = codec()
    other.documents.update(text.documents)
    world = other.value(json.loads(written))
    assert isinstance(world, World) and world.terrain is not None and isinstance(world.terrain, Terrain)
    assert world.terrain.heights_amsl_m.tobytes() == WORLD.terrain.heights_amsl_m.tobytes()
    digest = next(iter(text.documents))
    other = codec()
    other.documents[digest] = text.documents[digest].replace("wall", "wool")
    with pytest.raises(TypedJsonError, match="missing or was changed"):
        other.value(json.loads(written))


def test_states_that_are_equal_have_one_digest() -> None:
    text = codec()
    state = ArbiterState(Limits(), Policy(), RULES)
    same = replace(state, limits=Limits(), policy=Policy())
    assert StateDigest(text).of(state) == StateDigest(text).of(same)
    for other in (replace(state, held=True), replace(state, returns=1), replace(state, stopped_at_s=math.nan)):
        assert StateDigest(text).of(other) != StateDigest(text).of(state)


def test_what_has_no_text_is_refused() -> None:
    with pytest.raises(TypedJsonError, match="neither a dataclass nor a named tuple|not among"):
        codec().text(object())
    with pytest.raises(TypedJsonError, match="two classes are called"):
        TypedJson([Ned, type("Ned", (), {})])
