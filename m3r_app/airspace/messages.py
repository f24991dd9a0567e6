"""What is sent, version 1: small strict JSON bodies. Durations are relative, so that no clock need be shared.

Anything unknown, missing, too long, not finite or of another type is refused whole. `docs/asyncapi.yaml` describes the same.
"""

from __future__ import annotations

from typing import Annotated, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from m3r_app.airspace.topics import NAME, AnswerTopic, AskTopic, HeldTopic, StateTopic, Topic
from safety.frames import LocalFrame
from safety.vocabulary import Geodetic, Ned, ReservedVolume

LEASE_MAX_S = 60.0
RADIUS_MAX_M = 100.0
HELD_MAX = 256
"""Claims, and volumes, in one area."""
LIMIT_BYTES: dict[type[Topic], int] = {
    StateTopic: 1024,
    AskTopic: 2048,
    AnswerTopic: 2048,
    HeldTopic: 256 * 1024,
}
"""The longest payload per kind of topic, signature included."""

LAT_MAX_DEG, LON_MAX_DEG = 90.0, 180.0
AMSL_MIN_M, AMSL_MAX_M = -500.0, 20_000.0
ROUNDING = 1e-6
"""What goes through a local frame and back comes out this little otherwise (degrees, metres, seconds): a bound still holds it."""

Name = Annotated[str, Field(pattern=f"^{NAME}$")]
Hex16 = Annotated[str, Field(pattern="^[0-9a-f]{16}$")]
Lease = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.:-]{1,64}$")]
Latitude = Annotated[float, Field(ge=-LAT_MAX_DEG, le=LAT_MAX_DEG)]
Longitude = Annotated[float, Field(ge=-LON_MAX_DEG, le=LON_MAX_DEG)]
Altitude = Annotated[float, Field(ge=AMSL_MIN_M, le=AMSL_MAX_M)]
Speed = Annotated[float, Field(ge=-1000.0, le=1000.0)]
Sigma = Annotated[float, Field(ge=0.0, le=10_000.0)]
Fence = Annotated[int, Field(ge=0, le=2**53)]
Duration = Annotated[float, Field(ge=0.0, le=LEASE_MAX_S)]
Sentence = Annotated[str, Field(max_length=300)]


def within(value: float, least: float, most: float) -> float:
    """The value, at the bound where it is past it by rounding alone; farther out it stays, to be refused."""
    near = min(max(float(value), least), most)
    return near if abs(near - value) <= ROUNDING else float(value)


class _Body(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, strict=True)


class Place(_Body):
    """WGS 84 degrees, metres above mean sea level."""

    lat_deg: Latitude
    lon_deg: Longitude
    amsl_m: Altitude

    @property
    def geodetic(self) -> Geodetic:
        return Geodetic(self.lat_deg, self.lon_deg, self.amsl_m)

    @staticmethod
    def of(place: Geodetic) -> Place:
        """Raises ValidationError where it is no place of this world."""
        return Place(
            lat_deg=within(place.lat_deg, -LAT_MAX_DEG, LAT_MAX_DEG),
            lon_deg=within(place.lon_deg, -LON_MAX_DEG, LON_MAX_DEG),
            amsl_m=within(place.amsl_m, AMSL_MIN_M, AMSL_MAX_M),
        )


class Velocity(_Body):
    """North, east, down, m/s."""

    north_m_s: Speed
    east_m_s: Speed
    down_m_s: Speed

    @property
    def ned(self) -> Ned:
        return Ned(self.north_m_s, self.east_m_s, self.down_m_s)


class State(_Body):
    """Where a drone is. sigma_m: 1-sigma accuracy; age_s: how old it was when it was sent. Source: R5, R11."""

    place: Place
    velocity: Velocity
    sigma_m: Sigma
    age_s: Annotated[float, Field(ge=0.0, le=10.0)]


class Capsule(_Body):
    """A volume: everything within radius_m of the line from start to end, from now on for lasts_s. Source: X10."""

    start: Place
    end: Place
    radius_m: Annotated[float, Field(gt=0.0, le=RADIUS_MAX_M)]
    lasts_s: Duration

    def reserved(self, holder: str, frame: LocalFrame, now_s: float) -> ReservedVolume:
        """The same in a local frame, counted from now."""
        start, end = frame.ned(self.start.geodetic), frame.ned(self.end.geodetic)
        return ReservedVolume(holder, start, end, self.radius_m, now_s, now_s + self.lasts_s)

    @staticmethod
    def of(volume: ReservedVolume, frame: LocalFrame, now_s: float) -> Capsule:
        """Raises ValidationError where it is no volume."""
        return Capsule(
            start=Place.of(frame.geodetic(volume.start)),
            end=Place.of(frame.geodetic(volume.end)),
            radius_m=float(volume.radius_m),
            lasts_s=within(max(0.0, volume.until_s - now_s), 0.0, LEASE_MAX_S),
        )


class Claim(_Body):
    """Pair with the drone. operator: where the operator stands. fence: of a claim that is to be renewed. Source: paper III-A."""

    kind: Literal["claim"]
    operator: Place
    fence: Fence | None


class GiveUp(_Body):
    """Let the drone go; whoever waits for it may have it."""

    kind: Literal["give_up"]
    fence: Fence


class Reserve(_Body):
    """Have this volume for a maneuver. fence: of the claim."""

    kind: Literal["reserve"]
    fence: Fence
    lease: Lease
    volume: Capsule


class Free(_Body):
    """The maneuver is over."""

    kind: Literal["free"]
    fence: Fence
    lease: Lease


Ask = Annotated[Claim | GiveUp | Reserve | Free, Field(discriminator="kind")]


class AskBody(_Body):
    """id: the correlation data; inbox: the app that asks, to which alone the answer goes."""

    id: Hex16
    inbox: Hex16
    ask: Ask


class Answer(_Body):
    """Of the authority. fence: of the grant; lasts_s: how long it holds; reason: why not."""

    id: Hex16
    granted: bool
    fence: Fence
    lasts_s: Duration
    reason: Sentence


class HeldClaim(_Body):
    """Who holds a drone, and who waits for it."""

    drone: Name
    operator: Name
    fence: Fence
    lasts_s: Duration
    wanted_by: Name | None


class HeldVolume(_Body):
    """What is kept clear for whom."""

    drone: Name
    lease: Lease
    fence: Fence
    volume: Capsule


class Held(_Body):
    """Everything held in an area. epoch: one life of the authority."""

    epoch: Hex16
    claims: Annotated[list[HeldClaim], Field(max_length=HELD_MAX)]
    volumes: Annotated[list[HeldVolume], Field(max_length=HELD_MAX)]


BODY_OF: dict[type[Topic], type[_Body]] = {StateTopic: State, AskTopic: AskBody, AnswerTopic: Answer, HeldTopic: Held}
"""The body that travels on each kind of topic."""

B = TypeVar("B", bound=_Body)


def read_body(body: bytes, kind: type[B]) -> B | None:
    """The body; None if it is not exactly one of its kind."""
    try:
        return kind.model_validate_json(body)
    except ValidationError:
        return None


def write_body(body: _Body) -> bytes:
    return body.model_dump_json().encode()
