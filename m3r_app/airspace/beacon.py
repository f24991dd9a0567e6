"""`m3r beacon`: tells the airspace where drones are that nobody is paired with. Source: R5, R11."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping

from m3r_app.airspace.credentials import AirError, Broker, Credentials
from m3r_app.airspace.messages import State
from m3r_app.airspace.signed_channel import Received, SignedChannel
from m3r_app.airspace.state_publisher import StatePublisher
from m3r_app.airspace.topics import ROOT, StateTopic

QUIET_S = 2.0


class Beacon:
    """Tells of drones whose telemetry it is given, and says when that does not get through."""

    def __init__(
        self,
        broker: Broker,
        credentials: Credentials,
        say: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
        wall_clock: Callable[[], float] = time.time,
    ) -> None:
        self._flies = credentials.flies
        self._user = credentials.user
        self._clock = clock
        self._say = say
        self._back_at_s: dict[str, float] = {}
        self._channel = SignedChannel(broker, credentials, self._take, say, clock, wall_clock)
        self.publisher = StatePublisher(self._channel, clock)
        self._channel.link.speaks = lambda: self.publisher.tells

    def check(self, drones: Mapping[str, object]) -> None:
        """Raises AirError for a drone that these credentials may not tell of."""
        for drone in drones:
            if drone not in self._flies or not self._channel.may_sign(f"drone.{drone}"):
                raise AirError(f"the credentials of {self._user} may not tell of {drone}: use ones made for it")

    async def run(self, ready: Callable[[], None] = lambda: None) -> None:
        """Tell until cancelled. ready: called when the first state of every drone has come back. Raises AirError."""
        async with self._channel.link.kept() as life:
            said: set[str] = set()
            started = False
            while not life.done():
                self._channel.listen(f"{ROOT}/state/{cell}/+" for cell in self.publisher.near)
                await asyncio.sleep(0.1)
                now_s = self._clock()
                for drone in self._flies:
                    told = self._back_at_s.get(drone)
                    if told is not None and now_s - told > QUIET_S and drone not in said:
                        said.add(drone)
                        self._say(f"{drone.capitalize()} is not seen in the air any more: its link or the broker fails")
                    elif told is not None and now_s - told <= QUIET_S and drone in said:
                        said.discard(drone)
                        self._say(f"{drone.capitalize()} is seen in the air again")
                if not started and self._back_at_s:
                    started = True
                    ready()
            life.result()

    def _take(self, received: Received) -> None:
        match received.topic, received.body:
            case StateTopic() as topic, State() if received.own:
                self._back_at_s[topic.drone] = received.at_s
            case _:
                pass
