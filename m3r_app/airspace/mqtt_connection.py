"""The connection to the broker: MQTT 5 by aiomqtt, always made anew, with what went wrong in one sentence.

A client id is random and used once, so that nobody can throw us out by guessing it; no session and nothing queued outlives a
connection. A connection counts only while our own messages come back over it: a broker that denies a publish says
nothing, and neither does a dead network.
"""

from __future__ import annotations

import asyncio
import logging
import random
import secrets
import socket
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Any

import aiomqtt
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from m3r_app.airspace.credentials import AirError, Broker, Credentials, tls_context

KEEPALIVE_S = 3
CONNECT_S = 3.0
PUBLISH_S = 2.0
SILENT_S = 1.2
"""Nothing of our own has come back for so long: the connection is as good as gone."""
BACKOFF_S = (0.1, 4.0)
OUTBOX = 64
INBOX = 1024
BAD_LOGIN, NOT_AUTHORIZED, WRONG_VERSION = 134, 135, 132
"""MQTT 5 reason codes; 1, 4 and 5 are what older brokers say in their place."""
REFUSED = 128


@dataclass(frozen=True, slots=True)
class Arrived:
    """A message as it came. answer_topic, correlation: MQTT 5's."""

    topic: str
    payload: bytes
    retained: bool
    answer_topic: str | None
    correlation: bytes | None


@dataclass(frozen=True, slots=True)
class _Outgoing:
    topic: str
    payload: bytes
    qos: int
    properties: Properties | None


