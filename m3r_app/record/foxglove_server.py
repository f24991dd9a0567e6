"""The flight live in 3D: the record's own views over Foxglove's WebSocket protocol, on loopback, to be looked at only.

A thread of its own takes messages from a bounded queue, so that no viewer, however slow, is felt by the flight; the server
drops what a viewer does not take. It advertises no capability: nothing that a viewer sends is listened to.
Source: Foxglove's WebSocket protocol, foxglove-sdk.
"""

from __future__ import annotations

import json
import time
from typing import TYPE_CHECKING

import foxglove

from m3r_app.plain import plain
from m3r_app.ports import require_free
from m3r_app.queue_thread import QueueThread
from m3r_app.record.foxglove_scene import SCENE_TOPICS, Scene
from m3r_app.record.foxglove_schemas import SCHEMAS
from m3r_app.record.foxglove_views import views
from m3r_app.record.recorder import TYPED

if TYPE_CHECKING:
    from collections.abc import Mapping

HOST = "127.0.0.1"
QUEUE_LENGTH = 1000
AGAIN_S = 3.0
LASTING = ("stage", "anchor", "plan")
"""The latest message of each of these is sent again this often, for viewers that connect late."""
CLOSE_S = 5.0
PER_VIEWER = 256
"""Messages that a slow viewer may be behind, before the oldest is dropped."""


class Viewer:
    """Shows one run. `record` is the recorder's: thread-safe, never blocks."""

    def __init__(self, port: int) -> None:
        """Open the port on loopback. Raises LinkError where somebody else holds it."""
        import socket

        require_free(HOST, port, socket.SOCK_STREAM, "choose another with --view")
        foxglove.set_log_level("ERROR")
        self._context = foxglove.Context()
        self._server = foxglove.start_server(
            name="m3r", host=HOST, port=port, capabilities=[], context=self._context, message_backlog_size=PER_VIEWER
        )
        self.dropped = 0
        self._scene = Scene()
        self._channels: dict[str, foxglove.Channel] = {}
        self._lasting: dict[str, tuple[float, Mapping[str, object]]] = {}
        for name in SCENE_TOPICS:
            self._channel(f"scene/{name}", "foxglove.SceneUpdate")  # or its first message would find nobody subscribed
        self._messages: QueueThread[tuple[str, float, int, Mapping[str, object]]] = QueueThread(
            "m3r-viewer", self._run, QUEUE_LENGTH
        )
        self._messages.start()

    @property
    def address(self) -> str:
        """What to open in a viewer."""
        return f"ws://{HOST}:{self._server.port}"

    def record(self, topic: str, t_s: float, data: Mapping[str, object]) -> None:
        """Queue one message; when the queue is full, it is the one that is dropped. Steps of the arbiter are not shown."""
        if topic in TYPED:
            return
        if not self._messages.put((topic, t_s, time.time_ns(), data)):
            self.dropped += 1

    def close(self) -> None:
        """Disconnect all viewers."""
        if self._messages.close(CLOSE_S):  # else its thread is stuck, and dies with the process
            self._server.stop()

    def _run(self) -> None:
        shown_s = time.monotonic()
        for message in self._messages.or_after(lambda: AGAIN_S):
            if message is not None:
                topic, t_s, log_ns, data = message
                if topic in LASTING:
                    self._lasting[topic] = t_s, data
                self._show(topic, t_s, log_ns, data)
            if time.monotonic() - shown_s >= AGAIN_S:
                shown_s = time.monotonic()
                for topic, (t_s, data) in self._lasting.items():
                    self._show(topic, t_s, time.time_ns(), data)

    def _show(self, topic: str, t_s: float, log_ns: int, data: Mapping[str, object]) -> None:
        message = plain(dict(data), lossless=True) | {"t": t_s}
        for view in (*views(topic, message, log_ns), *self._scene.views(topic, message, log_ns)):
            self._channel(view.topic, view.schema).log(
                json.dumps(view.message, allow_nan=False).encode(), log_time=log_ns
            )

    def _channel(self, topic: str, schema_name: str) -> foxglove.Channel:
        channel = self._channels.get(topic)
        if channel is None:
            text = json.dumps(SCHEMAS[schema_name]).encode()
            schema = foxglove.Schema(name=schema_name, encoding="jsonschema", data=text)
            channel = foxglove.Channel(f"/view/{topic}", schema=schema, message_encoding="json", context=self._context)
            self._channels[topic] = channel
        return channel
