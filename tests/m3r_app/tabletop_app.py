"""The running app about vehicles that lie on the table: the real runtime, arbiter, pairing and airspace, no link and no process."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

from m3r_app.airspace.interface import Airspace
from m3r_app.airspace.local import LocalAirspace
from m3r_app.arbiter.events import Event
from m3r_app.arbiter.state import ArbiterState, Policy
from m3r_app.options import RunOptions
from m3r_app.output import AnnounceEvent, Notice, OutputEvent
from m3r_app.pairing import Pairing
from m3r_app.run_setup import prepare
from m3r_app.runtime import Shell, request_event
from m3r_app.takeoff_landing import GroundWork
from m3r_app.vehicle.fleet import Fleet
from m3r_app.vehicle.guard import Guard
from safety.vocabulary import Command, ManeuverRequest, Modality, Ned
from tests.m3r_app.tabletop_vehicle import TabletopVehicle, flying
from tests.whole import PLAIN

SETTING = prepare(RunOptions(headless=True, scenario=PLAIN))


class ReadyGuard(Guard):
    """A guard whose thread and process are taken for running."""

    @property
    def ready(self) -> bool:
        return True


class TabletopApp:
    """red and green hover at 10 m, ten metres to the north and to the south of the operator."""

    def __init__(self, airspace: Airspace | None = None, takeoff_m: float | None = None) -> None:
        frame, clock = SETTING.frame, time.monotonic
        places = {"red": Ned(10.0, 0.0, -10.0), "green": Ned(-10.0, 0.0, -10.0)}
        self.vehicles = {
            colour: TabletopVehicle(colour, flying(frame.geodetic(place), place), clock)
            for colour, place in places.items()
        }
        self.airspace = airspace if airspace is not None else LocalAirspace(clock)
        self.output: list[OutputEvent] = []
        self.recorded: list[tuple[str, dict[str, object]]] = []
        fleet = Fleet(self.vehicles, {}, clock, complete=True)
        guard = ReadyGuard(lambda _: None)
        pairing = Pairing(SETTING, fleet, self.airspace, guard, clock, self._say, takeoff_m)
        self.shell = Shell(
            ArbiterState(SETTING.limits, Policy()),
            fleet,
            frame,
            self.airspace,
            guard,
            clock,
            self.output.append,
            self,
            pairing,
            GroundWork(fleet.commanders, self.airspace, frame.origin, self._say, pairing.against),
            declared_empty=False,
        )
        self._asked = 0

    def record(self, topic: str, _t_s: float, data: dict[str, object]) -> None:
        self.recorded.append((topic, data))

    def _say(self, sentence: str, notice: Notice = Notice.INFORMATION, /) -> None:
        self.output.append(AnnounceEvent(sentence, notice))

    def said(self) -> list[str]:
        return [event.text for event in self.output if isinstance(event, AnnounceEvent)]

    def put(self, event: Event) -> None:
        self.shell.inbox.put(event)

    def ask(self, command: Command, colour: str | None = None) -> None:
        """A button is pressed."""
        self._asked += 1
        now_s = time.monotonic()
        name = f"panel-{self._asked}"
        self.put(request_event(ManeuverRequest(name, command, Modality.PANEL, 1.0, now_s, now_s, colour=colour)))

    async def until(self, condition: Callable[[], bool], within_s: float = 5.0) -> None:
        deadline_s = time.monotonic() + within_s
        while not condition():
            assert time.monotonic() < deadline_s, (self.output, {c: v.commands for c, v in self.vehicles.items()})
            for vehicle in self.vehicles.values():
                vehicle.tell()
            await asyncio.sleep(0.005)


@asynccontextmanager
async def tabletop(airspace: Airspace | None = None, takeoff_m: float | None = None) -> AsyncIterator[TabletopApp]:
    """One that runs until the block ends."""
    app = TabletopApp(airspace, takeoff_m)
    running = [asyncio.create_task(app.shell.run()), asyncio.create_task(app.shell.tick())]
    try:
        yield app
    finally:
        for task in running:
            task.cancel()
        await asyncio.gather(*running, return_exceptions=True)
        await app.shell.close()
