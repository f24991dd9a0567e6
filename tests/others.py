"""Others on a drone's link: a second ground station, and a wire between drone and app that can be cut, counted and made bad."""

from __future__ import annotations

import socket
import threading

from pymavlink.dialects.v20 import common as mavlink


class OtherStation:
    """A second ground station on a drone's link."""

    def __init__(self, port: int, system: int) -> None:
        """port: where the drone listens on loopback; system: its MAVLink system id."""
        self._port, self._system = port, system

    def command(self, number: int, *values: float) -> None:
        filled = (*values, *[0.0] * (7 - len(values)))
        message = mavlink.MAVLink_command_long_message(self._system, 1, number, 0, *filled)
        packed = message.pack(mavlink.MAVLink(None, srcSystem=255, srcComponent=190))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
            link.sendto(packed, ("127.0.0.1", self._port))

    def mode(self, main: int, sub: int) -> None:
        self.command(mavlink.MAV_CMD_DO_SET_MODE, 1.0, float(main), float(sub))


class Wire:
    """What passes between a drone and the app: datagrams are handed on, counted by kind, and lost while it is cut."""

    def __init__(self, listens: int, tells: int) -> None:
        self._drone = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._drone.bind(("127.0.0.1", listens))
        self._app = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._app.bind(("127.0.0.1", 0))
        self._tells = ("127.0.0.1", tells)
        self._from: tuple[str, int] | None = None
        self.cut = False
        self.setpoints = 0
        """SET_POSITION_TARGET_LOCAL_NED that the app has sent, lost ones too."""
        self._done = threading.Event()
        self._threads = [threading.Thread(target=t, daemon=True) for t in (self._down, self._up)]

    def __enter__(self) -> Wire:
        for one in (self._drone, self._app):
            one.settimeout(0.1)
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._done.set()
        for thread in self._threads:
            thread.join()
        self._drone.close()
        self._app.close()

    def _down(self) -> None:
        while not self._done.is_set():
            try:
                data, self._from = self._drone.recvfrom(65535)
            except OSError:
                continue
            if not self.cut:
                self._app.sendto(data, self._tells)

    def _up(self) -> None:
        parser = mavlink.MAVLink(None)
        parser.robust_parsing = True
        while not self._done.is_set():
            try:
                data = self._app.recv(65535)
            except OSError:
                continue
            found = parser.parse_buffer(data) or []
            self.setpoints += sum(m.get_type() == "SET_POSITION_TARGET_LOCAL_NED" for m in found)
            if not self.cut and self._from is not None:
                self._drone.sendto(data, self._from)
