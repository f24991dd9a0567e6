"""Scenario files (TOML): where, terrain, obstacles, geofence, wind, GPS, the fleet with its start states, traffic.

Places of vehicles and traffic are metres north and east of the origin and metres above the ground there; files are
named relative to the scenario. Every key is checked: an unknown, missing or impossible one is an error that names it.

What happens to a simulated drone stands in `[[vehicles.NAME.events]]`, in any number and order:

    [[vehicles.red.events]]
    at_s = 2.0                 # seconds after
    after = "offboard"         # "start" (default): when the fleet begins; "takeoff": when it leaves the ground;
                               # "offboard": when a station first commands Offboard while it is armed;
                               # "move": when the Offboard setpoint first differs by 0.3 m from the first one
    kind = "estimate_jump"     # an EKF reset: the estimate, not the drone, is elsewhere; ODOMETRY counts it
    ned_m = [2.0, 0.0, 0.0]

The kinds and their keys: `estimate_jump` ned_m; `gps_lost` for_s (left out: for good); `mode` mode (by another ground
station: HOLD, LAND, RTL, POSCTL, ALTCTL, MISSION, OFFBOARD); `disarm` and `kill` (in the air: it falls); `restart`
for_s (the flight controller reboots: it falls, is silent so long, then counts time from 0); `link_cut` for_s (both
ways); `link` loss, delay_ms (from now on); `component` component, type, autopilot (another component's heartbeat, a
gimbal's unless said); `second_autopilot` system_id (whose telemetry comes to the same port); `text` text, severity
(STATUSTEXT); `battery` level (0 to 1, or "unknown"); `fault` fault (of m3r_app.sim.modes.Fault, in lower case).
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from safety.vocabulary import Geodetic

Latitude = Annotated[float, Field(gt=-85.0, lt=85.0)]
Longitude = Annotated[float, Field(ge=-180.0, le=180.0)]
Altitude = Annotated[float, Field(gt=-500.0, lt=9000.0)]
Offset = Annotated[float, Field(ge=-500.0, le=500.0)]
Height = Annotated[float, Field(ge=0.0, le=500.0)]
Sigma = Annotated[float, Field(ge=0.0, le=50.0)]
Waypoint = tuple[Offset, Offset, Height]
"""North (m), east (m), height above the ground there (m)."""
Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_-]{0,31}$")]


class ScenarioError(ValueError):
    """A scenario file that cannot be used; one sentence that names the file and the key."""


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Origin(_Table):
    """The scenario's local frame: the ground at this place is its zero."""

    lat_deg: Latitude
    lon_deg: Longitude
    ground_amsl_m: Altitude

    @property
    def place(self) -> Geodetic:
        return Geodetic(self.lat_deg, self.lon_deg, self.ground_amsl_m)


class OperatorPlace(_Table):
    """Where the operator stands unless the command line says otherwise. Source: design 1."""

    lat_deg: Latitude
    lon_deg: Longitude
    amsl_m: Altitude
    sigma_m: Sigma

    @property
    def place(self) -> Geodetic:
        return Geodetic(self.lat_deg, self.lon_deg, self.amsl_m)


class TerrainSource(_Table):
    """A DEM file, or flat ground at one altitude: one of the two, said. sigma_m: the stated 1-sigma height error."""

    dem: Path | None = None
    flat_amsl_m: Altitude | None = None
    sigma_m: Sigma

    @model_validator(mode="after")
    def _one_of_two(self) -> Self:
        if (self.dem is None) == (self.flat_amsl_m is None):
            raise ValueError("give either dem or flat_amsl_m")
        return self


class ObstacleSource(_Table):
    """GeoJSON polygons with properties base_amsl_m and top_amsl_m."""

    file: Path


class GeofenceSource(_Table):
    """A GeoJSON polygon, holes allowed, and how low and high it reaches."""

    file: Path
    floor_amsl_m: Altitude
    ceiling_amsl_m: Altitude

    @model_validator(mode="after")
    def _floor_below_ceiling(self) -> Self:
        if self.floor_amsl_m >= self.ceiling_amsl_m:
            raise ValueError("floor_amsl_m must be below ceiling_amsl_m")
        return self


