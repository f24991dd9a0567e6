"""The console by keys and mouse, on a stage: what is asked, what is shown, and that STOP is always there."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from textual.command import CommandPalette
from textual.pilot import Pilot
from textual.strip import Strip
from textual.widgets import Button, Static
from textual.widgets._toast import Toast

from m3r_app.run_setup import RunSetup
from safety.vocabulary import Command, State
from tests.told import told
from tests.ui.console_stage import LARGE, SMALL, SNAPSHOTS, Stage, console, drawn, flying_snapshot, hillside, text_of
from ui.console.keys import FLOOD, KEYS
from ui.console.prompts import READ_S, Help, Question
from ui.console.terminal import PlainSigns, is_plain, plain_signs
from ui.console.views import heights

pytestmark = pytest.mark.xdist_group("screen")  # one at a time, so that what is drawn is drawn in time

FINDINGS = (
    {"requirements": ["R3"], "constraint": "obstacle_clearance", "margin": -0.6, "text": "the wall: 0.6 m too near"},
    {
        "requirements": ["R7"],
        "constraint": "workspace",
        "margin": 4.0,
        "passed": True,
        "text": "workspace: 4.0 m to spare",
    },
)
SHORTENED = told("decision", 12.3, request="panel-1", verdict="reduced", granted_m=0.4, findings=FINDINGS)
REJECTED = told("decision", 12.3, request="panel-1", verdict="rejected", findings=FINDINGS)
STORY = [
    told("pair", 10.0),
    told("request", 12.3, id="panel-1", command="go_right", modality="panel", confidence=1.0, latency_ms=0.0),
    SHORTENED,
    told("announce", 12.3, text="Red: right 0.40 m of 1.00 m, the wall: 0.6 m too near"),
]


@pytest.fixture(scope="module")
def setup() -> RunSetup:
    return hillside()


async def until(pilot: Pilot[Any], condition: Callable[[], bool], within_s: float = 10.0) -> None:
    """Wait for what the screen shows only when the machine has had the time to draw it."""
    deadline_s = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < deadline_s, f"not within {within_s:g} s"
        await pilot.pause(0.05)


async def test_a_key_asks(setup: RunSetup) -> None:
    stage = Stage(flying_snapshot(setup))
    async with console(stage).run_test(size=SMALL) as pilot:
        for key in KEYS:
            stage.now_s += 1.0
            await pilot.press(key)
    assert stage.commands == list(KEYS.values())


@pytest.mark.parametrize("size", [SMALL, LARGE])
async def test_a_button_asks_at_both_sizes(setup: RunSetup, size: tuple[int, int]) -> None:
    stage = Stage(flying_snapshot(setup))
    asked = [command for command in Command if command not in (Command.ACTIVATE, Command.DISCONNECT)]
    async with console(stage).run_test(size=size) as pilot:
        for command in asked:
            stage.now_s += 1.0
            await pilot.click(f"#{command.value}")
    assert stage.commands == asked


async def test_a_digit_or_a_click_pairs(setup: RunSetup) -> None:
    stage = Stage(flying_snapshot(setup, paired=False))
    async with console(stage).run_test(size=SMALL) as pilot:
        await pilot.pause(0.3)
        await pilot.press("2")
        stage.now_s += 1.0
        await pilot.click("#pair-2")
        stage.now_s += 1.0
        await pilot.press("9")  # there is no ninth drone
    assert stage.asked == [(Command.ACTIVATE, "green"), (Command.ACTIVATE, "blue")]


async def test_stop_from_every_focus(setup: RunSetup) -> None:
    stage = Stage(flying_snapshot(setup))
    app = console(stage)
    async with app.run_test(size=SMALL) as pilot:
        await pilot.pause(0.3)
        for number, widget in enumerate(app.screen.focus_chain):
            widget.focus()
            stage.asked.clear()
            await pilot.press(("space", "escape")[number % 2])
            assert stage.commands == [Command.STOP], widget
        for opens, screen, key in (
            (opens, screen, key)
            for opens, screen in (("question_mark", Help), ("x", Question), ("ctrl+p", CommandPalette))
            for key in ("space", "escape")
        ):
            stage.now_s += 1.0
            await pilot.press(opens)
            await pilot.pause()
            assert isinstance(app.screen, screen)
            stage.asked.clear()
            await pilot.press(key)
            assert stage.commands == [Command.STOP], screen
            await pilot.pause()
            assert not isinstance(app.screen, screen)


async def test_moves_are_not_flown_from_an_open_question(setup: RunSetup) -> None:
    stage = Stage(flying_snapshot(setup))
    async with console(stage).run_test(size=SMALL) as pilot:
        await pilot.press("x")
        for key in KEYS:
            await pilot.press(key)
        await pilot.press("1")
    assert stage.asked == []


async def test_too_small_says_how_large_and_still_stops(setup: RunSetup) -> None:
    stage = Stage(flying_snapshot(setup))
    app = console(stage)
    async with app.run_test(size=(79, 24)) as pilot:
        for size in ((79, 24), (80, 23), (20, 5), (1, 1)):
            await pilot.resize_terminal(*size)
            await pilot.pause(0.1)
            said = str(app.screen.query_one("#too_small", Static).render())
            assert f"{size[0]} x {size[1]}" in said
            assert "80 x 24" in said
            assert app.screen.query_one("#small").display
            stage.asked.clear()
            await pilot.press("space")
            assert stage.commands == [Command.STOP]
        await pilot.resize_terminal(*SMALL)
        await pilot.pause(0.1)
        assert not app.screen.query_one("#small").display


async def test_a_pasted_flood_asks_for_nothing_but_stop(setup: RunSetup) -> None:
    """Also questions are not answered by it: nobody has read them."""
    stage = Stage(flying_snapshot(setup))
    app = console(stage)
    async with app.run_test(size=SMALL) as pilot:
        for _ in range(4):
            await pilot.press("left", "right", "up", "c")
            stage.now_s += 0.01
        assert len(stage.asked) <= FLOOD
        stage.asked.clear()
        await pilot.press("space")
        assert stage.commands == [Command.STOP]
        stage.now_s += 10.0
        await pilot.press("left")
        assert stage.commands == [Command.STOP, Command.GO_LEFT]
        stage.now_s += 10.0
        await pilot.press("x", "y")
        assert Command.DISCONNECT not in stage.commands


async def test_a_paste_that_goes_on_answers_no_question_and_does_not_leave(setup: RunSetup) -> None:
    stage = Stage(flying_snapshot(setup))
    async with console(stage).run_test(size=SMALL) as pilot:
        await pilot.press("x")
        for _ in range(8):
            await pilot.press("y", "e")
            await pilot.pause(0.1)
        assert stage.asked == []
        await pilot.pause(READ_S)
        await pilot.press("y")
        await pilot.pause()
        assert stage.commands == [Command.DISCONNECT]
        stage.snapshot = flying_snapshot(setup, paired=False)
        for _ in range(FLOOD):
            await pilot.press("left")
        await pilot.press("q")
        await pilot.pause()
        assert not stage.quitted
        stage.now_s += 1.0
        await pilot.press("q")
    assert stage.quitted


async def test_m_opens_the_microphone(setup: RunSetup) -> None:
    stage = Stage(flying_snapshot(setup))
    async with console(stage).run_test(size=SMALL) as pilot:
        await pilot.press("m")
    assert stage.talked
    assert stage.asked == []


async def test_a_held_key_asks_once(setup: RunSetup) -> None:
    stage = Stage(flying_snapshot(setup))
    async with console(stage).run_test(size=SMALL) as pilot:
        for _ in range(5):
            await pilot.press("left")
            stage.now_s += 0.2
    assert stage.commands == [Command.GO_LEFT]


async def test_disconnecting_and_leaving_are_confirmed_and_name_the_drone(
    setup: RunSetup, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ui.console.prompts.READ_S", 0.0)
    stage = Stage(flying_snapshot(setup))
    app = console(stage)
    async with app.run_test(size=SMALL) as pilot:
        for key, words in (("x", "Red: disconnect?"), ("q", "Red: leave?")):
            stage.now_s += 1.0
            await pilot.press(key)
            await pilot.pause()
            assert words in text_of(drawn(app))
            await pilot.press("n")
            await pilot.pause()
            assert not stage.asked and not stage.quitted
        stage.now_s += 1.0
        await pilot.press("x")
        await pilot.pause()
        await pilot.press("y")
        await pilot.pause()
        assert stage.commands == [Command.DISCONNECT]
        await pilot.press("q")
        await pilot.pause()
        await pilot.press("y")
        await pilot.pause()
        assert stage.quitted
    assert READ_S > 0.2


async def test_take_off_and_landing_are_confirmed_and_only_without_a_session(
    setup: RunSetup, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ui.console.prompts.READ_S", 0.0)
    stage = Stage(flying_snapshot(setup))
    app = console(stage)
    async with app.run_test(size=SMALL) as pilot:
        await pilot.press("o")
        await pilot.pause()
        assert not isinstance(app.screen, Question)
        stage.snapshot = flying_snapshot(setup, paired=False)
        await pilot.pause(0.3)
        stage.now_s += 1.0
        await pilot.press("o")
        await pilot.pause()
        assert "Blue: take off to 5 m" in text_of(drawn(app))
        await pilot.press("y")
        await pilot.pause()
        await pilot.press("l")
        await pilot.pause()
        await pilot.click("#yes-1")
        await pilot.pause()
    assert stage.ground == [("take off 5", "blue"), ("land", "green")]


async def test_looking_first_shows_what_a_request_would_become(
    setup: RunSetup, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ui.console.prompts.READ_S", 0.0)
    stage = Stage(flying_snapshot(setup))
    app = console(stage)
    async with app.run_test(size=LARGE) as pilot:
        await pilot.press("d")
        await pilot.press("right")
        await pilot.pause()
        shown = text_of(drawn(app))
        assert "Red: go right would be" in shown
        assert "obstacle clearance" in shown
        assert stage.asked == []
        await pilot.press("n")
        await pilot.pause()
        assert stage.asked == []
        stage.now_s += 1.0
        await pilot.press("right")
        await pilot.pause()
        await pilot.press("y")
        await pilot.pause()
    assert stage.commands == [Command.GO_RIGHT]


async def test_a_toast_for_what_is_blocked_and_none_for_routine(setup: RunSetup) -> None:
    for events, expected in ((STORY, 0), ([*STORY, REJECTED], 1)):
        app = console(Stage(flying_snapshot(setup)), list(events))
        async with app.run_test(size=SMALL) as pilot:
            await pilot.pause(0.3)
            await until(pilot, lambda: len(app._notifications) == expected)  # noqa: B023
            toasts = list(app._notifications)
            assert all(toast.message.startswith("Red: blocked, the wall") for toast in toasts)


@pytest.mark.parametrize("size", [SMALL, LARGE])
async def test_toasts_leave_stop_and_every_button_to_the_mouse(setup: RunSetup, size: tuple[int, int]) -> None:
    stage = Stage(flying_snapshot(setup))
    app = console(stage, [REJECTED] * 6)
    async with app.run_test(size=size, notifications=True) as pilot:
        await until(pilot, lambda: bool(app.screen.query(Toast)))
        for number in range(3):  # a toast that covers it takes the click
            await pilot.click("#stop", offset=(1 + 5 * number, number))
            await pilot.pause(0.4)  # a button takes no second click within 0.2 s
        stage.now_s += 1.0
        await pilot.click("#help")
        await until(pilot, lambda: isinstance(app.screen, Help))
    assert stage.commands == [Command.STOP] * 3


async def test_of_many_toasts_the_newest_is_seen(setup: RunSetup) -> None:
    app = console(Stage(flying_snapshot(setup)))
    async with app.run_test(size=SMALL, notifications=True) as pilot:
        for number in range(5):
            finding = {
                **FINDINGS[0],
                "text": f"wall {number}: a reason that is told in more than one line",
            }
            app._flying._events.append(told("decision", 12.3, verdict="rejected", findings=[finding]))

            def newest() -> str:
                lines = map(_told, app.screen._compositor.render_strips())
                return next((line for line in reversed(list(lines)) if "▌ Red: blocked" in line), "")

            await until(pilot, lambda: f"wall {number}" in newest())  # noqa: B023 - used up before the next number


async def test_a_refusal_says_what_was_asked(setup: RunSetup) -> None:
    app = console(Stage(flying_snapshot(setup)), [REJECTED])
    async with app.run_test(size=SMALL) as pilot:
        await until(pilot, lambda: "rejected, 1.00 m asked" in text_of(drawn(app)))


async def test_with_many_drones_every_answer_is_on_the_screen_and_named(
    setup: RunSetup, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ui.console.prompts.READ_S", 0.0)
    snapshot = flying_snapshot(setup, paired=False)
    names = ("red", "green", "blue", "yellow", "magenta", "cyan", "white", "orange", "purple")
    stage = Stage(replace(snapshot, craft=tuple(replace(snapshot.craft[0], name=name) for name in names)))
    app = console(stage)
    async with app.run_test(size=SMALL) as pilot:
        await pilot.press("l")
        await pilot.pause()
        for button in app.screen.query(Button):
            assert app.screen.region.contains_region(button.region), button.label
            assert button.size.width >= len(str(button.label))
        await pilot.press("down", "down", "enter")
        await pilot.pause()
    assert stage.ground == [("land", "green")]


async def test_a_long_preview_is_read_by_keys(setup: RunSetup) -> None:
    app = console(Stage(flying_snapshot(setup)))
    async with app.run_test(size=SMALL) as pilot:
        await pilot.press("d", "pagedown")
        await pilot.pause(0.3)
        assert "no reserved volume" not in text_of(drawn(app))
        await pilot.press(*["down"] * 20)
        await until(pilot, lambda: "no reserved volume" in text_of(drawn(app)))


async def test_the_whole_caption_is_shown(setup: RunSetup) -> None:
    app = console(Stage(flying_snapshot(setup)))
    async with app.run_test(size=SMALL) as pilot:
        await until(pilot, lambda: "C courier" in text_of(drawn(app)))
        await pilot.press("v")
        await until(pilot, lambda: "towards the drone" in text_of(drawn(app)))


async def test_the_palette_names_the_drone_and_the_keys_that_are_stop(setup: RunSetup) -> None:
    app = console(Stage(flying_snapshot(setup)))
    async with app.run_test(size=SMALL) as pilot:
        await pilot.press("ctrl+p")
        await until(pilot, lambda: "Red: ask to go left" in text_of(drawn(app)))
        assert "STOP by space or Escape" in text_of(drawn(app))


@pytest.mark.parametrize("theme", ["textual-dark", "textual-light"])
async def test_a_neighbour_of_no_colour_is_seen_in_both_themes(setup: RunSetup, theme: str) -> None:
    snapshot = flying_snapshot(setup)
    fresh = tuple(replace(one, age_s=0.1) for one in snapshot.craft)
    app = console(Stage(replace(snapshot, craft=fresh)))
    async with app.run_test(size=SMALL) as pilot:
        app.theme = theme
        await pilot.pause(1.2)
        segments = [s for strip in app.screen._compositor.render_strips() for s in strip if s.text == "C"]
        styles = [s.style.color.get_truecolor() for s in segments if s.style and s.style.color]
        dark = [0.3 * r + 0.6 * g + 0.1 * b < 128 for r, g, b in styles]
        assert dark == [theme == "textual-light"] * len(dark)
        assert dark


@given(st.floats(-100.0, 100.0), st.floats(0.5, 200.0), st.integers(1, 60))
def test_no_height_is_written_over_another(low_m: float, span_m: float, rows: int) -> None:
    ticks = heights(low_m, low_m + span_m, rows)
    assert all(low_m - 1e-6 <= tick <= low_m + span_m + 1e-6 for tick in ticks)
    assert all(b - a > span_m / rows for a, b in pairwise(ticks))
    assert not any(str(tick).startswith("-0.0") and tick == 0.0 for tick in ticks)


def _told(strip: Strip) -> str:
    return "".join(segment.text for segment in strip)


async def test_ctrl_c_and_the_end_of_the_run_end_the_console(setup: RunSetup) -> None:
    stage = Stage(flying_snapshot(setup))
    app = console(stage)
    async with app.run_test(size=SMALL) as pilot:
        await pilot.press("ctrl+c")
        await pilot.pause(0.5)
    assert stage.interrupted
    assert not app.is_running


async def test_before_the_fleet_is_there_keys_do_no_harm() -> None:
    stage = Stage(None)
    async with console(stage).run_test(size=SMALL) as pilot:
        await pilot.pause(0.3)
        await pilot.press("x", "o", "l", "v", "plus", "minus", "t", "d", "left", "space", "q")
        await pilot.pause()
    assert stage.quitted
    assert Command.STOP in stage.commands


@pytest.mark.parametrize(
    ("name", "size", "theme", "paired", "state"),
    [
        ("unpaired", SMALL, "textual-dark", False, State.IDLE),
        ("armed", SMALL, "textual-dark", True, State.ARMED),
        ("executing", LARGE, "textual-light", True, State.EXECUTING),
        ("emergency", LARGE, "textual-dark", True, State.EMERGENCY_HOLD),
        ("side", SMALL, "textual-light", True, State.ARMED),
        ("help", SMALL, "textual-dark", True, State.ARMED),
    ],
)
async def test_the_screen_is_as_it_was(
    setup: RunSetup, name: str, size: tuple[int, int], theme: str, paired: bool, state: State
) -> None:
    """M3R_UPDATE_SNAPSHOTS=1 renews them; look at them then."""
    stage = Stage(flying_snapshot(setup, paired=paired, state=state))
    app = console(stage, list(STORY) if paired else [])
    async with app.run_test(size=size) as pilot:
        app.theme = theme
        if name == "side":
            await pilot.press("v")
        if name == "help":
            await pilot.press("question_mark")
        path = SNAPSHOTS / f"{name}.svg"
        if os.environ.get("M3R_UPDATE_SNAPSHOTS"):
            await pilot.pause(1.2)
            path.parent.mkdir(exist_ok=True)
            path.write_text(drawn(app))
        with suppress(AssertionError):  # what differs is told below
            await until(pilot, lambda: drawn(app) == path.read_text(), 5.0)
        svg = drawn(app)
    assert text_of(svg) == text_of(path.read_text())
    assert svg == path.read_text(), "the words are the same, the looks are not"


async def test_without_unicode_only_ascii_is_drawn(setup: RunSetup, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LC_ALL", "C")
    app = console(Stage(flying_snapshot(setup)), list(STORY))
    assert app.plain
    async with app.run_test(size=LARGE) as pilot:
        await pilot.pause(0.4)
        lines = [
            PlainSigns().apply(list(strip), app.screen.styles.background)
            for strip in app.screen._compositor.render_strips()
        ]
        assert all(segment.text.isascii() for line in lines for segment in line)
        shown = ["".join(segment.text for segment in line) for line in lines]
        assert not any("####" in line[:75] for line in shown[:30]), "lines of all kinds as one block"
        assert any("xxxx" in line for line in shown)  # the fence
        assert any("....." in line[:75] for line in shown)  # contours
        assert any(isinstance(one, PlainSigns) for one in app.get_line_filters())


async def test_without_colour_the_signs_tell(setup: RunSetup, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NO_COLOR", "1")
    snapshot = flying_snapshot(setup)
    low = replace(snapshot, craft=(replace(snapshot.craft[0], battery=0.1, link_age_s=9.0), *snapshot.craft[1:]))
    app = console(Stage(low), [*STORY, REJECTED])
    async with app.run_test(size=SMALL) as pilot:
        await pilot.pause(0.4)
        shown = text_of(drawn(app))
        lines = [list(strip) for strip in app.screen._compositor.render_strips()]
        for one in app.get_line_filters():
            lines = [one.apply(line, app.screen.background_colors[1]) for line in lines]
        for text in (" Red ", "↓", "B"):  # whose name it is may not sink into what is behind it
            style = next(s.style for line in lines for s in line if s.text == text)
            assert style is not None and style.color is not None and style.bgcolor is not None
            ink, paper = (sum(c.get_truecolor()) / 3.0 for c in (style.color, style.bgcolor))
            assert abs(ink - paper) > 100.0, text
    assert "!battery" in shown
    assert "!link age" in shown
    assert "[Armed]" in shown
    assert "rejected" in shown


@pytest.mark.parametrize(
    ("environment", "plain"),
    [
        ({"LANG": "en_US.UTF-8", "TERM": "xterm-256color"}, False),
        ({"LANG": "C.UTF-8", "TERM": "xterm"}, False),
        ({"LC_ALL": "C", "LANG": "en_US.UTF-8", "TERM": "xterm"}, True),
        ({"LANG": "de_DE.ISO-8859-1", "TERM": "xterm"}, True),
        ({"LANG": "de_DE@euro", "LC_ALL": "xx_YY.NO-SUCH", "TERM": "xterm"}, True),
        ({"LANG": "en_US.UTF-8", "TERM": "linux"}, True),
        ({"TERM": "xterm"}, False),
    ],
)
def test_a_terminal_tells_whether_it_knows_more_than_ascii(environment: dict[str, str], plain: bool) -> None:
    assert is_plain(environment) is plain


def test_plain_signs_keep_their_cells() -> None:
    text = "█░←↑◆✓╭─╮⠿⠀é…"
    assert plain_signs(text).isascii()
    assert len(plain_signs(text)) == len(text)


async def test_every_button_shows_its_whole_label(setup: RunSetup) -> None:
    for size in (SMALL, LARGE):
        app = console(Stage(flying_snapshot(setup)))
        async with app.run_test(size=size) as pilot:
            await pilot.pause(0.3)
            for button in app.screen.query(Button):
                label = str(button.label)
                assert button.size.width >= max(map(len, label.splitlines())), (size, label)
