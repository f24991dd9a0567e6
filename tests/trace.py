"""Which test holds which requirement: read from the marks `pytest.mark.requirement("R7")` alone. `make trace` prints it.

Only a mark on a test counts, a function or a method: one on a file or a class does not say which test holds it.
"""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

from safety.requirements import REQUIREMENTS

TESTS = Path(__file__).resolve().parent


def marks(path: Path) -> Iterator[tuple[str, str]]:
    """(requirement, test) of a file: by the decorators of its tests."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.name.startswith("test_"):
            yield from ((one, node.name) for each in node.decorator_list for one in _named(each))


def marks_elsewhere(path: Path) -> list[str]:
    """Requirements that a file marks on anything but a test: on the whole file or a class, say."""
    everywhere = list(_named(ast.parse(path.read_text(encoding="utf-8"))))
    for one, _ in marks(path):
        everywhere.remove(one)
    return everywhere


def _named(node: ast.expr) -> Iterator[str]:
    for call in ast.walk(node):
        if isinstance(call, ast.Call) and ast.unparse(call.func) == "pytest.mark.requirement":
            yield from (str(ast.literal_eval(argument)) for argument in call.args)


def trace() -> dict[str, list[str]]:
    """Tests by requirement, in the order of the table; every requirement is in it."""
    found: dict[str, list[str]] = defaultdict(list)
    for path in sorted(TESTS.rglob("test_*.py")):
        for requirement, test in marks(path):
            found[requirement].append(f"{path.relative_to(TESTS)}::{test}")
    unknown = found.keys() - REQUIREMENTS.keys()
    assert not unknown, f"no such requirement: {sorted(unknown)}"
    return {requirement: found[requirement] for requirement in REQUIREMENTS}


def main() -> None:
    for requirement, tests in trace().items():
        print(f"{requirement:4} {REQUIREMENTS[requirement]}")
        for test in tests:
            print(f"       {test}")


if __name__ == "__main__":
    main()