class WindModel(_Table):
    """Mean wind and Gauss-Markov gusts, which stay within twice gust_sigma_m_s of it."""

    speed_m_s: Annotated[float, Field(ge=0.0, le=25.0)] = 0.0
    from_deg: Annotated[float, Field(ge=0.0, le=360.0)] = 0.0
    gust_sigma_m_s: Annotated[float, Field(ge=0.0, le=10.0)] = 0.0
    gust_tau_s: Annotated[float, Field(gt=0.0, le=600.0)] = 3.0


Noise = Literal["bounded", "px4-sih", "px4-sih-half", "px4-sih-quiet"]
"""bounded: honest, as the other keys of [gps] say. The others: PX4's own simulation, see m3r_app.sim.estimator."""


class GpsModel(_Table):
    """What the drones' position estimates are wrong by, and say they are; the error stays within twice the sigmas."""

    noise: Noise = "bounded"

    sigma_h_m: Annotated[float, Field(gt=0.0, le=50.0)] = 0.25
    sigma_v_m: Annotated[float, Field(gt=0.0, le=50.0)] = 0.35
    tau_s: Annotated[float, Field(gt=0.0, le=3600.0)] = 300.0
    drift_m_s: Annotated[float, Field(gt=0.0, le=1.0)] = 0.01
    """The error moves at most at twice this."""


class LinkModel(_Table):
    """How a drone's MAVLink comes through."""

    loss: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.0
    """The fraction of datagrams that is lost, each way."""
    delay_ms: Annotated[float, Field(ge=0.0, le=10_000.0)] = 0.0
    """Each way."""
    rate_hz_max: Annotated[float, Field(gt=0.0, le=50.0)] | None = None
    """No message is sent more often, whatever is asked for."""
    mode_at_once: bool = True
    """A change of mode is told at once. PX4 itself tells it with its next heartbeat, a second later at worst."""
    without: tuple[Annotated[str, Field(pattern=r"^[A-Z][A-Z0-9_]*$")], ...] = ()
    """MAVLink names of messages that it does not send."""


class _Event(_Table):
    at_s: Annotated[float, Field(ge=0.0, le=3600.0)] = 0.0
    after: Literal["start", "takeoff", "offboard", "move"] = "start"


Seconds = Annotated[float, Field(gt=0.0, le=3600.0)]


class EstimateJump(_Event):
    kind: Literal["estimate_jump"]
    ned_m: tuple[Offset, Offset, Offset]


class GpsLost(_Event):
    kind: Literal["gps_lost"]
    for_s: Seconds | None = None


class ModeByOther(_Event):
    kind: Literal["mode"]
    mode: Literal["HOLD", "LAND", "RTL", "POSCTL", "ALTCTL", "MISSION", "OFFBOARD"]


class DisarmByOther(_Event):
    kind: Literal["disarm", "kill"]


class Restart(_Event):
    kind: Literal["restart"]
    for_s: Seconds = 2.0


class LinkCut(_Event):
    kind: Literal["link_cut"]
    for_s: Seconds


class LinkChange(_Event):
    kind: Literal["link"]
    loss: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    delay_ms: Annotated[float, Field(ge=0.0, le=10_000.0)] = 0.0


class ComponentHeard(_Event):
    """A gimbal that fills in its autopilot field, unless said otherwise."""

    kind: Literal["component"]
    component: Annotated[int, Field(ge=1, le=255)] = 154
    type: Annotated[int, Field(ge=0, le=255)] = 26
    autopilot: Annotated[int, Field(ge=0, le=255)] = 3


class SecondAutopilot(_Event):
    kind: Literal["second_autopilot"]
    system_id: Annotated[int, Field(ge=1, le=250)]


class StatusText(_Event):
    kind: Literal["text"]
    text: Annotated[str, Field(min_length=1, max_length=500)]
    severity: Annotated[int, Field(ge=0, le=7)] = 6


class BatteryTold(_Event):
    kind: Literal["battery"]
    level: Annotated[float, Field(ge=0.0, le=1.0)] | Literal["unknown"]


class FaultHappens(_Event):
    kind: Literal["fault"]
    fault: Literal["gps_stuck", "gps_wrong", "battery_off", "motor_off", "rc_off", "rc_wrong", "link_off"]


