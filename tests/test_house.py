"""The house itself: whose packages these are, that every requirement is kept somewhere, what must not be in a file."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

import safety
from safety.requirements import REQUIREMENTS

ROOT = Path(__file__).resolve().parent.parent
FLOORS = ("ui", "m3r_app", "modalities", "config", "safety")
TABLE = ROOT / "safety" / "requirements.py"
# Spelled so that this file does not contain what it forbids.
FORBIDDEN = {
    "a path of one machine": r"/(?:wor[k]|roo[t]|hom[e]/\w+|far[m])/",
    "a package registry": r"pyp[i]\.org|pythonhoste[d]|npmj[s]|deb\.debia[n]",
}
LARGEST_BYTES = 1 << 20


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
TESTS = cited([path for path in sources("tests") if path != Path(__file__).resolve()])


def test_safety_is_ours() -> None:
    """`safety` is a name that others could have; the one imported is this project's."""
    assert Path(safety.__file__).resolve().parent == ROOT / "safety"


@pytest.mark.parametrize("requirement", list(REQUIREMENTS))
def test_every_requirement_is_cited_by_code_and_by_a_test(requirement: str) -> None:
    assert requirement in CODE
    assert requirement in TESTS


def test_only_requirements_that_exist_are_cited() -> None:
    assert set(REQUIREMENTS) >= CODE | TESTS


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
