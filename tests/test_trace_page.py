"""The page that says what holds each requirement is that of this code and these tests."""

from __future__ import annotations

from safety.requirements import REQUIREMENTS
from scripts.trace_page import PAGE, naming, page


def test_the_page_is_up_to_date() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "make it anew: .venv/bin/python -m scripts.trace_page"


def test_every_requirement_is_named_somewhere_in_the_code() -> None:
    assert [one for one in REQUIREMENTS if not naming(one)] == []
