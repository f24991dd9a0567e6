"""One app's part in the shared airspace: claims, volumes and neighbours over a broker.

A claim is ours until 4 s after we *sent* the last renewal that was granted; the authority keeps it for 5 s from when it came,
so ours ends first whatever the network does. Source: P1, X8, X10, R5, R11; paper III-A, V.
"""

from __future__ import annotations

import asyncio
import hashlib
import math
import secrets
import time
from collections.abc import Callable, Mapping
from contextlib import AsyncExitStack
from dataclasses import dataclass, replace

import numpy as np
from pydantic import ValidationError

from m3r_app.airspace.authority import CLAIM_S
from m3r_app.airspace.credentials import Broker, Credentials
from m3r_app.airspace.interface import Answered
from m3r_app.airspace.messages import Answer, AskBody, Capsule, Claim, Free, GiveUp, Held, Place, Reserve, State
from m3r_app.airspace.signed_channel import Received, SignedChannel
from m3r_app.airspace.state_publisher import Reported, StatePublisher
from m3r_app.airspace.topics import ROOT, AnswerTopic, AskTopic, HeldTopic, StateTopic
from m3r_app.airspace.traffic import RemoteTraffic
from safety.frames import LocalFrame
from safety.vocabulary import Geodetic, Neighbours, ReservedVolume

OURS_S = CLAIM_S - 1.0
RENEW_S = 0.7
ANSWER_S = 0.9
ATTACKS = ("forged", "wrong signer", "replayed", "retained", "unreadable")
AUTHORITY_AGE_S = 2.5
"""Not heard for so long: the authority is gone."""


@dataclass(frozen=True, slots=True)
class _Claimed:
    operator: Geodetic
    fence: int
    until_s: float
    refused: str | None = None


@dataclass(frozen=True, slots=True)
class _Pending:
    then: Callable[[Answer], None]
    late_at_s: float


