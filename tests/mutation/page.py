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
quickest first, until one fails or those that pass have taken {patience_s:g} s of the processor; what is not noticed until
then counts as surviving. Each that survives stands in `tests/mutation/survivors.toml` with the reason why nothing comes of it.
{dangerous} mutants that outsiders once found to survive are tried in every `make test`, each by a test that knows what is
right without asking the product.

| module | mutants | noticed | survive for a reason | survive without | share noticed |
|---|---|---|---|---|---|
"""


def page(results: Results, patience_s: float, jobs: int) -> str:
    """The whole page."""
    rows: list[str] = []
    left_out: Counter[str] = Counter()
    total: Counter[str] = Counter()
    for module in modules():
        mutants, others = mutants_of(module)
        left_out += others
        if mutants:
            count = counted(results, mutants)
            total += count
            rows.append(_row(f"`{module}`", count))
    rows.append(_row("all", total))
    sources = digest("".join(source(module) for module in modules()))
    return "\n".join(
        [
            HEADING.format(patience_s=patience_s, dangerous=len(dangerous())) + "\n".join(rows),
            "",
            f"Not tried yet: {total['not tried']}. Compile to what was there: {total['no mutant']}.",
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
    tried = killed + reason + without
    share = f"{100.0 * killed / tried:.1f} %" if tried else "-"
    return f"| {name} | {tried} | {killed} | {reason} | {without} | {share} |"


def write(results: Results, patience_s: float, jobs: int) -> None:
    PAGE.write_text(page(results, patience_s, jobs), encoding="utf-8")
