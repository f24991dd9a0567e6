"""The terminal is the console's own while it lasts."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from ui.console.terminal import NoTerminalError, own_screen, require_terminal


def test_what_libraries_print_goes_to_the_log_and_the_screen_is_kept(tmp_path: Path) -> None:
    """In a process of its own, since it is about the descriptors 1 and 2 themselves."""
    log, out, err = tmp_path / "log", tmp_path / "out", tmp_path / "err"
    pid = os.fork()
    if pid == 0:
        try:
            os.dup2(os.open(out, os.O_WRONLY | os.O_CREAT), 1)
            os.dup2(os.open(err, os.O_WRONLY | os.O_CREAT), 2)
            sys.__stdout__, sys.__stderr__ = os.fdopen(1, "w", closefd=False), os.fdopen(2, "w", closefd=False)
            sys.stdout, sys.stderr = sys.__stdout__, sys.__stderr__
            with own_screen(log):
                os.write(1, b"a library on 1\n")
                os.write(2, b"a library on 2\n")
                print("python")
                print("screen \u2588", file=sys.__stderr__, flush=True)
            os.write(2, b"after\n")
        finally:
            os._exit(0)
    os.waitpid(pid, 0)
    assert sorted(log.read_text().splitlines()) == ["a library on 1", "a library on 2", "python"]
    assert out.read_text() == ""
    assert err.read_text() == "screen \u2588\nafter\n"


@pytest.mark.parametrize("term", [{"TERM": "xterm"}, {"TERM": "dumb"}, {}])
def test_without_a_terminal_one_sentence(term: dict[str, str]) -> None:
    with pytest.raises(NoTerminalError, match="use m3r run --") as error:
        require_terminal(term)
    assert "\n" not in str(error.value)


def test_a_browser_needs_no_terminal() -> None:
    require_terminal({"TEXTUAL_DRIVER": "textual.drivers.web_driver:WebDriver"})
