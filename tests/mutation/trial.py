"""Whether the tests notice a mutant: in a forked child, from the function's code up, or from the import where it must be.

One process collects the tests once; a child of it exchanges the code of the functions that differ, forgets what was cached,
and passes the tests that run the changed lines until one fails. What differs at import is tried by a child that had imported
nothing of ours, with the changed module in the place of the true one.
"""

from __future__ import annotations

import contextlib
import gc
import os
import resource
import select
import signal
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.machinery import SourceFileLoader
from types import CellType, CodeType, FunctionType
from typing import Any, Literal

import pytest
from coverage import Coverage
from hypothesis import Phase, settings

from tests.mutation.covered import Map
from tests.mutation.mutants import ROOT, Mutant, changed, code_of, modules, unchanged

PLAIN = [
    *("-p", "no:cacheprovider", "-p", "no:terminal", "-p", "no:xdist", "-p", "no:rerunfailures", "-p", "no:timeout"),
    *("-p", "no:faulthandler", "-p", "no:warnings", "-o", "addopts=--import-mode=importlib"),
]
MEMORY_BYTES = 3 << 30
ENDLESS = 10.0
"""A test that takes so many times its time, and 3 s, is noticed to go on for ever."""
ENDLESS_S = 3.0
AT_MOST_S = 900.0
ROOMS_OF_OURS = ("safety", "m3r_app", "modalities", "config", "ui", "tests")


@dataclass(frozen=True)
class Outcome:
    """status: killed, survived, or untried where no test runs a line of it."""

    mutant: Mutant
    status: str
    by: str = ""


class Collected:
    """The plugin that has pytest's collected tests, and does what is asked instead of passing them all."""

    def __init__(self, then: Callable[[Collected], None]) -> None:
        self.then = then
        self.failed: list[str] = []
        self.items: dict[str, pytest.Item] = {}
        self.happened = False

    def pytest_sessionstart(self) -> None:
        # A failing example is not made smaller, nor explained: that it fails is enough.
        settings.register_profile("mutation", settings.get_profile("sample"), phases=(Phase.explicit, Phase.generate))
        settings.load_profile("mutation")

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        if not session.testsfailed:
            self.items = {item.nodeid: item for item in session.items if not item.get_closest_marker("skip")}
            self.then(self)
            self.happened = True
        return True

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_makereport(self, item: pytest.Item, call: pytest.CallInfo[None]) -> pytest.TestReport:
        # Without the story of a failure, which takes longer to tell than to find.
        outcome: Literal["passed", "failed", "skipped"] = "passed"
        if call.excinfo is not None:
            outcome = "skipped" if isinstance(call.excinfo.value, pytest.skip.Exception) else "failed"
        said = None if outcome == "passed" else str(call.excinfo)
        return pytest.TestReport(item.nodeid, item.location, {}, outcome, said, call.when, (), call.duration)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self.failed.append(report.nodeid)

    def passes(self, name: str) -> bool:
        """Whether this test passes."""
        item = self.items[name]
        item.config.hook.pytest_runtest_protocol(item=item, nextitem=None)
        return not self.failed

    def first_failing(self, tests: Sequence[str], seconds: dict[str, float], patience_s: float) -> str | None:
        """The first that fails or does not end; so many seconds of the processor are spent on those that pass."""
        until_s = time.process_time() + patience_s
        for name in tests:
            if time.process_time() > until_s:
                return None
            # Of the processor, so that a busy machine changes nothing.
            signal.setitimer(signal.ITIMER_PROF, ENDLESS_S + ENDLESS * seconds.get(name, 0.0))
            passed = self.passes(name)
            signal.setitimer(signal.ITIMER_PROF, 0.0)
            if not passed:
                return name
        return None


def collect(tests: Sequence[str], then: Callable[[Collected], None]) -> bool:
    """Have pytest collect, then do it. False: they cannot be collected."""
    plugin = Collected(then)
    with contextlib.suppress(SystemExit):
        pytest.main([*PLAIN, *tests], plugins=[plugin])
    return plugin.happened


# ---------------------------------------------------------------- which test runs which line


def mapped(collected: Collected) -> Map:
    """Pass every test once, watched. Raises RuntimeError where one fails with nothing changed."""
    files = {str(ROOT / module): module for module in modules()}
    coverage = Coverage(data_file=None, config_file=False, include=list(files))
    ours = Ours()
    coverage.start()
    found = Map()
    for name in collected.items:
        ours.forget()
        coverage.switch_context(name)
        before_s = time.process_time()
        if not collected.passes(name):
            raise RuntimeError(f"{collected.failed[0]} fails with nothing changed")
        found.seconds[name] = round(time.process_time() - before_s, 4)
    coverage.stop()
    data = coverage.get_data()
    for file, module in files.items():
        lines = data.contexts_by_lineno(file)
        found.tests[module] = {line: [name for name in names if name] for line, names in sorted(lines.items())}
    return found


# ---------------------------------------------------------------- children


