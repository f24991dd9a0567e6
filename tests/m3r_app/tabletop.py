"""A tabletop session: the arbiter over flat ground with a kinematic drone that does exactly as it is told.

Time stands still unless it is let pass. Every step is checked for what must always hold.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from m3r_app.arbiter.announcements import Announce
from m3r_app.arbiter.effects import (
    AnchorMoved,
    CallOffPairing,
    Effect,
    FaceOperator,
    Fly,
    Hold,
    Land,
    LetGo,
    Pair,
    PlayTune,
    Release,
    Report,
    Reserve,
    TakeOff,
)
from m3r_app.arbiter.events import (
    Event,
    NeighboursHeard,
    PairingAnswered,
    Requested,
    ReservationAnswered,
    TelemetryArrived,
    Tick,
)
from m3r_app.arbiter.modes import MODE_OF, TRANSITIONS, WHILE_HELD
from m3r_app.arbiter.signals import SignalReader
from m3r_app.arbiter.state import ArbiterState, Policy
from m3r_app.arbiter.step import step
from safety.frames import wrap_deg
from safety.limits import Limits
from safety.obstacles import Obstacles
from safety.properties import Watch
from safety.situation import World
from safety.terrain import Terrain
from safety.vocabulary import (
    Command,
    FlightMode,
    ManeuverRequest,
    Modality,
    Ned,
    Neighbours,
    Operator,
    Plan,
    ReservedVolume,
    State,
    VehicleState,
)

DT_S = 0.1
OPERATOR = Operator(Ned(0.0, 0.0, 0.0), 0.1)
PLACE = Ned(10.0, 0.0, -10.0)
FLAT = World(Terrain.flat(0.0, 0.0, 0.0), Obstacles.none(), None)
MOVING = frozenset({Command.STOP, Command.ACTIVATE, Command.DISCONNECT})


class Tabletop:
    """One session. `grant`: what the airspace authority answers; None: nothing at all."""

    def __init__(self, *, policy: Policy | None = None, world: World = FLAT, limits: Limits | None = None) -> None:
        self.now_s = 100.0
        self.state = ArbiterState(limits or Limits(), policy or Policy())
        self.world = world
        self.operator = OPERATOR
        self.grant: str | None = "granted"
        self.pairing_reasons: tuple[str, ...] = ()
        self.answers_pairing = True
        self.position, self.yaw_deg, self.velocity = PLACE, 150.0, Ned(0.0, 0.0, 0.0)
        self.flight_mode, self.in_air = FlightMode.OFFBOARD, True
        self.sigma_m = 0.1
        self.sky = Neighbours.none(math.inf)
        self.volumes: tuple[ReservedVolume, ...] = ()
        self.plan: Plan | None = None
        self.turn_to_deg: float | None = None
        self.since_s = 0.0
        self.coasting_s = 0.0
        self.log: list[Effect] = []
        self.steps: list[tuple[ArbiterState, Event, ArbiterState, tuple[Effect, ...]]] = []
        self.reserved: dict[str, int] = {}
        self.held: set[str] = set()
        """Volumes that the authority keeps for us."""
        self.signals, self.watch = SignalReader(self.state.limits), Watch()
        self.asked = 0

    # ------------------------------------------------------------ events

    def put(self, event: Event) -> tuple[Effect, ...]:
        """One step; its effects are carried out, the authority's answers follow at once."""
        before = self.state
        self.state, effects = step(before, event, self.now_s)
        self.steps.append((before, event, self.state, effects))
        self.log += effects
        check_step(before, event, self.state, effects)
        broken = self.watch.update(self.now_s, self.signals.read(event, effects))
        assert not broken, f"{[one.formula for one in broken]} at {type(event).__name__}"
        answers: list[Event] = []
        for effect in effects:
            answers += self.carry_out(effect)
        for answer in answers:
            self.put(answer)
        return effects

    def carry_out(self, effect: Effect) -> list[Event]:
        match effect:
            case Pair() if self.answers_pairing:
                return [PairingAnswered(effect.colour, self.pairing_reasons, self.operator, self.world)]
            case FaceOperator():
                self.turn_to_deg = effect.yaw_deg
            case Fly():
                self.plan, self.since_s, self.turn_to_deg = effect.plan, self.now_s, None
            case Hold() | LetGo():
                self.coasting_s = 0.3 if self.velocity.norm > 0.0 else 0.0
                self.plan = self.turn_to_deg = None
            case Reserve():
                self.reserved[effect.request_id] = self.reserved.get(effect.request_id, 0) + 1
                if self.grant in ("granted", None):
                    self.held.add(effect.request_id)
                if self.grant is not None:
                    return [ReservationAnswered(effect.request_id, self.grant)]  # type: ignore[arg-type]
            case Release():
                self.held.discard(effect.request_id)
        return []

    def request(
        self,
        command: Command,
        modality: Modality = Modality.VOICE,
        confidence: float = 0.9,
        *,
        ago_s: float = 0.0,
        colour: str | None = "red",
    ) -> ManeuverRequest:
        self.asked += 1
        captured_at_s = self.now_s - ago_s
        return ManeuverRequest(
            f"r{self.asked}", command, modality, confidence, captured_at_s, captured_at_s, command, colour
        )

    def ask(self, command: Command, modality: Modality = Modality.VOICE, confidence: float = 0.9, **more: Any) -> str:
        """Put a request; returns its id."""
        request = self.request(command, modality, confidence, **more)
        self.put(Requested(request, 10.0))
        return request.id

    def vehicle(self) -> VehicleState:
        return VehicleState(
            self.now_s,
            self.position,
            self.velocity,
            self.yaw_deg,
            0.0,
            self.sigma_m,
            self.sigma_m,
            healthy=True,
            in_air=self.in_air,
            flight_mode=self.flight_mode,
        )

    def tell(self) -> tuple[Effect, ...]:
        """Telemetry as things are."""
        return self.put(TelemetryArrived(self.vehicle()))

    def neighbours(self) -> None:
        self.put(NeighboursHeard(self.sky, self.volumes))

    # ------------------------------------------------------------ time

    def tick(self, *, telemetry: bool = True) -> None:
        """A tenth of a second."""
        self.now_s += DT_S
        self.move()
        self.neighbours()
        if telemetry:
            self.tell()
        self.put(Tick())

    def move(self) -> None:
        if self.plan is not None:
            t_s = min(self.now_s - self.since_s, self.plan.duration_s)
            at, before = self.plan.position(t_s), self.plan.position(max(0.0, t_s - 0.05))
            self.velocity = Ned(*(c / 0.05 for c in at.minus(before)))
            if self.now_s - self.since_s > self.plan.duration_s:
                self.velocity = Ned(0.0, 0.0, 0.0)
            self.position, self.yaw_deg = at, wrap_deg(self.plan.yaw_deg(t_s))
        elif self.coasting_s > 0.0:
            self.coasting_s -= DT_S
            self.position = self.position.plus(Ned(*(c * DT_S for c in self.velocity)))
        else:
            self.velocity = Ned(0.0, 0.0, 0.0)
            if self.turn_to_deg is not None:
                off_deg = wrap_deg(self.turn_to_deg - self.yaw_deg)
                self.yaw_deg = wrap_deg(self.yaw_deg + max(-3.0, min(3.0, off_deg)))

    def wait(self, seconds: float) -> Tabletop:
        for _ in range(round(seconds / DT_S)):
            self.tick()
        return self

    def until(self, condition: Callable[[], bool] | State, within_s: float = 30.0) -> Tabletop:
        """Let time pass until the condition holds (or the state is reached)."""
        wanted = condition
        met = (lambda: self.state.state is wanted) if isinstance(wanted, State) else wanted
        for _ in range(round(within_s / DT_S)):
            if met():
                return self
            self.tick()
        assert met(), f"still {self.state.state} after {within_s} s"
        return self

    def paired(self) -> Tabletop:
        self.neighbours()
        self.tell()
        self.ask(Command.ACTIVATE)
        return self.until(State.ARMED)

    # ------------------------------------------------------------ what was said

    def reports(self, event: str) -> list[dict[str, Any]]:
        return [e.fields for e in self.log if isinstance(e, Report) and e.event == event]

    def decisions(self, request_id: str | None = None) -> list[dict[str, Any]]:
        return [d for d in self.reports("decision") if request_id in (None, d["request"])]

    def verdicts(self, request_id: str) -> list[str]:
        return [str(d["verdict"].value) for d in self.decisions(request_id)]

    def failing(self, request_id: str) -> set[str]:
        return {f["constraint"] for f in self.decisions(request_id)[-1]["findings"] if not f["passed"]}

    def states(self) -> list[State]:
        return [r["state"] for r in self.reports("mode")]

    def said(self) -> list[str]:
        return [e.text for e in self.log if isinstance(e, Announce)]

    def effects(self, kind: type[Any]) -> list[Any]:
        return [e for e in self.log if isinstance(e, kind)]

    def motions(self, status: str) -> list[dict[str, Any]]:
        return [m for m in self.reports("motion") if m["status"] == status]