class SharedAirspace:
    """`m3r_app.airspace.interface.Airspace` over a broker, and the neighbours that are heard of there. From one event loop only."""

    def __init__(
        self,
        broker: Broker,
        credentials: Credentials,
        frame: LocalFrame,
        say: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
        wall_clock: Callable[[], float] = time.time,
    ) -> None:
        """frame: the session's. say: one sentence for the operator. Raises AirError."""
        self._heard = asyncio.Event()
        self._credentials = credentials
        self._frame = frame
        self._say = say
        self._clock = clock
        self._remote = RemoteTraffic(say)
        self._channel = SignedChannel(broker, credentials, self._take, say, clock, wall_clock, self._doubt)
        self.publisher = StatePublisher(self._channel, clock)
        self._channel.link.speaks = lambda: self.publisher.tells
        self._inbox = AnswerTopic(credentials.name, secrets.token_hex(8))
        self._lease_key = secrets.token_bytes(16)
        self._pending: dict[str, _Pending] = {}
        self._claims: dict[str, _Claimed] = {}
        self._held: Held | None = None
        self._held_at_s = -math.inf
        self._epochs: dict[str, float] = {}
        self._fence = 0
        self._claim_fences: dict[str, int] = {}
        """Of each drone's last claim; a claim that is renewed before it expires keeps its number."""
        self._back_at_s: dict[str, float] = {}
        self._wanted: frozenset[tuple[str, str]] = frozenset()
        self._authority_heard = True
        self._opened_at_s = clock()
        self._linked: Mapping[str, Callable[[], Reported]] = {}
        self._life = AsyncExitStack()
        self._told_dropped: set[str] = set()

    # ------------------------------------------------------------ its life

    async def open(self) -> None:
        """Connect. Raises AirError with one sentence if that cannot be."""
        self._listen()
        await self._life.enter_async_context(self._channel.link.kept())
        self._opened_at_s = self._clock()
        keeping = asyncio.create_task(self._keep())
        self._life.push_async_callback(asyncio.wait, {keeping})
        self._life.callback(keeping.cancel)

    async def close(self) -> None:
        """Let go what is claimed, and disconnect."""
        for drone in list(self._claims):
            self.give_up(drone)
        if self.dropped:
            counts = ", ".join(f"{reason} {count}" for reason, count in sorted(self.dropped.items()))
            self._say(f"messages dropped in the shared air: {counts}")
        if self._channel.link.up:
            await asyncio.sleep(0.05)  # the last words leave
        await self._life.aclose()

    def watch(self, linked: Mapping[str, Callable[[], Reported]]) -> None:
        """The drones that this app has links to: what others say of them is ignored."""
        self._linked = linked

    @property
    def trouble(self) -> str | None:
        """What is missing, in two words; None: nothing."""
        if not self._channel.link.up:
            return "no broker"
        return "no authority" if self._authority_silent(self._clock()) is not None else None

    @property
    def dropped(self) -> Mapping[str, int]:
        """Messages that were dropped, by reason."""
        return self._channel.dropped

    def _tell_dropped(self) -> None:
        """Announce each kind of attack once; all of them are counted."""
        for reason in ATTACKS:
            if self._channel.dropped[reason] and reason not in self._told_dropped:
                self._told_dropped.add(reason)
                self._say(f"a message in the shared air was dropped ({reason}): somebody may be trying to get in")

    async def _keep(self) -> None:
        """Renew claims, look after the authority, follow the cells."""
        while True:
            await asyncio.sleep(RENEW_S)
            now_s = self._clock()
            self._pending = {k: p for k, p in self._pending.items() if p.late_at_s > now_s}
            self._listen()
            self._tell_dropped()
            for drone, claimed in self._claims.items():
                if claimed.refused is None:
                    self._renew(drone, claimed)
            silent = self._authority_silent(now_s) if self._channel.link.up else None
            if (silent is None) != self._authority_heard and now_s - self._opened_at_s > AUTHORITY_AGE_S:
                self._authority_heard = silent is None
                self._say(silent or f"the airspace authority of {self._credentials.area} is heard again")

    def _listen(self) -> None:
        states = (f"{ROOT}/state/{cell}/+" for cell in self.publisher.near)
        self._channel.listen((str(self._inbox), str(HeldTopic(self._credentials.area)), *states))

    # ------------------------------------------------------------ claims

    async def claim(self, drone: str, operator: Geodetic) -> str | None:
        """None if the drone is ours now, or one sentence that says why not."""
        if drone not in self._credentials.flies:
            return f"the credentials of {self._credentials.user} do not allow it: give ones made for {drone}"
        silent = await self._authority_or_silence()
        if silent is not None:
            return silent
        place = Place.of(operator)
        sent_s = self._clock()
        answered: asyncio.Future[Answer] = asyncio.get_running_loop().create_future()
        self._ask(drone, Claim(kind="claim", operator=place, fence=None), lambda a: _settle(answered, a))
        try:
            answer = await asyncio.wait_for(answered, ANSWER_S)
        except TimeoutError:
            return f"the airspace authority of {self._credentials.area} did not answer: ask again"
        if not answer.granted:
            return answer.reason
        if answer.fence < self._fence and answer.fence != self._claim_fences.get(drone):
            return "the airspace authority has forgotten what it granted before: ask who runs it"
        self._fence = max(self._fence, answer.fence)
        self._claim_fences[drone] = answer.fence
        self._claims[drone] = _Claimed(operator, answer.fence, sent_s + OURS_S)
        return None

    async def _authority_or_silence(self) -> str | None:
        """Right after connecting the authority has yet to be heard."""
        while (silent := self._authority_silent(self._clock())) is not None:
            if self._clock() - self._opened_at_s > AUTHORITY_AGE_S:
                return silent
            await asyncio.sleep(0.05)
        return None

    def _renew(self, drone: str, claimed: _Claimed) -> None:
        sent_s = self._clock()

        def then(answer: Answer) -> None:
            current = self._claims.get(drone)
            if current is None or current.fence != claimed.fence:
                return
            if answer.granted:
                self._claims[drone] = replace(current, until_s=max(current.until_s, sent_s + OURS_S))
            else:
                self._claims[drone] = replace(current, refused=answer.reason)

        self._ask(drone, Claim(kind="claim", operator=Place.of(claimed.operator), fence=claimed.fence), then)

    def give_up(self, drone: str) -> None:
        """Let it go; whoever waits for it may have it."""
        claimed = self._claims.pop(drone, None)
        if claimed is not None:
            self._ask(drone, GiveUp(kind="give_up", fence=claimed.fence), lambda _: None)

    def lost(self, drone: str) -> str | None:
        """Why a drone that was claimed is ours no longer; None while it is."""
        claimed = self._claims.get(drone)
        if claimed is None:
            return "it is not claimed any more"
        if claimed.refused is not None:
            return f"its claim is lost, {claimed.refused}"
        if self._clock() >= claimed.until_s:
            return f"its claim could not be renewed for {OURS_S:.0f} s"
        return None

    # ------------------------------------------------------------ volumes

    def reserve(self, drone: str, lease: str, volume: ReservedVolume, answered: Answered) -> None:
        """Ask for a volume; the answer may never come."""
        claimed, now_s = self._claims.get(drone), self._clock()
        trouble = self.lost(drone) or self._authority_silent(now_s)
        if trouble is not None or claimed is None:
            answered("denied", trouble or "")
            return
        try:
            capsule = Capsule.of(volume, self._frame, now_s)
        except ValidationError:
            answered("denied", "the volume asked for is incomplete or too large")
            return

        def then(answer: Answer) -> None:
            if answer.granted and answer.fence <= self._fence:
                answered("denied", "the airspace authority has forgotten what it granted before")
                return
            if answer.granted:
                self._fence = answer.fence
            answered("granted" if answer.granted else "denied", answer.reason)

        ask = Reserve(kind="reserve", fence=claimed.fence, lease=self._lease(lease), volume=capsule)
        self._ask(drone, ask, then)

    def free(self, drone: str, lease: str) -> None:
        claimed = self._claims.get(drone)
        if claimed is not None:
            self._ask(drone, Free(kind="free", fence=claimed.fence, lease=self._lease(lease)), lambda _: None)

    def _lease(self, lease: str) -> str:
        """Unlike those of any other app; everybody is told of it, and it says nothing of whose it is."""
        return hashlib.blake2b(lease.encode(), key=self._lease_key, digest_size=16).hexdigest()

    def held_by_others(self, drone: str) -> tuple[ReservedVolume, ...]:
        """The live volumes of all other drones, as last told."""
        if self._held is None:
            return ()
        told = (
            v.volume.reserved(v.drone, self._frame, self._held_at_s) for v in self._held.volumes if v.drone != drone
        )
        return tuple(v for v in told if v.until_s > self._clock())

    # ------------------------------------------------------------ neighbours

    def neighbours(self, own: str, linked: Neighbours, now_s: float) -> Neighbours:
        """Everybody: those linked and those heard of. Source: R5, R11.

        What is heard is as fresh as what last came back of our own drone's state; where others are linked too, the older counts.
        """
        feed_at_s = self._back_at_s.get(own, -math.inf)
        reports = {drone: telemetry() for drone, telemetry in self._linked.items()}
        seen = {drone: (report.geodetic, now_s - report.at_s) for drone, report in reports.items()}
        heard = self._remote.neighbours(self._frame, self.publisher.near, seen, feed_at_s, now_s)
        nobody_linked = self._linked.keys() <= {own} and linked.feed_at_s == -math.inf
        return Neighbours(
            linked.names + heard.names,
            np.concatenate((linked.positions_ned_m, heard.positions_ned_m)),
            np.concatenate((linked.velocities_ned_m_s, heard.velocities_ned_m_s)),
            np.concatenate((linked.sigmas_m, heard.sigmas_m)),
            np.concatenate((linked.at_s, heard.at_s)),
            heard.feed_at_s if nobody_linked else min(linked.feed_at_s, heard.feed_at_s),
        )

    async def news(self) -> None:
        """Wait until something was heard of a neighbour."""
        await self._heard.wait()
        self._heard.clear()

    # ------------------------------------------------------------ what arrives

    def _take(self, received: Received) -> None:
        match received.topic, received.body:
            case StateTopic() as topic, State() as state if received.own:
                self._back_at_s[topic.drone] = received.at_s + min(0.0, received.envelope.early_s) - state.age_s
            case StateTopic() as topic, State() as state:
                envelope = received.envelope
                self._remote.heard(topic.drone, envelope.life, state, envelope.early_s, received.at_s)
                self._heard.set()
            case AnswerTopic() as topic, Answer() as answer if topic == self._inbox:
                self._answered(answer, received.correlation)
            case HeldTopic() as topic, Held() as held if topic.area == self._credentials.area:
                self._hold(held, received.at_s)
            case _:
                pass

    def _doubt(self, drone: str, why: str) -> None:
        if drone not in self._linked:
            self._remote.doubt(drone, why, self._clock())

    def _answered(self, answer: Answer, correlation: bytes | None) -> None:
        if correlation != bytes.fromhex(answer.id):
            return
        pending = self._pending.pop(answer.id, None)
        if pending is not None and self._clock() <= pending.late_at_s:
            pending.then(answer)

    def _hold(self, held: Held, now_s: float) -> None:
        self._held, self._held_at_s = held, now_s
        self._epochs = {e: t for e, t in self._epochs.items() if now_s - t <= AUTHORITY_AGE_S} | {held.epoch: now_s}
        me = self._credentials.name
        wanted = frozenset(
            (c.drone, c.wanted_by)
            for c in held.claims
            if c.operator == me and c.wanted_by is not None and c.drone in self._claims
        )
        for drone, who in sorted(wanted - self._wanted):
            self._say(f"{drone.capitalize()}: {who} asks for it; disconnect to hand it over")
        self._wanted = wanted

    def _authority_silent(self, now_s: float) -> str | None:
        area = self._credentials.area
        if not self._channel.link.up:
            return f"{self._channel.link.broker} is not reached"
        if not now_s - self._held_at_s <= AUTHORITY_AGE_S:
            return f"the airspace authority of {area} is not heard: start m3r airspace, or wait for the network"
        if sum(now_s - at_s <= AUTHORITY_AGE_S for at_s in self._epochs.values()) > 1:
            return f"there are two airspace authorities of {area}, or one has just started anew"
        return None

    # ------------------------------------------------------------ asking

    def _ask(self, drone: str, ask: Claim | GiveUp | Reserve | Free, then: Callable[[Answer], None]) -> None:
        topic = AskTopic(self._credentials.area, drone, self._credentials.name)
        number = secrets.token_hex(8)
        self._pending[number] = _Pending(then, self._clock() + ANSWER_S)
        body = AskBody(id=number, inbox=self._inbox.inbox, ask=ask)
        self._channel.send(
            topic,
            body,
            self._credentials.user,
            qos=1,
            answer_topic=str(self._inbox),
            correlation=bytes.fromhex(number),
        )


def _settle(future: asyncio.Future[Answer], answer: Answer) -> None:
    if not future.done():
        future.set_result(answer)
