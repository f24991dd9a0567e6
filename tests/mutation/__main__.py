"""Mutation testing of the rules and the arbiter. Run from the project's root:

    .venv/bin/python -m tests.mutation [--only MODULE] [--sample N --seed S] [--jobs N] [--seconds S] [--page] TEST ...

Every small change of safety/ and m3r_app/arbiter/ is tried: some test must fail, or `survivors.toml` says why none need. It
goes on where it was stopped. Nothing is written but to .mutation/: the tree stays as it is. mutmut and cosmic-ray start the
tests anew for each mutant and write it into the tree (mutmut into a copy): seconds each, where this takes a tenth.
"""

from __future__ import annotations

import argparse
import gc
import os
import random
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path

HEAVY = ("numpy", "pydantic", "shapely", "hypothesis.strategies", "rich.console", "rasterio", "pymap3d")
"""Imported before the first fork, so that no child imports them again; nothing of ours is."""
for threads in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[threads] = "1"  # a fork takes no threads along

from tests.mutation import results as kept_results  # noqa: E402
from tests.mutation.covered import Map  # noqa: E402
from tests.mutation.mutants import ROOT, Mutant, dangerous, digest, modules, mutants_of  # noqa: E402
from tests.mutation.page import write  # noqa: E402
from tests.mutation.trial import Collected, Ours, Outcome, Stage, afresh, collect, in_child, mapped, told, within  # noqa: E402


def everything_read() -> str:
    """A short name for all that the tests are and read."""
    files = [*(ROOT / "tests").rglob("*.py"), *(ROOT / "config").rglob("*.toml")]
    return digest("".join(path.read_text(encoding="utf-8") for path in sorted(files) if "mutation" not in path.parts))


