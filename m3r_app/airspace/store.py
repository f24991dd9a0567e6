"""What an authority must not forget: the highest fencing number and what it has granted, in one file that one process owns.

Written and synced before a grant leaves, replaced whole. Renewals are not written: after a start everything that is in the
file holds for its full time again, so no clock is compared across the restart. Source: X10.
"""

from __future__ import annotations

import fcntl
import os
from pathlib import Path
from typing import IO

from pydantic import BaseModel, ConfigDict, ValidationError

from m3r_app.airspace.authority import CLAIM_S, WANTED_S, App, Authority, HeldBy, Volume, Waiting
from m3r_app.airspace.credentials import AirError
from m3r_app.airspace.messages import Capsule, Fence, Hex16, Lease, Name
from safety.frames import LocalFrame


class _Row(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class _Claim(_Row):
    drone: Name
    operator: Name
    inbox: Hex16
    fence: Fence


class _Waiting(_Row):
    drone: Name
    operator: Name


class _Volume(_Row):
    lease: Lease
    drone: Name
    operator: Name
    inbox: Hex16
    fence: Fence
    volume: Capsule


class _Stored(_Row):
    version: int = 2
    area: Name
    fence: Fence
    claims: list[_Claim]
    waiting: list[_Waiting]
    volumes: list[_Volume]


class Store:
    """The file of one area's authority. Only one process may have it open."""

    def __init__(self, path: Path, area: str) -> None:
        """Raises AirError if it cannot be used or another authority uses it."""
        self._path = path
        self._area = area
        self._last: bytes | None = None
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._lock: IO[str] = path.with_name(f"{path.name}.lock").open("w")
        except OSError as error:
            raise AirError(f"the authority's memory {path} cannot be written: {error.strerror}") from None
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            self._lock.close()
            raise AirError(f"another airspace authority uses {path}: end it first") from None

    def close(self) -> None:
        self._lock.close()

    def load(self, frame: LocalFrame, now_s: float) -> Authority:
        """What was granted when it was last written, all for its full time from now. Raises AirError."""
        try:
            text = self._path.read_bytes()
        except FileNotFoundError:
            return Authority()
        except OSError as error:
            raise AirError(f"the authority's memory {self._path} cannot be read: {error.strerror}") from None
        try:
            stored = _Stored.model_validate_json(text)
        except ValidationError:
            raise AirError(
                f"the authority's memory {self._path} is damaged: if no drone is flown in {self._area}, delete it"
            ) from None
        if stored.version != 2 or stored.area != self._area:
            raise AirError(f"{self._path} is the memory of another area or version ({stored.area}): name another file")
        return Authority(
            stored.fence,
            {c.drone: HeldBy(App(c.operator, c.inbox), c.fence, now_s + CLAIM_S) for c in stored.claims},
            {w.drone: Waiting(w.operator, now_s + WANTED_S) for w in stored.waiting},
            {
                v.lease: Volume(v.drone, App(v.operator, v.inbox), v.volume.reserved(v.drone, frame, now_s), v.fence)
                for v in stored.volumes
            },
        )

    def save(self, authority: Authority, frame: LocalFrame) -> None:
        """Keep it, unless nothing but times has changed. Raises AirError: then nothing may be granted."""
        stored = _Stored(
            area=self._area,
            fence=authority.fence,
            claims=[
                _Claim(drone=d, operator=c.operator, inbox=c.app.inbox, fence=c.fence)
                for d, c in authority.claims.items()
            ],
            waiting=[_Waiting(drone=d, operator=w.operator) for d, w in authority.waiting.items()],
            volumes=[
                _Volume(
                    lease=k,
                    drone=v.drone,
                    operator=v.app.operator,
                    inbox=v.app.inbox,
                    fence=v.fence,
                    volume=Capsule.of(v.volume, frame, v.volume.from_s),
                )
                for k, v in authority.volumes.items()
            ],
        )
        text = stored.model_dump_json(indent=1).encode()
        if text == self._last:
            return
        fresh = self._path.with_name(f"{self._path.name}.new")
        try:
            with fresh.open("wb") as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())
            fresh.replace(self._path)
            folder = os.open(self._path.parent, os.O_RDONLY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)
        except OSError as error:
            raise AirError(f"the authority's memory {self._path} cannot be written: {error.strerror}") from None
        self._last = text
