"""A bad UDP link between a simulated drone and the app: datagrams are lost, late or cut off, both ways. Loopback only.

Beside the faults that the simulated fleet makes by itself (`m3r_app.sim.channel`), this one knows nothing of either end.
"""

from __future__ import annotations

import heapq
import random
import select
import socket
import threading
import time

from m3r_app.ports import free_udp_block

HOST = "127.0.0.1"


class BadLink:
    """Between the port that a drone sends to and one of its own, at which the app listens. Use it in a `with`."""

    def __init__(self, drone_port: int, *, loss: float = 0.0, delay_s: float = 0.0, seed: int = 0) -> None:
        """loss: the fraction lost each way; delay_s: each way, a fifth more or less."""
        self.loss, self.delay_s = loss, delay_s
        self._rng = random.Random(seed)
        self._cut_until_s = 0.0
        self._drone_port = drone_port
        self._app = (HOST, free_udp_block(1))
        self._drone: tuple[str, int] | None = None
        self._queue: list[tuple[float, int, bool, bytes]] = []
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self.passed = self.lost = 0

    @property
    def url(self) -> str:
        """Where the app finds the drone."""
        return f"udpin://{HOST}:{self._app[1]}"

    def cut(self, seconds: float) -> None:
        """Nothing passes from now on for so long."""
        self._cut_until_s = time.monotonic() + seconds

    def __enter__(self) -> BadLink:
        self._to_drone = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._to_drone.bind((HOST, self._drone_port))
        self._to_app = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._to_app.bind((HOST, 0))
        for one in (self._to_drone, self._to_app):
            one.setblocking(False)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()
        self._to_drone.close()
        self._to_app.close()

    def _run(self) -> None:
        count = 0
        while not self._ended.is_set():
            wait_s = 0.05 if not self._queue else min(0.05, max(0.0, self._queue[0][0] - time.monotonic()))
            for one in select.select([self._to_drone, self._to_app], [], [], wait_s)[0]:
                for data in self._arrived(one):
                    count += 1
                    late_s = self.delay_s * self._rng.uniform(0.8, 1.2)
                    heapq.heappush(self._queue, (time.monotonic() + late_s, count, one is self._to_drone, data))
            while self._queue and self._queue[0][0] <= time.monotonic():
                _, _, down, data = heapq.heappop(self._queue)
                self._send(down, data)

    def _arrived(self, one: socket.socket) -> list[bytes]:
        """What has come and is not lost."""
        found = []
        while True:
            try:
                data, sender = one.recvfrom(65535)
            except BlockingIOError:
                return found
            except ConnectionError:
                continue  # an earlier datagram found nobody listening
            if one is self._to_drone:
                self._drone = sender
            if time.monotonic() < self._cut_until_s or self._rng.random() < self.loss:
                self.lost += 1
            else:
                found.append(data)

    def _send(self, down: bool, data: bytes) -> None:
        target = self._app if down else self._drone
        if target is None or time.monotonic() < self._cut_until_s:
            self.lost += 1
            return
        try:
            (self._to_app if down else self._to_drone).sendto(data, target)
            self.passed += 1
        except OSError:
            self.lost += 1  # nobody listens there
