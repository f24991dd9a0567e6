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

`granting`: a decision approves or shortens, and with it the least margin of every rule (`m3r_app/arbiter/margins.py`), in the unit of its
name: `terrain_clearance_m` and so on; `least_margin` is the least of them all, of rules too that nobody names here; 0 where what is broken is only mended, minus infinity where the rule was not asked. `again`: a
request begins that was flown before; `scan`: a turn begins, with its `peak_deg_s` and `yaw_limit_deg_s`; `heard`: telemetry came; `idle`: no
session; `accepted`: the checks before pairing have passed; `confirmed`: pairing is; `stalled`: the guard or the controller dropped what was
flown; `contradicted`: two modalities ask for different things.
"""

from __future__ import annotations

from dataclasses import dataclass

from safety.temporal import Monitor, Signals, monitor


@dataclass(frozen=True)
class Property:
    """One requirement over time. formula: must hold at every step; also: other requirements that it states a part of."""

    requirement: str
    formula: str
    says: str
    also: tuple[str, ...] = ()


PROPERTIES: tuple[Property, ...] = (
    Property("P1", "armed -> paired", "no mode of a session is without a confirmed pairing"),
    Property("P2", "start -> O[0,2] cleared", "what is flown was cleared by every constraint within 2 s before"),
    Property("P2", "granting -> least_margin >= 0", "every rule was asked of what is granted, and permits it"),
    Property("P3", "reduced -> asked_m >= granted_m & granted_m >= 0", "what is shortened is no longer than asked"),
    Property("R1", "start -> O request", "nothing is flown before anything was asked for"),
    Property(
        "R4",
        "granting -> terrain_clearance_m >= 0 & obstacle_clearance_m >= 0",
        "what is granted was judged against ground and obstacles and keeps clear of them",
        ("R3", "G2"),
    ),
    Property("G5", "granting -> agl_m >= 0", "what is granted keeps the least height above ground", ("R3",)),
    Property(
        "R6",
        "granting -> separation_m >= 0",
        "what is granted was judged against others and keeps the separation",
        ("R5", "G3"),
    ),
    Property(
        "R5", "granting -> reservation_m >= 0", "what is granted keeps out of what others have reserved", ("X10",)
    ),
    Property("R7", "granting -> workspace_m >= 0", "what is granted stays within the workspace"),
    Property(
        "R8", "start_any -> speed_limit_m_s >= peak_m_s & duration_limit_s >= duration_s", "no plan is too fast or long"
    ),
    Property("R8", "granting -> envelope >= 0", "what is granted is within the envelope", ("G6",)),
    Property(
        "R10",
        "aborting & Y flying -> emergency & hold | Y O[0,4] emergency",
        "a broken limit that ends a maneuver holds, in EmergencyHold, at once",
    ),
    Property("R10", "aborting -> O[0,4] emergency", "no broken limit is told to end a maneuver that goes on"),
    Property(
        "R11",
        "granting -> localization_m >= 0 & terrain_confidence_m >= 0 & neighbour_age_s >= 0",
        "what is granted is so with position, ground and others known well enough",
        ("X6",),
    ),
    Property("G1", "granting -> input_confidence >= 0", "what is granted was understood well enough", ("P2", "R11")),
    Property("G4", "granting -> geofence_m >= 0", "what is granted stays inside the geofence"),
    Property("G6", "start -> length_limit_m >= length_m", "no plan is longer than a maneuver may be"),
    Property("X1", "granting -> session_m >= 0", "what is granted stays near the place of pairing"),
    Property("X2", "granting -> standoff_m >= 0", "what is granted keeps the standoff from the operator"),
    Property("X3", "commanded -> authority", "the drone is commanded only while it is ours"),
    Property("X4", "stop & authority -> hold", "STOP holds at once"),
    Property(
        "X4", "start_any -> !stop S (request | emergency)", "after STOP nothing flies that was not asked for since"
    ),
    Property("X5", "start -> !again", "no request is flown twice"),
    Property("X5", "contradicted & Y flying -> hold", "contradicting requests end what is flown"),
    Property("X6", "start_any -> O[0,2] heard", "nothing begins while the drone is not heard"),
    Property("X7", "stalled & Y flying -> hold & !flying", "what stalls is dropped"),
    Property("X8", "confirmed -> !idle S accepted", "no pairing is confirmed whose checks have not all passed"),
    Property("X9", "scan -> yaw_limit_deg_s >= peak_deg_s & 0 >= length_m", "a turn is slow, and on the spot"),
    Property("X10", "start_any -> granted", "what is flown has its airspace"),
    Property("X14", "start_any -> !Y flying", "nothing begins while something is flown"),
)
NO_PROPERTY: dict[str, str] = {
    "R2": "every plan that is flown is bounded by R8 and G6; one that is not flown is not told",
    "R9": "what the monitor sees is told where a limit breaks; `m3r verify` judges every sample anew",
    "X11": "what counts against a distance is inside its margin; `m3r verify` adds it up anew for every plan",
    "X12": "what STOP left is not told; CONTINUE starts nothing that P2, X4 and X10 do not permit",
    "X13": "a decision tells the margin at its worst, not along the plan; `m3r verify` follows it along",
}
"""Requirements that no property of a trace of these signals can state, and why."""
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
