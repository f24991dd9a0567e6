"""The temporal properties beside a flight: after every step of the arbiter, outside of it, from what it was told and did."""

from __future__ import annotations

from m3r_app.arbiter.effects import Effect
from m3r_app.arbiter.events import Event, PropertyBroken
from m3r_app.arbiter.signals import SignalReader
from safety.limits import Limits
from safety.properties import Property, Watch


class PropertyWatch:
    """Follows one run. limits: the settings'."""

    def __init__(self, limits: Limits) -> None:
        self._signals, self._watch = SignalReader(limits), Watch()
        self._broken: frozenset[Property] = frozenset()

    def after(self, event: Event, effects: tuple[Effect, ...], now_s: float) -> tuple[PropertyBroken, ...]:
        """What the arbiter must be told of: each property that this step falsifies and the one before did not."""
        broken = self._watch.update(now_s, self._signals.read(event, effects))
        if not broken and not self._broken:
            return ()
        news = tuple(
            PropertyBroken(one.requirement, one.formula, one.says) for one in broken if one not in self._broken
        )
        self._broken = frozenset(broken)
        return news
