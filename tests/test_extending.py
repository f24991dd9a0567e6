"""docs/extending.md does what it says: its blocks, put where they say into a copy of the project, pass its tests."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.test_house import FLOORS, ROOT, tracked

PAGE = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
BLOCK = re.compile(r"^```(\w+) (\S+)(?: after (.+?))?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
MOST = {"A constraint": 6, "A modality": 8, "A vehicle": 4, "An event of the output": 5}
"""Files of the program, which tests and pages for people are not."""
PROGRAM = (*FLOORS, "pyproject.toml")
LEFT_OUT = (".mp4", ".ogg", ".png", ".tif")
BESIDE = {
    "A constraint": (
        "tests/test_readme.py",
        "tests/config",
        "tests/safety/test_constraints.py",
        "tests/ui/test_cues.py",
    ),
    "An event of the output": ("tests/m3r_app/test_output_contract.py", "tests/ui/test_output.py"),
}
"""What else must still hold in the copy, beside the house's own tests."""


@dataclass(frozen=True)
class Block:
    """Text for a file: new, or after the first line that begins with `after`."""

    path: str
    after: str | None
    text: str


def sections() -> dict[str, str]:
    """The parts of the page by their headings, without the number of files."""
    parts = re.split(r"^## (.+)$", PAGE, flags=re.MULTILINE)[1:]
    return dict(zip((heading.partition(":")[0] for heading in parts[::2]), parts[1::2], strict=True))


def blocks(section: str) -> list[Block]:
    return [Block(path, after, text) for _, path, after, text in BLOCK.findall(sections()[section])]


def put(block: Block, root: Path) -> None:
    path = root / block.path
    if not block.after:
        assert not path.exists(), path
        path.parent.mkdir(exist_ok=True)
        path.write_text(block.text, encoding="utf-8")
        return
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    at = [number for number, line in enumerate(lines, start=1) if line.startswith(block.after)]
    assert at, f"{block.path} has no line that begins with {block.after!r}"
    lines.insert(at[0], block.text)
    path.write_text("".join(lines), encoding="utf-8")


def passes(root: Path, *command: str) -> None:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(root), *sys.path])}
    ran = subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stdout + ran.stderr


@pytest.mark.parametrize("section", list(sections()))
def test_its_blocks_are_all_that_it_takes(section: str, tmp_path: Path) -> None:
    for path in tracked():
        if path.suffix not in LEFT_OUT:
            copy = tmp_path / path.relative_to(ROOT)
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, copy)
    found = blocks(section)
    for block in found:
        if block.path == "run":
            program, *words = block.text.split()
            assert program == "python"
            passes(tmp_path, sys.executable, *words)
        else:
            put(block, tmp_path)
    python = sorted({block.path for block in found if block.path.endswith(".py")})
    tests = [path for path in python if path.startswith("tests/")]
    assert tests
    ruff, lint_imports = (str(Path(sys.executable).parent / name) for name in ("ruff", "lint-imports"))
    # As a person would: what was put into a file may join what is there.
    joined = sorted({block.path for block in found if block.after and block.path in python})
    passes(tmp_path, ruff, "check", "--fix", "--quiet", "--select", "I", *joined)
    passes(tmp_path, ruff, "format", "--quiet", *joined)
    passes(tmp_path, ruff, "check", *python)
    passes(tmp_path, ruff, "format", "--check", *python)
    passes(tmp_path, lint_imports, "--no-cache")
    beside = ("tests/test_house.py", *BESIDE.get(section, ()))
    passes(tmp_path, sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *tests, *beside)


@pytest.mark.parametrize("section", list(sections()))
def test_the_number_of_files_is_said_and_kept(section: str) -> None:
    (heading,) = re.findall(rf"^## {section}: (\d+) files$", PAGE, re.MULTILINE)
    changed = {block.path for block in blocks(section) if block.path.startswith(PROGRAM)}
    assert len(changed) <= int(heading) <= MOST[section]
    if section != "A modality":
        assert len(changed) == int(heading)


def test_the_gamepads_files_are_those_that_the_page_lists() -> None:
    listed = re.findall(r"^\| `(\S+)` \|", sections()["A modality"], re.MULTILINE)
    program = [path for path in tracked() if str(path.relative_to(ROOT)).startswith(PROGRAM)]
    named = [str(path.relative_to(ROOT)) for path in program if "gamepad" in path.read_bytes().decode(errors="ignore")]
    assert sorted(listed) == sorted(named)
    assert len(listed) <= MOST["A modality"]
