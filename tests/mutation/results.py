"""What became of each mutant, kept between runs, and what is said of those that no test notices."""

from __future__ import annotations

import ast
import json
import tomllib
from collections import Counter
from collections.abc import Iterable
from functools import cache
from pathlib import Path

from tests.mutation.mutants import ROOT, Mutant, digest, source
from tests.mutation.trial import Outcome

KEPT = ROOT / ".mutation"
JUSTIFIED = Path(__file__).with_name("survivors.toml")


def justified() -> dict[str, str]:
    """Why each may survive, by the mutant's name."""
    read = tomllib.loads(JUSTIFIED.read_text(encoding="utf-8"))
    said: dict[str, str] = {}
    for group in read.get("survivors", []):
        for name in group["mutants"]:
            if name in said:
                raise ValueError(f"{JUSTIFIED.name} names it twice: {name}")
            said[name] = group["why"]
    return said


class Results:
    """One line a mutant. What was killed stays so while its module and the test read the same; what survived, while its module
    and all tests do, and no more of them are to be passed.
    """

    def __init__(self, kept: Path, tests: str, patience_s: float) -> None:
        self.path, self.tests, self.patience_s = kept / "results.jsonl", tests, patience_s
        self.known: dict[str, tuple[str, str]] = {}
        self.once: dict[str, str] = {}
        """What became, with other tests or less patience, of those that are to be tried again."""
        kept.mkdir(exist_ok=True)
        for line in self.path.read_text(encoding="utf-8").splitlines() if self.path.is_file() else ():
            each = json.loads(line)
            if each["module"] != digest(source(each["of"])):
                continue
            untried = each["status"] == "survived" and each["patience_s"] < patience_s
            if untried or each["tests"] != self._tests_of(each["by"]):
                self.once[each["name"]] = each["status"]
            else:
                self.known[each["name"]] = each["status"], each["by"]
        self.path.touch()

    def _tests_of(self, by: str) -> str:
        file, _, test = by.partition("::")
        return _digests(file).get(test.partition("[")[0], "gone") if test else self.tests

    def add(self, outcome: Outcome) -> None:
        mutant = outcome.mutant
        by = outcome.by if outcome.status == "killed" and "::" in outcome.by else outcome.by[:200]
        self.known[mutant.name] = outcome.status, by
        line = {
            "name": mutant.name,
            "of": mutant.module,
            "module": digest(source(mutant.module)),
            "tests": self._tests_of(by),
            "status": outcome.status,
            "by": by,
            "patience_s": self.patience_s,
        }
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")


@cache
def _digests(file: str) -> dict[str, str]:
    """A short name for the text of each test in a file."""
    path = ROOT / file
    text = path.read_text(encoding="utf-8") if path.is_file() else ""
    tests = (node for node in ast.parse(text).body if isinstance(node, ast.FunctionDef))
    return {node.name: digest(ast.unparse(node)) for node in tests}


def spent_s(more_s: float = 0.0) -> float:
    """How long all runs together have taken, this one as well."""
    path = KEPT / "seconds"
    total_s = more_s + (float(path.read_text(encoding="utf-8")) if path.is_file() else 0.0)
    path.write_text(f"{total_s:.1f}", encoding="utf-8")
    return total_s


def counted(results: Results, mutants: Iterable[Mutant]) -> Counter[str]:
    """How many of each status; justified ones apart."""
    said = justified()
    count: Counter[str] = Counter()
    for mutant in mutants:
        status = results.known.get(mutant.name, (results.once.get(mutant.name, "not tried"), ""))[0]
        count["justified" if status == "survived" and mutant.name in said else status] += 1
    return count
