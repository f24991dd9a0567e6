"""Pairing: the checks before it, a pure list of everything that stands against it, and the procedure that makes them.

Source: X8, P1, design 1, 12; paper III-A.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from m3r_app.airspace.interface import Airspace
from m3r_app.arbiter.events import PairingAnswered
from m3r_app.heights import disagreements
from m3r_app.output import Announcing, Notice
from m3r_app.run_setup import RunSetup
from m3r_app.vehicle import px4_failsafe
from m3r_app.vehicle.fleet import Fleet
from m3r_app.vehicle.guard import Guard
from m3r_app.vehicle.interface import ObservedVehicle, VehicleError
from m3r_app.vehicle.telemetry import Telemetry
from safety.confidence import confidence_of
from safety.constraints import RULES, findings, nearby
from safety.frames import LocalFrame
from safety.limits import Limits
from safety.situation import Situation, World
from safety.vocabulary import Anchor, FlightMode, Geodetic, Ned, Neighbours, Operator, Path, VehicleState

FIT_TO_HOLD = frozenset({FlightMode.HOLD, FlightMode.MISSION, FlightMode.READY, FlightMode.TAKEOFF})
"""Flight modes that pairing may end; in any other a person, another ground station or a failsafe is flying it."""
WHERE_IT_STANDS = frozenset(
    {"geofence", "standoff", "terrain_clearance", "agl", "obstacle_clearance", "terrain_confidence"}
)
"""Constraints that a drone must keep where it hovers, and where a take-off will bring it."""
REPORTS = 3.0
"""So many positions must come in the time after which the last is too old: one may be late, and one lost."""
NO_OPERATOR = "the operator's position is unknown; give --operator LAT,LON,AMSL"


@dataclass(frozen=True, slots=True)
class PairingLimits:
    """range_m: how far from the operator; operator_sigma_max_m: how well the operator must be located.

    battery_may_be_unknown: it has been declared so.
    """

    range_m: float
    operator_sigma_max_m: float
    battery_may_be_unknown: bool = False


def needed_rate_hz(limits: Limits) -> float:
    """How often positions must come: often enough that none is too old (X6), and that at full speed the drone stays in the
    tube about its path between two of them (R9, X11).
    """
    return max(REPORTS / limits.telemetry_age_s, 2.0 * limits.speed_m_s / limits.tracking_m)


def objections(
    telemetry: Telemetry,
    frame: LocalFrame,
    operator: Operator,
    world: World,
    limits: Limits,
    pairing: PairingLimits,
    now_s: float,
    takeoff_m: float | None = None,
) -> tuple[str, ...]:
    """Everything that forbids pairing, each one sentence; empty: it may be paired (failsafe parameters aside).

    takeoff_m: for a drone that stands, everything that would forbid it after a take-off to this height, as far as it can
    be known before.
    """
    found: list[str] = []
    if not telemetry.age_s(now_s) <= limits.telemetry_age_s:
        found.append("its telemetry is missing or stale")
    if not telemetry.healthy:
        found.append(f"it is not healthy: {', '.join(telemetry.unhealthy) or 'no reason given'}")
    if takeoff_m is None and telemetry.in_air is not True:
        found.append("it is not in the air; take off first")
    if not telemetry.rate_hz >= needed_rate_hz(limits):
        rate = f"{telemetry.rate_hz:.1f} times" if math.isfinite(telemetry.rate_hz) else "an unknown number of times"
        found.append(f"its position comes {rate} a second, {needed_rate_hz(limits):.0f} are needed")
    if telemetry.battery is None and not pairing.battery_may_be_unknown:
        found.append('its battery is unknown; declare battery = "unknown" to fly without')
    elif telemetry.battery is not None and not telemetry.battery >= limits.battery_min:
        found.append(f"its battery is at {telemetry.battery:.0%}, {limits.battery_min:.0%} is needed")
    if telemetry.flight_mode not in FIT_TO_HOLD:
        found.append(f"it flies in {telemetry.flight_mode}, which pairing does not interrupt")
    if not (math.isfinite(operator.sigma_m) and operator.sigma_m <= pairing.operator_sigma_max_m):
        found.append(f"the operator's position is not known to {pairing.operator_sigma_max_m:.0f} m")
    found += _distance(telemetry.geodetic, frame, operator, limits, pairing)
    localization = confidence_of(telemetry.sigma_m, limits.localization_half_m)
    if not localization >= limits.localization_min:
        found.append(f"its localisation confidence is {_shown(localization)}, {limits.localization_min:.2f} is needed")
    if world.terrain is None:
        found.append('there is no terrain model here; give a scenario or declare terrain = "flat"')
    else:
        terrain = confidence_of(world.terrain.sigma_m, limits.terrain_half_m)
        if not terrain >= limits.terrain_confidence_min:
            found.append(
                f"the terrain model's confidence is {_shown(terrain)}, {limits.terrain_confidence_min:.2f} is needed"
            )
    found += disagreements(telemetry, frame, operator, world.terrain, limits)
    if not found:
        found += _there(telemetry, frame, operator, world, limits, now_s, takeoff_m)
    return tuple(found)


def _there(
    telemetry: Telemetry,
    frame: LocalFrame,
    operator: Operator,
    world: World,
    limits: Limits,
    now_s: float,
    takeoff_m: float | None,
) -> list[str]:
    """What the drone breaks where it hovers, by its best estimate; or where a take-off brings it, with all that is uncertain."""
    if telemetry.geodetic is None:
        return []
    place = frame.ned(telemetry.geodetic)
    if takeoff_m is not None:
        place = place.plus(Ned(0.0, 0.0, -takeoff_m))
    else:
        limits = replace(limits, sigma_k=0.0, tracking_m=0.0)
    vehicle = VehicleState(
        now_s, place, Ned(0.0, 0.0, 0.0), 0.0, sigma_h_m=telemetry.sigma_h_m, sigma_v_m=telemetry.sigma_v_m
    )
    about = Situation(
        now_s, vehicle, operator, Anchor(place, 0.0, now_s), place, now_s, Neighbours.none(math.inf), (), world, True
    )
    rules = tuple(rule for rule in RULES if rule.name in WHERE_IT_STANDS)
    here = Path(np.array([place]), np.zeros(1))
    broken = [f.text for f in findings(here, nearby(about, here, limits), limits, rules=rules) if not f.passed]
    if not broken:
        return []
    where = f"a take-off to {takeoff_m:g} m brings it" if takeoff_m is not None else "it hovers"
    return [f"{where} {'; '.join(broken)}"]


def _distance(
    place: Geodetic | None, frame: LocalFrame, operator: Operator, limits: Limits, pairing: PairingLimits
) -> list[str]:
    if place is None:
        return ["its position is unknown"]
    away = frame.ned(place).minus(operator.position)
    found = []
    if not away.norm <= pairing.range_m:
        found.append(f"it is {away.norm:.0f} m away, more than {pairing.range_m:.0f} m")
    needed_m = limits.standoff_m + limits.sigma_k * operator.sigma_m
    if not away.horizontal >= needed_m:
        found.append(f"it is {away.horizontal:.1f} m from the operator, nearer than {needed_m:.1f} m")
    return found


def _shown(confidence: float) -> str:
    return f"{confidence:.2f}" if math.isfinite(confidence) else "unknown"


class Pairing:
    """What the effects Pair and CallOffPairing mean. From the event loop only."""

    def __init__(
        self,
        setup: RunSetup,
        fleet: Fleet,
        airspace: Airspace,
        guard: Guard,
        clock: Callable[[], float],
        say: Announcing,
        takeoff_m: float | None = None,
        *,
        apply_failsafe: bool = False,
    ) -> None:
        """takeoff_m: a drone that stands takes off first, this high; apply_failsafe: set the required parameters first."""
        self._setting = setup
        self._fleet = fleet
        self._airspace = airspace
        self._guard = guard
        self._clock = clock
        self._say = say
        self._takeoff_m = takeoff_m
        self._failsafe = px4_failsafe.apply if apply_failsafe else px4_failsafe.check
        settings = setup.settings
        self._limits = PairingLimits(
            settings.pairing.range_m, settings.pairing.operator_sigma_max_m, settings.battery == "unknown"
        )

    async def pair(self, colour: str) -> PairingAnswered:
        """Check everything, and leave the drone at rest in Hold and claimed for us; or say what is against it."""
        reasons: tuple[str, ...] = ("pairing was called off",)
        try:
            reasons = await self._objections(colour)
        except VehicleError as error:
            reasons = (str(error),)
        finally:
            if reasons:
                self._airspace.give_up(colour)
        return PairingAnswered(colour, reasons, self._setting.operator, self._setting.world)

    async def call_off(self, colour: str) -> PairingAnswered:
        """A take-off that was begun for it ends in Hold. The arbiter knows why it is off. Source: X4."""
        commander = self._fleet.commanders.get(colour)
        try:
            if commander is not None:
                await commander.stop()
        except VehicleError as error:
            self._say(str(error), Notice.VEHICLE_ERROR)
        return PairingAnswered(colour, ())

    async def against(self, vehicle: ObservedVehicle, takeoff_m: float | None) -> tuple[str, ...]:
        """Everything against pairing; takeoff_m: before a take-off, all that can be known on the ground. Source: X8."""
        setup = self._setting
        if setup.operator is None:
            return (NO_OPERATOR,)
        await vehicle.wait_measured()
        told = vehicle.telemetry()
        found = objections(
            told,
            setup.frame,
            setup.operator,
            setup.world,
            setup.limits,
            self._limits,
            self._clock(),
            takeoff_m,
        )
        return (*found, *(m.text for m in await self._failsafe(vehicle, told.rc_present)))

    async def _objections(self, colour: str) -> tuple[str, ...]:
        setup, commander = self._setting, self._fleet.commanders.get(colour)
        if commander is None:
            return (f"there is no such drone; there are {', '.join(self._fleet.vehicles)}",)
        if not self._guard.ready:
            return ("the guard process is not running, so nothing may be flown",)
        if setup.operator is None:
            return (NO_OPERATOR,)
        held = await self._airspace.claim(colour, setup.frame.geodetic(setup.operator.position))
        if held is not None:
            return (held,)
        vehicle = commander.vehicle
        await vehicle.wait_ready(setup.settings.pairing.answer_s)
        if self._takeoff_m is not None and vehicle.telemetry().in_air is False:
            found = await self.against(vehicle, self._takeoff_m)
            if found:
                return found
            self._say(f"{colour.capitalize()}: taking off to {self._takeoff_m:g} m", Notice.TAKING_OFF)
            await commander.take_off(self._takeoff_m)
        found = await self.against(vehicle, None)
        if found:
            return found
        await commander.hold()
        await vehicle.wait_settled(self._setting.settings.pairing.settle_s)
        return ()