class Run:
    """One run: the mutants, what is known of them, and the tests."""

    def __init__(self, tests: Sequence[str], jobs: int, until_s: float, patience_s: float) -> None:
        self.tests, self.jobs, self.until_s, self.patience_s = tests, jobs, until_s, patience_s
        self.read = everything_read()
        self.began_s = time.monotonic()
        self.remember()

    def remember(self) -> None:
        """Read what is known, and which tests have noticed how many: by function, and of all."""
        self.results = kept_results.Results(kept_results.KEPT, self.read, self.patience_s)
        self.killers: dict[str, Counter[str]] = defaultdict(Counter)
        for name, (status, by) in self.results.known.items():
            if status == "killed":
                self.killers[""][by] += 1
                self.killers[name.partition(": ")[0]][by] += 1

    @property
    def over(self) -> bool:
        return time.monotonic() - self.began_s > self.until_s

    def where(self, collected: Collected) -> Map:
        """Which test runs which line, read again where nothing has changed since."""
        sources = digest("".join((ROOT / module).read_text(encoding="utf-8") for module in modules()))
        path = kept_results.KEPT / f"map-{self.read}-{sources}-{digest(' '.join(collected.items))}.json"
        if not path.is_file():

            def made() -> str:
                path.with_suffix(".new").write_text(mapped(collected).to_json(), encoding="utf-8")
                path.with_suffix(".new").rename(path)
                return "made"

            child, readable = in_child(made)
            os.waitpid(child, 0)
            said = os.read(readable, 4096).decode()
            if said != "made":
                raise SystemExit(f"The tests cannot be passed with nothing changed: {said.partition(chr(10))[2]}")
        return Map.from_json(path.read_text(encoding="utf-8"))

    def ordered(self, mutant: Mutant, tests: set[str], where: Map) -> list[str]:
        """What has noticed mutants of the same function before; then in turn what notices most in the time it takes, and
        what runs little else.
        """
        here, anywhere = self.killers[f"{mutant.module}::{mutant.scope}"], self.killers[""]
        first = sorted((name for name in tests if here[name]), key=lambda name: -here[name])
        worth = {name: (anywhere[name] + 0.5) / (where.seconds.get(name, 0.0) + 0.005) for name in tests}
        by_worth = sorted(tests, key=lambda name: (-worth[name], name))
        by_aim = sorted(tests, key=lambda name: (where.wide[name], name))
        in_turn = (name for pair in zip(by_worth, by_aim, strict=True) for name in pair)
        return list(dict.fromkeys((*first, *in_turn)))

    def note(self, outcome: Outcome) -> None:
        if outcome.status == "killed":
            for of in ("", f"{outcome.mutant.module}::{outcome.mutant.scope}"):
                self.killers[of][outcome.by] += 1
        self.results.add(outcome)

    def forked(self, todo: list[Mutant]) -> None:
        """Try what lies within functions, in a child that has collected the tests; what does not is left."""

        def then(collected: Collected) -> None:
            where, ours = self.where(collected), Ours()
            gc.freeze()

            def jobs() -> Iterator[tuple[Mutant, Callable[[], str]]]:
                for mutant in todo:
                    if self.over:
                        return
                    tests = {mutant.by} if mutant.by else where.of(mutant)
                    yield (
                        mutant,
                        partial(
                            within, mutant, collected, ours, self.ordered(mutant, tests, where), where, self.patience_s
                        ),
                    )

            for done, outcome in enumerate(told(self.jobs, jobs()), 1):
                self.note(outcome)
                if done % 200 == 0:
                    print(
                        f"{done} of {len(todo)} in {time.monotonic() - self.began_s:.0f} s",
                        file=sys.__stdout__,
                        flush=True,
                    )

        child = os.fork()
        if child == 0:
            ok = False
            try:
                ok = collect(self.tests, then)
            finally:
                os._exit(0 if ok else 1)
        if os.waitpid(child, 0)[1]:
            raise SystemExit("The tests could not be collected or passed; see above.")

    def stages(self, mutant: Mutant, where: Map) -> list[Stage]:
        """Where it is looked for first: two files whose tests notice most; then everywhere."""
        if mutant.by:
            return [([mutant.by.partition("::")[0]], [mutant.by])]
        near = where.touching(mutant.module)
        tests = [*self.ordered(mutant, near, where), *self.ordered(mutant, set(where.seconds) - near, where)]
        files = list(dict.fromkeys(name.partition("::")[0] for name in tests))[:2]
        few = [name for name in tests if name.partition("::")[0] in files]
        return [(files, few), (self.tests, [name for name in tests if name not in set(few)])]

    def from_import(self, todo: list[Mutant]) -> None:
        """Try what differs when a module is imported: everything anew in a child."""
        maps = sorted(kept_results.KEPT.glob(f"map-{self.read}-*.json"), key=lambda path: path.stat().st_mtime)
        where = Map.from_json(maps[-1].read_text(encoding="utf-8"))

        def jobs() -> Iterator[tuple[Mutant, Callable[[], str]]]:
            for mutant in todo:
                if self.over:
                    return
                yield mutant, partial(afresh, mutant, self.stages(mutant, where), where, self.patience_s)

        for done, outcome in enumerate(told(self.jobs, jobs()), 1):
            self.note(outcome)
            if done % 50 == 0:
                print(f"{done} of {len(todo)} from the import in {time.monotonic() - self.began_s:.0f} s", flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.mutation", description="Whether the tests notice small changes."
    )
    parser.add_argument("tests", nargs="*", help="the tests that must notice")
    parser.add_argument(
        "--dangerous", action="store_true", help="only the dangerous ones, each by the test that it names"
    )
    parser.add_argument("--only", action="append", default=[], metavar="MODULE", help="mutate this module alone")
    parser.add_argument("--sample", type=int, default=-1, metavar="N", help="the dangerous ones, and N others")
    parser.add_argument("--seed", type=int, default=0, help="which others")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="how many at a time")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="begin no other after so long")
    parser.add_argument(
        "--patience", type=float, default=2.0, metavar="S", help="of the processor, for tests of a mutant that pass"
    )
    parser.add_argument("--mix", action="store_true", help="in any order")
    parser.add_argument("--page", action="store_true", help="write docs/mutation.md")
    args = parser.parse_args()
    os.chdir(ROOT)
    for name in HEAVY:
        import_module(name)
    if args.dangerous:
        return only_dangerous()
    chosen = [name for name in modules() if not args.only or name in args.only]
    mutants = [mutant for name in chosen for mutant in mutants_of(name)[0]]
    if args.sample >= 0:
        mutants = random.Random(args.seed).sample(mutants, min(args.sample, len(mutants)))
    run = Run(args.tests, args.jobs, args.seconds, args.patience)
    first = [m for m in dangerous() if m.module in chosen]
    todo = [m for m in [*first, *mutants] if m.name not in run.results.known]
    if args.mix:
        random.Random(0).shuffle(todo)
    again = [m for m in todo if m.name in run.results.once]
    for part in ([m for m in todo if m.name not in run.results.once], again):
        if part and not run.over:
            run.forked(part)
            run.remember()
    at_import = [m for m in [*first, *mutants] if run.results.known.get(m.name, ("",))[0] == "afresh"]
    if at_import and not run.over:
        run.from_import(at_import)
    kept_results.spent_s(time.monotonic() - run.began_s)
    if args.page:
        write(run.results, args.patience, args.jobs)
    return said(run, first, mutants)