def check_step(before: ArbiterState, event: Event, after: ArbiterState, effects: tuple[Effect, ...]) -> None:
    """What holds of every single step."""
    state = before.state
    if state is State.EMERGENCY_HOLD and after.state in (State.ARMED, State.SETTLING):
        raise AssertionError("EmergencyHold is left by an approval, or by the end of the session")
    for fields in (e.fields for e in effects if isinstance(e, Report) and e.event == "mode"):
        assert fields["previous"] is MODE_OF[state], "mode reports follow one another"
        assert fields["state"] in (
            TRANSITIONS.get((state, fields["cause"])),
            WHILE_HELD.get((state, fields["cause"])),
        ), "every transition is the tables'"
        assert fields["mode"] is MODE_OF[fields["state"]]
        state = fields["state"]
    assert state is after.state, "no state changes untold"
    if isinstance(event, Requested) and event.request.command is Command.STOP and before.authority:
        assert isinstance(effects[0], Hold), "X4: STOP holds before anything else"
        assert after.flight is None
    check_effects(before, after, effects)
    commanding = [e for e in effects if isinstance(e, Hold | Fly | FaceOperator)]
    if not before.authority and not after.authority:
        assert not commanding, "X3: nothing is commanded without authority"
    flights = [e for e in effects if isinstance(e, Fly)]
    if flights:
        assert isinstance(event, ReservationAnswered), "X10: airspace first"
        assert event.answer == "granted"
        assert after.state in (State.EXECUTING, State.RETURN_TO_ANCHOR)
    assert (after.flight is not None) == (after.state in (State.EXECUTING, State.RETURN_TO_ANCHOR))
    assert (after.session is not None) or after.state in (State.IDLE, State.PAIRING)
    assert after.deciding is None or after.state in (State.DELAYED, State.PLANNED, State.EMERGENCY_HOLD)
    assert after.pending is None or after.state is State.SETTLING
    assert after.state not in (State.DETECTED, State.VALIDATED), "these last no longer than a step"


