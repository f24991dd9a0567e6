"""Whatever arrives: nothing but what is whole and authentic is taken, nothing raises, nothing grows."""

from __future__ import annotations

import json
import os
import random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from m3r_app.airspace.credentials import Broker, Credentials
from m3r_app.airspace.messages import LIMIT_BYTES
from m3r_app.airspace.mqtt_connection import Arrived
from m3r_app.airspace.signatures import Signer
from m3r_app.airspace.signed_channel import Received, SignedChannel
from m3r_app.airspace.topics import AnswerTopic, AskTopic, HeldTopic, StateTopic

COUNT = 100_000 if os.environ.get("M3R_SOAK") == "1" else 4_000
KEY = "11" * 32
TOPICS = [
    StateTopic("881f8edb2bfffff", "blue"),
    AskTopic("field", "red", "bob"),
    AnswerTopic("alice", "0" * 16),
    HeldTopic("field"),
]
SIGNERS = ["drone.blue", "operator.bob", "airspace.field", "airspace.field"]
STATE = {
    "place": {"lat_deg": 46.0, "lon_deg": 7.0, "amsl_m": 580.0},
    "velocity": {"north_m_s": 0.0, "east_m_s": 0.0, "down_m_s": 0.0},
    "sigma_m": 0.3,
    "age_s": 0.0,
}


class Office:
    """An exchange that nothing leaves, and what it took."""

    def __init__(self) -> None:
        keys = dict.fromkeys(SIGNERS, KEY) | {"operator.alice": KEY}
        who = Credentials(user="operator.alice", password="x", area="field", ca=None, flies=[], keys=keys)
        self.taken: list[Received] = []
        self.doubted: list[tuple[str, str]] = []
        self.exchange = SignedChannel(
            Broker("127.0.0.1", 1, tls=False), who, self.taken.append, lambda _: None,
            doubt=lambda *doubt: self.doubted.append(doubt),
        )  # fmt: skip

    def arrive(self, topic: str, payload: bytes, *, retained: bool = False) -> None:
        self.exchange.arrived(Arrived(topic, payload, retained, None, None))


def body(seed: random.Random) -> bytes:
    """Something like JSON, mostly of the right keys with wrong values."""
    value: Any = json.loads(json.dumps(STATE))
    for _ in range(seed.randrange(1, 4)):
        target = (
            seed.choice([value, value["place"], value["velocity"]])
            if isinstance(value.get("place"), dict) and isinstance(value.get("velocity"), dict)
            else value
        )
        key = seed.choice([*target, "more", ""])
        target[key] = seed.choice([None, [], {}, "x" * seed.randrange(50), 1e308, -1, True, [[]] * 20, {"a": {"b": 1}}])
    value["and"] = "one thing more than there is"
    return json.dumps(value).encode()


async def test_whatever_arrives_nothing_of_it_is_taken() -> None:
    """4,000 payloads on every kind of topic here, 100,000 with M3R_SOAK=1: noise, torn and changed messages, authentic nonsense."""
    seed, office = random.Random(5), Office()
    signers = [Signer(signer, bytes.fromhex(KEY)) for signer in SIGNERS]
    sent = 0
    for n in range(COUNT):
        at = n % len(TOPICS)
        topic, signer = str(TOPICS[at]), signers[at]
        match seed.randrange(6):
            case 0:
                payload = seed.randbytes(seed.randrange(400))
            case 1:
                changed = bytearray(signer.seal(topic, json.dumps(STATE).encode()))
                changed[seed.randrange(len(changed))] ^= 1 << seed.randrange(8)
                payload = bytes(changed)
            case 2:
                whole = signer.seal(topic, json.dumps(STATE).encode())
                payload = whole[: seed.randrange(len(whole))]
            case 3:
                payload = signer.seal(topic, body(seed))
            case 4:
                payload = signer.seal(topic, seed.randbytes(seed.randrange(200)))
            case _:
                payload = signer.seal(str(TOPICS[(at + 1) % 4]), b"{}")
        office.arrive(topic, payload)
        office.arrive(seed.choice(["", "m3r/1/held/field\0", "m3r/1/state/x/y", "$SYS/broker", topic + "/x"]), payload)
        sent += 2
    assert office.taken == []
    assert sum(office.exchange.dropped.values()) == sent
    assert len(office.exchange.dropped) <= 10 and len(office.exchange.verifier._last) <= len(TOPICS)
    assert {drone for drone, _ in office.doubted} == {"blue"}, (
        "what blue itself sends and nobody can read makes it nowhere"
    )


words = st.text(max_size=12) | st.sampled_from(
    [*STATE, *STATE["place"], "id", "inbox", "ask", "kind", "fence", "epoch", "claims"]
)
json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | words,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(words, inner, max_size=6),
    max_leaves=20,
)


@given(st.sampled_from(range(len(TOPICS))), json_values)
async def test_no_authentic_nonsense_is_taken(at: int, value: Any) -> None:
    """Even who has the keys cannot say anything but what the messages are."""
    office, topic = Office(), str(TOPICS[at])
    office.arrive(topic, Signer(SIGNERS[at], bytes.fromhex(KEY)).seal(topic, json.dumps(value).encode()))
    assert office.taken == [] and office.exchange.dropped in ({"malformed": 1}, {"too long": 1})


async def test_what_was_kept_or_is_too_long_is_dropped() -> None:
    office, signer = Office(), Signer("drone.blue", bytes.fromhex(KEY))
    topic = str(TOPICS[0])
    good = json.dumps(STATE).encode()
    office.arrive(topic, signer.seal(topic, good), retained=True)
    office.arrive(topic, signer.seal(topic, good + b" " * LIMIT_BYTES[StateTopic]))
    assert office.taken == [] and office.exchange.dropped == {"retained": 1, "too long": 1}
    office.arrive(topic, signer.seal(topic, good))
    (taken,) = office.taken
    assert taken.topic == TOPICS[0] and not taken.own


async def test_ones_own_messages_are_known_as_such() -> None:
    office = Office()
    signer = office.exchange._signers["operator.alice"]
    asked = {"id": "0" * 16, "inbox": "0" * 16, "ask": {"kind": "give_up", "fence": 1}}
    topic = str(AskTopic("field", "red", "alice"))
    before_s = office.exchange.link.echoed_at_s
    office.arrive(topic, signer.seal(topic, json.dumps(asked).encode()))
    assert office.taken[0].own and office.exchange.link.echoed_at_s > before_s
    with pytest.raises(KeyError):
        office.exchange.send(TOPICS[0], office.taken[0].body, "drone.blue")