Event = Annotated[
    EstimateJump
    | GpsLost
    | ModeByOther
    | DisarmByOther
    | Restart
    | LinkCut
    | LinkChange
    | ComponentHeard
    | SecondAutopilot
    | StatusText
    | BatteryTold
    | FaultHappens,
    Field(discriminator="kind"),
]


class VehicleStart(_Table):
    """One drone of the fleet. params: autopilot parameters that differ from PX4's defaults."""

    north_m: Offset
    east_m: Offset
    height_m: Height = 0.0
    """Above the ground there."""
    heading_deg: Annotated[float, Field(ge=-180.0, le=360.0)] = 0.0
    state: Literal["ground", "hold", "mission"]
    waypoints: tuple[Waypoint, ...] = ()
    """The mission; flown round and round."""
    rc: bool = False
    """A pilot with a remote control stands by."""
    battery: Annotated[float, Field(gt=0.0, le=1.0)] | Literal["unknown"] = 1.0
    """unknown: told as -1."""
    rangefinder: bool = False
    """It tells its height above the ground (DISTANCE_SENSOR)."""
    noise: Noise | None = None
    """Unlike the others', which is gps.noise."""
    link: LinkModel = LinkModel()
    events: tuple[Event, ...] = ()
    params: dict[str, int | float] = {}

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if (self.state == "ground") != (self.height_m == 0.0):
            raise ValueError('height_m must be 0 for state "ground" and above 0 otherwise')
        if self.state == "mission" and not self.waypoints:
            raise ValueError('state "mission" needs waypoints')
        return self


class Traffic(_Table):
    """A drone of somebody else that flies along its waypoints: to the end and back for ever, or once."""

    waypoints: Annotated[tuple[Waypoint, ...], Field(min_length=2)]
    speed_m_s: Annotated[float, Field(gt=0.0, le=20.0)]
    loop: bool = True
    adsb: bool = False
    """It has no link: only its transponder tells of it."""
    start_delay_s: Annotated[float, Field(ge=0.0, le=3600.0)] = 0.0


class Scenario(_Table):
    """Everything a simulated session needs; for real vehicles, the environment."""

    name: str
    seed: int = 1
    origin: Origin
    operator: OperatorPlace
    terrain: TerrainSource
    obstacles: ObstacleSource | None = None
    geofence: GeofenceSource | None = None
    wind: WindModel = WindModel()
    gps: GpsModel = GpsModel()
    vehicles: Annotated[dict[Name, VehicleStart], Field(min_length=1, max_length=40)]
    traffic: dict[Name, Traffic] = {}
    path: Path
    """The file it came from."""

    @model_validator(mode="after")
    def _names_differ(self) -> Self:
        if both := set(self.vehicles) & set(self.traffic):
            raise ValueError(f"{min(both)} names both a vehicle and traffic")
        return self

    def file(self, name: Path) -> Path:
        """A file the scenario names, relative to it."""
        return self.path.parent / name


SHIPPED = Path(__file__).resolve().parents[2] / "config" / "scenarios"
"""Where the scenarios that come with M3R are."""


def load_scenario(path: Path | str) -> Scenario:
    """Read and check a scenario. Raises ScenarioError: one sentence with the file, the key and what is wrong."""
    path = Path(path)
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ScenarioError(f"scenario {path} cannot be read: {error.strerror or error}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ScenarioError(f"scenario {path} is not valid TOML: {error}") from None
    if "path" in data:
        raise ScenarioError(f"scenario {path}: path: there is no such key")
    try:
        return Scenario.model_validate({**data, "path": path.resolve()})
    except ValidationError as error:
        raise ScenarioError(f"scenario {path}: {_sentence(error)}") from None


def _sentence(error: ValidationError) -> str:
    """The first error as `key: what is wrong`."""
    first = error.errors(include_url=False)[0]
    key = ".".join(str(part) for part in first["loc"] if part != "[key]") or "the file"
    match first["type"]:
        case "extra_forbidden":
            return f"{key}: there is no such key"
        case "missing":
            return f"{key}: this key is required"
    reason = first["msg"].removeprefix("Value error, ")
    shown = "" if isinstance(first["input"], dict) else f", not {first['input']!r}"
    return f"{key}: {reason[0].lower()}{reason[1:]}{shown}"
