"""The search for a fleet: given up, it leaves no link open."""

from __future__ import annotations

import asyncio
import time

import pytest

from m3r_app.vehicle.fleet import Fleet
from m3r_app.vehicle.interface import Links
from m3r_app.vehicle.mavsdk_vehicle import MavsdkVehicle


async def test_a_search_that_is_given_up_closes_who_had_answered(monkeypatch: pytest.MonkeyPatch) -> None:
    closed: list[str] = []
    answered = asyncio.Event()

    class Answered(MavsdkVehicle):
        def __init__(self) -> None: ...

        async def close(self) -> None:
            closed.append("red")

    async def connect(name: str, *_: object) -> MavsdkVehicle:
        if name == "red":
            answered.set()
            return Answered()
        await asyncio.Event().wait()
        raise AssertionError

    monkeypatch.setattr(MavsdkVehicle, "connect", connect)
    links = Links({"red": "udpin://127.0.0.1:1", "blue": "udpin://127.0.0.1:2"}, {}, complete=False)
    searching = asyncio.create_task(Fleet.connect(links, time.monotonic, 5.0))
    await answered.wait()
    await asyncio.sleep(0)
    searching.cancel()
    with pytest.raises(asyncio.CancelledError):
        await searching
    assert closed == ["red"]
