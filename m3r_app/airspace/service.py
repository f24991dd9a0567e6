"""`m3r airspace`: the one authority of an area, over the broker. `authority` decides; this module receives what is
asked and sends the answers.

It also receives its own broadcasts: while they do not come back from the broker no claim expires, because nobody could
have renewed it. If it receives another authority of its area it ends, because both would grant. During its first second
it only renews claims that it has on file. Source: X10, P1.
"""

from __future__ import annotations

import asyncio
import math
import secrets
import time
from collections.abc import Callable
from dataclasses import replace

from m3r_app.airspace import authority
from m3r_app.airspace.authority import CLAIM_S, App, Authority, Verdict
from m3r_app.airspace.credentials import AirError, Broker, Credentials
from m3r_app.airspace.messages import (
    LEASE_MAX_S,
    Answer,
    AskBody,
    Capsule,
    Claim,
    Free,
    GiveUp,
    Held,
    HeldClaim,
    HeldVolume,
    Reserve,
    within,
)
from m3r_app.airspace.signed_channel import Received, SignedChannel
from m3r_app.airspace.store import Store
from m3r_app.airspace.topics import ROOT, AnswerTopic, AskTopic, HeldTopic
from safety.frames import LocalFrame
from safety.vocabulary import Geodetic, ReservedVolume

HEARTBEAT_S = 0.5
LISTEN_S = 1.0
"""For this long after the start it only listens and renews: another authority would have been heard by then."""
AWAY_S = 1.2
EARTH = LocalFrame(Geodetic(0.0, 0.0, 0.0))
"""Any local frame will do: it differs from ECEF by a rotation and a shift, which keep distances."""


def told(a: Authority, epoch: str, now_s: float) -> Held:
    """All that is held, as everybody is told. What was prolonged lasts longer than can be said at once: it is told again."""
    return Held(
        epoch=epoch,
        claims=[
            HeldClaim(
                drone=drone,
                operator=claim.operator,
                fence=claim.fence,
                lasts_s=min(max(0.0, claim.until_s - now_s), CLAIM_S),
                wanted_by=a.waiting[drone].operator if drone in a.waiting else None,
            )
            for drone, claim in a.claims.items()
        ],
        volumes=[
            HeldVolume(
                drone=v.drone, lease=lease, fence=v.fence, volume=Capsule.of(_sayable(v.volume, now_s), EARTH, now_s)
            )
            for lease, v in a.volumes.items()
        ],
    )


def _sayable(volume: ReservedVolume, now_s: float) -> ReservedVolume:
    return replace(volume, until_s=min(volume.until_s, now_s + LEASE_MAX_S))


