"""What is fixed before anything flies: settings, scenario, operator, frame, world. Everything that can be wrong is found here."""

from __future__ import annotations

from dataclasses import dataclass

from config.settings import Settings, load_settings
from m3r_app.airspace.credentials import AirError, Broker, Credentials, load_credentials, parse_broker
from m3r_app.environment.loaders import load_world
from m3r_app.environment.scenario import SHIPPED, Scenario, load_scenario
from m3r_app.options import OptionError, RunOptions
from m3r_app.ports import check_link
from m3r_app.record.chain import private_key
from safety.frames import LocalFrame
from safety.limits import Limits
from safety.obstacles import Obstacles
from safety.situation import World
from safety.terrain import Terrain
from safety.vocabulary import Geodetic, Operator


@dataclass(frozen=True)
class RunSetup:
    """The stage of one run. operator None: unknown, so there is no pairing (design 1)."""

    settings: Settings
    limits: Limits
    scenario: Scenario | None
    operator: Operator | None
    frame: LocalFrame
    """Its origin is where the operator stands."""
    world: World
    colours: tuple[str, ...]
    """The drones that can be paired with."""
    air: tuple[Broker, Credentials] | None = None
    """The shared airspace; None: alone."""


def prepare(options: RunOptions) -> RunSetup:
    """Load and check everything.

    Raises ValueError (SettingsError, ScenarioError, WorldError, OptionError), LinkError or AirError: one sentence.
    """
    settings = load_settings(options.config, options.overrides)
    if options.record_key is not None:
        if options.record is None:
            raise OptionError("--record-key signs a flight record: name one with --record FILE")
        private_key(options.record_key)  # what is wrong with it is told before anything flies
    for url in options.vehicles.values():
        check_link(url)
    path = options.scenario or (None if options.vehicles else SHIPPED / "hillside.toml")
    scenario = load_scenario(path) if path is not None else None
    colours = tuple(options.vehicles or (scenario.vehicles if scenario is not None else ()))
    if options.pair is not None and options.pair not in colours:
        raise OptionError(f"--pair {options.pair}: there is no such drone, there are {', '.join(colours)}")
    place, sigma_m = options.operator, settings.operator.sigma_m
    if place is None and scenario is not None:
        place, sigma_m = scenario.operator.place, scenario.operator.sigma_m
    frame = LocalFrame(place or Geodetic(0.0, 0.0, 0.0))
    operator = Operator(frame.ned(place), sigma_m) if place is not None else None
    world = _world(settings, scenario, frame)
    return RunSetup(settings, settings.limits(), scenario, operator, frame, world, colours, _air(options))


def _air(options: RunOptions) -> tuple[Broker, Credentials] | None:
    if options.broker is None and options.credentials is None:
        return None
    if options.broker is None:
        raise AirError("--credentials is given without --broker: give the broker's address too")
    broker = parse_broker(options.broker)
    if options.credentials is None:
        raise AirError("--broker is given without --credentials FILE: make them with scripts/make_airspace.py")
    return broker, load_credentials(options.credentials, "operator")


def _world(settings: Settings, scenario: Scenario | None, frame: LocalFrame) -> World:
    amsl_m = frame.origin.amsl_m
    flat = Terrain.flat(amsl_m, settings.clearance.flat_sigma_m, amsl_m) if settings.terrain == "flat" else None
    if scenario is None:
        return World(flat, Obstacles.none(amsl_m), None)
    return load_world(scenario, frame, flat)
