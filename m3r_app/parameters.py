"""A vehicle's parameters: read and written as the type that the vehicle says they have.

MAVSDK needs the type beforehand and reports a missing parameter as a time-out of three seconds, one after the other. So
all names are asked for at once first (PARAM_REQUEST_READ); which ones answer, and as what, is known within a second.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Sequence
from concurrent.futures import Executor
from typing import Any

from mavsdk.plugins.mavlink_direct import MavlinkMessage

PROBE_ROUNDS = 4
PROBE_ROUND_S = 0.25
REAL32 = 9
"""MAV_PARAM_TYPE_REAL32; every other type that PX4 has is an integer."""


class ParameterClient:
    """Parameters of one vehicle through MAVSDK's plugins. Raises what MAVSDK raises, and ValueError by name."""

    def __init__(self, param: Any, direct: Any, system_id: int, executor: Executor) -> None:
        self._param = param
        self._direct = direct
        self._system_id = system_id
        self._executor = executor

    async def read(self, names: Sequence[str]) -> dict[str, float | int | None]:
        """Values by name, None for a parameter that the vehicle does not have."""
        is_float = await self._probe(names)
        loop = asyncio.get_running_loop()
        values: dict[str, float | int | None] = {}
        for name in names:
            if name not in is_float:
                values[name] = None
                continue
            get = self._param.get_param_float if is_float[name] else self._param.get_param_int
            values[name] = await loop.run_in_executor(self._executor, get, name)
        return values

    async def write(self, name: str, value: float) -> None:
        """Set one parameter. Raises ValueError if there is none of that name, or a fraction is set on an integer."""
        is_float = (await self._probe([name])).get(name)
        if is_float is None:
            raise ValueError(f"the vehicle has no parameter {name}")
        if not is_float and value != int(value):
            raise ValueError(f"{name} is an integer and cannot be {value:g}")
        loop = asyncio.get_running_loop()
        if is_float:
            await loop.run_in_executor(self._executor, self._param.set_param_float, name, float(value))
        else:
            await loop.run_in_executor(self._executor, self._param.set_param_int, name, int(value))

    async def _probe(self, names: Sequence[str]) -> dict[str, bool]:
        """Which of the names exist, and whether as a float."""
        loop = asyncio.get_running_loop()
        types: dict[str, bool] = {}
        all_known = asyncio.Event()

        def learn(name: str, is_float: bool) -> None:
            types[name] = is_float
            if all(wanted in types for wanted in names):
                all_known.set()

        def received(message: Any, _: Any) -> None:
            try:
                fields = json.loads(message.fields_json)
                name, is_float = str(fields["param_id"]).rstrip("\0"), int(fields["param_type"]) == REAL32
                loop.call_soon_threadsafe(learn, name, is_float)
            except (ValueError, KeyError, TypeError, RuntimeError):
                return  # unreadable, or the loop has closed: as good as no answer

        subscription = self._direct.subscribe_message("PARAM_VALUE", received)
        try:
            for _ in range(PROBE_ROUNDS):
                for name in names:
                    if name not in types:
                        self._request(name)
                try:
                    await asyncio.wait_for(all_known.wait(), PROBE_ROUND_S)
                    break
                except TimeoutError:
                    continue
        finally:
            # In a thread: it waits for a callback that may be waiting for the interpreter.
            await loop.run_in_executor(self._executor, self._direct.unsubscribe_message, subscription)
        return {name: types[name] for name in names if name in types}

    def _request(self, name: str) -> None:
        fields = {"target_system": self._system_id, "target_component": 1, "param_id": name, "param_index": -1}
        self._direct.send_message(MavlinkMessage("PARAM_REQUEST_READ", 0, 0, self._system_id, 1, json.dumps(fields)))
