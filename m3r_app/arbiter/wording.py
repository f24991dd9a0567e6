"""What the operator hears: one short sentence, named by the drone's colour, with the number. Pure."""

from __future__ import annotations

from collections.abc import Sequence

from safety.constraints import DECLARED
from safety.declarations import LOCALIZATION
from safety.monitor import Breach
from safety.vocabulary import Decision, Finding, ManeuverRequest, Primitive, Verdict

WORD_OF: dict[Primitive, str] = {
    Primitive.MOVE_LEFT: "left",
    Primitive.MOVE_RIGHT: "right",
    Primitive.MOVE_FORWARD: "forward",
    Primitive.MOVE_BACKWARD: "back",
    Primitive.ASCEND: "up",
    Primitive.DESCEND: "down",
    Primitive.SCAN_LEFT: "turn left",
    Primitive.SCAN_RIGHT: "turn right",
    Primitive.RETURN: "return to anchor",
}


MOVES = frozenset({"left", "right", "forward", "back", "up", "down"})


def asked(request: ManeuverRequest) -> str:
    """What was asked for, in words."""
    return request.command.value.replace("go_", "").replace("_", " ")


def reasons(findings: tuple[Finding, ...]) -> str:
    """The sentences of all failing findings, joined: one cause, one sentence."""
    return _causes([(f.constraint, f.text) for f in findings if not f.passed])


def told(breaches: Sequence[Breach]) -> str:
    """The sentences of breaches, joined: one cause, one sentence."""
    return _causes([(b.constraint, b.text) for b in breaches])


def _causes(failing: list[tuple[str, str]]) -> str:
    unlocated = any(constraint == LOCALIZATION.name for constraint, _ in failing)
    return "; ".join(dict.fromkeys(text for name, text in failing if not (unlocated and DECLARED[name].located)))


def decided(colour: str, what: str, decision: Decision) -> str:
    """A decision as the operator hears it."""
    name = colour.capitalize() or "No drone"
    why = reasons(decision.findings)
    if decision.primitive is Primitive.RETURN:
        what = WORD_OF[Primitive.RETURN]
    go = "go " if what in MOVES else ""
    match decision.verdict:
        case Verdict.APPROVED:
            metres = "" if decision.granted_m is None else f" {decision.granted_m:.2f} m"
            return f"{name}: {what}{metres}"
        case Verdict.REDUCED:
            return f"{name}: {what} {decision.granted_m:.2f} m of {decision.requested_m:.2f} m, {why}"
        case Verdict.DELAYED:
            return f"{name}: {what} waits a moment, {why}"
        case Verdict.REPLACED:
            return f"{name}: not {what} as asked, {why}; say continue to fly it slower"
        case _:
            return f"{name}: cannot {go}{what}, {why}"
