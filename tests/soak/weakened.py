"""The app as it is shipped, with one of its guards taken away and two stalls that a signal brings about. For the soak's tests alone.

    weakened.main(): argv is GUARD, then the app's own arguments. GUARD: none | thread | process | failsafe | jump | agreement | place

SIGUSR1 blocks the event loop, SIGUSR2 the whole interpreter (with its lock held), each for STALL_S.
"""

from __future__ import annotations

import ctypes
import signal
import sys
import time

STALL_S = 5.0


def main() -> int:
    guard = sys.argv.pop(1)
    signal.signal(signal.SIGUSR1, lambda _number, _frame: time.sleep(STALL_S))
    signal.signal(signal.SIGUSR2, lambda _number, _frame: ctypes.PyDLL(None).usleep(int(STALL_S * 1e6)))
    _take_away(guard)
    from ui.entry import main as run

    return run()


def _take_away(guard: str) -> None:
    from m3r_app.vehicle import guard as guards
    from m3r_app.vehicle import px4_failsafe

    match guard:
        case "none":
            return
        case "thread":
            guards.Guard._check = lambda _self: None  # type: ignore[method-assign]
        case "process":
            start = guards._GuardProcess.__init__
            guards._GuardProcess.__init__ = lambda self, _silence_s: start(self, 1e6)  # type: ignore[method-assign]
        case "failsafe":
            px4_failsafe.mismatches = lambda _values, _rc: ()
        case "jump":
            from m3r_app.arbiter import monitoring

            monitoring.jumped = lambda _run, _vehicle, _last: False
        case "agreement":
            from m3r_app.arbiter import step
            from safety.vocabulary import Ned

            step.disagreement = lambda _heard, _last: Ned(0.0, 0.0, 0.0)
        case "place":
            _without_rules("localization")
        case _:
            raise ValueError(guard)


def _without_rules(*names: str) -> None:
    """The arbiter judges by all rules but these."""
    from m3r_app.arbiter.state import ArbiterState
    from safety.constraints import RULES

    kept = tuple(rule for rule in RULES if rule.name not in names)
    defaults = ArbiterState.__init__.__defaults__
    assert defaults is not None and RULES in defaults
    ArbiterState.__init__.__defaults__ = tuple(kept if value is RULES else value for value in defaults)  # type: ignore[misc]