def in_child(work: Callable[[], str]) -> tuple[int, int]:
    """(process, where to read what it says) of a fork that does this and ends; what it cannot do it says as an error."""
    readable, writable = os.pipe()
    sys.stdout.flush()
    child = os.fork()
    if child:
        os.close(writable)
        return child, readable
    said = "error"
    try:
        os.setpgid(0, 0)
        os.close(readable)
        nothing = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(nothing, stream)
        resource.setrlimit(resource.RLIMIT_DATA, (MEMORY_BYTES, MEMORY_BYTES))

        def endless(*_: object) -> None:
            os.write(writable, b"killed\ndoes not end")
            os._exit(0)

        signal.signal(signal.SIGPROF, endless)
        said = work()
    except BaseException as error:  # noqa: BLE001 - whatever a mutant does, it is told
        said = f"killed\n{type(error).__name__}: {error}"
    finally:
        os.write(writable, said.encode()[:4000])
        os._exit(0)


def told(children: int, jobs: Iterator[tuple[Mutant, Callable[[], str]]]) -> Iterator[Outcome]:
    """Outcomes of jobs, as they come; so many children at a time."""
    running: dict[int, tuple[int, Mutant, float]] = {}
    more = True
    while more or running:
        while more and len(running) < children:
            job = next(jobs, None)
            more = job is not None
            if job is not None:
                child, readable = in_child(job[1])
                running[readable] = (child, job[0], time.monotonic())
        ready = select.select(list(running), [], [], 1.0)[0]
        for readable, (child, mutant, since_s) in list(running.items()):
            late = time.monotonic() - since_s > AT_MOST_S
            if readable not in ready and not late:
                continue
            if late:
                os.killpg(child, signal.SIGKILL)
            said = b"" if late else os.read(readable, 4096)
            os.close(readable)
            os.waitpid(child, 0)
            del running[readable]
            # One that ends without a word was ended by what it did.
            status, _, by = (said.decode() or "killed\nended").partition("\n")
            yield Outcome(mutant, status, by)


def within(
    mutant: Mutant, collected: Collected, ours: Ours, tests: Sequence[str], where: Map, patience_s: float
) -> str:
    """In a child of the process that has collected: exchange the code, pass the tests. Says again if it must be afresh."""
    try:
        pairs = changed(unchanged(mutant.module), code_of(mutant))
    except (SyntaxError, ValueError) as error:
        return f"no mutant\n{error}"
    if pairs is None:
        return "afresh"
    if not pairs:
        return "no mutant\ncompiles to the same"
    for old, new in pairs:
        functions = ours.of(old)
        if not functions or any(f.__code__.co_freevars != new.co_freevars for f in functions):
            return "afresh"
        for function in functions:
            function.__code__ = new
    ours.forget()
    if not tests:
        return "survived\nno test runs it"
    by = collected.first_failing(tests, where.seconds, patience_s)
    return f"killed\n{by}" if by is not None else "survived"


Stage = tuple[Sequence[str], Sequence[str]]
"""Files to collect, and tests of them to pass."""


def afresh(mutant: Mutant, stages: Sequence[Stage], where: Map, patience_s: float) -> str:
    """In a child that has imported nothing of ours: the changed module in the place of the true one, from the import on.

    stages: to collect a few files takes less time than all of them, and is often enough.
    """
    try:
        code = code_of(mutant)
    except (SyntaxError, ValueError) as error:
        return f"no mutant\n{error}"
    path, true_code = str(ROOT / mutant.module), SourceFileLoader.get_code

    def get_code(self: SourceFileLoader, fullname: str) -> CodeType | None:
        return code if self.path == path else true_code(self, fullname)

    SourceFileLoader.get_code = get_code  # type: ignore[method-assign]
    for files, tests in stages:
        by: list[str | None] = []
        if not collect(files, partial(_first, by, tests, where, patience_s)):
            return "killed\nthe tests cannot be collected"
        if by[0] is not None:
            return f"killed\n{by[0]}"
    return "survived"


def _first(by: list[str | None], tests: Sequence[str], where: Map, patience_s: float, collected: Collected) -> None:
    gone = next((name for name in tests if name not in collected.items), None)
    by.append(gone or collected.first_failing(tests, where.seconds, patience_s))


class Ours:
    """The functions of the mutated modules and all that is cached, found once in a process that has imported everything."""

    def __init__(self) -> None:
        files = {str(ROOT / module) for module in modules()}
        self.functions: dict[tuple[str, str, int], list[FunctionType]] = defaultdict(list)
        self.caches: list[Any] = []
        self.last: list[CellType] = []
        """What `safety.findings.once` remembers."""
        for each in gc.get_objects():
            if isinstance(each, FunctionType) and each.__code__.co_filename in files:
                self.functions[_key(each.__code__)].append(each)
                if each.__code__.co_qualname == "once.<locals>.asked":
                    self.last.append(dict(zip(each.__code__.co_freevars, each.__closure__ or (), strict=True))["last"])
            elif type(each).__name__ == "_lru_cache_wrapper" and str(each.__module__).split(".")[0] in ROOMS_OF_OURS:
                self.caches.append(each)

    def of(self, code: CodeType) -> list[FunctionType]:
        return self.functions.get(_key(code), [])

    def forget(self) -> None:
        for cache in self.caches:
            cache.cache_clear()
        for cell in self.last:
            cell.cell_contents = None


def _key(code: CodeType) -> tuple[str, str, int]:
    return code.co_filename, code.co_qualname, code.co_firstlineno
