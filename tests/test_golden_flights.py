"""Three whole flights go as they went; what differs is printed, with the command that agrees to it."""

from __future__ import annotations

from difflib import unified_diff

import pytest

from tests.golden_flights import FLIGHTS, lines, path

pytestmark = pytest.mark.xdist_group("busy")
MOST_BYTES = 200_000


@pytest.mark.parametrize("name", FLIGHTS)
def test_the_flight_goes_as_it_went(name: str) -> None:
    kept = path(name).read_text(encoding="utf-8").splitlines()
    difference = list(unified_diff(kept, lines(name), "as it went", "as it goes now", lineterm="", n=1))
    assert not difference, "\n".join([*difference, "agreed to? then: .venv/bin/python -m tests.golden_flights"])


def test_they_are_worth_keeping_and_small() -> None:
    texts = [path(name).read_text(encoding="utf-8") for name in FLIGHTS]
    assert sum(len(text.encode()) for text in texts) <= MOST_BYTES
    for told in ('"approved"', '"reduced"', '"rejected"', '"completed"', '"aborted"', '"violation"', '"EmergencyHold"'):
        assert any(told in text for text in texts), told
