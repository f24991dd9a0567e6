"""The mutants of a module: what each is called, and the code it gives; read from the source, nothing of it is imported."""

from __future__ import annotations

import ast
import hashlib
import inspect
import tomllib
from collections import Counter
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import CodeType

from coverage import Coverage

from tests.mutation.operators import change, places

ROOT = Path(__file__).resolve().parents[2]
ROOMS = ("safety", "m3r_app/arbiter")
DANGEROUS = Path(__file__).with_name("dangerous.toml")
EXCLUDED = "its line is excluded from coverage, with a reason beside it"


@dataclass(frozen=True)
class Mutant:
    """One change of one module. number: its place among `places`; -1: made by replacing text, old by new.

    by: the test that must notice it, of a dangerous one.
    """

    module: str
    scope: str
    text: str
    lines: tuple[int, ...]
    number: int
    old: str = ""
    new: str = ""
    by: str = ""

    @property
    def name(self) -> str:
        return f"{self.module}::{self.scope}: {self.text}"


def modules() -> list[str]:
    """The modules that are mutated."""
    found = (path.relative_to(ROOT) for room in ROOMS for path in (ROOT / room).glob("*.py"))
    return sorted(str(path) for path in found)


@cache
def source(module: str) -> str:
    return (ROOT / module).read_text(encoding="utf-8")


def digest(text: str) -> str:
    """A short name for a text."""
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def mutants_of(module: str) -> tuple[list[Mutant], Counter[str]]:
    """All mutants, and how many places were left out, by reason. Two that read alike in one function are numbered."""
    excluded = _excluded(module)
    made: list[Mutant] = []
    left_out: Counter[str] = Counter()
    alike: Counter[tuple[str, str]] = Counter()
    for place in places(ast.parse(source(module))):
        why = place.left_out or (EXCLUDED if excluded.intersection(place.lines) else "")
        if why:
            left_out[why] += 1
            continue
        alike[place.scope, place.text] += 1
        nth = alike[place.scope, place.text]
        text = place.text if nth == 1 else f"{place.text}  ({nth})"
        made.append(Mutant(module, place.scope, text, tuple(place.lines), place.number))
    return made, left_out


def dangerous() -> list[Mutant]:
    """Those that outsiders found to survive once, as text of today's code. Each is noticed by the test that it names."""
    made = []
    for entry in tomllib.loads(DANGEROUS.read_text(encoding="utf-8"))["mutant"]:
        text, old, new = source(entry["module"]), entry["old"], entry["new"]
        if text.count(old) != 1:
            raise ValueError(f"{DANGEROUS.name}: {old!r} stands {text.count(old)} times in {entry['module']}, not once")
        first = text[: text.index(old)].count("\n") + 1
        lines = tuple(range(first, first + old.count("\n") + 1))
        made.append(Mutant(entry["module"], "dangerous", entry["name"], lines, -1, old, new, entry["by"]))
    return made


def code_of(mutant: Mutant) -> CodeType:
    """The compiled module with the change. Raises SyntaxError where it is none of the language."""
    text = source(mutant.module)
    if mutant.number < 0:
        tree = ast.parse(text.replace(mutant.old, mutant.new))
    else:
        tree = ast.parse(text)
        change(tree, mutant.number)
        ast.fix_missing_locations(tree)
    return _compiled(tree, mutant.module)


@cache
def unchanged(module: str) -> CodeType:
    """The compiled module."""
    return _compiled(ast.parse(source(module)), module)


def _compiled(tree: ast.Module, module: str) -> CodeType:
    return compile(tree, str(ROOT / module), "exec", dont_inherit=True)


def changed(before: CodeType, after: CodeType) -> list[tuple[CodeType, CodeType]] | None:
    """The functions, not those within functions, whose code differs, old and new; None: what runs at import differs too."""
    if _is_function(before) and _is_function(after):
        return [] if before == after else [(before, after)]
    mine, others = _inner(before), _inner(after)
    if len(mine) != len(others) or _outer(before) != _outer(after):
        return None
    pairs = [changed(a, b) for a, b in zip(mine, others, strict=True)]
    return None if None in pairs else [one for each in pairs if each is not None for one in each]


def _is_function(code: CodeType) -> bool:
    return bool(code.co_flags & inspect.CO_OPTIMIZED)


def _inner(code: CodeType) -> list[CodeType]:
    return [const for const in code.co_consts if isinstance(const, CodeType)]


def _outer(code: CodeType) -> tuple[object, ...]:
    consts = tuple(
        const.co_qualname if isinstance(const, CodeType) else (type(const), const, str(const))
        for const in code.co_consts
    )
    return code.co_code, consts, code.co_names, code.co_flags


@cache
def _excluded(module: str) -> frozenset[int]:
    found = Coverage(config_file=str(ROOT / "pyproject.toml"), data_file=None).analysis2(str(ROOT / module))
    return frozenset(found[2])
