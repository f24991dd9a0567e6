"""Which requirements each entry of the mode machine's tables is there for, and why it differs from what the game would allow."""

from __future__ import annotations

from m3r_app.arbiter.modes import TRANSITIONS, WHILE_HELD
from safety.vocabulary import Cause, State

S, C = State, Cause

BY_CAUSE: dict[C, tuple[str, ...]] = {
    C.PAIR_REQUESTED: ("P1",),
    C.PAIR_ACCEPTED: ("P1", "X8"),
    C.PAIR_REFUSED: ("X8", "P1"),
    C.FACING_OPERATOR: ("P1",),
    C.RELEASED: ("X3",),
    C.AUTHORITY_LOST: ("X3",),
    C.REQUEST: ("R1",),
    C.CONFIDENCE_OK: ("P2", "G1"),
    C.CONFIDENCE_LOW: ("R11", "G1"),
    C.GUARDS_OK: ("P2", "R2", "R3", "R5"),
    C.GUARDS_FAILED: ("P3", "R4", "R6", "R7", "R8"),
    C.DELAY: ("R5", "R11"),
    C.DELAY_OVER: ("P2",),
    C.VOLUME_GRANTED: ("X10", "P2"),
    C.VOLUME_DENIED: ("X10",),
    C.DRY_RUN: ("R2", "P2"),
    C.CONTRADICTED: ("X5",),
    C.TOLD: ("P3",),
    C.COMPLETED: ("R1", "R7"),
    C.STOP: ("X4",),
    C.INTERRUPTED: ("X14",),
    C.STALLED: ("X7",),
    C.SETTLED: ("X4", "R7"),
    C.VIOLATION: ("R9", "R10"),
    C.RETURN_APPROVED: ("R10", "X10"),
    C.RETURNED: ("R10",),
}
"""For every entry with this cause."""

HELD = ("R10",)
"""Besides, for what is decided while held: EmergencyHold is left by an approval and by nothing else."""

BESIDES: dict[tuple[S, C], tuple[str, ...]] = {
    (S.PLANNED, C.GUARDS_FAILED): ("X10",),
    (S.EMERGENCY_HOLD, C.REQUEST): ("R10",),
    (S.EMERGENCY_HOLD, C.STOP): ("R10",),
}

WITHOUT_ENTRY: dict[tuple[S, C], tuple[S, str]] = {
    (S.IDLE, C.STOP): (S.IDLE, "nobody is paired: it is told that there is nothing to hold"),
    (S.PAIRING, C.STOP): (S.PAIRING, "the shell is still checking: what it answers is refused (`pairing_off`), so that no motion comes of it"),
    (S.FACING, C.STOP): (S.IDLE, "STOP calls pairing off, so the cause that is taken is `pair_refused`"),
    (S.FACING, C.STALLED): (S.IDLE, "a stall calls pairing off, so the cause that is taken is `pair_refused`"),
    (S.SETTLING, C.INTERRUPTED): (S.SETTLING, "nothing flies that could be interrupted: the newer request waits in place of the older"),
    (S.ARMED, C.CONTRADICTED): (S.ARMED, "nothing flies or waits: both requests are refused where the drone rests"),
    (S.EMERGENCY_HOLD, C.CONTRADICTED): (S.EMERGENCY_HOLD, "it is left by an approval only: both requests are refused there"),
}  # fmt: skip
"""What can happen although no table has an entry for it, and what becomes of it: the arbiter asks `can` first."""

STRICTER: dict[C, str] = {
    C.STOP: "Armed is an anchor at rest; after STOP that is measured first (design 2), so the table settles",
    C.INTERRUPTED: "what interrupts is judged from where the drone has come to rest, so the table settles first (X14, design 2)",
    C.CONTRADICTED: "both are refused and the anchor is where the drone rests, so the table settles first (X5, design 2)",
    C.TOLD: "nothing has moved since Armed, so there is nothing to settle: the table goes back at once (design 5)",
    C.DRY_RUN: "nothing has moved since Armed, so there is nothing to settle: the table goes back at once",
}
"""Why, of several answers that the game allows, the table has the one it has."""

Entry = tuple[State, Cause, bool]
"""State, cause, and whether it is an entry of WHILE_HELD."""

ENTRIES: frozenset[Entry] = frozenset(
    {*((s, c, False) for s, c in TRANSITIONS), *((s, c, True) for s, c in WHILE_HELD)}
)

PASSING = (State.DETECTED, State.VALIDATED)
"""No step ends in these, so nothing from outside meets them."""
OUTSIDE = (Cause.STOP, Cause.RELEASED, Cause.AUTHORITY_LOST)
UNTAKEN: dict[str, frozenset[Entry]] = {
    "Detected and Validated last no longer than a step, so no event meets them": frozenset(
        e for e in ENTRIES if e[0] in PASSING and e[1] in OUTSIDE
    ),
    "in Blocked every event, STOP included, first tells it and leaves it": frozenset(
        e for e in ENTRIES if e[0] is State.BLOCKED and e[1] in OUTSIDE
    ),
    "a dry run flies nothing, so nothing is asked for in EmergencyHold": frozenset(
        {(State.PLANNED, Cause.DRY_RUN, True)}
    ),
}
"""Entries that no step takes, and why; the table has them so that it is whole by itself."""


def justification(state: S, cause: C, *, held: bool) -> tuple[str, ...]:
    """The ids of the requirements that an entry serves."""
    return tuple(dict.fromkeys((*BY_CAUSE[cause], *BESIDES.get((state, cause), ()), *(HELD if held else ()))))
