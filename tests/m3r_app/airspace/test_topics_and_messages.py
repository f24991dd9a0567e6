"""Topics, map cells and bodies: exactly what is meant, and nothing else. R5, R11."""

from __future__ import annotations

import json
import math

import h3
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from m3r_app.airspace import messages
from m3r_app.airspace.messages import (
    BODY_OF,
    HELD_MAX,
    LIMIT_BYTES,
    Answer,
    AskBody,
    Capsule,
    Held,
    HeldClaim,
    HeldVolume,
    Place,
    State,
    Velocity,
    read_body,
    within,
    write_body,
)
from m3r_app.airspace.service import EARTH
from m3r_app.airspace.signatures import Signer
from m3r_app.airspace.topics import (
    EDGE_M,
    AnswerTopic,
    AskTopic,
    HeldTopic,
    StateTopic,
    cell_of,
    cells_near,
    cells_told,
    parse_topic,
)
from safety.frames import LocalFrame
from safety.vocabulary import Geodetic, Ned, ReservedVolume

STATE = '{"place":{"lat_deg":46.0,"lon_deg":7.0,"amsl_m":580.0},"velocity":{"north_m_s":0,"east_m_s":0.5,"down_m_s":0},"sigma_m":0.3,"age_s":0.02}'
LONGEST = "a" + "b" * 31
CELL = "881f8edb2bfffff"


@pytest.mark.parametrize("topic", [
    StateTopic(CELL, "red"), AskTopic("field", "red", "alice"), AnswerTopic("alice", "0123456789abcdef"), HeldTopic("field"),
])  # fmt: skip
def test_a_topic_reads_as_it_is_written(topic: object) -> None:
    assert parse_topic(str(topic)) == topic


@pytest.mark.parametrize("text", [
    "", "m3r", "m3r/1", "m3r/2/held/field", "m3r/1/held/field/x", "m3r/1/held/", "m3r/1/held/Field", f"m3r/1/held/{LONGEST}c",
    f"m3r/1/state/{CELL}/+", "m3r/1/state/#", f"m3r/1/state/{CELL}/red\n", f"m3r/1/state/{CELL}g/red", "m3r/1/ask/field/red",
    "m3r/1/answer/alice/0123", "m3r/1/held/fi\u0435ld", "m3r/1/held/1field",
])  # fmt: skip
def test_anything_else_is_no_topic(text: str) -> None:
    assert parse_topic(text) is None


places = st.builds(Geodetic, st.floats(-90, 90), st.floats(-180, 180), st.floats(0, 3000))


@pytest.mark.requirement("R5")
@given(places, st.floats(0, 500), st.floats(0, 2 * math.pi))
def test_whoever_is_within_500_m_is_heard(here: Geodetic, away_m: float, bearing: float) -> None:
    """Anywhere on earth, the date line and the poles too."""
    there = LocalFrame(here).geodetic(Ned(away_m * math.cos(bearing), away_m * math.sin(bearing), 0.0))
    assert cells_near(here) & cells_told(there)
    assert cell_of(there) in cells_told(there)


@given(places)
def test_few_cells_are_told_and_heard(here: Geodetic) -> None:
    assert 1 <= len(cells_told(here)) <= 4
    assert len(cells_near(here)) in (6, 7)


@pytest.mark.requirement("R5")
@given(places, st.integers(0, 4), st.floats(0, 2 * math.pi))
def test_a_drone_near_an_edge_is_told_of_beyond_it(here: Geodetic, corner: int, bearing: float) -> None:
    """So that nobody loses it in the moment that it crosses."""
    lat_deg, lon_deg = h3.cell_to_boundary(cell_of(here))[corner]
    assume(abs(lat_deg) < 89.0)
    frame, step = LocalFrame(Geodetic(lat_deg, lon_deg, 0.0)), 0.3 * EDGE_M
    here, there = (
        frame.geodetic(Ned(way * step * math.cos(bearing), way * step * math.sin(bearing), 0.0)) for way in (-1, 1)
    )
    assert cell_of(there) in cells_told(here) and cell_of(here) in cells_told(there)


@pytest.mark.requirement("R5")
def test_a_state_is_taken() -> None:
    state = read_body(STATE.encode(), State)
    assert state is not None and state.velocity.ned == Ned(0, 0.5, 0)
    assert read_body(write_body(state), State) == state


@pytest.mark.requirement("R11")
@pytest.mark.parametrize(("old", "new"), [
    ("46.0", "NaN"), ("46.0", "Infinity"), ("46.0", "1e400"), ("46.0", '"46.0"'), ("46.0", "null"), ("46.0", "90.1"),
    ("46.0", "true"), ("7.0", "-180.1"), ("580.0", "20001"), ('"sigma_m":0.3', '"sigma_m":-0.1'), ('"age_s":0.02', '"age_s":-1'),
    ('"age_s":0.02', '"age_s":11'), ('"age_s":0.02', '"age_s":0.02,"more":1'), (',"age_s":0.02', ""), ("{", "["), ("0.02}", "0.02"),
    ("0.5", "1001"), (STATE, ""), (STATE, "null"), (STATE, "[]"), (STATE, "\x00"), (STATE, '"state"'),
])  # fmt: skip
def test_whatever_is_not_exactly_a_state_is_refused(old: str, new: str) -> None:
    changed = STATE.replace(old, new, 1)
    assert changed != STATE
    assert read_body(changed.encode(), State) is None


