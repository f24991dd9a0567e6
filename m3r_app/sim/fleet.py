"""The simulated fleet of a scenario: its drones and its traffic, in one loop that keeps real time.

The ground stops a drone; walls and other drones do not. The record of true states shows who flew into one.
"""

from __future__ import annotations

import json
import math
import selectors
import time
from collections.abc import Callable
from random import Random
from typing import IO

import numpy as np

from m3r_app.environment.loaders import load_terrain
from m3r_app.environment.scenario import LinkModel, Noise, Scenario, Traffic, VehicleStart, Waypoint
from m3r_app.sim.autopilot import Autopilot
from m3r_app.sim.dynamics import EstimateError, Multirotor, PositionError, Wind
from m3r_app.sim.estimator import SIH_SCALES, SihError
from m3r_app.sim.guidance import TICK_S
from m3r_app.sim.happenings import Happenings
from m3r_app.sim.link import VehicleLink
from m3r_app.sim.messages import adsb_vehicle
from m3r_app.sim.modes import FlightMode
from m3r_app.sim.parameters import Parameters
from safety.frames import LocalFrame
from safety.vocabulary import Ned

HOST = "127.0.0.1"
FIRST_TRAFFIC_ID = 101
"""MAVLink system id of the first traffic drone; the fleet's own count from 1."""
FIRST_ICAO = 0x3C0001
SQUITTER_S = 1.0
"""How often a transponder is heard."""
SETTLE_S = 10.0
"""Flown before anybody watches, so that hovering drones have found the wind."""
LATE_S = 0.2
"""If the process is held up for longer than this, simulated time stops for the rest of the delay."""


