"""Whether the shared air can be reached: the broker, these credentials there, and the authority of the area."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING

from ui.check.findings import Finding, State, Wanted, parts_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from m3r_app.airspace.credentials import Broker, Credentials

AUTHORITY_S = 3.0


def air(wanted: Wanted) -> Iterator[Finding]:
    """Connect as an operator would, and listen for the authority."""
    if wanted.broker is None:
        return
    from m3r_app.airspace.credentials import AirError, load_credentials, parse_broker

    if wanted.credentials is None:
        yield Finding("broker", State.MISSING, "no credentials are given", "give --credentials FILE")
        return
    try:
        broker = parse_broker(wanted.broker)
        who = load_credentials(wanted.credentials, "operator")
        connected_ms, heard = asyncio.run(_visit(broker, who))
    except AirError as error:
        yield Finding("broker", State.MISSING, *parts_of(str(error)))
        return
    yield Finding("broker", State.WORKS, f"{broker} lets {who.user} in, connected in {connected_ms:.0f} ms")
    if heard:
        yield Finding("authority", State.WORKS, f"the airspace authority of {who.area} is heard")
    else:
        yield Finding(
            "authority",
            State.MISSING,
            f"the airspace authority of {who.area} is not heard",
            "start m3r airspace with its credentials",
        )


async def _visit(broker: Broker, who: Credentials) -> tuple[float, bool]:
    """How long connecting took (ms), and whether the authority was heard. Raises AirError."""
    from m3r_app.airspace.signed_channel import Received, SignedChannel
    from m3r_app.airspace.topics import HeldTopic

    heard = asyncio.Event()

    def take(received: Received) -> None:
        if isinstance(received.topic, HeldTopic):
            heard.set()

    exchange = SignedChannel(broker, who, take, lambda _: None)
    exchange.listen((str(HeldTopic(who.area)),))
    began_s = time.monotonic()
    exchange.link.speaks = lambda: False
    async with exchange.link.kept():
        connected_ms = 1000.0 * (time.monotonic() - began_s)
        try:
            await asyncio.wait_for(heard.wait(), AUTHORITY_S)
        except TimeoutError:
            return connected_ms, False
        return connected_ms, True
