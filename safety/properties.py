"""Requirements as temporal properties: what must hold at every step of every flight. Written as data; judged by `temporal`.

Signals (`m3r_app/arbiter/signals.py`), true or false unless a unit says otherwise: `armed`: a mode of a session; `paired`: its
pairing was confirmed; `start`: a maneuver that somebody asked for begins; `start_any`: any begins, the way back included;
`cleared`: a decision that every constraint of what is granted passes; `reduced`: one that shortens, of `asked_m` to `granted_m`
metres; `stop`, `request`: STOP, or a move, was asked for; `hold`: the drone is told to hold; `commanded`: it is told anything;
`authority`: it is ours; `granted`: its airspace has just been granted; `flying`: a maneuver is under way; `aborting`: a limit is
broken and the maneuver is to end; `emergency`: EmergencyHold; `peak_m_s`, `length_m`, `duration_s` of the plan that begins, and
what is allowed: `speed_limit_m_s`, `length_limit_m`, `duration_limit_s`; `low`: a decision for want of input confidence alone.

A broken limit is told once the drone has told its mode since, which takes 3 s at most and a sample more (X3): by then the drone is in
EmergencyHold, or has left it for the next maneuver.

Not here: R1-R6, R9, R11, G2-G5, X1, X2 and X13 are about geometry, which `m3r verify` judges anew for every plan and sample; R7
likewise; X5, X7, X8, X9, X11, X12 and X14 need what these signals do not tell.
"""

from __future__ import annotations

from dataclasses import dataclass

from safety.temporal import Monitor, Signals, monitor


@dataclass(frozen=True)
class Property:
    """One requirement over time. formula: must hold at every step."""

    requirement: str
    formula: str
    says: str


PROPERTIES: tuple[Property, ...] = (
    Property("P1", "armed -> paired", "no mode of a session without a confirmed pairing"),
    Property("P2", "start -> O[0,2] cleared", "what is flown was cleared by every constraint within 2 s before"),
    Property("P3", "reduced -> asked_m >= granted_m & granted_m >= 0", "what is shortened is no longer than asked"),
    Property(
        "R8", "start_any -> speed_limit_m_s >= peak_m_s & duration_limit_s >= duration_s", "no plan is too fast or long"
    ),
    Property(
        "R10",
        "aborting & Y flying -> emergency & hold | Y O[0,4] emergency",
        "a broken limit that ends a maneuver holds, in EmergencyHold, at once",
    ),
    Property("R10", "aborting -> O[0,4] emergency", "no broken limit is told to end a maneuver that goes on"),
    Property("G6", "start -> length_limit_m >= length_m", "no plan is longer than a maneuver may be"),
    Property("X3", "commanded -> authority", "the drone is commanded only while it is ours"),
    Property("X4", "stop & authority -> hold", "STOP holds at once"),
    Property(
        "X4", "start_any -> !stop S (request | emergency)", "after STOP nothing flies that was not asked for since"
    ),
    Property("X10", "start_any -> granted", "what is flown has its airspace"),
)
LITERAL = Property("R11", "Y low -> blocked", "as the paper prints it: low confidence, then Blocked")
"""Fails by design where a maneuver is interrupted: the drone holds first and the refusal is told at rest. As designed, it is
`R11_AS_DESIGNED`."""
R11_AS_DESIGNED = Property("R11", "low -> !start_any", "a request with too little confidence starts nothing")


@dataclass(frozen=True)
class PropertyResult:
    """What a flight says of one property. robustness: the least of all steps; vacuous: its antecedent was never true."""

    of: Property
    robustness: float
    at_s: float
    vacuous: bool

    @property
    def holds(self) -> bool:
        return self.robustness >= 0.0


class Watch:
    """All properties beside one flight."""

    def __init__(self, properties: tuple[Property, ...] = (*PROPERTIES, R11_AS_DESIGNED)) -> None:
        self._watched: list[tuple[Property, Monitor]] = [(one, monitor(one.formula)) for one in properties]
        self._least: list[tuple[float, float]] = [(float("inf"), 0.0)] * len(self._watched)
        self._met = [False] * len(self._watched)

    def update(self, t_s: float, signals: Signals) -> tuple[Property, ...]:
        """One step; the properties that it falsifies."""
        broken = []
        for i, (one, watching) in enumerate(self._watched):
            robustness = watching.update(t_s, signals)
            if robustness < self._least[i][0]:
                self._least[i] = robustness, t_s
            if watching.antecedent is not None and watching.antecedent(t_s, signals) > 0.0:
                self._met[i] = True
            if robustness < 0.0:
                broken.append(one)
        return tuple(broken)

    def results(self) -> tuple[PropertyResult, ...]:
        """So far."""
        return tuple(
            PropertyResult(one, *self._least[i], vacuous=watching.antecedent is not None and not self._met[i])
            for i, (one, watching) in enumerate(self._watched)
        )
