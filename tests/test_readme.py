"""What the README shows is what the program does."""

from __future__ import annotations

import re
from pathlib import Path

from m3r_app.arbiter.modes import mermaid
from safety.constraints import RULES

README = (Path(__file__).resolve().parent.parent / "README.md").read_text(encoding="utf-8")


def test_the_diagram_is_the_table() -> None:
    """Printed by `m3r modes`."""
    shown = re.search(r"```mermaid\n(.*?)\n```", README, re.DOTALL)
    assert shown is not None
    assert shown[1] == mermaid()


def test_every_rule_is_named() -> None:
    """And no other."""
    table = README.split("## What is checked")[1].split("## ")[0]
    assert set(re.findall(r"^\| (`.*?) \|", table, re.MULTILINE)), "the table of rules"
    named = {name for row in re.findall(r"^\| (`.*?) \|", table, re.MULTILINE) for name in re.findall(r"`(\w+)`", row)}
    assert named == {rule.name for rule in RULES}
