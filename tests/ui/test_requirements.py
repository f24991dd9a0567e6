"""The export of the requirements: complete, FRETish that FRET's grammar takes, and forms that their tools read."""

from __future__ import annotations

import csv
import io
import re

import pytest

from safety.fretish import FRETISH
from safety.requirements import REQUIREMENTS
from ui import cli
from ui.requirements import FORMATS, served_by

SENTENCE = re.compile(
    r"(?:in \w+ mode )?"
    r"(?:(?P<word>upon|when) (?P<condition>[^;]+?) )?"
    r"the (?P<component>\w+) shall "
    r"(?:immediately|always|at the next timepoint|within \d+ seconds) "
    r"satisfy (?P<response>.+)"
)


@pytest.mark.parametrize("name", REQUIREMENTS)
def test_every_requirement_has_a_sentence_of_the_grammar(name: str) -> None:
    found = SENTENCE.fullmatch(FRETISH[name])
    assert found is not None, FRETISH[name]
    assert found["component"] in {"arbiter", "planner", "supervisor", "monitor", "guard"}
    for formula in (found["condition"] or "true", found["response"]):
        # It is one Boolean formula: with every name a number, Python's own grammar takes it.
        logic = re.sub(r"(?<![<>=!])=>", "<=", formula).replace("!", " not ").replace("&", " and ").replace("|", " or ")
        compile(logic.strip(), name, "eval")


def test_nothing_is_exported_that_is_no_requirement() -> None:
    assert FRETISH.keys() == REQUIREMENTS.keys()


def test_fretish_is_a_table_of_ids_and_sentences(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["requirements", "--format", "fretish"]) == 0
    rows = list(csv.DictReader(io.StringIO(capsys.readouterr().out)))
    assert {row["Requirement ID"]: row["FRETish"] for row in rows} == FRETISH


def test_strictdoc_has_one_block_a_requirement() -> None:
    document = FORMATS["strictdoc"]()
    assert re.findall(r"^UID: (\w+)$", document, re.MULTILINE) == list(REQUIREMENTS)
    assert all(f">>>\n{text}\n<<<" in document for text in REQUIREMENTS.values())


def test_markdown_names_the_constraints_that_serve_a_requirement() -> None:
    table = FORMATS["markdown"]()
    assert "terrain_clearance" in served_by("R4")
    row = next(line for line in table.splitlines() if line.startswith("| R4 |"))
    assert row.endswith(f"| {', '.join(served_by('R4'))} |")
    assert all(len(re.split(r"(?<!\\)\|", line)) == 6 for line in table.splitlines()), "no cell breaks the table"