def check_effects(before: ArbiterState, after: ArbiterState, effects: tuple[Effect, ...]) -> None:
    """Nothing that must be done has to be looked for in the state or in a report."""
    anchors = [s.session.anchor if s.session is not None else None for s in (before, after)]
    moved = [e.position for e in effects if isinstance(e, AnchorMoved)]
    if anchors[0] is not anchors[1] or moved:
        assert moved[-1] == (anchors[1].position if anchors[1] is not None else None)
    called_off = after.pairing_off is not None and before.pairing_off is None
    assert [e.colour for e in effects if isinstance(e, CallOffPairing)] == ([after.pairing] if called_off else [])
    confirmed = [
        e for e in effects if isinstance(e, Report) and e.event == "pair" and e.fields["status"] == "confirmed"
    ]
    assert sum(isinstance(e, PlayTune) for e in effects) == len(confirmed)
    begun = [e.colour for e in effects if isinstance(e, TakeOff | Land)]
    assert begun == ([after.ground_work] if before.ground_work is None and after.ground_work is not None else [])


def ball(name: str, position: Ned, velocity: Ned, at_s: float, sigma_m: float = 0.1) -> Neighbours:
    """A sky with one aircraft in it."""
    return Neighbours((name,), np.array([position]), np.array([velocity]), np.array([sigma_m]), np.array([at_s]), at_s)
