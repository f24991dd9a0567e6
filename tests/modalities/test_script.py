"""Scripts of timed requests, and the sentence for every line that cannot be read."""

from __future__ import annotations

import io
from pathlib import Path

import pytest

from modalities.script import ScriptError, parse_script, read_script
from safety.vocabulary import Command, Modality

COLOURS = ("red", "green")
STORY = """
# a comment
2.0 panel go left     # another
2.0 voice activate red confidence=0.4
3 gesture STOP

10.25 panel fly backwards
"""


def test_a_story() -> None:
    requests = parse_script(STORY, COLOURS)
    assert [(r.at_s, r.modality, r.command, r.colour, r.confidence, r.line) for r in requests] == [
        (2.0, Modality.PANEL, Command.GO_LEFT, None, 1.0, 3),
        (2.0, Modality.VOICE, Command.ACTIVATE, "red", 0.4, 4),
        (3.0, Modality.GESTURE, Command.STOP, None, 0.95, 5),
        (10.25, Modality.PANEL, Command.GO_BACK, None, 1.0, 7),
    ]


def test_a_request_is_stamped_with_the_apps_time() -> None:
    request = parse_script("2.5 panel go up", COLOURS)[0].request("panel-1", began_s=100.0)
    assert (request.captured_at_s, request.made_at_s, request.evidence) == (102.5, 102.5, "go up")


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("panel go left", "'panel' is no time in seconds"),
        ("-1 panel go left", "'-1' is no time in seconds: give a number from 0"),
        ("nan panel go left", "'nan' is no time"),
        ("inf panel go left", "'inf' is no time"),
        ("2.0 go left", "'go' is no modality"),
        ("2.0 fused go left", "'fused' is no modality"),
        ("2.0 panel", "is not `TIME MODALITY REQUEST`"),
        ("2.0 panel go sideways", "'go sideways' is no request"),
        ("2.0 panel please stop", "'please stop' is no request"),
        ("2.0 panel activate mauve", "'mauve' is no drone here: the colours are red, green"),
        ("2.0 panel go left confidence=high", "'high' is no confidence"),
        ("2.0 panel go left confidence=1.5", "'1.5' is no confidence: give a number from 0 to 1"),
        ("2.0 panel go left confidence=nan", "'nan' is no confidence"),
        ("0.5 panel go left", "time 0.5 is before 1, the line before it"),
    ],
)
def test_a_line_that_cannot_be_read_is_named(line: str, says: str) -> None:
    with pytest.raises(ScriptError) as error:
        parse_script(f"# first\n1 panel stop\n{line}\n", COLOURS, "script x")
    assert "script x, line 3: " in str(error.value)
    assert says in str(error.value)
    assert "\n" not in str(error.value)


def test_a_file_and_standard_input(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "story.script"
    path.write_text(STORY)
    assert read_script(path, COLOURS) == parse_script(STORY, COLOURS)
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(STORY.encode())))
    assert read_script("-", COLOURS) == parse_script(STORY, COLOURS)


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    binary = tmp_path / "binary.script"
    binary.write_bytes(b"\xff\xfe\x00")
    for path in (tmp_path / "missing.script", tmp_path, binary):
        with pytest.raises(ScriptError, match=str(path)):
            read_script(path, COLOURS)


def test_the_shipped_story_is_a_script() -> None:
    story = Path(__file__).parents[2] / "config" / "demo" / "operator.script"
    requests = read_script(story, ("red", "green", "blue"))
    assert requests[0].command is Command.ACTIVATE
    assert requests[-1].command is Command.DISCONNECT
    assert Command.STOP in {request.command for request in requests}


def test_what_notepad_writes_is_read_and_what_is_long_is_clipped(tmp_path: Path) -> None:
    """A byte-order mark is no fault of the operator's; a wrong line is shown in part."""
    script = tmp_path / "script.txt"
    script.write_bytes(b"\xef\xbb\xbf2.0 panel go left\r\n")
    assert read_script(script, ("red",))[0].command is Command.GO_LEFT
    script.write_text("x" * 10_000)
    with pytest.raises(ScriptError) as caught:
        read_script(script, ("red",))
    assert len(str(caught.value)) < 400
