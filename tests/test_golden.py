"""Nothing that the arbiter does or the rules say has changed unnoticed; `python -m tests.golden` renews what is kept."""

from __future__ import annotations

import pytest

from tests.golden import CASES, FOLDER, made


@pytest.mark.parametrize(
    ("name", "part"), [(name, part) for name, (_, parts) in CASES.items() for part in range(parts)]
)
def test_nothing_has_changed(name: str, part: int) -> None:
    text = (FOLDER / f"{name}.txt").read_text(encoding="utf-8")
    kept = [line for line in text.splitlines() if line.startswith(f"{part:02} ")]
    assert made(name, part) == kept, "agreed to? then renew: python -m tests.golden"
