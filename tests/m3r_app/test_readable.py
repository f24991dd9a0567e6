"""What somebody else says cannot move a cursor, hide or reorder what stands beside it. Source: X6."""

from __future__ import annotations

import unicodedata

import pytest
from hypothesis import given
from hypothesis import strategies as st

from m3r_app.readable import HIDDEN, LONGEST, readable


@pytest.mark.parametrize(
    ("said", "shown"),
    [
        ("Arming denied: GPS", "Arming denied: GPS"),
        ("\x1b[2J\x1b[31mred", "[2J[31mred"),
        ("\x1b]0;title\x07text", "]0;titletext"),
        ("two\nlines\r\n\tand a tab", "two lines and a tab"),
        ("right\u202eto left\u202c", "rightto left"),
        ("zero\u200bwidth\ufeff", "zerowidth"),
        ("Kältebrücke höher 高", "Kältebrücke höher 高"),
        ("", ""),
    ],
)
def test_it_is_one_line_of_what_can_be_read(said: str, shown: str) -> None:
    assert readable(said) == shown


@given(st.text(max_size=3000), st.integers(5, 300))
def test_nothing_hidden_is_left_and_it_is_never_long(said: str, longest: int) -> None:
    shown = readable(said, longest)
    assert len(shown) <= longest <= 300
    assert not any(unicodedata.category(c) in HIDDEN for c in shown)
    assert readable(shown, longest) == shown


def test_the_longest_is_cut_visibly() -> None:
    assert readable("a" * 1000) == "a" * (LONGEST - 1) + "…"
