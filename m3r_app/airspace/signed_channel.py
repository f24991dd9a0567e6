"""Signed messages over a link: only what is whole, fresh and really from whom its topic says reaches the app."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from m3r_app.airspace.credentials import Broker, Credentials
from m3r_app.airspace.messages import BODY_OF, LIMIT_BYTES, read_body, write_body
from m3r_app.airspace.mqtt_connection import Arrived, MqttConnection
from m3r_app.airspace.signatures import Dropped, Envelope, Signer, Verifier
from m3r_app.airspace.topics import AnswerTopic, StateTopic, Topic, parse_topic


@dataclass(frozen=True, slots=True)
class Received:
    """An authentic message. answer_topic, correlation: MQTT 5's, which are not signed."""

    topic: Topic
    body: Any
    envelope: Envelope
    at_s: float
    own: bool
    answer_topic: str | None
    correlation: bytes | None


class SignedChannel:
    """Signs and sends; verifies and hands on."""

    def __init__(
        self,
        broker: Broker,
        credentials: Credentials,
        take: Callable[[Received], None],
        say: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
        wall_clock: Callable[[], float] = time.time,
        doubt: Callable[[str, str], None] = lambda _drone, _why: None,
    ) -> None:
        """take: every authentic message. doubt: a drone whose messages are its own, but unusable, and why."""
        self.credentials = credentials
        self.verifier = Verifier(
            {key_id: key for key_id in credentials.keys if (key := credentials.key(key_id)) is not None}, wall_clock
        )
        self.link = MqttConnection(broker, credentials, self.arrived, say, clock)
        self._take = take
        self._doubt = doubt
        self._clock = clock
        self._signers = {
            key_id: Signer(key_id, key, wall_clock)
            for key_id in (credentials.user, *(f"drone.{drone}" for drone in credentials.flies))
            if (key := credentials.key(key_id)) is not None
        }
        self._area_key = f"airspace.{credentials.area}"

    @property
    def dropped(self) -> Counter[str]:
        """How many messages were dropped, by reason."""
        return self.verifier.dropped

    def may_sign(self, key_id: str) -> bool:
        return key_id in self._signers

    def send(
        self, topic: Topic, body: BaseModel, signer: str, *, qos: int = 0, answer_topic: str | None = None,
        correlation: bytes | None = None,
    ) -> None:  # fmt: skip
        """Sign and send soon. Raises KeyError for a signer whose key we do not have."""
        payload = self._signers[signer].seal(str(topic), write_body(body))  # type: ignore[arg-type]
        self.link.post(str(topic), payload, qos=qos, answer_topic=answer_topic, correlation=correlation)

    def listen(self, topics: Iterable[str]) -> None:
        self.link.listen(frozenset(topics))

    def arrived(self, message: Arrived) -> None:
        """Whatever the broker delivers. Never raises."""
        topic = parse_topic(message.topic)
        if topic is None:
            self.dropped["unknown topic"] += 1
            return
        if message.retained:
            self.dropped["retained"] += 1  # somebody left it there: never fresh, so never executed
            return
        if len(message.payload) > LIMIT_BYTES[type(topic)]:
            self.dropped["too long"] += 1
            return
        signer = self._area_key if isinstance(topic, AnswerTopic) else topic.signer
        assert signer is not None
        try:
            envelope = self.verifier.open(message.topic, message.payload, signer)
        except Dropped as drop:
            # A replay only shows that somebody repeats messages; with a wrong clock the drone's place is unknown.
            if drop.signer is not None and drop.reason == "clock" and isinstance(topic, StateTopic):
                self._doubt(topic.drone, "its clock and ours differ by more than 5 s, or its messages are late")
            return
        own = any(s.life == envelope.life for s in self._signers.values())
        body = read_body(envelope.body, BODY_OF[type(topic)])
        if body is None:
            self.dropped["malformed"] += 1
            if isinstance(topic, StateTopic):
                self._doubt(topic.drone, "its messages cannot be read")
            return
        if own:
            self.link.echoed()
            self.link.alright()
        self._take(Received(topic, body, envelope, self._clock(), own, message.answer_topic, message.correlation))
