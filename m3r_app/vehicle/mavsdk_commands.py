"""Commands over MAVSDK: each with MAVSDK's own callback, a deadline, and the autopilot's reason where it refuses.

Its calls are not used through `mavsdk.asyncio`, which puts every command behind one thread pool.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from typing import Any

from mavsdk.plugins.mavlink_direct import MavlinkMessage

from m3r_app.vehicle.interface import VehicleError
from m3r_app.vehicle.mavsdk_telemetry import AUTOPILOT_COMPONENT

COMMAND_TIMEOUT_S = 4.0
"""MAVSDK itself sends a command three times, half a second apart or more, before it gives up."""
REASON_WAIT_S = 0.3
"""A refusal's reason comes as status text, shortly before or after the refusal."""
DO_SET_MODE = 176
CUSTOM_MODE_ENABLED = 1
"""MAV_MODE_FLAG_CUSTOM_MODE_ENABLED"""

MAV_RESULT = {
    0: "SUCCESS",
    1: "TEMPORARILY_REJECTED",
    2: "COMMAND_DENIED",
    3: "UNSUPPORTED",
    4: "FAILED",
    5: "IN_PROGRESS",
    6: "CANCELLED",
}


def verdict(result: Any, *more: Any) -> str:
    """What became of a command, by name: of MAVSDK's own plugins the result, of a message sent as it is its COMMAND_ACK's."""
    acknowledged = next((m for m in more if isinstance(m, MavlinkMessage)), None)
    if acknowledged is None or result.name != "SUCCESS":
        return str(result.name)
    try:
        return MAV_RESULT.get(int(json.loads(acknowledged.fields_json)["result"]), "UNKNOWN")
    except (ValueError, KeyError, TypeError):
        return "UNKNOWN"


def post(loop: asyncio.AbstractEventLoop, call: Callable[..., None], *arguments: Any) -> None:
    """call_soon_threadsafe that a loop already closed may ignore: nobody listens any more."""
    try:
        loop.call_soon_threadsafe(call, *arguments)
    except RuntimeError:
        if not loop.is_closed():
            raise


def settle(future: asyncio.Future[Any], result: Any) -> None:
    if not future.done():
        future.set_result(result)


def set_mode(system_id: int, main: int, sub: int) -> MavlinkMessage:
    """DO_SET_MODE to a PX4 itself: MAVSDK may take another component for it."""
    values = dict.fromkeys((f"param{i}" for i in range(1, 8)), 0.0)
    values |= {"param1": float(CUSTOM_MODE_ENABLED), "param2": float(main), "param3": float(sub)}
    target = {"target_system": system_id, "target_component": AUTOPILOT_COMPONENT}
    fields = {**target, "command": DO_SET_MODE, "confirmation": 0, **values}
    return MavlinkMessage("COMMAND_LONG", 0, 0, system_id, AUTOPILOT_COMPONENT, json.dumps(fields))


async def command(
    colour: str, what: str, send: Callable[[Callable[..., None]], None], reason: Callable[[], str]
) -> None:
    """Send a command with MAVSDK's own callback (its result, then a COMMAND_ACK if it has one) and wait for its result.

    reason: what the autopilot has said in words since. Raises VehicleError.
    """
    loop = asyncio.get_running_loop()
    answered: asyncio.Future[Any] = loop.create_future()
    try:
        send(lambda result, *more: post(loop, settle, answered, verdict(result, *more)))
    except RuntimeError as error:
        raise VehicleError(f"{colour}: {what} could not be sent ({error}).") from None
    try:
        result = await asyncio.wait_for(answered, COMMAND_TIMEOUT_S)
    except TimeoutError:
        raise VehicleError(f"{colour}: no answer to {what} within {COMMAND_TIMEOUT_S:g} s.") from None
    if result == "SUCCESS":
        return
    if result == "TIMEOUT":
        raise VehicleError(f"{colour}: no answer to {what}: the link or the autopilot is silent.")
    await asyncio.sleep(REASON_WAIT_S)
    raise VehicleError(f"{colour}: {what} was refused ({result}){reason()}.")