def only_dangerous() -> int:
    """Try each dangerous one with the test that it names. 1: one is not noticed."""
    unnoticed: list[str] = []

    def then(collected: Collected) -> None:
        ours = Ours()
        # The first with the test of the last, which has nothing to do with it: a control.
        control = replace(dangerous()[0], text="the control", by=dangerous()[-1].by)
        every = (*dangerous(), control)
        jobs = ((m, partial(within, m, collected, ours, [m.by], Map(), float("inf"))) for m in every)
        for outcome in told(2, jobs):
            if outcome.mutant is control:
                if outcome.status != "survived":
                    unnoticed.append(f"The control is noticed, so nothing that is said here counts: {outcome.by}")
            elif outcome.by != outcome.mutant.by:
                unnoticed.append(
                    f"{outcome.mutant.by} does not notice: {outcome.mutant.text} ({outcome.status} {outcome.by})"
                )

    if not collect(sorted({m.by.partition("::")[0] for m in dangerous()}), then):
        unnoticed.append("The tests cannot be collected.")
    print("\n".join(unnoticed) or f"{len(dangerous())} dangerous mutants are noticed.")
    return 1 if unnoticed else 0


def said(run: Run, first: list[Mutant], mutants: list[Mutant]) -> int:
    """Print what became of them. 1: some survive that should not."""
    bad = 0
    for module in sorted({m.module for m in mutants}):
        count = kept_results.counted(run.results, [m for m in mutants if m.module == module])
        print(f"{module:36} " + ", ".join(f"{n} {status}" for status, n in sorted(count.items())))
    why = kept_results.justified()
    for mutant in [*first, *mutants]:
        status, _ = run.results.known.get(mutant.name, ("not tried", ""))
        if status == "survived" and mutant.name not in why:
            print(f"survived: {mutant.module}:{mutant.lines[0]} {mutant.name}")
            bad = 1
        if status == "killed" and mutant.name in why:
            print(f"{kept_results.JUSTIFIED.name} names one that a test notices: {mutant.name}")
            bad = 1
    names = {m.name for m in mutants}
    for name in why:
        if name not in names and Path(name.partition("::")[0]).is_file() and len(names) > 8000:
            print(f"{kept_results.JUSTIFIED.name} names what is no mutant: {name}")
            bad = 1
    count = kept_results.counted(run.results, mutants)
    tried = count["killed"] + count["survived"] + count["justified"]
    print(
        f"{len(mutants)} mutants: {count['killed']} of {tried} tried are noticed ({100.0 * count['killed'] / max(1, tried):.1f} %), "
        f"{count['justified']} survive with a reason, {count['survived']} without, {count['not tried']} not tried, {count['no mutant']} compile to the same; "
        f"{time.monotonic() - run.began_s:.0f} s"
    )
    return bad


if __name__ == "__main__":
    sys.exit(main())
