"""Which test runs which line, and for how long."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass, field
from functools import cached_property

from tests.mutation.mutants import Mutant


@dataclass
class Map:
    """Which test runs which line, and how long each takes (s of the processor, measured)."""

    seconds: dict[str, float] = field(default_factory=dict)
    tests: dict[str, dict[int, list[str]]] = field(default_factory=dict)
    """By module and line."""

    @cached_property
    def wide(self) -> Counter[str]:
        """How many lines each test runs."""
        return Counter(test for lines in self.tests.values() for tests in lines.values() for test in tests)

    def of(self, mutant: Mutant) -> set[str]:
        """The tests that run a line of it."""
        lines = self.tests.get(mutant.module, {})
        return {test for line in mutant.lines for test in lines.get(line, ())}

    def touching(self, module: str) -> set[str]:
        return {test for tests in self.tests.get(module, {}).values() for test in tests}

    def to_json(self) -> str:
        names = list(self.seconds)
        number = {name: i for i, name in enumerate(names)}
        lines = {m: {n: [number[t] for t in of] for n, of in each.items()} for m, each in self.tests.items()}
        return json.dumps({"seconds": list(self.seconds.items()), "tests": lines})

    @classmethod
    def from_json(cls, text: str) -> Map:
        read = json.loads(text)
        names = [name for name, _ in read["seconds"]]
        tests = {m: {int(n): [names[i] for i in of] for n, of in each.items()} for m, each in read["tests"].items()}
        return cls(dict(read["seconds"]), tests)
