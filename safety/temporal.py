"""Past-time metric temporal logic over sampled signals, with robustness: how far a formula is from being false. Pure.

Notation: a name is a signal; `x >= 3` or `x >= y` (also <=, >, <) is their difference; `!`, `&`, `|`, `->` as usual, binding in
this order; `Y f`: at the last sample; `O[a,b] f`: at some sample between a and b seconds ago; `H[a,b] f`: at every one; without
brackets: ever; `f S g`: g held once and f ever since. A signal that is true or false is +1 or -1. Before the first sample
nothing held. At a sample of which a named signal is unknown (NaN) the formula does not hold, whatever its form, and nothing of it
is remembered. Source: Donze and Maler (2010), Maler and Nickovic (2004); Ulus, "Online monitoring of MTL" (2019).
"""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass

Signals = Mapping[str, float]
Update = Callable[[float, Signals], float]
"""From the time (s, rising) and the signals then to the robustness."""

_TOKEN = re.compile(r"\s*(->|>=|<=|[()\[\],!&|<>]|-?\d+(?:\.\d+)?|[A-Za-z_]\w*)")

_OPERATORS = frozenset("HOSY")


class FormulaError(ValueError):
    """A formula that cannot be read; one sentence."""


@dataclass(frozen=True)
class Monitor:
    """One formula, ready to be updated sample by sample. antecedent: what stands before its `->`, if it is one."""

    update: Update
    antecedent: Update | None
    names: frozenset[str]


def monitor(text: str) -> Monitor:
    """The monitor of a formula. Raises FormulaError."""
    reader = _Reader(text)
    update = reader.implication(whole=True)
    if reader.word is not None:
        raise FormulaError(f"{text!r} has {reader.word!r} too much")
    names = tuple(sorted(reader.names))
    antecedent = None if reader.antecedent is None else _where_known(reader.antecedent, names)
    return Monitor(_where_known(update, names), antecedent, frozenset(names))


def _where_known(update: Update, names: tuple[str, ...]) -> Update:
    """What is unknown does not hold, under `!` and before `->` too; a memory that took it in would keep it. Source: X6."""

    def known(t_s: float, now: Signals) -> float:
        for name in names:
            if now[name] != now[name]:
                return -math.inf
        return update(t_s, now)

    return known


class _Reader:
    """Reads one formula by descent."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._words = [match[1] for match in _TOKEN.finditer(text)]
        if "".join(self._words) != re.sub(r"\s", "", text):
            raise FormulaError(f"{text!r} holds something that is no part of a formula")
        self._at = 0
        self.names: set[str] = set()
        self.antecedent: Update | None = None

    @property
    def word(self) -> str | None:
        return self._words[self._at] if self._at < len(self._words) else None

    def _take(self, wanted: str | None = None) -> str:
        word = self.word
        if word is None or (wanted is not None and word != wanted):
            raise FormulaError(f"{self._text!r} lacks {wanted or 'something'} after {self._at} words")
        self._at += 1
        return word

    def implication(self, *, whole: bool = False) -> Update:
        before = self._disjunction()
        if self.word != "->":
            return before
        self._take()
        if whole:
            # Once more, with a memory of its own: whether it was ever true is asked about it alone.
            again = _Reader(self._text)
            self.antecedent = again._disjunction()
        after = self.implication()
        return lambda t_s, now: max(-before(t_s, now), after(t_s, now))

    def _disjunction(self) -> Update:
        return self._joined("|", self._conjunction, max)

    def _conjunction(self) -> Update:
        return self._joined("&", self._since, min)

    def _joined(self, sign: str, part: Callable[[], Update], least: Callable[[float, float], float]) -> Update:
        found = part()
        while self.word == sign:
            self._take()
            found = _both(found, part(), least)
        return found

    def _since(self) -> Update:
        held = self._unary()
        if self.word != "S":
            return held
        self._take()
        return _since(held, self._unary())

    def _unary(self) -> Update:
        match self.word:
            case "!":
                self._take()
                inner = self._unary()
                return lambda t_s, now: -inner(t_s, now)
            case "(":
                self._take()
                inner = self.implication()
                self._take(")")
                return inner
            case "Y":
                self._take()
                return _previous(self._unary())
            case "O" | "H":
                return self._window(self._take())
        return self._comparison()

    def _window(self, kind: str) -> Update:
        first_s, last_s = 0.0, math.inf
        if self.word == "[":
            self._take()
            first_s = self._number()
            self._take(",")
            last_s = self._number()
            self._take("]")
        if not 0.0 <= first_s <= last_s:
            raise FormulaError(f"{self._text!r} looks at no time: [{first_s:g}, {last_s:g}]")
        inner = self._unary()
        if kind == "O":
            return _once(inner, first_s, last_s)
        never = _once(lambda t_s, now: -inner(t_s, now), first_s, last_s)
        return lambda t_s, now: -never(t_s, now)

    def _number(self) -> float:
        try:
            return float(self._take())
        except ValueError:
            raise FormulaError(f"{self._text!r} has no number where a time belongs") from None

    def _comparison(self) -> Update:
        left = self._value()
        sign = {">=": 1.0, ">": 1.0, "<=": -1.0, "<": -1.0}.get(self.word or "")
        if sign is None:
            return left
        self._take()
        right, way = self._value(), sign
        return lambda t_s, now: _difference(way, left(t_s, now), right(t_s, now))

    def _value(self) -> Update:
        word = self._take()
        if re.fullmatch(r"-?\d+(\.\d+)?", word):
            value = float(word)
            return lambda _t_s, _now: value
        if word in _OPERATORS or not re.fullmatch(r"[A-Za-z_]\w*", word):
            raise FormulaError(f"{self._text!r} has {word!r} where a signal belongs")
        self.names.add(word)
        return lambda _t_s, now: now[word]


def _difference(way: float, left: float, right: float) -> float:
    """Two that are infinite alike differ by nothing."""
    return 0.0 if left == right else way * (left - right)


def _both(a: Update, b: Update, least: Callable[[float, float], float]) -> Update:
    return lambda t_s, now: least(a(t_s, now), b(t_s, now))


def _previous(inner: Update) -> Update:
    last = -math.inf

    def update(t_s: float, now: Signals) -> float:
        nonlocal last
        before, last = last, inner(t_s, now)
        return before

    return update


def _since(held: Update, began: Update) -> Update:
    last = -math.inf

    def update(t_s: float, now: Signals) -> float:
        nonlocal last
        last = max(began(t_s, now), min(held(t_s, now), last))
        return last

    return update


def _once(inner: Update, first_s: float, last_s: float) -> Update:
    """The largest of a sliding window of time: every sample is put in and taken out once."""
    coming: deque[tuple[float, float]] = deque()
    window: deque[tuple[float, float]] = deque()

    def update(t_s: float, now: Signals) -> float:
        coming.append((t_s, inner(t_s, now)))
        while coming and coming[0][0] <= t_s - first_s:
            sample = coming.popleft()
            while window and window[-1][1] <= sample[1]:
                window.pop()
            window.append(sample)
        while window and window[0][0] < t_s - last_s:
            window.popleft()
        return window[0][1] if window else -math.inf

    return update
