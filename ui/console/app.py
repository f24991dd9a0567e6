"""The console: keys and buttons become requests of the panel, a snapshot of the run is drawn on the screen.

It composes and shows; it decides nothing, and the run does not wait for it. Source: design "Command line", paper III-A.
"""

from __future__ import annotations

import os
import signal
from collections import deque
from typing import TYPE_CHECKING, Any, ClassVar

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text
from textual import events
from textual.app import App, ComposeResult, SystemCommand
from textual.binding import Binding, BindingType
from textual.command import CommandPalette
from textual.containers import Container, Horizontal, Vertical
from textual.screen import ModalScreen, Screen
from textual.widgets import Button, RichLog, Static

from m3r_app.arbiter.preview import Preview, preview
from m3r_app.output import DecisionEvent, RequestEvent
from m3r_app.snapshot import margins
from safety.vocabulary import Command
from ui.console import panels, story
from ui.console.drawing import Asked, from_above, from_side, reach_of_all
from ui.console.keys import KEYS, Keys
from ui.console.prompts import Choice, Help, Question
from ui.console.terminal import NEEDED, PlainSigns, Styled, is_plain
from ui.console.views import Skeleton, View

if TYPE_CHECKING:
    from collections.abc import Iterable

    from m3r_app.output import Told
    from m3r_app.run_thread import Live
    from m3r_app.snapshot import Snapshot
    from ui.console.seat import Seat

REFRESH_S = 0.2
"""Nobody reads faster, and drawing takes time from the control loop."""
TURNS = ("#above", "#side", "#above", "#skeleton")
"""The view that is drawn at each refresh, in turn."""
LARGE = (120, 40)
"""From this size on everything is shown at once."""
KEPT_EVENTS = 2000
LOG_LINES = 1000
TOASTS = 2
"""How many are shown at once."""
TAKEOFF_M = 5.0
"""How high the console offers to take off, unless told otherwise."""
STOP_KEYS = ("space", "escape")
DIGITS = "123456789"
MOVES = (
    ("go_left", "← left"),
    ("go_right", "→ right"),
    ("go_forward", "↑ forward"),
    ("go_back", "↓ back"),
    ("go_up", "PgUp up"),
    ("go_down", "PgDn down"),
)
OTHERS = (
    ("turn_left", "[ turn L"),
    ("turn_right", "] turn R"),
    ("continue", "c continue"),
    ("disconnect", "x unpair"),
    ("look", "d look"),
    ("help", "? help"),
)
HELP = """Space, Escape   STOP: hold now, from anywhere
Arrows          left, right, forward (away from you), back (towards you)
Page Up, Down   up, down
[ and ]         turn left, turn right
c               continue what STOP left
1 to 9          pair with the drone of that number
x               disconnect: the drone stays in Hold
d               look first: show what a request would become, then ask for it or not
o, l            take off, land (a drone that is not paired)
v               the other view (where there is room for one only)
m               open and close a push-to-talk microphone
+ and -         nearer, farther
t               dark or light
Ctrl-P          all commands by name
q, Ctrl-C       leave: the drone stays in Hold

Left, right, forward and back are yours, as you look at the drone.
Nothing you ask for is a command: what is not safe is shortened or refused, and the log says why.
Signs: O you, the arrow is the drone, + the anchor with its workspace, letters are other aircraft.
?, q or Enter close this."""


class Key(Button):
    """A button that is also a key: its label begins with it."""

    def __init__(self, label: str, name: str) -> None:
        super().__init__(label, id=name, compact=True)
        self.styles.line_pad = 0  # the labels need every cell (a style sheet takes no 0 here)