class Fleet:
    """Every drone of a scenario, each with a MAVLink endpoint of its own."""

    def __init__(self, scenario: Scenario, first_port: int, truth: IO[str] | None = None) -> None:
        """Port first_port + i is where the i-th drone's station listens, vehicles first, in the scenario's order.

        truth: where to write the true states, one JSON line per drone and tick. Raises WorldError, or ValueError that
        names a parameter which does not exist.
        """
        self.frame = LocalFrame(scenario.origin.place)
        terrain = load_terrain(scenario, self.frame)
        self._truth = truth

        def ground_down_m(north_m: float, east_m: float) -> float:
            agl_m = float(terrain.agl_m(np.array([[north_m, east_m, 0.0]]))[0])
            # Off the map there is no ground to meet; the app refuses to fly there anyway.
            return agl_m if math.isfinite(agl_m) else math.inf

        self._ground_down_m: Callable[[float, float], float] = ground_down_m
        self.links: dict[str, VehicleLink] = {}
        self._winds: dict[str, Wind] = {}
        self._start_s: dict[str, float] = {}
        self.vehicles: dict[str, str] = {}
        """Where to listen for each, as MAVSDK wants it: udpin://127.0.0.1:port"""
        self.traffic: dict[str, str] = {}
        self._transponders: dict[str, int] = {}
        """ICAO address of each aircraft that only its transponder tells of."""
        self._squitter_s = 0.0
        for i, (name, start) in enumerate(scenario.vehicles.items()):
            pilot = self._vehicle(scenario, name, start)
            self.vehicles[name] = self._add(scenario, name, pilot, 1 + i, first_port + i, start.link)
            self.links[name].telemetry.battery_unknown = start.battery == "unknown"
            self.links[name].telemetry.rangefinder = start.rangefinder
        for i, (name, traffic) in enumerate(scenario.traffic.items()):
            pilot = self._traffic(scenario, name, traffic)
            port = first_port + len(scenario.vehicles) + i
            url = self._add(scenario, name, pilot, FIRST_TRAFFIC_ID + i, port)
            if traffic.adsb:
                self._transponders[name] = FIRST_ICAO + i
                pilot.link_silent = True
            else:
                self.traffic[name] = url
            self._start_s[name] = SETTLE_S + traffic.start_delay_s
        for _ in range(round(SETTLE_S / TICK_S)):
            self.step()
        for name, start in scenario.vehicles.items():
            if start.state == "mission":
                self.links[name].autopilot.change_mode(FlightMode.MISSION)
        for link in self.links.values():
            link.autopilot.texts.clear()
        self._happenings = {
            name: Happenings(start.events, self.links[name])
            for name, start in scenario.vehicles.items()
            if start.events
        }

    def _place(self, waypoint: Waypoint) -> Ned:
        north, east, height = waypoint
        return Ned(north, east, self._ground_down_m(north, east) - height)

    def _error(self, scenario: Scenario, name: str, noise: Noise | None = None) -> EstimateError:
        gps = scenario.gps
        if (scale := SIH_SCALES.get(noise or gps.noise)) is not None:
            return SihError(scale, _rng(scenario, name, "gps"))
        return PositionError(gps.sigma_h_m, gps.sigma_v_m, gps.tau_s, gps.drift_m_s, _rng(scenario, name, "gps"))

    def _vehicle(self, scenario: Scenario, name: str, start: VehicleStart) -> Autopilot:
        place = self._place((start.north_m, start.east_m, start.height_m))
        if not place.finite:
            raise ValueError(f"scenario {scenario.path}: vehicles.{name} starts where the terrain model has no data")
        try:
            parameters = Parameters(start.params)
        except ValueError as error:
            raise ValueError(f"scenario {scenario.path}: vehicles.{name}.params: {error}") from None
        return Autopilot(
            Multirotor(position=place, yaw_deg=start.heading_deg),
            self._error(scenario, name, start.noise),
            self._ground_down_m,
            parameters,
            tuple(map(self._place, start.waypoints)),
            start.rc,
            1.0 if start.battery == "unknown" else start.battery,
        )

    def _traffic(self, scenario: Scenario, name: str, traffic: Traffic) -> Autopilot:
        places = tuple(map(self._place, traffic.waypoints))
        if not all(place.finite for place in places):
            raise ValueError(f"scenario {scenario.path}: traffic.{name} flies where the terrain model has no data")
        there_and_back = (*places, *places[-2:0:-1]) if traffic.loop else places
        # Somebody else's drone is flown gently, inside what neighbours are assumed to do.
        drone = Multirotor(position=places[0])
        parameters = Parameters({"MPC_XY_CRUISE": traffic.speed_m_s, "MPC_ACC_HOR": 1.0})
        return Autopilot(
            drone,
            self._error(scenario, name),
            self._ground_down_m,
            parameters,
            there_and_back,
            mission_loops=traffic.loop,
        )

    def _add(
        self,
        scenario: Scenario,
        name: str,
        pilot: Autopilot,
        system_id: int,
        port: int,
        model: LinkModel | None = None,
    ) -> str:
        wind = scenario.wind
        self._winds[name] = Wind(
            wind.speed_m_s, wind.from_deg, wind.gust_sigma_m_s, wind.gust_tau_s, _rng(scenario, name, "wind")
        )
        obeys = system_id < FIRST_TRAFFIC_ID
        rng = _rng(scenario, name, "link")
        try:
            self.links[name] = VehicleLink(pilot, self.frame, system_id, (HOST, port), obeys, model, rng)
        except ValueError as error:
            raise ValueError(f"scenario {scenario.path}: vehicles.{name}.link.{error}") from None
        return f"udpin://{HOST}:{port}"

    def step(self) -> None:
        """Fly TICK_S, in whatever time that takes."""
        for name, link in self.links.items():
            pilot = link.autopilot
            pilot.tick(self._winds[name].step(TICK_S))
            if pilot.now_s >= self._start_s.get(name, math.inf):
                del self._start_s[name]
                pilot.change_mode(FlightMode.MISSION)

    @property
    def also(self) -> dict[str, str]:
        """Where any other ground station may send commands, as a second operator does: udpout://127.0.0.1:port"""
        return {name: f"udpout://{HOST}:{link.socket.getsockname()[1]}" for name, link in self.links.items()}

    def tick(self) -> None:
        """TICK_S more for everybody, then telemetry and the record of the truth."""
        self.step()
        for happening in self._happenings.values():
            happening.tick()
        for link in self.links.values():
            link.tick()
        self._squitter()
        if self._truth is not None:
            self._record(self._truth)

    def _squitter(self) -> None:
        """Every transponder is heard by every drone with a link."""
        for name, icao in self._transponders.items():
            pilot = self.links[name].autopilot
            if pilot.now_s < self._squitter_s:
                return
            message = adsb_vehicle(icao, name, self.frame.geodetic(pilot.position), pilot.velocity)
            for other in (*self.vehicles, *self.traffic):
                self.links[other].tell(message)
        if self._transponders:
            self._squitter_s += SQUITTER_S

    def _record(self, truth: IO[str]) -> None:
        at_s = round(time.monotonic(), 4)
        for name, link in self.links.items():
            pilot = link.autopilot
            drone = pilot.drone
            line = {
                "t": round(pilot.now_s - SETTLE_S, 3),
                "monotonic_s": at_s,
                "vehicle": name,
                "ned_m": [round(x, 4) for x in drone.position],
                "velocity_m_s": [round(x, 4) for x in drone.velocity],
                "yaw_deg": round(drone.yaw_deg, 2),
                "estimate_ned_m": [round(x, 4) for x in pilot.position],
                "mode": pilot.mode.name,
                "armed": pilot.armed,
                "tunes": link.tunes,
            }
            if (happenings := self._happenings.get(name)) is not None:
                line["events"] = happenings.happened
            truth.write(json.dumps(line) + "\n")

    def run(self, stopped: Callable[[], bool]) -> None:
        """Tick in real time and answer what arrives at once, until stopped() says so (asked every tick)."""
        with selectors.DefaultSelector() as selector:
            for link in self.links.values():
                selector.register(link.socket, selectors.EVENT_READ, link)
            due_s = time.monotonic()
            while not stopped():
                for key, _ in selector.select(max(0.0, due_s - time.monotonic())):
                    key.data.receive()
                late_s = time.monotonic() - due_s
                if late_s >= 0.0:
                    self.tick()
                    due_s += TICK_S if late_s < LATE_S else late_s

    def close(self) -> None:
        for link in self.links.values():
            link.close()


def _rng(scenario: Scenario, name: str, purpose: str) -> Random:
    """A generator of its own for each drone and purpose: adding a drone changes nobody else's noise."""
    return Random(f"{scenario.seed}/{name}/{purpose}")