class MqttConnection:
    """Keeps one connection for as long as `kept` is entered. From one event loop only."""

    def __init__(
        self,
        broker: Broker,
        credentials: Credentials,
        receive: Callable[[Arrived], None],
        say: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """receive: takes every message and never raises. say: one sentence for a person."""
        self.broker = broker
        self.up_since_s: float | None = None
        """None: not connected."""
        self.client_id = ""
        self.dropped = 0
        """Messages that could not be sent in time."""
        self.speaks: Callable[[], bool] = lambda: True
        """Whether anything of ours was sent that must come back by now; while not, silence says nothing of the broker."""
        self._opened: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        """Done when first connected, or failed for good before that."""
        self._user = credentials.user
        self._password = credentials.password
        self._tls = tls_context(credentials, broker)
        self._receive = receive
        self._say = say
        self._clock = clock
        self._wanted: frozenset[str] = frozenset()
        self._rewanted = asyncio.Event()
        self._outbox: deque[_Outgoing] = deque()
        self._posted = asyncio.Event()
        self.echoed_at_s = clock()
        self._proved = False
        """Whether this connection has worked: then the next one is tried soon again."""
        self._told: str | None = None
        self.overflowed = 0
        """Messages that came faster than they could be read, and were dropped."""
        self._log = logging.Logger("m3r.mqtt", logging.WARNING)  # noqa: LOG001  (of its own: nothing reaches the screen)
        self._log.addHandler(_Overflow(self._overflow))

    @property
    def up(self) -> bool:
        return self.up_since_s is not None

    # ------------------------------------------------------------ what users do

    def listen(self, topics: frozenset[str]) -> None:
        """Receive exactly these from now on, on this connection and all later ones."""
        if topics != self._wanted:
            self._wanted = topics
            self._rewanted.set()

    def post(
        self,
        topic: str,
        payload: bytes,
        *,
        qos: int = 0,
        answer_topic: str | None = None,
        correlation: bytes | None = None,
    ) -> None:
        """Send soon, while connected; never waits, and what waits too long is dropped: it would only be old."""
        if not self.up:
            return
        properties = None
        if answer_topic is not None or correlation is not None:
            properties = Properties(PacketTypes.PUBLISH)  # type: ignore[no-untyped-call]
            if answer_topic is not None:
                properties.ResponseTopic = answer_topic
            if correlation is not None:
                properties.CorrelationData = correlation
        self._outbox.append(_Outgoing(topic, payload, qos, properties))
        if len(self._outbox) > OUTBOX:
            self._outbox.popleft()
            self.dropped += 1
            self._tell(f"the broker {self.broker} takes messages too slowly, and some were not sent")
        self._posted.set()

    def echoed(self) -> None:
        """A message of our own has come back."""
        self.echoed_at_s = self._clock()
        self._proved = True

    # ------------------------------------------------------------ its life

    @asynccontextmanager
    async def kept(self) -> AsyncIterator[asyncio.Task[None]]:
        """Connected within, and again whenever the connection is lost. Yields the task that sees to it.

        Raises AirError, with nothing left running, where the first connection cannot be made.
        """
        life = asyncio.create_task(self._run())
        try:
            await asyncio.shield(self._opened)
            yield life
        finally:
            life.cancel()
            await asyncio.gather(life, return_exceptions=True)

    async def _run(self) -> None:
        """Connect, and again whenever the connection is lost, until cancelled."""
        wait_s = BACKOFF_S[0]
        me = asyncio.current_task()
        # The client may replace our cancellation by an error of its own.
        while me is None or not me.cancelling():
            self._proved = False
            try:
                await self._connected_once()
            except AirError as error:
                self._down(str(error))
            except aiomqtt.MqttError as error:
                self._down(self._in_words(error))
            except Exception as error:  # noqa: BLE001  (whatever breaks a connection, the next one is made)
                self._down(f"the connection to {self.broker} broke ({type(error).__name__}: {error})")
            if self._proved:
                wait_s = BACKOFF_S[0]
            await asyncio.sleep(random.uniform(0.5, 1.0) * wait_s)
            wait_s = min(BACKOFF_S[1], 2.0 * wait_s)

    async def _connected_once(self) -> None:
        """One connection, to its end. Raises what ended it."""
        self.client_id = f"m3r-{secrets.token_hex(8)}"
        client = aiomqtt.Client(
            self.broker.host,
            self.broker.port,
            username=self._user,
            password=self._password,
            identifier=self.client_id,
            protocol=aiomqtt.ProtocolVersion.V5,
            clean_start=True,
            keepalive=KEEPALIVE_S,
            timeout=CONNECT_S,
            tls_context=self._tls,
            max_queued_incoming_messages=INBOX,
            max_queued_outgoing_messages=OUTBOX,
            socket_options=[(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)],
            logger=self._log,
        )
        try:
            async with client:
                listening = await self._subscribe(client, frozenset(), self._wanted)
                self._is_up()
                await _first_to_end(
                    self._read(client), self._write(client), self._follow(client, listening), self._watch()
                )
        except RuntimeError as error:
            raise AirError(f"the connection to {self.broker} broke ({error})") from None
        raise AirError(f"{self.broker} ended the connection")

    def _is_up(self) -> None:
        self.up_since_s = self.echoed_at_s = self._clock()
        self._outbox.clear()
        if not self._opened.done():
            self._opened.set_result(None)

    def _down(self, why: str) -> None:
        self.up_since_s = None
        if not self._opened.done():
            self._opened.set_exception(AirError(why))
            self._opened.exception()  # whether or not anybody waits
        else:
            self._tell(why)

    def alright(self) -> None:
        """Own messages come back again: say so if anything else had been said."""
        if self._told is not None:
            self._told = None
            self._say(f"connected to {self.broker} again")

    def _overflow(self) -> None:
        self.overflowed += 1
        self._tell(f"more messages come from {self.broker} than can be read, and some are dropped")

    def _tell(self, why: str) -> None:
        if why != self._told:
            self._told = why
            self._say(why)

    # ------------------------------------------------------------ while connected

    async def _read(self, client: aiomqtt.Client) -> None:
        async for message in client.messages:
            payload = message.payload if isinstance(message.payload, bytes) else b""
            properties = message.properties
            answer_topic = getattr(properties, "ResponseTopic", None)
            correlation = getattr(properties, "CorrelationData", None)
            self._receive(Arrived(str(message.topic), payload, bool(message.retain), answer_topic, correlation))

    async def _write(self, client: aiomqtt.Client) -> None:
        while True:
            while self._outbox:
                one = self._outbox.popleft()
                await client.publish(one.topic, one.payload, one.qos, properties=one.properties, timeout=PUBLISH_S)
            self._posted.clear()
            await self._posted.wait()

    async def _follow(self, client: aiomqtt.Client, listening: frozenset[str]) -> None:
        while True:
            listening = await self._subscribe(client, listening, self._wanted)
            self._rewanted.clear()
            await self._rewanted.wait()

    async def _watch(self) -> None:
        """Raises AirError when nothing of our own comes back."""
        while True:
            await asyncio.sleep(0.1)
            if not self.speaks():
                self.echoed()
            if self._clock() - self.echoed_at_s > SILENT_S:
                raise AirError(
                    f"{self.broker} does not pass our messages on: the network is down, or {self._user} may not publish there"
                )

    async def _subscribe(
        self, client: aiomqtt.Client, before: frozenset[str], wanted: frozenset[str]
    ) -> frozenset[str]:
        for topic in before - wanted:
            await client.unsubscribe(topic)
        for topic in sorted(wanted - before):
            codes = await client.subscribe(topic, qos=1)
            values = [code if isinstance(code, int) else code.value for code in codes]
            if any(value >= REFUSED for value in values):
                raise AirError(
                    f"{self.broker} does not let {self._user} listen to {topic}: its access list must allow it"
                )
        return wanted

    def _in_words(self, error: aiomqtt.MqttError) -> str:
        """One sentence that says what to do."""
        text = " ".join(str(error).split())
        code = getattr(error, "rc", None)
        refused = isinstance(error, aiomqtt.exceptions.MqttConnectError)
        value = (code if isinstance(code, int) else getattr(code, "value", None)) if refused else None
        if value in (BAD_LOGIN, NOT_AUTHORIZED, 4, 5):
            return f"{self.broker} does not accept the password of {self._user}: use credentials made for this broker"
        if value in (WRONG_VERSION, 1):
            return f"{self.broker} does not speak MQTT 5: use one that does, such as Mosquitto 2"
        if "CERTIFICATE_VERIFY_FAILED" in text:
            why = text.rpartition("failed: ")[2].partition(" (_ssl")[0]
            return (
                f"the certificate of {self.broker} is not to be trusted ({why}): use credentials made for this broker"
            )
        if "SSL" in text or "EOF occurred" in text:
            return f"{self.broker} speaks no TLS, or another kind of it ({text})"
        if "Connection refused" in text:
            return f"nobody answers at {self.broker}: start the broker, or correct --broker"
        if "Name or service" in text or "name resolution" in text:
            return f"there is no host {self.broker.host}: correct --broker"
        return f"the connection to {self.broker} is lost ({text})"


async def _first_to_end(*work: Coroutine[Any, Any, None]) -> None:
    """Run all until one ends, then none. Raises what that one raised."""
    tasks = [asyncio.create_task(one) for one in work]
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()
    finally:
        running: set[asyncio.Task[None]] = set(tasks)
        while running:
            for task in running:
                task.cancel()
            # Again and again: the client may swallow a cancellation that meets an answer.
            _, running = await asyncio.wait(running, timeout=0.1)


class _Overflow(logging.Handler):
    """What a person must know of the client's own log: that messages came faster than they could be read."""

    def __init__(self, told: Callable[[], None]) -> None:
        super().__init__()
        self._told = told

    def emit(self, record: logging.LogRecord) -> None:
        if "queue is full" in record.getMessage():
            self._told()
