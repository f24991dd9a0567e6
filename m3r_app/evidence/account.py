"""Whether the record gives a whole account: every request has one final verdict, every motion its grant and its end.

Source: contract (exactly one final decision; stop, activate and disconnect get none), X4, X10, G1.
"""

from __future__ import annotations

from collections import Counter

from m3r_app.evidence.flight import Flight
from m3r_app.evidence.verdict import Line

WITHOUT_VERDICT = frozenset({"stop", "activate", "disconnect"})
RETURN = "return"
"""What a way back to the anchor is called, which nobody asked for."""
GRANTED_AS_FLOWN_M = 1e-6


def account(flight: Flight) -> tuple[Line, ...]:
    """A line for each request, motion and plan, and for the record itself."""
    lost = "" if not flight.lost else f"{flight.lost} messages are missing"
    return (
        Line(
            "record",
            "complete",
            "",
            None,
            "",
            flight.whole,
            note="" if flight.whole else "it breaks off before its end",
        ),
        Line("record", "gapless", "", None, "", not flight.lost, note=lost),
        *_verdicts(flight),
        *_motions(flight),
        *_grants(flight),
    )


def _verdicts(flight: Flight) -> list[Line]:
    finals: Counter[str] = Counter()
    delays: Counter[str] = Counter()
    late: set[str] = set()
    for decided in flight.decisions:
        if decided.verdict == "delayed":
            delays[decided.request] += 1
            late |= {decided.request} if finals[decided.request] else set()
        else:
            finals[decided.request] += 1
    known = {asked.id: asked for asked in flight.requests}
    lines = []
    for name, asked in known.items():
        expected = 0 if asked.command in WITHOUT_VERDICT else 1
        found = finals[name]
        note = "" if found == expected else f"{found} final verdicts, expected {expected}"
        if delays[name] > 1 or name in late:
            note = "delayed after its final verdict, or more than once"
        lines.append(Line("record", "verdict", name, None, "", not note, asked.t_s, note))
    lines += [
        Line("record", "verdict", d.request, None, "", passed=False, at_s=d.t_s, note="a verdict on what nobody asked")
        for d in flight.decisions
        if d.request not in known and d.request != RETURN
    ]
    return lines


def _motions(flight: Flight) -> list[Line]:
    """Started, then completed or aborted, one at a time."""
    lines: list[Line] = []
    flying: tuple[float, str] | None = None
    for moved in flight.motions:
        if moved.status == "started":
            if flying is not None:
                lines.append(_motion(*flying, "another motion began before it had ended"))
            flying = (moved.t_s, moved.request)
        elif flying is None or flying[1] != moved.request:
            lines.append(_motion(moved.t_s, moved.request, f"{moved.status} without having been started"))
        else:
            lines.append(_motion(*flying, ""))
            flying = None
    if flying is not None:
        lines.append(_motion(*flying, "neither completed nor aborted"))
    return lines


def _motion(t_s: float, request: str, note: str) -> Line:
    return Line("record", "motion", request, None, "", not note, t_s, note)


def _grants(flight: Flight) -> list[Line]:
    """Every motion flies one plan, which was granted to its request at this length; and no plan is flown unsaid."""
    lines: list[Line] = []
    flown = flight.flown()
    for moved in (m for m in flight.motions if m.status == "started"):
        plans = [planned.plan for planned, started in flown if started == moved]
        granted = [d for d in flight.decisions if d.request == moved.request and d.verdict in ("approved", "reduced")]
        note = ""
        if len(plans) != 1:
            note = f"{len(plans)} plans began with it"
        elif moved.request != RETURN and not any(d.t_s <= moved.t_s for d in granted):
            note = "flown without a grant"
        elif moved.request != RETURN and plans[0] is not None and granted[0].granted_m is not None:
            longer_m = plans[0].move.distance - granted[0].granted_m
            note = f"flies {longer_m:+.3f} m other than granted" if abs(longer_m) > GRANTED_AS_FLOWN_M else ""
        lines.append(Line("record", "grant", moved.request, None, "", not note, moved.t_s, note))
    unsaid = [planned.t_s for planned, started in flown if started is None]
    note = "a plan was flown unsaid"
    return lines + [Line("record", "grant", "", None, "", passed=False, at_s=t_s, note=note) for t_s in unsaid]
