"""A console on a stage: the real screen, and in place of a run a snapshot that is set by hand and a list of what was asked."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from m3r_app.arbiter.state import ArbiterState, Policy, Session
from m3r_app.options import RunOptions
from m3r_app.run_setup import RunSetup, prepare
from m3r_app.snapshot import Craft, Snapshot
from safety.limits import Limits
from safety.vocabulary import (
    Anchor,
    Command,
    FlightMode,
    ManeuverRequest,
    Modality,
    Ned,
    Neighbours,
    State,
    VehicleState,
)
from ui.console.app import Console

SMALL, LARGE = (80, 24), (140, 45)
HERE = Ned(14.0, 0.0, -6.0)
NOW_S = 100.0


class Stage:
    """In place of `m3r_app.run_thread.Live`."""

    def __init__(self, snapshot: Snapshot | None) -> None:
        self.snapshot = snapshot
        self.asked: list[tuple[Command, str | None]] = []
        self.ground: list[tuple[str, str]] = []
        self.ended = False
        self.quitted = False
        self.interrupted = False
        self.now_s = NOW_S
        self.talked = False

    def clock(self) -> float:
        return self.now_s

    def ask(self, command: Command, colour: str | None = None, evidence: str = "") -> ManeuverRequest:
        self.asked.append((command, colour))
        return self.request(command, colour, evidence)

    def request(self, command: Command, colour: str | None = None, evidence: str = "") -> ManeuverRequest:
        return ManeuverRequest("panel-1", command, Modality.PANEL, 1.0, self.now_s, self.now_s, evidence, colour)

    def take_off(self, colour: str, metres: float) -> None:
        self.ground.append((f"take off {metres:g}", colour))

    def land(self, colour: str) -> None:
        self.ground.append(("land", colour))

    def talk(self) -> None:
        self.talked = True

    def quit(self) -> None:
        self.quitted = self.ended = True

    def interrupt(self) -> None:
        self.interrupted = self.ended = True

    @property
    def commands(self) -> list[Command]:
        return [command for command, _ in self.asked]


def craft(name: str, place: Ned | None, **changes: Any) -> Craft:
    whole = Craft(name, place, Ned(0.0, 0.0, 0.0), 180.0, 0.3, 0.1, 0.1, 0.8, FlightMode.HOLD, in_air=True, ours=True)
    return replace(whole, **changes)


def flying_snapshot(setup: RunSetup, *, paired: bool = True, state: State = State.ARMED) -> Snapshot:
    """Red at 6 m before the operator, green beside, blue on the ground, the courier passing by."""
    operator = setup.operator
    assert operator is not None
    session = Session("red", operator, setup.world, 0.0, Anchor(HERE, 180.0, 0.0), HERE, 90.0)
    vehicle = VehicleState(
        NOW_S,
        HERE,
        Ned(0.0, 0.0, 0.0),
        180.0,
        0.0,
        0.3,
        0.3,
        healthy=True,
        in_air=True,
        flight_mode=FlightMode.HOLD,
        battery=0.8,
    )
    arbiter = ArbiterState(
        Limits(),
        Policy(),
        state=state if paired else State.IDLE,
        session=session if paired else None,
        vehicle=vehicle if paired else None,
        neighbours=Neighbours.none(NOW_S),
    )
    others = (
        craft("green", Ned(-18.0, -12.0, -8.0)),
        craft("blue", Ned(-6.0, 8.0, 0.0), in_air=False),
        craft("courier", Ned(5.8, 9.0, -6.5), velocity=Ned(0.0, 2.5, 0.0), age_s=1.4, ours=False),
    )
    return Snapshot(NOW_S, arbiter, setup, (craft("red", HERE), *others))


def hillside() -> RunSetup:
    return prepare(RunOptions())


def console(stage: Stage, events: list[Mapping[str, Any]] | None = None) -> Console:
    return Console(stage, deque(events or []))  # type: ignore[arg-type]


def drawn(app: Console) -> str:
    """The screen as SVG, without the names that change and the fonts that it would fetch."""
    svg = app.export_screenshot(title="M3R")
    svg = re.sub(r"@font-face \{.*?\}", "", svg, flags=re.DOTALL)
    return re.sub(r"terminal-\d+", "terminal", svg)


def text_of(svg: str) -> str:
    """What is to be read on it."""
    words = re.findall(r">([^<>]*)</text>", svg)
    return "".join(words).replace("&#160;", " ").replace("&amp;", "&").replace("&#x27;", "'").replace("&gt;", ">")


SNAPSHOTS = Path(__file__).parent / "snapshots"
