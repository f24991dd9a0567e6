"""The terminal as the console's own: what libraries print goes to a file, and a poor terminal gets plain signs.

Textual draws on `sys.__stderr__` (in a browser: `sys.__stdout__`); MediaPipe, MAVSDK and PortAudio write to the descriptors
1 and 2 from C++. So the screen gets descriptors of its own, and 1 and 2 lead to the log.
"""

from __future__ import annotations

import codecs
import contextlib
import locale
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from platformdirs import user_log_path
from rich.color import ColorType
from rich.segment import Segment
from rich.style import Style
from textual.filter import LineFilter

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from textual.color import Color

NEEDED = (80, 24)
"""Columns and rows."""
WEB_DRIVER = "TEXTUAL_DRIVER"
"""Set by whoever shows a Textual app elsewhere than in a terminal."""
PLAIN_TERMS = ("linux", "vt100", "vt220", "ansi")
_PLAIN = str.maketrans(
    {
        **dict.fromkeys("─━═╌┄▔▁▂▃", "-"),
        **dict.fromkeys("│┃║▏▎▍▌▐▕┊┆", "|"),
        **dict.fromkeys("┌┐└┘├┤┬┴┼╭╮╰╯┏┓┗┛╔╗╚╝┣┫┳┻╋", "+"),
        **dict.fromkeys("█▓▄▀▆▇▅", "#"),
        **dict.fromkeys("░▒", "."),
        **dict.fromkeys("●◆■◉⬤", "*"),
        **dict.fromkeys("○◌◎", "o"),
        **dict.fromkeys("▶►→❯›⭘", ">"),
        **dict.fromkeys("◀←", "<"),
        **dict.fromkeys("↑▲↗", "^"),
        **dict.fromkeys("↓▼↘↙↖", "v"),
        **dict.fromkeys("✓✔", "+"),
        **dict.fromkeys("✗✘×", "x"),
        **dict.fromkeys("·•…", "."),
        **dict.fromkeys("–—−", "-"),
        "’": "'",
        "“": '"',
        "”": '"',
        "°": "d",
        "²": "2",
    }
)


class NoTerminalError(ValueError):
    """There is no terminal that a console can be drawn on; one sentence."""


class Styled(LineFilter):
    """Before Textual's filter for NO_COLOR: every segment has a style, which it needs, and no name of a colour is left.

    As greys red and blue would hardly be seen.
    """

    def apply(self, segments: list[Segment], background: Color) -> list[Segment]:
        clear = Style(color=background.get_contrast_text(1.0).rich_color)
        return [
            Segment(s.text, (s.style or Style.null()) + (clear if _is_named(s.style) else Style.null()), s.control)
            for s in segments
        ]


def _is_named(style: Style | None) -> bool:
    return style is not None and style.color is not None and style.color.type is ColorType.STANDARD


class PlainSigns(LineFilter):
    """Every sign that ASCII lacks as one that it has, cell for cell."""

    def apply(self, segments: list[Segment], background: Color) -> list[Segment]:  # noqa: ARG002
        return [Segment(plain_signs(text), style, control) for text, style, control in segments]


def plain_signs(text: str) -> str:
    """The same in ASCII; braille dots are points, and what is unknown is a question mark."""
    if text.isascii():
        return text
    text = text.translate(_PLAIN)
    return "".join(
        c if c.isascii() else (" " if c == "\u2800" else "." if "\u2800" < c <= "\u28ff" else "?") for c in text
    )


def is_plain(environment: Mapping[str, str]) -> bool:
    """Whether this terminal shows ASCII only, as far as it tells."""
    told = environment.get("LC_ALL") or environment.get("LC_CTYPE") or environment.get("LANG") or ""
    if environment.get("TERM", "") in PLAIN_TERMS:
        return True
    if told in ("", "C", "POSIX"):
        return told != "" and "UTF" not in told.upper()
    name = told.partition(".")[2].partition("@")[0] or locale.getencoding()
    try:
        return codecs.lookup(name).name != "utf-8"
    except LookupError:
        return True


def require_terminal(environment: Mapping[str, str]) -> None:
    """Raises NoTerminalError where a console cannot be drawn."""
    if WEB_DRIVER in environment:
        return
    if not (sys.__stdin__ and sys.__stdin__.isatty() and sys.__stderr__ and sys.__stderr__.isatty()):
        raise NoTerminalError(
            "the console needs a terminal and this is none: use m3r run --headless or m3r run --plain"
        )
    if environment.get("TERM", "") in ("", "dumb"):
        raise NoTerminalError("this terminal (TERM is dumb or not set) cannot show a console: use m3r run --plain")


def log_path() -> Path:
    """Where what libraries print goes. The folder is made."""
    return user_log_path("m3r", ensure_exists=True) / "console.log"


@contextlib.contextmanager
def own_screen(log: Path) -> Iterator[None]:
    """While it lasts only the console writes to the terminal; everything else goes to `log`, which is begun anew."""
    kept = [os.dup(1), os.dup(2)]
    before = sys.stdout, sys.stderr, sys.__stdout__, sys.__stderr__
    for stream in before[:2]:
        if stream is not None:
            stream.flush()
    screen = [os.fdopen(os.dup(fd), "w", encoding="utf-8", errors="replace") for fd in kept]
    try:
        with log.open("w", encoding="utf-8", buffering=1) as file:
            os.dup2(file.fileno(), 1)
            os.dup2(file.fileno(), 2)
            sys.stdout = sys.stderr = file
            sys.__stdout__, sys.__stderr__ = screen  # type: ignore[misc]
            try:
                yield
            finally:
                sys.stdout, sys.stderr, sys.__stdout__, sys.__stderr__ = before  # type: ignore[misc]
    finally:
        for number, fd in enumerate(kept, start=1):
            os.dup2(fd, number)
            os.close(fd)
        for file in screen:
            with contextlib.suppress(OSError):  # the terminal is gone
                file.close()