@pytest.mark.parametrize("ask", [
    {"kind": "claim", "operator": {"lat_deg": 1.0, "lon_deg": 2.0, "amsl_m": 3.0}},
    {"kind": "take_over", "fence": 1},
    {"kind": "give_up", "fence": -1},
    {"kind": "give_up", "fence": 1.5},
    {"kind": "free", "fence": 1, "lease": "a b"},
    {"kind": "free", "fence": 1, "lease": ""},
    {"kind": "claim", "operator": {"lat_deg": 1.0, "lon_deg": 2.0, "amsl_m": 3.0}, "fence": None, "lease": "x"},
])  # fmt: skip
def test_whatever_is_not_exactly_an_ask_is_refused(ask: dict[str, object]) -> None:
    body = {"id": "0" * 16, "inbox": "1" * 16, "ask": ask}
    assert read_body(json.dumps(body).encode(), AskBody) is None


def test_a_volume_is_the_same_in_any_frame() -> None:
    ours, theirs = LocalFrame(Geodetic(46.68, 7.86, 580.0)), LocalFrame(Geodetic(0.0, 0.0, 0.0))
    volume = ReservedVolume("red", Ned(3, 4, -10), Ned(3, 5, -10), 2.0, 100.0, 104.0)
    capsule = read_body(write_body(Capsule.of(volume, ours, 100.0)), Capsule)
    assert capsule is not None
    there = capsule.reserved("red", theirs, 7.0)
    assert (there.from_s, there.until_s) == (7.0, 11.0)
    assert there.start.minus(there.end).norm == pytest.approx(1.0, abs=1e-6)
    back = Capsule.of(there, theirs, 7.0).reserved("red", ours, 100.0)
    assert back.start == pytest.approx(volume.start, abs=1e-6) and back.end == pytest.approx(volume.end, abs=1e-6)


def test_the_largest_bodies_fit() -> None:
    """A message of ours is never too long to be taken, and none is longer than the shipped broker passes on."""
    place = Place(lat_deg=-89.12345678901234, lon_deg=-179.12345678901234, amsl_m=-499.12345678901234)
    capsule = Capsule(start=place, end=place, radius_m=99.12345678901234, lasts_s=59.12345678901234)
    lease = "0" * 64
    claim = HeldClaim(drone=LONGEST, operator=LONGEST, fence=2**53, lasts_s=4.123456789012345, wanted_by=LONGEST)
    volume = HeldVolume(drone=LONGEST, lease=lease, fence=2**53, volume=capsule)
    velocity = Velocity(north_m_s=-999.123456789012, east_m_s=-999.123456789012, down_m_s=-999.123456789012)
    ask = {"kind": "reserve", "fence": 2**53, "lease": lease, "volume": capsule.model_dump()}
    largest = {
        StateTopic(CELL, LONGEST): State(
            place=place, velocity=velocity, sigma_m=9999.12345678901, age_s=9.1234567890123
        ),
        AskTopic(LONGEST, LONGEST, LONGEST): AskBody.model_validate({"id": "0" * 16, "inbox": "0" * 16, "ask": ask}),
        AnswerTopic(LONGEST, "0" * 16): Answer(
            id="0" * 16, granted=False, fence=2**53, lasts_s=59.123456789012, reason="é" * 300
        ),
        HeldTopic(LONGEST): Held(epoch="0" * 16, claims=[claim] * HELD_MAX, volumes=[volume] * HELD_MAX),
    }
    for topic, body in largest.items():
        key_id = f"operator.{LONGEST}"
        payload = Signer(key_id, bytes(32)).seal(str(topic), write_body(body))
        assert isinstance(body, BODY_OF[type(topic)])
        assert len(payload) <= LIMIT_BYTES[type(topic)] <= 262_144 < 300_000, topic
    with pytest.raises(ValueError, match="at most"):
        Held(epoch="0" * 16, claims=[claim] * (HELD_MAX + 1), volumes=[])


def test_limits_of_the_authority_and_of_the_messages_agree() -> None:
    from m3r_app.airspace import authority

    assert authority.CLAIMS_MAX == authority.LEASES_MAX == messages.HELD_MAX


@pytest.mark.requirement("X10")
@pytest.mark.parametrize("lasts_s", [0.0, 4.0, 60.0])
@pytest.mark.parametrize("amsl_m", [-500.0, 0.0, 20_000.0])
@pytest.mark.parametrize("lat_deg", [-90.0, 0.0, 46.679, 90.0])
@pytest.mark.parametrize("lon_deg", [-180.0, 0.0, 7.863, 180.0])
def test_every_volume_that_can_be_asked_for_can_be_told(
    lat_deg: float, lon_deg: float, amsl_m: float, lasts_s: float
) -> None:
    """Through the authority's frame and clock and back, at the bounds of each field: -500 m comes back as -500.0000000005 m."""
    place = Place(lat_deg=lat_deg, lon_deg=lon_deg, amsl_m=amsl_m)
    asked = Capsule(start=place, end=place, radius_m=100.0, lasts_s=lasts_s)
    for now_s in (0.1, 1234.7, 86_400.3):
        told = Capsule.of(asked.reserved("red", EARTH, now_s), EARTH, now_s)
        assert told.start.amsl_m == pytest.approx(amsl_m, abs=1e-5)
        assert told.lasts_s == pytest.approx(lasts_s, abs=1e-6)
        assert read_body(write_body(told), Capsule) == told


@pytest.mark.parametrize(
    ("value", "kept"), [(-0.0, 0.0), (-1e-7, 0.0), (-1e-5, -1e-5), (5.0, 5.0), (9.0 + 1e-7, 9.0), (9.1, 9.1)]
)
def test_what_is_past_a_bound_by_rounding_is_at_it(value: float, kept: float) -> None:
    assert within(value, 0.0, 9.0) == kept
    assert math.isnan(within(math.nan, 0.0, 9.0)), "refused by the field it goes to"
