"""The house itself: whose packages these are, that every requirement is kept somewhere, what must not be in a file."""

from __future__ import annotations

import ast
import re
import subprocess
from pathlib import Path

import pytest

import safety
from safety.requirements import REQUIREMENTS
from tests.trace import TESTS, marks, marks_elsewhere, trace

ROOT = Path(__file__).resolve().parent.parent
FLOORS = ("ui", "m3r_app", "modalities", "config", "safety")
TABLE = ROOT / "safety" / "requirements.py"
# Spelled so that this file does not contain what it forbids.
FORBIDDEN = {
    "a path of one machine": r"/(?:wor[k]|roo[t]|hom[e]/\w+|far[m])/",
    "a package registry": r"pyp[i]\.org|pythonhoste[d]|npmj[s]|deb\.debia[n]",
}
LARGEST_BYTES = 1 << 20
PURE = {
    "__future__",
    "collections",
    "dataclasses",
    "enum",
    "functools",
    "itertools",
    "operator",
    "re",
    "math",
    "numpy",
    "typing",
}
MAY_IMPORT = {
    "safety": {*PURE, "pymap3d", "shapely", "safety"},
    "m3r_app/arbiter": {*PURE, "safety", "m3r_app.arbiter", "m3r_app.output"},
}
"""What has no clock, no files, no network and no threads: what it may import, not what it may not."""


def tracked() -> list[Path]:
    """Every file of the project; without git, every file that is not made by tools."""
    listed = subprocess.run(["git", "-C", str(ROOT), "ls-files", "-z"], capture_output=True, text=True, check=False)
    if listed.returncode == 0 and listed.stdout:
        paths = [ROOT / name for name in listed.stdout.split("\0") if name]
    else:
        made = {".venv", ".stamps", ".git", "__pycache__"}
        paths = [path for path in ROOT.rglob("*") if not made & set(path.relative_to(ROOT).parts)]
    return [path for path in paths if path.is_file() and not path.is_symlink()]


def sources(*folders: str) -> list[Path]:
    return [path for folder in folders for path in (ROOT / folder).rglob("*.py")]


def cited(paths: list[Path]) -> set[str]:
    return {found for path in paths for found in re.findall(r"\b[RPGX]\d{1,2}\b", path.read_text(encoding="utf-8"))}


CODE = cited([path for path in sources(*FLOORS) if path != TABLE])
TRACE = trace()


def test_safety_is_ours() -> None:
    """`safety` is a name that others could have; the one imported is this project's."""
    assert Path(safety.__file__).resolve().parent == ROOT / "safety"


def imported(path: Path) -> set[str]:
    """What a file imports: of ours the package in its floor, of others the first name."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        match node:
            case ast.Import():
                found |= {alias.name for alias in node.names}
            case ast.ImportFrom(module=str(module), level=0):
                # `from m3r_app import plain` imports m3r_app.plain.
                found |= {f"{module}.{alias.name}" for alias in node.names} if module == "m3r_app" else {module}
            case ast.ImportFrom():
                raise AssertionError(f"{path}: a relative import")
    return {".".join(name.split(".")[: 2 if name.startswith("m3r_app.") else 1]) for name in found}


@pytest.mark.parametrize("folder", list(MAY_IMPORT))
def test_what_is_pure_imports_only_what_is(folder: str) -> None:
    for path in sources(folder):
        assert imported(path) <= MAY_IMPORT[folder], path


def test_an_import_is_found_wherever_it_stands(tmp_path: Path) -> None:
    one = tmp_path / "one.py"
    one.write_text("import os.path\nfrom m3r_app import runtime\ndef f():\n    from time import monotonic\n")
    assert imported(one) == {"os", "m3r_app.runtime", "time"}


@pytest.mark.parametrize("requirement", list(REQUIREMENTS))
def test_every_requirement_is_cited_by_code_and_held_by_a_test_that_names_it(requirement: str) -> None:
    assert requirement in CODE
    assert TRACE[requirement], "no test is marked with it"


def test_only_requirements_that_exist_are_cited() -> None:
    assert set(REQUIREMENTS) >= CODE


def test_only_marks_on_tests_count(tmp_path: Path) -> None:
    """A docstring that names R1 holds nothing, nor does a mark on a file, on a class or on what is no test."""
    one = tmp_path / "test_one.py"
    one.write_text(
        'import pytest\n"""R2"""\npytestmark = [pytest.mark.slow, pytest.mark.requirement("R3")]\n'
        '@pytest.mark.requirement("R4", "R5")\ndef test_it():\n    """R1"""\n'
        '@pytest.mark.requirement("R6")\nclass TestThis:\n'
        '    @pytest.mark.requirement("R7")\n    def test_that(self): ...\n'
        '@pytest.mark.requirement("R8")\ndef helps(): ...\n'
    )
    assert set(marks(one)) == {("R4", "test_it"), ("R5", "test_it"), ("R7", "test_that")}
    assert sorted(marks_elsewhere(one)) == ["R3", "R6", "R8"]


def test_requirements_are_marked_on_tests_alone() -> None:
    found = {str(path.relative_to(TESTS)): marks_elsewhere(path) for path in TESTS.rglob("*.py")}
    assert {path: named for path, named in found.items() if named} == {}


def test_the_tracked_files_are_seen() -> None:
    assert {ROOT / "pyproject.toml", TABLE} <= set(tracked())


@pytest.mark.parametrize("what", list(FORBIDDEN))
def test_no_file_names(what: str) -> None:
    pattern = re.compile(FORBIDDEN[what])
    found = [
        f"{path.relative_to(ROOT)}: {match[0]}"
        for path in tracked()
        if (match := pattern.search(path.read_bytes().decode("utf-8", errors="ignore")))
    ]
    assert found == []


def test_no_file_is_large() -> None:
    assert [path.name for path in tracked() if path.stat().st_size > LARGEST_BYTES] == []
