"""The mode machine: the paper's modes and fine states, every transition of it, and those the design adds. One table.

Source: paper III (modes) and IV-B (state machine); P1; design 3, 5, 6, 13, 14, 15. Pure.
"""

from __future__ import annotations

from safety.vocabulary import Cause, Mode, State

MODE_OF: dict[State, Mode] = {
    State.IDLE: Mode.NORMAL_AUTONOMY,
    State.PAIRING: Mode.NORMAL_AUTONOMY,
    State.FACING: Mode.NORMAL_AUTONOMY,
    State.ARMED: Mode.ARMED,
    State.SETTLING: Mode.ARMED,
    State.DETECTED: Mode.ARMED,
    State.VALIDATED: Mode.ARMED,
    State.DELAYED: Mode.ARMED,
    State.PLANNED: Mode.ARMED,
    State.EXECUTING: Mode.ACTIVE,
    State.BLOCKED: Mode.BLOCKED,
    State.EMERGENCY_HOLD: Mode.EMERGENCY_HOLD,
    State.RETURN_TO_ANCHOR: Mode.RETURN_TO_ANCHOR,
}


S, C = State, Cause

_PAIRED = tuple(s for s in State if s not in (S.IDLE, S.PAIRING))
DECIDING = (S.DETECTED, S.VALIDATED, S.DELAYED, S.PLANNED, S.BLOCKED)
"""From a request to what becomes of it."""
_AT_REST_OR_DECIDING = (S.ARMED, S.SETTLING, *DECIDING)

TRANSITIONS: dict[tuple[State, Cause], State] = {
    # Pairing: P1, X8
    (S.IDLE, C.PAIR_REQUESTED): S.PAIRING,
    (S.PAIRING, C.PAIR_REFUSED): S.IDLE,
    (S.PAIRING, C.PAIR_ACCEPTED): S.FACING,
    (S.FACING, C.FACING_OPERATOR): S.ARMED,
    (S.FACING, C.PAIR_REFUSED): S.IDLE,
    # Request, validate, plan: the paper's list
    (S.ARMED, C.REQUEST): S.DETECTED,
    (S.DETECTED, C.CONFIDENCE_OK): S.VALIDATED,
    (S.DETECTED, C.CONFIDENCE_LOW): S.BLOCKED,
    (S.VALIDATED, C.GUARDS_OK): S.PLANNED,
    (S.VALIDATED, C.GUARDS_FAILED): S.BLOCKED,
    (S.VALIDATED, C.DELAY): S.DELAYED,
    (S.DELAYED, C.DELAY_OVER): S.VALIDATED,
    (S.DELAYED, C.INTERRUPTED): S.SETTLING,
    (S.PLANNED, C.VOLUME_GRANTED): S.EXECUTING,
    (S.PLANNED, C.RETURN_APPROVED): S.RETURN_TO_ANCHOR,
    (S.PLANNED, C.VOLUME_DENIED): S.BLOCKED,
    (S.PLANNED, C.GUARDS_FAILED): S.BLOCKED,
    (S.PLANNED, C.DRY_RUN): S.ARMED,
    (S.PLANNED, C.INTERRUPTED): S.SETTLING,
    (S.BLOCKED, C.TOLD): S.ARMED,
    # Execute, complete, abort
    (S.EXECUTING, C.COMPLETED): S.ARMED,
    (S.EXECUTING, C.VIOLATION): S.EMERGENCY_HOLD,
    (S.EXECUTING, C.STOP): S.SETTLING,
    (S.EXECUTING, C.INTERRUPTED): S.SETTLING,
    (S.EXECUTING, C.CONTRADICTED): S.SETTLING,
    (S.EXECUTING, C.STALLED): S.SETTLING,
    (S.SETTLING, C.SETTLED): S.ARMED,
    # Recovery: design 14
    (S.EMERGENCY_HOLD, C.RETURN_APPROVED): S.RETURN_TO_ANCHOR,
    (S.EMERGENCY_HOLD, C.REQUEST): S.DETECTED,
    (S.RETURN_TO_ANCHOR, C.RETURNED): S.ARMED,
    (S.RETURN_TO_ANCHOR, C.VIOLATION): S.EMERGENCY_HOLD,
    (S.RETURN_TO_ANCHOR, C.STOP): S.SETTLING,
    (S.RETURN_TO_ANCHOR, C.INTERRUPTED): S.SETTLING,
    (S.RETURN_TO_ANCHOR, C.STALLED): S.SETTLING,
    # STOP holds in every paired state; in EmergencyHold it already does, and cancels the way back: X4
    **{(s, C.STOP): S.SETTLING for s in _AT_REST_OR_DECIDING},
    (S.EMERGENCY_HOLD, C.STOP): S.EMERGENCY_HOLD,
    **{(s, C.CONTRADICTED): S.SETTLING for s in (S.DELAYED, S.PLANNED, S.SETTLING, S.RETURN_TO_ANCHOR)},
    # The end of a session: X3, design 4, 15
    **{(s, C.RELEASED): S.IDLE for s in _PAIRED},
    **{(s, C.AUTHORITY_LOST): S.IDLE for s in _PAIRED},
}


