"""What the temporal properties beside a flight cost: an update of each, beside RTAMT's online monitors of the same formulas.

    python benchmarks/property_watch.py

The signals are those of a flight of 10 s on the table-top, over and over, at the rate of the real one: telemetry 50 times a second,
neighbours and ticks 10 times. RTAMT is given every property whose formula its language has as it stands once the signs are
written in words, on discrete time: its window counts samples, ours measures seconds. It runs on Python up to 3.12.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable

from rich.console import Console
from rich.table import Table

from m3r_app.arbiter.effects import Effect
from m3r_app.arbiter.events import Event
from m3r_app.arbiter.signals import SignalReader
from m3r_app.property_watch import PropertyWatch
from safety.limits import Limits
from safety.properties import PROPERTIES, R11_AS_DESIGNED, Property
from safety.temporal import Signals, monitor
from safety.vocabulary import Command
from tests.m3r_app.tabletop import Tabletop

STEPS_PER_S = 70.0
UPDATES = 20_000
BAR_US = 2.0
BAR_SHARE = 0.05
WORDS = (("->", " implies "), ("&", " and "), ("|", " or "), ("!", " not "), (" S ", " since "))


def flight() -> list[tuple[Event, tuple[Effect, ...]]]:
    """What the arbiter is told and does."""
    table = Tabletop()
    table.paired().ask(Command.GO_LEFT)
    table.wait(8.0)
    return [(event, effects) for _, event, _, effects in table.steps]


def each_us(update: Callable[[int], object]) -> float:
    """The best of five passes, in microseconds an update."""
    best_s = min(_pass_s(update) for _ in range(5))
    return 1e6 * best_s / UPDATES


def _pass_s(update: Callable[[int], object]) -> float:
    began_s = time.perf_counter()
    for i in range(UPDATES):
        update(i)
    return time.perf_counter() - began_s


def ours(one: Property, signals: list[Signals]) -> float:
    update, n = monitor(one.formula).update, len(signals)
    clock = iter(range(10**9))
    return each_us(lambda i: update(next(clock) / STEPS_PER_S, signals[i % n]))


def rtamts(one: Property, signals: list[Signals]) -> float | None:
    """None: it does not run here."""
    try:
        import rtamt  # type: ignore[import-untyped]
    except ImportError:
        return None
    text = one.formula
    for sign, word in WORDS:
        text = text.replace(sign, word)
    text = re.sub(r"\bY\b", "prev ", re.sub(r"\bO\[(\d+),(\d+)\] (\w+)", r"once[\1:\2](\3)", text))
    text = re.sub(r"\bO (\w+)", r"once(\1)", text)
    specification = rtamt.StlDiscreteTimeSpecification()
    names = sorted(monitor(one.formula).names)
    for name in (*names, "out"):
        specification.declare_var(name, "float")
    specification.spec = f"out = {text}"
    specification.parse()
    samples = [[(name, sample[name]) for name in names] for sample in signals]
    n, clock = len(samples), iter(range(10**9))
    return each_us(lambda i: specification.update(next(clock), samples[i % n]))


def main() -> None:
    taken = flight()
    reader = SignalReader(Limits())
    signals: list[Signals] = [reader.read(event, effects) for event, effects in taken]
    table = Table("property", "formula", "ours, µs", "RTAMT, µs", "RTAMT / ours")
    most_us = 0.0
    for one in (*PROPERTIES, R11_AS_DESIGNED):
        us, theirs = ours(one, signals), rtamts(one, signals)
        most_us = max(most_us, us)
        told = ("does not run here", "-") if theirs is None else (f"{theirs:.2f}", f"{theirs / us:.1f}")
        table.add_row(one.requirement, one.formula, f"{us:.2f}", *told)
    watch, n, clock = PropertyWatch(Limits()), len(taken), iter(range(10**9))
    whole_us = each_us(lambda i: watch.after(*taken[i % n], next(clock) / STEPS_PER_S))
    share = whole_us * 1e-6 * STEPS_PER_S
    console = Console()
    console.print(table)
    console.print(f"dearest property {most_us:.2f} µs an update (at most {BAR_US:g})")
    console.print(
        f"signals and all properties {whole_us:.1f} µs a step, {share:.2%} of a core at {STEPS_PER_S:g} steps a second "
        f"(at most {BAR_SHARE:.0%})"
    )


if __name__ == "__main__":
    main()