class Flying(Screen[None]):
    """The one screen: views, facts, log, buttons."""

    BINDINGS: ClassVar[list[BindingType]] = [
        *(
            Binding(key, f"ask('{command.value}')", command.value, priority=True, show=False)
            for key, command in KEYS.items()
        ),
        *(
            Binding(digit, f"pair({number})", f"pair {digit}", priority=True, show=False)
            for number, digit in enumerate(DIGITS)
        ),
        Binding("x", "disconnect", "disconnect", priority=True, show=False),
        Binding("d", "look", "look first", priority=True, show=False),
        Binding("o", "take_off", "take off", priority=True, show=False),
        Binding("l", "land", "land", priority=True, show=False),
        Binding("v", "other_view", "other view", priority=True, show=False),
        Binding("plus,equals_sign", "zoom(0.7)", "nearer", priority=True, show=False),
        Binding("minus", "zoom(1.4)", "farther", priority=True, show=False),
        Binding("m", "talk", "microphone", priority=True, show=False),
        Binding("t", "theme", "dark or light", priority=True, show=False),
        Binding("question_mark", "help", "help", priority=True, show=False),
        Binding("q,ctrl+q", "leave", "leave", priority=True, show=False),
    ]

    def __init__(self, live: Live, inbox: deque[Told], *, dry_run: bool, takeoff_m: float) -> None:
        super().__init__()
        self._live = live
        self._events = inbox
        self._dry_run = dry_run
        self._takeoff_m = takeoff_m
        self._keys = Keys()
        self._looks = 0
        self._looking = False
        self._side = False
        self._reach_m: float | None = None
        self._asked: Asked | None = None
        self._last: dict[str, tuple[float, float]] = {}
        self._colours: tuple[str, ...] = ()
        self._before: Told | None = None
        self._toasted_s: deque[float] = deque(maxlen=TOASTS)

    # ------------------------------------------------------------ what there is

    def compose(self) -> ComposeResult:
        yield Static(id="title", markup=False)
        with Horizontal(id="middle"):
            with Vertical(id="views"):
                yield View(id="above")
                yield View(id="side")
                yield Static(id="caption", markup=False)
            with Vertical(id="facts"):
                yield Static(id="margins", markup=False)
                yield Static(id="modes", markup=False)
                yield Static(id="senses", markup=False)
                yield Skeleton(id="skeleton")
        yield RichLog(id="log", max_lines=LOG_LINES, wrap=True, markup=False, auto_scroll=True)
        with Horizontal(id="panel"):
            with Vertical(id="buttons"):
                with Horizontal(id="colours", classes="row"):
                    yield Key("o take off", "take_off")
                    yield Key("l land", "land")
                for row in (MOVES, OTHERS):
                    with Horizontal(classes="row"):
                        for name, label in row:
                            yield Key(label, name)
            yield Button("STOP\nspace or Esc", id="stop", variant="error")
        with Container(id="small"):
            yield Static(id="too_small", markup=False)

    def on_mount(self) -> None:
        self.call_later(self.look)
        self.set_interval(REFRESH_S, self.look)
        self.query_one("#log").can_focus = True
        self.query_one("#stop").focus()

    def on_resize(self, event: events.Resize) -> None:
        width, height = event.size
        small = width < NEEDED[0] or height < NEEDED[1]
        self.set_class(small, "too-small")
        self.set_class(width >= LARGE[0] and height >= LARGE[1], "large")
        self.query_one("#too_small", Static).update(
            f"This terminal is {width} x {height}, the console needs {NEEDED[0]} x {NEEDED[1]}: make it larger. "
            "Space or Escape is still STOP."
        )

    # ------------------------------------------------------------ looking

    def look(self) -> None:
        """Draw the latest snapshot; all that has come since the last one is drawn together."""
        snapshot = self._live.snapshot
        self._read_events(snapshot)
        if snapshot is not None and not self._colours:
            self._show_colours(snapshot)
        self._show("#title", panels.title(snapshot, dry_run=self._dry_run, looking=self._looking))
        facts = self.query_one("#facts").content_size.width
        if snapshot is not None:
            self._show("#margins", panels.margins(margins(snapshot.state, snapshot.paired, snapshot.at_s), facts))
        self._show("#modes", panels.modes(snapshot))
        self._show("#senses", panels.senses(snapshot, self._last, facts))
        self._looks += 1
        if snapshot is not None and not self.has_class("too-small"):
            self._draw(snapshot, self._looks % len(TURNS))

    def _draw(self, snapshot: Snapshot, turn: int) -> None:
        """Draw one view at a time, in turn, so that a key waits for one view at most."""
        selector = TURNS[turn]
        view = self.query_one(selector)
        if not view.display:
            return
        if isinstance(view, Skeleton):
            view.draw(snapshot.taken.hands)
        if not isinstance(view, View):
            return
        reach_m = self._reach_m or reach_of_all(snapshot)
        above = selector == "#above"
        both = self.has_class("large")
        drawing = (
            from_above(snapshot, reach_m, view.aspect, self._asked)
            if above
            else from_side(snapshot, 0.6 * reach_m if both else reach_m, view.aspect, self._asked)
        )
        view.draw(drawing, plain=bool(getattr(self.app, "plain", False)))
        if above or not both:
            self._show("#caption", Text(drawing.caption, style="dim", overflow="ellipsis"))

    def _show(self, selector: str, text: Text) -> None:
        """Update only what has changed."""
        widget = self.query_one(selector, Static)
        if getattr(widget, "_m3r_shown", None) != text:
            widget._m3r_shown = text  # type: ignore[attr-defined]
            widget.update(text)

    def _read_events(self, snapshot: Snapshot | None) -> None:
        log = self.query_one("#log", RichLog)
        session = snapshot.state.session if snapshot is not None else None
        width = log.scrollable_content_region.width or None
        while self._events:
            told = self._events.popleft()
            for line in story.lines(told, self._before):
                log.write(line, width=width)
            self._before, event = told, told.event
            if isinstance(event, RequestEvent):
                self._last[event.modality] = (self._live.clock(), event.confidence or 0.0)
            if isinstance(event, DecisionEvent):
                self._asked = Asked(event.requested_m, event.granted_m)
            toast = story.toast(event, session.colour if session is not None else "")
            if toast is not None:
                self._toast(toast)

    def _toast(self, text: str) -> None:
        """Remove the older toasts where more would be shown than fit: the newest is always seen."""
        now_s = self._live.clock()
        if len(self._toasted_s) == TOASTS and now_s - self._toasted_s[0] < self.app.NOTIFICATION_TIMEOUT:
            self.app.clear_notifications()
            self._toasted_s.clear()
        self._toasted_s.append(now_s)
        self.notify(text, severity="error", markup=False)

    def _show_colours(self, snapshot: Snapshot) -> None:
        self._colours = snapshot.setup.colours
        row = self.query_one("#colours", Horizontal)
        buttons = [
            Key(f"{number} {colour.capitalize()}", f"pair-{number - 1}")
            for number, colour in enumerate(self._colours[: len(DIGITS)], start=1)
        ]
        row.mount(*buttons, before=0)

    # ------------------------------------------------------------ asking

    def on_button_pressed(self, event: Button.Pressed) -> None:
        event.stop()
        name = event.button.id or ""
        if name == "stop":
            self.stop()
        elif name.startswith("pair-"):
            self.action_pair(int(name.removeprefix("pair-")))
        elif name in {c.value for c in Command} - {"disconnect"}:
            self.action_ask(name)
        else:
            getattr(self, f"action_{name}")()

    def stop(self) -> None:
        self._live.ask(Command.STOP, evidence="key or button")

    def action_ask(self, name: str) -> None:
        """A move, a turn or continue: asked at once, or looked at first."""
        command = Command(name)
        if not self._believed(name):
            return
        snapshot = self._live.snapshot
        if self._looking and snapshot is not None:
            self._look_first(command, snapshot)
        else:
            self._live.ask(command)

    def action_pair(self, number: int) -> None:
        if self._believed(f"pair {number}") and number < len(self._colours):
            self._live.ask(Command.ACTIVATE, colour=self._colours[number])

    def action_disconnect(self) -> None:
        colour = self._colour
        if colour is None:
            self.notify("no drone is paired", severity="warning")
        elif self._believed("disconnect"):
            question = f"{colour}: disconnect? It stays where it is, in Hold, and nobody is paired with it."
            self._question(question, (Choice("Disconnect", "yes"),), lambda _: self._live.ask(Command.DISCONNECT))

    def action_take_off(self) -> None:
        self._ground("take off", lambda c: c.in_air is False, lambda name: self._live.take_off(name, self._takeoff_m))

    def action_land(self) -> None:
        self._ground("land", lambda c: c.in_air is True, self._live.land)

    def action_look(self) -> None:
        self._looking = not self._looking
        self.query_one("#look", Button).set_class(self._looking, "on")

    def action_other_view(self) -> None:
        self._side = not self._side
        self.set_class(self._side, "side")

    def action_zoom(self, by: float) -> None:
        snapshot = self._live.snapshot
        if snapshot is not None:
            self._reach_m = min(80.0, max(3.0, (self._reach_m or reach_of_all(snapshot)) * by))

    def action_theme(self) -> None:
        self.app.theme = "textual-light" if self.app.current_theme.dark else "textual-dark"

    def action_talk(self) -> None:
        self._live.talk()

    def action_help(self) -> None:
        self.app.push_screen(Help(HELP))

    def action_leave(self) -> None:
        if not self._believed("leave"):
            return
        colour = self._colour
        if colour is None:
            self._live.quit()
            return
        question = f"{colour}: leave? It stays where it is, in Hold, and the console ends."
        self._question(question, (Choice("Leave", "yes"),), lambda _: self._live.quit())

    @property
    def _colour(self) -> str | None:
        """The paired drone's name."""
        snapshot = self._live.snapshot
        session = snapshot.state.session if snapshot is not None else None
        return session.colour.capitalize() if session is not None else None

    def _believed(self, key: str) -> bool:
        if self._keys.believes(key, self._live.clock()):
            return True
        if self._keys.ignored == 1:
            self.notify("more keys than anybody types: ignored until they end (STOP is not)", severity="warning")
        return False

    def _question(self, text: RenderableType, choices: tuple[Choice, ...], then: Any) -> None:
        def answered(answer: str | None) -> None:
            if answer is not None:
                then(answer)

        self.app.push_screen(Question(text, choices), answered)

    def _ground(self, what: str, fits: Any, then: Any) -> None:
        """Take-off and landing, confirmed, of a drone that can be."""
        snapshot = self._live.snapshot
        if snapshot is None or not self._believed(what):
            return
        if snapshot.state.session is not None:
            self.notify(f"{self._colour}: disconnect first, to {what} is no maneuver", severity="warning")
            return
        able = [c for c in snapshot.craft if c.ours and fits(c)]
        if not able:
            self.notify(f"there is no drone that could {what}", severity="warning")
            return
        height = f" to {self._takeoff_m:g} m" if what == "take off" else ""
        choices = tuple(Choice(f"{c.name.capitalize()}: {what}{height}", c.name) for c in able)
        names = " or ".join(c.name.capitalize() for c in able)
        question = f"{names}: {what}{height}? See that nobody is near. This is not checked against terrain or others."
        self._question(question, choices, then)

    def _look_first(self, command: Command, snapshot: Snapshot) -> None:
        request = self._live.request(command)
        found = preview(snapshot.state, request, self._live.clock())
        name = self._colour or "No drone"
        self._question(
            preview_table(name, command, found),
            (Choice(f"{name}: ask for it", "yes"),),
            lambda _: self._live.ask(command),
        )