WHILE_HELD: dict[tuple[State, Cause], State] = {
    # A request made in EmergencyHold leaves it by being approved, and by nothing else: R10, design 14
    (S.BLOCKED, C.TOLD): S.EMERGENCY_HOLD,
    (S.PLANNED, C.DRY_RUN): S.EMERGENCY_HOLD,
    **{(s, C.STOP): S.EMERGENCY_HOLD for s in DECIDING},
    **{(s, c): S.EMERGENCY_HOLD for s in (S.DELAYED, S.PLANNED) for c in (C.INTERRUPTED, C.CONTRADICTED)},
}
"""Where these lead while what was asked for in EmergencyHold is being decided, instead of where TRANSITIONS says."""


def next_state(state: State, cause: Cause, *, held: bool = False) -> State | None:
    """Where `cause` leads from `state`; None where the table has no such transition. held: as WHILE_HELD says."""
    there = WHILE_HELD.get((state, cause)) if held else None
    return there if there is not None else TRANSITIONS.get((state, cause))


def mermaid() -> str:
    """The table as a Mermaid state diagram. What leads out of a mode from every state of it is one arrow from the mode.

    Mermaid cannot draw arrows between inner states of two composite states, so only Armed, which has most, is drawn as
    one; the other states carry the name of their mode.
    """
    lines = ["stateDiagram-v2", f"    [*] --> {State.IDLE}", f"    state {_COMPOSITE} {{"]
    lines += [f"        {state}" for state in State if MODE_OF[state] is _COMPOSITE]
    lines.append("    }")
    lines += [
        f'    state "{state} ({mode})" as {state}'
        for state, mode in MODE_OF.items()
        if mode is not _COMPOSITE and state.value != mode.value
    ]
    arrows: dict[tuple[str, State], list[str]] = {}
    for (state, cause), to in (*TRANSITIONS.items(), *WHILE_HELD.items()):
        source = _COMPOSITE.value if _leaves_composite(state, cause, to) else state.value
        causes = arrows.setdefault((source, to), [])
        if cause.value not in causes:
            causes.append(cause.value)
    lines += [f"    {source} --> {to} : {', '.join(causes)}" for (source, to), causes in arrows.items()]
    return "\n".join(lines)


_COMPOSITE = Mode.ARMED


def _leaves_composite(state: State, cause: Cause, to: State) -> bool:
    """Whether all states of the composite mode have this transition, which leads out of it."""
    inner = [s for s in State if MODE_OF[s] is _COMPOSITE]
    return state in inner and to not in inner and all(TRANSITIONS.get((s, cause)) is to for s in inner)
