"""A vehicle's parameters: read and written as the type that the vehicle says they have, by the messages themselves.

MAVSDK's own plugin needs the type beforehand, reports a missing parameter as a time-out of three seconds, and takes the
encoding from whoever claims to be the autopilot. So all names are asked for at once (PARAM_REQUEST_READ), and what PX4
answers is read as PX4 writes it: integers travel bytewise in the float. On a link that loses messages silence proves
nothing: a parameter that every PX4 has is asked for beside them, and only where it answers again and again does one that
never answers not exist. MAVLink: PARAM_VALUE, PARAM_SET.
"""

from __future__ import annotations

import asyncio
import json
import math
import struct
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Any

from mavsdk import MavsdkError
from mavsdk.plugins.mavlink_direct import MavlinkMessage

if TYPE_CHECKING:
    from collections.abc import AsyncIterator

ROUNDS = 24
ROUND_S = 0.25
WITNESS = "SYS_AUTOSTART"
"""A parameter that every PX4 has."""
WITNESS_ANSWERS = 4
"""So often the witness answers while a parameter does not, before that one does not exist."""
REAL32 = 9
"""MAV_PARAM_TYPE_REAL32; every other type that PX4 has is an integer of 32 bits or less."""

Heard = tuple[int, float | int | None]
"""The type, and the value; None: it is carried by a float that is not a number, which the message's text cannot say."""


class ParameterClient:
    """Parameters of one vehicle. Raises what MAVSDK raises, and ValueError by name."""

    def __init__(
        self, param: Any, direct: Any, system_id: int, executor: Executor, bytewise: Callable[[], bool]
    ) -> None:
        """param, direct: MAVSDK's plugins. bytewise: whether integers travel as PX4 sends them."""
        self._param = param
        self._direct = direct
        self._system_id = system_id
        self._executor = executor
        self._bytewise = bytewise
        self._heard: dict[str, Heard] = {}
        self._witnessed = 0
        self._news = asyncio.Event()

    async def read(self, names: Sequence[str]) -> dict[str, float | int | None]:
        """Values by name: None for a parameter that the vehicle does not have, NaN for one that did not answer."""
        await self._ask(names)
        return {name: await self._value(name) for name in names}

    async def write(self, name: str, value: float) -> None:
        """Set one parameter. Raises ValueError if there is none of that name, or a fraction is set on an integer."""
        await self._ask([name])
        heard = self._heard.get(name)
        if heard is None:
            raise ValueError(f"the vehicle has no parameter {name}" if self._absent else f"{name} did not answer")
        kind = heard[0]
        if kind != REAL32 and value != int(value):
            raise ValueError(f"{name} is an integer and cannot be {value:g}")
        carried = value if kind == REAL32 or not self._bytewise() else _as_float(int(value))
        if not math.isfinite(carried):
            # The message's text cannot say it; MAVSDK's own plugin can.
            await self._in_thread(self._param.set_param_int, name, int(value))
            return
        target = {"target_system": self._system_id, "target_component": 1}
        fields = {**target, "param_id": name, "param_value": carried, "param_type": kind}
        async with self._listening():
            for _ in range(ROUNDS):
                self._send("PARAM_SET", fields)
                await self._answered(lambda: name in self._heard)
                if name in self._heard:
                    return
        raise ValueError(f"{name} did not answer to being set")

    @property
    def _absent(self) -> bool:
        return self._witnessed >= WITNESS_ANSWERS

    async def _value(self, name: str) -> float | int | None:
        heard = self._heard.get(name)
        if heard is None:
            return None if self._absent else math.nan
        kind, value = heard
        if value is not None:
            return value
        get = self._param.get_param_float if kind == REAL32 else self._param.get_param_int
        try:
            found: float | int = await self._in_thread(get, name)
        except MavsdkError:
            return math.nan
        return found

    async def _ask(self, names: Sequence[str]) -> None:
        """Ask for all of them until they have answered, or it is known that they do not exist."""
        async with self._listening():
            for _ in range(ROUNDS):
                for name in (WITNESS, *(n for n in names if n not in self._heard)):
                    fields = {"target_system": self._system_id, "target_component": 1}
                    self._send("PARAM_REQUEST_READ", {**fields, "param_id": name, "param_index": -1})
                await self._answered(lambda: all(name in self._heard for name in names))
                if self._absent or all(name in self._heard for name in names):
                    return

    async def _answered(self, enough: Callable[[], bool]) -> None:
        """Wait for ROUND_S, or until it is enough."""
        loop = asyncio.get_running_loop()
        until_s = loop.time() + ROUND_S
        while not enough() and loop.time() < until_s:
            self._news.clear()
            try:
                await asyncio.wait_for(self._news.wait(), max(0.0, until_s - loop.time()))
            except TimeoutError:
                return

    @asynccontextmanager
    async def _listening(self) -> AsyncIterator[None]:
        """Everything that is heard meanwhile, and nothing from before."""
        loop = asyncio.get_running_loop()
        self._heard, self._witnessed = {}, 0

        def learn(name: str, heard: Heard) -> None:
            self._heard[name] = heard
            self._witnessed += name == WITNESS
            self._news.set()

        def received(message: Any, _: Any) -> None:
            try:
                fields = json.loads(message.fields_json)
                name, kind = str(fields["param_id"]).rstrip("\0"), int(fields["param_type"])
                loop.call_soon_threadsafe(learn, name, (kind, self._decoded(kind, fields.get("param_value"))))
            except (ValueError, KeyError, TypeError, RuntimeError):
                return  # unreadable, or the loop has closed: as good as no answer

        subscription = self._direct.subscribe_message("PARAM_VALUE", received)
        try:
            yield
        finally:
            # In a thread: it waits for a callback that may be waiting for the interpreter.
            await self._in_thread(self._direct.unsubscribe_message, subscription)

    def _decoded(self, kind: int, carried: float | None) -> float | int | None:
        if carried is None or kind == REAL32:
            return carried
        return struct.unpack("<i", struct.pack("<f", carried))[0] if self._bytewise() else round(carried)

    def _send(self, kind: str, fields: dict[str, Any]) -> None:
        self._direct.send_message(MavlinkMessage(kind, 0, 0, self._system_id, 1, json.dumps(fields)))

    async def _in_thread(self, work: Callable[..., Any], *arguments: Any) -> Any:
        return await asyncio.get_running_loop().run_in_executor(self._executor, work, *arguments)


def _as_float(value: int) -> float:
    """The float that carries an integer bytewise."""
    return float(struct.unpack("<f", struct.pack("<i", value))[0])
