"""One of two racing apps, a process of its own: at each `go WHEN N` it claims red and reserves the same air for its own drone.

Prints one JSON line per race: whether it got the claim, and whether it got the volume.
"""

from __future__ import annotations

import asyncio
import json
import sys
import time
from pathlib import Path

from m3r_app.airspace.credentials import load_credentials, parse_broker
from m3r_app.airspace.shared import SharedAirspace
from safety.frames import LocalFrame
from safety.vocabulary import Geodetic, Ned, ReservedVolume

HERE = Geodetic(46.679, 7.863, 580.0)


async def race(url: str, credentials: Path, own: str) -> None:
    shared = SharedAirspace(
        parse_broker(url), load_credentials(credentials, "operator"), LocalFrame(HERE), lambda _: None
    )
    shared.publisher.tell(own, HERE, Ned(0, 0, 0), 0.3, 0.0)
    await shared.open()
    telling = asyncio.create_task(tell(shared, own))
    assert await shared.claim(own, HERE) is None
    print(json.dumps({"ready": True}), flush=True)
    loop = asyncio.get_running_loop()
    while line := await loop.run_in_executor(None, sys.stdin.readline):
        _, when, number = line.split()
        await asyncio.sleep(max(0.0, float(when) - time.monotonic()))
        volume = ReservedVolume(own, Ned(0, 0, -9), Ned(1, 0, -9), 2.0, time.monotonic(), time.monotonic() + 5.0)
        answered: asyncio.Future[str] = loop.create_future()
        shared.reserve(own, f"race-{number}", volume, lambda answer, _, to=answered: to.set_result(answer))
        claimed = await shared.claim("red", HERE)
        granted = await asyncio.wait_for(answered, 2.0)
        print(json.dumps({"claim": claimed is None, "why": claimed, "volume": granted == "granted"}), flush=True)
        await loop.run_in_executor(None, sys.stdin.readline)  # both have told
        if claimed is None:
            shared.give_up("red")
        shared.free(own, f"race-{number}")
    telling.cancel()
    await shared.close()


async def tell(shared: SharedAirspace, own: str) -> None:
    while True:
        shared.publisher.tell(own, HERE, Ned(0, 0, 0), 0.3, 0.0)
        await asyncio.sleep(0.05)


if __name__ == "__main__":
    asyncio.run(race(sys.argv[1], Path(sys.argv[2]), sys.argv[3]))
