"""Every cue there is: what the cues make of every command, verdict, constraint, mode, pairing, violation and announcement."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

from m3r_app.arbiter.modes import MODE_OF, TRANSITIONS
from m3r_app.output import Action, Notice, Told
from safety.constraints import RULES
from safety.vocabulary import Command, Modality, Verdict
from tests.told import told
from ui.cues import Cues

CONSTRAINTS = (*(rule.name for rule in RULES), "paired", "property", "contradiction")
MOVES = tuple(c.value for c in Command if c not in (Command.STOP, Command.ACTIVATE, Command.DISCONNECT))
SUBJECTS = ("", "the wall", "blue", "the bus stop", "go left")


def finding(constraint: str, subject: str = "", margin: float | None = -0.3, **fields: object) -> dict[str, Any]:
    found: dict[str, Any] = {
        "constraint": constraint,
        "margin": margin,
        "text": "a sentence",
        "requirements": [],
        "subject": subject,
    }
    return {**found, **fields}


def request(command: str, modality: str = "voice", number: str = "r1") -> Told:
    return told("request", id=number, command=command, modality=modality)


def decision(verdict: str, *findings: dict[str, Any], granted_m: float | None = None, number: str = "r1") -> Told:
    granted_m = granted_m if verdict in ("approved", "reduced") else None
    return told("decision", 1.1, request=number, verdict=verdict, granted_m=granted_m, findings=findings)


def pair(status: str, vehicle: str = "red", t: float = 0.0) -> Told:
    return told("pair", t, vehicle=vehicle, status=status, reasons=["because"])


def paired(colour: str = "red", **options: bool) -> Cues:
    """The cues of a run in which this drone has been paired."""
    cues = Cues(**options)
    cues.of(pair("requested", colour))
    cues.of(pair("confirmed", colour))
    return cues


def all_events() -> Iterator[list[Told]]:
    """Events that follow a pairing, each list from the same beginning."""
    for command, modality in itertools.product(Command, Modality):
        yield [request(command.value, modality.value)]
    for move, verdict, constraint in itertools.product(MOVES, Verdict, CONSTRAINTS):
        for margin, subject in itertools.product((None, -0.3), SUBJECTS):
            found = finding(constraint, subject, margin)
            yield [request(move), decision(verdict.value, found, granted_m=0.4)]
    for modality in Modality:
        yield [request("go_left", modality.value), decision("rejected", finding("input_confidence"))]
    for requirement in ("X3", "X4", "X5", "X12", "X14"):
        yield [request("go_left"), decision("rejected", finding("contradiction", requirements=[requirement]))]
    for asked, centimetres in itertools.product(("go_up", "turn_left", "continue"), range(0, 520, 7)):
        yield [request(asked), decision("approved", granted_m=centimetres / 100)]
    for move in MOVES:
        yield [request(move), told("motion", 2.0)]
    yield [told("motion", 2.0, request="return")]
    for (state, cause), to in TRANSITIONS.items():
        yield [told("mode", 2.0, mode=MODE_OF[to], previous=MODE_OF[state], state=to, cause=cause)]
    for status, vehicle in itertools.product(
        ("requested", "confirmed", "refused", "released"), ("red", "blue", "stop")
    ):
        yield [pair(status, vehicle, 2.0)]
    for constraint, action, subject in itertools.product(CONSTRAINTS, Action, SUBJECTS):
        yield [told("violation", 2.0, action=action, **finding(constraint, subject))]
    for notice in Notice:
        yield [told("announce", 2.0, notice=notice, text="use another way to say stop")]


def all_cues(colours: tuple[str, ...] = ("red", "green", "blue")) -> list[str]:
    """Every different one, named by these drones."""
    found: dict[str, None] = {}
    for colour, dry_run in itertools.product(colours, (False, True)):
        for events in all_events():
            cues = paired(colour, dry_run=dry_run)
            for event in events:
                cue = cues.of(event)
                if cue is not None:
                    found[cue.text] = None
    return list(found)
