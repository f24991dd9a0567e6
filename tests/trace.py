"""Which test holds which requirement: read from the marks `pytest.mark.requirement("R7")` alone. `make trace` prints it.

A mark on a test names what that test holds; one on a file names what all of its tests are about.
"""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

from safety.requirements import REQUIREMENTS

TESTS = Path(__file__).resolve().parent


def marks(path: Path) -> Iterator[tuple[str, str]]:
    """(requirement, test) of a file; the test is empty where the mark is the whole file's."""
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        match node:
            case ast.FunctionDef() | ast.AsyncFunctionDef():
                yield from ((one, node.name) for each in node.decorator_list for one in _named(each))
            case ast.Assign(targets=[ast.Name(id="pytestmark")]):
                yield from ((one, "") for one in _named(node.value))


def _named(node: ast.expr) -> Iterator[str]:
    for call in ast.walk(node):
        if isinstance(call, ast.Call) and ast.unparse(call.func) == "pytest.mark.requirement":
            yield from (str(ast.literal_eval(argument)) for argument in call.args)


def trace() -> dict[str, list[str]]:
    """Tests by requirement, in the order of the table; every requirement is in it."""
    found: dict[str, list[str]] = defaultdict(list)
    for path in sorted(TESTS.rglob("test_*.py")):
        for requirement, test in marks(path):
            found[requirement].append(f"{path.relative_to(TESTS)}{'::' + test if test else ''}")
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
