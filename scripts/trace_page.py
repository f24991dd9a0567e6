"""Write `docs/trace.md`: what in the code, the tests and the record each requirement has. Run from the project's root.

    .venv/bin/python -m scripts.trace_page

Code: modules whose text names the id. Tests: files with tests that are marked with it, and how many. Record: the findings of
the constraints that serve it, as the topics `decision`, `margins` and `violation` of a flight record name them. Properties: its
formulas over time, which are watched in flight and judged by `m3r verify`, or why there is none.
"""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

from safety.properties import NO_PROPERTY, PROPERTIES, R11_AS_DESIGNED
from safety.requirements import REQUIREMENTS
from tests.trace import trace
from ui.requirements import served_by

ROOT = Path(__file__).resolve().parents[1]


PAGE = ROOT / "docs" / "trace.md"
CODE = ("safety", "modalities", "m3r_app", "ui")
TABLES = {"safety/requirements.py", "safety/fretish.py"}
"""They name every id."""
HEADING = """# What holds each requirement

Made by `.venv/bin/python -m scripts.trace_page` from the code and the tests; a test holds that it is up to date. The sentences and their FRETish
are printed by `m3r requirements`; single tests by `make trace`.

| id | requirement | code that names it | tests | findings in the record | properties over time |
|---|---|---|---|---|---|
"""


def naming(requirement: str) -> list[str]:
    """The modules whose text names the requirement."""
    word = re.compile(rf"\b{requirement}\b")
    files = (path for room in CODE for path in sorted((ROOT / room).rglob("*.py")))
    named = (str(path.relative_to(ROOT)) for path in files if word.search(path.read_text(encoding="utf-8")))
    return [name for name in named if name not in TABLES]


def properties(requirement: str) -> str:
    """The formulas that state it, or a part of it, by its rules at least; else why none does."""
    stating = (one.formula for one in (*PROPERTIES, R11_AS_DESIGNED) if requirement in (one.requirement, *one.also))
    found = "; ".join(f"`{formula}`".replace("|", "\\|") for formula in stating)
    if not found and served_by(requirement):
        found = next(f"`{one.formula}`" for one in PROPERTIES if "least_margin" in one.formula)
    return found or f"none: {NO_PROPERTY[requirement]}"


def page() -> str:
    """The whole page."""
    rows = []
    for requirement, tests in trace().items():
        files = Counter(test.partition("::")[0] for test in tests)
        held = ", ".join(f"`{name}` {count}" for name, count in sorted(files.items()))
        code = ", ".join(f"`{name}`" for name in naming(requirement))
        found = ", ".join(f"`{name}`" for name in served_by(requirement)) or "-"
        rows.append(
            f"| {requirement} | {REQUIREMENTS[requirement]} | {code} | {held} | {found} | {properties(requirement)} |"
        )
    return HEADING + "\n".join(rows) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
