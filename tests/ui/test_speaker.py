"""How cues are spoken: a program that stands in for espeak-ng, and whatever can go wrong with it."""

from __future__ import annotations

import os
import pty
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from m3r_app.options import RunOptions
from m3r_app.output import Told
from modalities.voice.self_speech import SelfSpeech
from tests.told import told
from ui import cli
from ui import speaker as speaker_module
from ui.cues import Cue
from ui.speaker import Speaker, bell

DEADLINE_S = 20.0
PROGRAM = """#!/bin/sh
cd {folder}
echo "$*" > words
text=$(cat)
echo "begin $text" >> log
while [ -e hold ]; do sleep 0.02; done
echo "end $text" >> log
exit $(cat status)
"""


def until(condition: Callable[[], object], what: str) -> None:
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline, what
        time.sleep(0.01)


def cue_of(event: Mapping[str, Any]) -> Cue | None:
    """The events of these tests are cues."""
    cue: Cue | None = event["cue"]
    return cue


def not_spoken(why: str) -> str:
    return f"cues are not spoken, {why}, or give --quiet; until then the terminal's bell rings for urgent ones"


class Spoken:
    """A speaker, and what became of its cues."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.self_speech = SelfSpeech()
        self.sentences: list[str] = []
        self.rung: list[int] = []
        self.speaker = Speaker(cue_of, self.self_speech, self.sentences.append, ring=lambda: self.rung.append(1))

    def cue(self, text: str, *, urgent: bool = False) -> None:
        self.speaker.hear({"cue": Cue(text, urgent)})

    @property
    def log(self) -> list[str]:
        file = self.folder / "log"
        return file.read_text().splitlines() if file.exists() else []

    def logged(self, *lines: str) -> None:
        until(lambda: self.log == list(lines), f"{self.log} is not {lines}")

    def silent(self) -> bool:
        return not self.self_speech.overlaps(time.monotonic() + 1.0, time.monotonic() + 1.0)


@pytest.fixture
def spoken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Spoken:
    program = tmp_path / "espeak-ng"
    program.write_text(PROGRAM.format(folder=tmp_path))
    program.chmod(0o755)
    (tmp_path / "status").write_text("0")
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    monkeypatch.setattr(speaker_module, "SHORTEST_S", 0.0)
    return Spoken(tmp_path)


@pytest.fixture
def held(spoken: Spoken) -> Iterator[Path]:
    """What is spoken lasts as long as this file is there."""
    hold = spoken.folder / "hold"
    hold.touch()
    yield hold
    hold.unlink(missing_ok=True)


def test_a_cue_is_spoken_and_known_to_be(spoken: Spoken, held: Path) -> None:
    with spoken.speaker:
        assert spoken.silent()
        spoken.cue("Red: left, one metre")
        spoken.logged("begin Red: left, one metre")
        assert not spoken.silent()
        assert "--stdin" in (spoken.folder / "words").read_text().split()
        held.unlink()
        until(spoken.silent, "it never ends")
    assert spoken.log == ["begin Red: left, one metre", "end Red: left, one metre"]
    assert spoken.sentences == spoken.rung == []


def test_the_newest_replaces_what_waits(spoken: Spoken, held: Path) -> None:
    with spoken.speaker:
        spoken.cue("one")
        spoken.logged("begin one")
        for text in ("two", "three", "four"):
            spoken.cue(text)
        until(lambda: spoken.speaker._waiting == Cue("four"), "the newest does not wait")
        assert spoken.log == ["begin one"]  # nothing of it cuts off what is spoken
        held.unlink()
        spoken.logged("begin one", "end one", "begin four", "end four")


def test_an_urgent_one_cuts_off_what_is_spoken(spoken: Spoken, held: Path) -> None:
    with spoken.speaker:
        spoken.cue("one")
        spoken.logged("begin one")
        spoken.cue("two")
        spoken.cue("Red: holding", urgent=True)
        spoken.logged("begin one", "begin Red: holding")
        assert not spoken.silent()
        held.unlink()
        spoken.logged("begin one", "begin Red: holding", "end Red: holding")  # neither "one" nor "two"
        until(spoken.silent, "it never ends")


def test_what_is_being_spoken_is_not_begun_again(spoken: Spoken, held: Path) -> None:
    with spoken.speaker:
        spoken.cue("Red: holding", urgent=True)
        spoken.logged("begin Red: holding")
        spoken.cue("two")
        spoken.cue("Red: holding", urgent=True)
        until(lambda: not spoken.speaker._events.waiting, "it is not taken")
        held.unlink()
        until(spoken.silent, "it never ends")
        spoken.cue("three")
        spoken.logged("begin Red: holding", "end Red: holding", "begin three", "end three")


def test_closing_kills_what_is_spoken(spoken: Spoken, held: Path) -> None:
    began_s = time.monotonic()
    with spoken.speaker:
        spoken.cue("one")
        spoken.logged("begin one")
        assert spoken.speaker._speaking is not None
        process = spoken.speaker._speaking[1]
    assert process.returncode == -9
    assert spoken.silent()
    assert not spoken.speaker._events.alive
    assert time.monotonic() - began_s < DEADLINE_S


def test_a_program_that_fails_rings_and_says_so_once_and_is_tried_again(spoken: Spoken) -> None:
    (spoken.folder / "status").write_text("1")
    with spoken.speaker:
        for text in ("Red: left", "Red: right"):
            spoken.cue(text)
            until(lambda text=text: f"end {text}" in spoken.log and spoken.silent(), "it is not tried")
        until(lambda: spoken.sentences, "it is not said")
        spoken.cue("Red: holding", urgent=True)
        until(lambda: spoken.rung, "it does not ring")
    assert spoken.sentences == [not_spoken("espeak-ng ended with status 1: see whether sound works")]
    assert spoken.rung == [1]


def test_a_program_that_ends_at_once_has_not_spoken(spoken: Spoken, monkeypatch: pytest.MonkeyPatch) -> None:
    """As espeak-ng does without a sound device, with status 0."""
    monkeypatch.setattr(speaker_module, "SHORTEST_S", 60.0)
    with spoken.speaker:
        spoken.cue("Red: holding", urgent=True)
        until(lambda: spoken.rung, "it does not ring")
    assert "ended without having spoken: see whether there is a sound device" in spoken.sentences[0]


def test_a_program_that_hangs_is_ended_and_not_tried_again(
    spoken: Spoken, held: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(speaker_module, "LONGEST_S", 0.3)
    with spoken.speaker:
        spoken.cue("one")
        until(lambda: spoken.sentences, "it is not said")
        until(spoken.silent, "the operator is not heard again")
        spoken.cue("Red: holding", urgent=True)
        until(lambda: spoken.rung, "it does not ring")
        assert spoken.silent()
    assert spoken.log in ([], ["begin one"])
    assert len(spoken.sentences) == 1
    assert "had not ended" in spoken.sentences[0]


def test_a_program_that_cannot_be_started(spoken: Spoken) -> None:
    (spoken.folder / "espeak-ng").write_bytes(b"\x7fELF, but no more")
    with spoken.speaker:
        spoken.cue("Red: holding", urgent=True)
        until(lambda: spoken.rung, "it does not ring")
        assert spoken.silent()
    assert "espeak-ng cannot be started" in spoken.sentences[0]


def test_without_the_program_urgent_cues_ring_and_it_is_said_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    spoken = Spoken(tmp_path)
    with spoken.speaker:
        spoken.cue("Red: left done")
        spoken.cue("Red: holding", urgent=True)
        spoken.cue("Red: left refused, wall too near", urgent=True)
        until(lambda: len(spoken.rung) == 2, "it does not ring for each")
    assert spoken.rung == [1, 1]
    assert spoken.sentences == [not_spoken("espeak-ng is not here: install it")]


def test_a_fault_in_the_cues_ends_them_and_nothing_else(spoken: Spoken) -> None:
    with spoken.speaker:
        spoken.speaker.hear({"no cue": 1})
        until(lambda: spoken.sentences, "it is not said")
        spoken.cue("nobody speaks it")  # and nobody raises
    assert "unexpected KeyError" in spoken.sentences[0]


def test_hearing_never_waits(spoken: Spoken, held: Path) -> None:
    with spoken.speaker:
        began_s = time.monotonic()
        for i in range(2000):
            spoken.cue(f"cue {i}")
        took_s = time.monotonic() - began_s
        held.unlink()
    assert took_s < 5.0
    assert not [thread for thread in threading.enumerate() if thread.name == "m3r-speaker"]


def test_the_bell_rings_in_the_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    keyboard, terminal = pty.openpty()
    with os.fdopen(terminal, "w") as screen:
        monkeypatch.setattr("sys.stderr", screen)
        bell()
        assert os.read(keyboard, 10) == b"\a"
    os.close(keyboard)


def test_a_bell_without_a_terminal_is_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stderr", None)

    def none(*_: object) -> int:
        raise OSError("no terminal")

    monkeypatch.setattr(speaker_module.os, "open", none)
    bell()


@pytest.mark.parametrize(
    ("words", "aloud"),
    [
        ([], True),
        (["--quiet"], False),
        (["--headless"], False),
        (["--plain"], False),
        (["--headless", "--speak"], True),
        (["--plain", "--speak"], True),
    ],
)
def test_when_cues_are_spoken(
    words: list[str], aloud: bool, spoken: Spoken, held: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The app is told of every word of it, by its own clock."""
    known: list[bool] = []

    async def run(options: RunOptions, emit: Callable[[Told], None], self_speech: SelfSpeech) -> int:
        assert options.aloud is aloud
        emit(told("pair", 0.0, status="requested"))
        if aloud:
            until(lambda: spoken.log == ["begin Red: pairing"], "it is not spoken")
        known.append(self_speech.overlaps(time.monotonic(), time.monotonic()))
        return 0

    monkeypatch.setattr("m3r_app.run.run", run)
    assert cli.main(["run", *words]) == 0
    assert known == [aloud]
    assert bool(spoken.log) is aloud
