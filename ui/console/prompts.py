"""The console's questions and its help. Every question names the drone's colour; space and Escape stay STOP in all of them."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rich.console import RenderableType
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.screen import ModalScreen
from textual.widgets import Button, Static

if TYPE_CHECKING:
    from typing import ClassVar

READ_S = 0.5
"""A question shown for less than this has not been read, so keys, of a paste for example, do not answer it yet."""


@dataclass(frozen=True, slots=True)
class Choice:
    """One answer: what it is called, and what asking for it returns."""

    label: str
    answer: str


class Question(ModalScreen[str | None]):
    """A question with its answers; None: not answered. The first answer is the cautious one."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("n", "answer('')", "No", show=False),
        Binding("y", "yes", "Yes", show=False),
        Binding("left", "app.focus_previous", show=False),
        Binding("right", "app.focus_next", show=False),
        Binding("up", "move(-1)", show=False),
        Binding("down", "move(1)", show=False),
    ]

    def __init__(self, text: RenderableType, choices: tuple[Choice, ...], refusal: str = "No") -> None:
        super().__init__()
        self._text = text
        self._choices = choices
        self._refusal = refusal
        self._since_s = self._typed_s = time.monotonic()

    def compose(self) -> ComposeResult:
        with Vertical(id="question"):
            with VerticalScroll(id="asked", can_focus=False):
                yield Static(self._text, markup=False)
            with (Horizontal if len(self._choices) == 1 else Vertical)(id="answers"):
                yield Button(f"{self._refusal} (n)", id="no", compact=True)
                for number, choice in enumerate(self._choices):
                    key = " (y)" if number == 0 else ""
                    yield Button(f"{choice.label}{key}", id=f"yes-{number}", variant="primary", compact=True)
        yield Static("Space or Escape: STOP", id="still", markup=False)

    def on_mount(self) -> None:
        self.query_one("#no", Button).focus()

    def on_button_pressed(self, event: Button.Pressed) -> None:
        event.stop()
        name = event.button.id or ""
        self.action_answer("" if name == "no" else self._choices[int(name.removeprefix("yes-"))].answer)

    def typed(self, at_s: float) -> None:
        """A character was typed. One that follows the last too soon belongs to a paste and answers nothing. at_s: when;
        the same key is reported again as it bubbles up.
        """
        if 0.0 < at_s - self._typed_s < READ_S:
            self._since_s = at_s
        self._typed_s = at_s

    def action_move(self, by: int) -> None:
        """Among answers that stand below each other; else in the text, where it is longer than the screen."""
        if len(self._choices) > 1:
            self.focus_next() if by > 0 else self.focus_previous()
        else:
            self.query_one("#asked", VerticalScroll).scroll_relative(y=by)

    def action_yes(self) -> None:
        self.action_answer(self._choices[0].answer)

    def action_answer(self, answer: str) -> None:
        """An empty answer is no."""
        if answer and time.monotonic() - self._since_s < READ_S:
            return
        self.dismiss(answer or None)


class Help(ModalScreen[None]):
    """All keys."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("question_mark,q,enter", "dismiss", "Close"),
        Binding("up", "scroll('up')", show=False),
        Binding("down", "scroll('down')", show=False),
    ]

    def __init__(self, text: str) -> None:
        super().__init__()
        self._text = text

    def compose(self) -> ComposeResult:
        with VerticalScroll(id="keys"):
            yield Static(self._text, markup=False)

    def action_scroll(self, where: str) -> None:
        scroll = self.query_one("#keys", VerticalScroll)
        if where == "up":
            scroll.scroll_up()
        else:
            scroll.scroll_down()
