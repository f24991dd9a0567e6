"""The radio link of a simulated drone: datagrams that are lost, late, or cut off, both ways, in the drone's own time."""

from __future__ import annotations

import heapq
import math
import socket
from random import Random

Address = tuple[str, int]


class Channel:
    """A UDP socket with the faults of a radio link. loss: the fraction of datagrams that never arrive, each way."""

    def __init__(self, bound_to: str, rng: Random, loss: float = 0.0, delay_s: float = 0.0) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind((bound_to, 0))
        self.socket.setblocking(False)
        self.loss, self.delay_s, self._rng = loss, delay_s, rng
        self._cut_until_s = -math.inf
        self._count = 0
        self._out: list[tuple[float, int, bytes, Address]] = []
        self._in: list[tuple[float, int, bytes, Address]] = []

    def close(self) -> None:
        self.socket.close()

    def cut(self, until_s: float) -> None:
        """Nothing passes until then, and what is under way is lost."""
        self._cut_until_s = until_s
        self._out.clear()
        self._in.clear()

    def _lost(self, now_s: float) -> bool:
        return now_s < self._cut_until_s or (self.loss > 0.0 and self._rng.random() < self.loss)

    def send(self, now_s: float, data: bytes, address: Address) -> None:
        if self._lost(now_s):
            return
        self._count += 1
        heapq.heappush(self._out, (now_s + self.delay_s, self._count, data, address))
        self.flush(now_s)

    def flush(self, now_s: float) -> None:
        """Send what is due."""
        while self._out and self._out[0][0] <= now_s:
            _, _, data, address = heapq.heappop(self._out)
            try:
                self.socket.sendto(data, address)
            except OSError:
                # Nobody listens there yet, or any more: a drone goes on flying.
                continue

    def arrived(self, now_s: float) -> list[tuple[bytes, Address]]:
        """What has arrived by now, in order."""
        while True:
            try:
                data, address = self.socket.recvfrom(65535)
            except BlockingIOError:
                break
            except OSError:
                # Linux reports here that an earlier datagram found nobody listening.
                continue
            if not self._lost(now_s):
                self._count += 1
                heapq.heappush(self._in, (now_s + self.delay_s, self._count, data, address))
        found = []
        while self._in and self._in[0][0] <= now_s:
            _, _, data, address = heapq.heappop(self._in)
            found.append((data, address))
        return found
