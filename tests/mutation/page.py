"""The page docs/mutation.md: what became of the mutants, by module. Made by `make mutate MUTATE=--page`."""

from __future__ import annotations

import platform
from collections import Counter

from tests.mutation.mutants import ROOT, dangerous, digest, modules, mutants_of, source
from tests.mutation.results import Results, counted, spent_s

PAGE = ROOT / "docs" / "mutation.md"
HEADING = """# Small changes of the rules and the arbiter, and whether the tests notice

Made by `make mutate MUTATE=--page` from what `make mutate` found. Every small change (a mutant) of `safety/` and
`m3r_app/arbiter/` is tried: an edge of a comparison moved or turned, `and` for `or`, a condition always true or never, a
number one larger or its sign turned, `min` for `max`, plus for minus, an argument, a keyword, a statement or what is returned
left out, another index. The tests of the pure core (`PURE_TESTS` in the Makefile) must fail. Those of a mutant are passed
likeliest first, until one fails or those that pass have taken {patience_s:g} s of the processor; what is not noticed until then
counts as surviving. Why nothing comes of one that survives stands in `tests/mutation/survivors.toml` by its name; those
without a reason are named by `make mutate`. {dangerous} mutants that outsiders once found to survive are tried in every
`make test`, each by a test that knows what is right without asking the product.

| module | mutants | noticed | survive for a reason | survive without | not tried yet | share of the tried |
|---|---|---|---|---|---|---|
"""


def page(results: Results, patience_s: float, jobs: int) -> str:
    """The whole page."""
    rows: list[str] = []
    left_out: Counter[str] = Counter()
    total: Counter[str] = Counter()
    older = 0
    for module in modules():
        mutants, others = mutants_of(module)
        left_out += others
        if mutants:
            count = counted(results, mutants)
            total += count
            older += sum(m.name in results.once and m.name not in results.known for m in mutants)
            rows.append(_row(f"`{module}`", count))
    rows.append(_row("all", total))
    sources = digest("".join(source(module) for module in modules()))
    return "\n".join(
        [
            HEADING.format(patience_s=patience_s, dangerous=len(dangerous())) + "\n".join(rows),
            "",
            f"Of the tried, {older} were tried last with other tests, or less of them; `make mutate` tries them again.",
            f"Those that compile to what was there do not count: {total['no mutant']}.",
            "",
            "Not mutated: " + "; ".join(f"{n} places ({why})" for why, n in left_out.most_common()) + "; strings.",
            "",
            f"To reproduce: `make mutate` ({spent_s() / 60.0:.0f} minutes on {jobs} cores; it goes on where it was stopped).",
            f"Python {platform.python_version()}, {platform.machine()}; the modules read `{sources}`.",
            "",
        ]
    )


def _row(name: str, count: Counter[str]) -> str:
    killed, reason, without = count["killed"], count["justified"], count["survived"]
    tried, yet = killed + reason + without, count["not tried"] + count["afresh"]
    share = f"{100.0 * killed / tried:.1f} %" if tried else "-"
    return f"| {name} | {tried + yet} | {killed} | {reason} | {without} | {yet} | {share} |"


def write(results: Results, patience_s: float, jobs: int) -> None:
    PAGE.write_text(page(results, patience_s, jobs), encoding="utf-8")
