"""The mutation tool itself, and what it must say in every run of the tests: the dangerous mutants are noticed."""

from __future__ import annotations

import ast
import subprocess
import sys

from tests.mutation.mutants import ROOT, changed, mutants_of
from tests.mutation.operators import change, places
from tests.mutation.results import justified

SOURCE = """
LIMIT = 3

def f(a, b=1):
    if not a < b and max(a, b) > 2:
        raise ValueError("no")
    return g(a, key=b)[0] - 1.5
"""


def of(source: str) -> dict[str, str]:
    """What each change of the source makes of it."""
    made = {}
    for place in places(ast.parse(source)):
        tree = ast.parse(source)
        change(tree, place.number)
        made[place.text] = ast.unparse(tree)
    return made


def test_every_kind_of_change_is_made() -> None:
    made = of(SOURCE)
    for text in (
        "LIMIT = 3  ->  LIMIT = 4",
        "a < b  ->  a <= b",
        "max(a, b) > 2  ->  max(a, b) >= 2",
        "not a < b and max(a, b) > 2  ->  not a < b or max(a, b) > 2",
        "not a < b and max(a, b) > 2  ->  a < b and max(a, b) > 2",
        "max(a, b)  ->  min(a, b)",
        "max(a, b)  ->  max(None, b)",
        "if not a < b and max(a, b) > 2  ->  if False",
        "left out: raise ValueError('no')",
        "g(a, key=b)[0]  ->  g(a, key=b)[1]",
        "g(a, key=b)  ->  g(a)",
        "g(a, key=b)[0] - 1.5  ->  g(a, key=b)[0] + 1.5",
        "g(a, key=b)[0] - 1.5  ->  g(a, key=b)[0] - 2.5",
        "return g(a, key=b)[0] - 1.5  ->  return None",
    ):
        assert made[text] != ast.unparse(ast.parse(SOURCE)), text
    assert len(set(made.values())) == len(made), "no two are the same"


def test_what_people_read_is_left_as_it_is() -> None:
    assert of('def f(a):\n    """Says 3."""\n    return f"{a + 1} m"\n').keys() >= {"a + 1  ->  a - 1"}
    left_out = {p.text: p.left_out for p in places(ast.parse('def f(a: int | None):\n    return f"{a + 1} m"\n'))}
    assert left_out["a + 1  ->  a - 1"] == "within a sentence" and left_out["int | None  ->  int & None"] == "a type"


def test_only_the_function_that_differs_is_exchanged() -> None:
    before = compile(SOURCE, "x", "exec")
    pairs = changed(before, compile(SOURCE.replace("a < b", "a <= b"), "x", "exec"))
    assert pairs is not None and [(old.co_name, new.co_name) for old, new in pairs] == [("f", "f")]
    assert changed(before, compile(SOURCE, "x", "exec")) == []
    for at_import in (("LIMIT = 3", "LIMIT = 4"), ("b=1", "b=2")):
        assert changed(before, compile(SOURCE.replace(*at_import), "x", "exec")) is None


def test_what_is_justified_is_a_mutant_of_today() -> None:
    said = justified()
    names = {m.name for module in {name.partition("::")[0] for name in said} for m in mutants_of(module)[0]}
    assert said.keys() - names == set(), "no such mutant any more: take it out of survivors.toml"


def test_the_dangerous_ones_are_noticed_by_the_tests_they_name() -> None:
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-m", "tests.mutation", "--dangerous"],
        cwd=ROOT, capture_output=True, text=True, check=False, timeout=100,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
