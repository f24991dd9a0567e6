"""A camera in the network, on loopback: Motion JPEG over HTTP, unplugged and frozen as a test wants it."""

from __future__ import annotations

import http.server
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import cv2
import numpy as np

from modalities.hands.camera import CameraAddress, camera_address


class Site(http.server.BaseHTTPRequestHandler):
    """Pictures until told to hang up, each new unless frozen."""

    draw: Callable[[int], np.ndarray]
    frozen = False
    down = False
    sent = 0
    served = 0
    pause_s = 0.02

    def do_GET(self) -> None:
        site = type(self)
        if site.down:
            self.send_error(503)
            return
        self.send_response(200)
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
        self.end_headers()
        tick = threading.Event()
        try:
            while not site.down:
                site.sent += not site.frozen
                _, data = cv2.imencode(".jpg", site.draw(site.sent))
                self.wfile.write(b"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n" % len(data))
                self.wfile.write(data.tobytes() + b"\r\n")
                site.served += 1
                tick.wait(site.pause_s)
        except (ConnectionError, TimeoutError):
            pass
        self.close_connection = True

    def log_message(self, *_: object) -> None:
        pass


@contextmanager
def serving(draw: Callable[[int], np.ndarray], pause_s: float = 0.02) -> Iterator[tuple[type[Site], CameraAddress]]:
    """A site that shows draw(1), draw(2), ... pause_s apart, and its address."""
    handler = type("OneSite", (Site,), {"draw": staticmethod(draw), "pause_s": pause_s})
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    server.daemon_threads = True
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    address = camera_address(f"http://127.0.0.1:{server.server_address[1]}/hands.mjpg")
    assert address is not None
    try:
        yield handler, address
    finally:
        handler.down = True
        server.shutdown()
        server.server_close()
        thread.join()