def preview_table(name: str, command: Command, found: Preview) -> RenderableType:
    """What a request would become, with every finding, those that fail first."""
    text = Text(f"{name}: {story.words(command.value)} would be ", style="bold")
    if found.decision is None:
        return text.append(f"judged later: {found.text}" if found.text else "judged later")
    text.append_text(story.verdict(found.decision))
    if found.interrupts:
        text.append("; what is flown now would end first")
    table = Table.grid(padding=(0, 1), expand=True)
    table.add_column()
    table.add_column(no_wrap=True)
    table.add_column(justify="right", no_wrap=True)
    table.add_column(ratio=1)
    for finding in sorted(found.decision.findings, key=lambda f: f.passed):
        margin = "" if finding.margin is None else f"{finding.margin:+.2f} {finding.unit}"
        sign, style = ("✓", "green") if finding.passed else ("✗", "bold red")
        name_of = finding.constraint.replace("_", " ")
        table.add_row(Text(sign, style), Text(name_of, style), Text(margin, style), Text(finding.text))
    return Group(text, table)


class Console(App[None]):
    """The application: one screen, STOP from everywhere, an orderly end."""

    CSS_PATH = "console.tcss"
    TITLE = "M3R"
    ENABLE_COMMAND_PALETTE = True
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("ctrl+c", "interrupt", "leave", priority=True, show=False, system=True),
    ]

    def __init__(
        self,
        live: Live,
        inbox: deque[Told],
        *,
        dry_run: bool = False,
        takeoff_m: float | None = None,
        seat: Seat | None = None,
    ) -> None:
        super().__init__()
        self.live = live
        self._seat = seat
        if self.no_color:
            self._filters.insert(0, Styled())
        self.plain = is_plain(os.environ)
        if self.plain:
            self._filters.append(PlainSigns())
        self._flying = Flying(live, inbox, dry_run=dry_run, takeoff_m=takeoff_m or TAKEOFF_M)

    def on_mount(self) -> None:
        self.push_screen(self._flying)
        self.set_interval(REFRESH_S, self._end_with_the_run)
        # Textual would suspend, and the guard would end a suspended app.
        signal.signal(signal.SIGTSTP, lambda *_: self._refuse_to_suspend())

    async def on_event(self, event: events.Event) -> None:
        """Handle STOP before the widget that has the focus sees the key: a text field would swallow it, binding or not."""
        if isinstance(event, events.Key) and event.is_printable and isinstance(self.screen, Question):
            self.screen.typed(event.time)
        if isinstance(event, events.Key) and event.key in STOP_KEYS:
            self.action_stop()
        else:
            await super().on_event(event)

    def get_system_commands(self, _screen: Screen[Any]) -> Iterable[SystemCommand]:
        """The palette: everything that has a key, by its name, and whom it is for."""
        flying = self._flying
        drone = flying._colour or "No drone is paired"
        yield SystemCommand("STOP", f"{drone}: hold now", self.action_stop)
        for command in KEYS.values():
            yield SystemCommand(
                story.words(command.value).capitalize(),
                f"{drone}: ask to {story.words(command.value)}",
                lambda c=command: flying.action_ask(c.value),
            )
        for number, colour in enumerate(flying._colours):
            yield SystemCommand(
                f"Pair with {colour.capitalize()}", "Ask to pair", lambda n=number: flying.action_pair(n)
            )
        yield SystemCommand("Disconnect", f"{drone}: stays in Hold", flying.action_disconnect)
        yield SystemCommand("Take off", "A drone that nobody is paired with", flying.action_take_off)
        yield SystemCommand("Land", "A drone that nobody is paired with", flying.action_land)
        yield SystemCommand("Look first", "Show what a request would become before it is asked", flying.action_look)
        yield SystemCommand("Other view", "From above or from the side", flying.action_other_view)
        yield SystemCommand("Dark or light", "Change the theme", flying.action_theme)
        yield SystemCommand("Help", "All keys", flying.action_help)
        yield SystemCommand("Leave", "The drone stays in Hold", flying.action_leave)

    def action_command_palette(self) -> None:
        """Textual's, with a word about the keys that are STOP here too."""
        if not isinstance(self.screen, CommandPalette):
            self.push_screen(CommandPalette(id="--command-palette", placeholder="Search, or STOP by space or Escape"))

    def action_stop(self) -> None:
        """From every focus; a question that is open is answered by no."""
        self._flying.stop()
        if isinstance(self.screen, ModalScreen):
            self.pop_screen()

    def action_interrupt(self) -> None:
        """Ctrl-C: hold, and leave."""
        self.live.interrupt()

    def _refuse_to_suspend(self) -> None:
        self.notify("a drone may depend on this app, so it cannot be suspended: leave it with q", severity="warning")

    def _end_with_the_run(self) -> None:
        snapshot = self.live.snapshot
        if self._seat is not None and snapshot is not None:
            self._seat.tell(snapshot.state.session.colour if snapshot.state.session is not None else None)
        if self.live.ended:
            self.exit()