class AirspaceService:
    """One area's authority, from `run` until that is cancelled or fails."""

    def __init__(
        self,
        broker: Broker,
        credentials: Credentials,
        store: Store,
        say: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
        wall_clock: Callable[[], float] = time.time,
    ) -> None:
        self._area = credentials.area
        self._user = credentials.user
        self._store = store
        self._say = say
        self._clock = clock
        self._epoch = secrets.token_hex(8)
        self._channel = SignedChannel(broker, credentials, self._take, say, clock, wall_clock)
        self._channel.link.speaks = lambda: not self._listening
        self._authority = Authority()
        self._began_at_s = math.inf
        """When it was first connected."""
        self._heard_at_s = clock()
        self._failed: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    async def run(self, ready: Callable[[], None] = lambda: None) -> None:
        """Serve. ready: called once it grants. Raises AirError when it cannot, or must not, go on."""
        self._store.load(EARTH, self._clock())  # what is wrong with it is told before anything else
        self._channel.listen((f"{ROOT}/ask/{self._area}/+/+", str(HeldTopic(self._area))))
        beat = asyncio.create_task(self._heartbeat(ready))
        try:
            async with self._channel.link.kept() as life:
                self._began_at_s = self._heard_at_s = self._clock()
                self._authority = self._store.load(EARTH, self._began_at_s)
                await asyncio.wait({beat, life, self._failed}, return_when=asyncio.FIRST_COMPLETED)
                for one in (self._failed, beat, life):
                    if one.done():
                        one.result()
        finally:
            beat.cancel()
            await asyncio.gather(beat, return_exceptions=True)
            self._store.close()

    @property
    def _listening(self) -> bool:
        return not self._clock() - self._began_at_s >= LISTEN_S

    async def _heartbeat(self, ready: Callable[[], None]) -> None:
        said = False
        while True:
            if self._channel.link.up and not self._listening:
                self._tell()
            if not said and self._channel.link.up and not self._listening:
                said = True
                ready()
            await asyncio.sleep(0.1 if self._listening else HEARTBEAT_S)

    def _tell(self) -> None:
        """All that is held, to everybody."""
        now_s = self._clock()
        if now_s - self._heard_at_s <= AWAY_S:  # nothing runs out while nobody can be heard
            self._authority = authority.current(self._authority, now_s)
        held = told(self._authority, self._epoch, now_s)
        self._channel.send(HeldTopic(self._area), held, self._user)

    def _take(self, received: Received) -> None:
        match received.topic, received.body:
            case HeldTopic(), Held() if received.own:
                now_s = self._clock()
                away_s = now_s - self._heard_at_s
                if away_s > AWAY_S:
                    self._authority = authority.resumed(self._authority, away_s)
                self._heard_at_s = now_s
            case HeldTopic(), Held() as held if held.epoch != self._epoch:
                self._fail(f"another airspace authority of {self._area} is at work: there may be only one")
            case AskTopic() as topic, AskBody() as body:
                inbox = AnswerTopic(topic.operator, body.inbox)
                if received.answer_topic != str(inbox) or received.correlation != bytes.fromhex(body.id):
                    return
                if self._clock() - self._heard_at_s > AWAY_S:
                    return  # first hear ourselves again
                try:
                    self._answer(topic, body, inbox)
                except Exception as error:  # noqa: BLE001  (one asker must not end it for all; unanswered is refused)
                    self._say(
                        f"what {topic.operator} asked for {topic.drone} was left unanswered ({type(error).__name__})"
                    )
            case _:
                pass

    def _answer(self, topic: AskTopic, body: AskBody, inbox: AnswerTopic) -> None:
        before = self._authority
        after, verdict = self._decide(before, topic, body)
        try:
            self._store.save(after, EARTH)
        except AirError as error:
            self._fail(str(error))
            return
        self._authority = after
        answer = Answer(
            id=body.id,
            granted=verdict.granted,
            fence=verdict.fence,
            lasts_s=within(verdict.lasts_s, 0.0, LEASE_MAX_S),
            reason=verdict.reason,
        )
        self._channel.send(inbox, answer, self._user, qos=1, correlation=bytes.fromhex(body.id))
        if not self._listening and (before.volumes != after.volumes or before.claims.keys() != after.claims.keys()):
            self._tell()
        if verdict.granted and isinstance(body.ask, Claim) and body.ask.fence is None:
            self._say(f"{topic.operator} has {topic.drone} (no. {verdict.fence})")

    def _decide(self, a: Authority, topic: AskTopic, body: AskBody) -> tuple[Authority, Verdict]:
        now_s, app = self._clock(), App(topic.operator, body.inbox)
        match body.ask:
            case Claim(fence=None) | Reserve() if self._listening:
                return a, authority.no("the airspace authority has just started: ask again in a moment")
            case Claim(fence=fence):
                return authority.claim(a, topic.drone, app, fence, now_s)
            case GiveUp():
                return authority.give_up(a, topic.drone, app, now_s)
            case Reserve() as ask:
                volume = ask.volume.reserved(topic.drone, EARTH, now_s)
                return authority.reserve(a, topic.drone, app, ask.fence, ask.lease, volume, now_s)
            case Free() as ask:
                return authority.free(a, topic.drone, app, ask.lease, now_s)

    def _fail(self, why: str) -> None:
        if not self._failed.done():
            self._failed.set_exception(AirError(why))
