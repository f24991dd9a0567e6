"""The flight record: everything that went in, was decided, was sent and was measured, as one MCAP file.

`Recorder.record` only puts a reference into a bounded queue; a thread of its own makes JSON of it and writes. Chunks are
small and written out as they fill, so that the record of a killed app is readable up to its last second or two. A disk that
fails in flight is reported once and never stops the flight.

Topics are the events of the machine-readable output under their own names (`request`, `decision`, `mode`, ...) and what
the app adds (`telemetry`, `setpoint`, `plan`, `input`, ...). Beside them stand copies in Foxglove's schemas, under
`/view/`, for maps, 3D and logs. Log time is the wall clock when the record was opened plus monotonic time since; `t` in
every message is the app's own monotonic time, seconds.
"""

from __future__ import annotations

import json
import math
import os
import struct
import threading
import time
from dataclasses import dataclass
from typing import IO, TYPE_CHECKING, Any, Protocol

from mcap.exceptions import McapError
from mcap.records import Attachment, Channel, Message, Metadata
from mcap.stream_reader import CRCValidationError, StreamReader
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer
from zstandard import ZstdCompressor, ZstdDecompressor, ZstdError

from m3r_app.plain import plain, restored
from m3r_app.queue_thread import QueueThread
from m3r_app.record.chain import LINK, LINK_S, Chain
from m3r_app.record.foxglove_scene import Scene
from m3r_app.record.foxglove_schemas import SCHEMAS
from m3r_app.record.foxglove_views import views

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Mapping
    from pathlib import Path

SCHEMA_VERSION = 1
"""Of the topics and their fields; a reader refuses what is newer."""
CHUNK_BYTES = 32_768
"""Half a second of flight: small enough that a killed app loses little, large enough to be packed well."""
COMPRESSION = CompressionType.ZSTD
VIEW_S = {"telemetry": 0.2, "setpoint": 0.5, "neighbours": 0.5}
"""Copies for viewers of what comes more often than this are thinned; the messages themselves never are."""
QUEUE_LENGTH = 20_000
"""Messages; about a minute of flight."""
CLOSE_S = 10.0
VIEW_PREFIX = "/view/"
METADATA_NAME = "m3r"
TYPED = frozenset({"start", "step", LINK})
"""Topics that only `read_lines` and `read_parts` read: typed values, and the chain of hashes."""
PACKED = "application/json+zstd"
_DAMAGE = (McapError, CRCValidationError, ZstdError, struct.error, UnicodeDecodeError, MemoryError)
"""What reading past the undamaged part of a file raises."""


class RecordError(ValueError):
    """A record that cannot be written or read; one sentence that names the file."""


@dataclass(frozen=True)
class Line:
    """A message that has its JSON already, without the braces about it. attachments: by name, written before it."""

    body: str
    attachments: Mapping[str, bytes]


class LineWriter(Protocol):
    """Makes the messages of some topics itself. Called on the recorder's thread."""

    def line(self, topic: str, data: Mapping[str, object]) -> Line: ...


def _is_device_or_empty(path: Path) -> bool:
    """Whether nothing is lost by writing to what is there."""
    return path.exists() and (not path.is_file() or not path.stat().st_size)


class Recorder:
    """Writes one flight record. Thread-safe; `record` takes microseconds and never blocks, waits or raises."""

    def __init__(
        self,
        path: Path,
        metadata: Mapping[str, object],
        on_failure: Callable[[str], None],
        writers: Mapping[str, LineWriter] | None = None,
        chain: Chain | None = None,
    ) -> None:
        """Open `path` and write the metadata (app version, settings, scenario, model: anything `plain` can take).

        writers: by topic, of messages that are no plain data; chain: with a key, if the record is to be signed.

        on_failure: called on the writing thread, with a sentence, the first time that messages are lost and if writing fails.
        Raises RecordError where the file cannot be written, or holds something already: a flight is not to be had again.
        """
        self._path = path
        self._on_failure = on_failure
        self._writers = writers or {}
        self._chain = chain or Chain()
        self._failed = False
        self._told_of_gaps = False
        self._dropped = 0
        self._dropped_lock = threading.Lock()
        self._wall_minus_monotonic_ns = time.time_ns() - time.monotonic_ns()
        self._linked_ns = time.time_ns()
        try:
            self._file: IO[bytes] = path.open("wb" if _is_device_or_empty(path) else "xb")
        except FileExistsError:
            raise RecordError(f"flight record {path} exists already and is not written over: name another") from None
        except OSError as error:
            raise RecordError(f"flight record {path} cannot be written: {error.strerror}") from None
        try:
            self._mcap = Writer(self._file, chunk_size=CHUNK_BYTES, compression=COMPRESSION)
            self._mcap.start(profile="", library="m3r")
            named = {"schema_version": SCHEMA_VERSION, **metadata}
            head = {key: _json(value) for key, value in named.items()}
            self._mcap.add_metadata(METADATA_NAME, head)
            self._chain.take(METADATA_NAME, _canonical(head))
            self._file.flush()
        except OSError as error:
            self._abandon_file()
            raise RecordError(f"flight record {path} cannot be written: {error.strerror}") from None
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._scene = Scene()
        self._viewed_s: dict[str, float] = {}
        """By topic: when it was last copied for viewers."""
        self._messages: QueueThread[tuple[str, float, int, Mapping[str, object]]] = QueueThread(
            "m3r-recorder", self._run, QUEUE_LENGTH
        )
        self._messages.start()

    def record(self, topic: str, t_s: float, data: Mapping[str, object]) -> None:
        """Queue one message. `data` and all in it may not be changed afterwards. Ignored after `close`."""
        message = topic, t_s, time.monotonic_ns() + self._wall_minus_monotonic_ns, data
        if not self._messages.put(message) and not self._messages.closed:
            with self._dropped_lock:
                self._dropped += 1

    def close(self) -> None:
        """Write what is queued and finish the file. Safe to call twice and from any thread."""
        self._messages.close(CLOSE_S)

    def _run(self) -> None:
        for topic, t_s, log_ns, data in self._messages:
            if self._failed:
                continue
            try:
                self._write(topic, t_s, log_ns, data)
                if self._dropped:
                    self._write_gap(t_s, log_ns)
                if not self._messages.waiting:
                    self._file.flush()
            except OSError as error:
                self._fail(error.strerror or str(error))
            except Exception as error:  # noqa: BLE001  (one message that no JSON can hold must not end the record)
                with self._dropped_lock:
                    self._dropped += 1
                self._tell_of_gaps(f"one {topic} message could not be written ({type(error).__name__})")
        if self._failed:
            return
        try:
            self._link(time.monotonic_ns() + self._wall_minus_monotonic_ns, last=True)
            self._mcap.finish()  # type: ignore[no-untyped-call]
            self._file.close()
        except OSError as error:
            self._fail(error.strerror or str(error))

    def _write(self, topic: str, t_s: float, log_ns: int, data: Mapping[str, object]) -> None:
        if topic in self._writers:
            line = self._writers[topic].line(topic, data)
            for name, content in line.attachments.items():
                packed = ZstdCompressor(level=3).compress(content)
                self._mcap.add_attachment(log_ns, log_ns, name, PACKED, packed)
            self._add_text(topic, f"m3r.{topic}", {}, f'{{"t":{t_s!r},{line.body}}}', log_ns)
            return
        message = plain(dict(data), lossless=True) | {"t": t_s}
        self._add(topic, f"m3r.{topic}", message, log_ns)
        if topic in VIEW_S:
            if t_s - self._viewed_s.get(topic, -math.inf) < VIEW_S[topic]:
                return
            self._viewed_s[topic] = t_s
        for view in (*views(topic, message, log_ns), *self._scene.views(topic, message, log_ns)):
            self._add(f"{VIEW_PREFIX}{view.topic}", view.schema, view.message, log_ns)

    def _write_gap(self, t_s: float, log_ns: int) -> None:
        """Say in the record itself that messages are missing here."""
        with self._dropped_lock:
            dropped, self._dropped = self._dropped, 0
        self._tell_of_gaps("writing it falls behind")
        self._write("record_gap", t_s, log_ns, {"dropped": dropped})

    def _add(self, topic: str, schema: str, message: Mapping[str, Any], log_ns: int) -> None:
        self._add_text(topic, schema, message, json.dumps(message, allow_nan=False), log_ns)

    def _add_text(self, topic: str, schema: str, like: Mapping[str, Any], text: str, log_ns: int) -> None:
        """like: a message whose fields its schema names."""
        channel = self._channels.get(topic)
        if channel is None:
            if schema not in self._schemas:
                fields = json.dumps(SCHEMAS.get(schema) or _schema_of(like)).encode()
                self._schemas[schema] = self._mcap.register_schema(schema, "jsonschema", fields)
            channel = self._mcap.register_channel(topic, "json", self._schemas[schema])
            self._channels[topic] = channel
        self._mcap.add_message(channel, log_ns, text.encode(), log_ns)
        if topic == LINK:
            return
        self._chain.take(topic, text.encode())
        if log_ns - self._linked_ns > LINK_S * 1e9:
            self._linked_ns = log_ns
            self._link(log_ns)

    def _link(self, log_ns: int, *, last: bool = False) -> None:
        link = {**self._chain.link(last=last), "t": log_ns / 1e9}
        self._add_text(LINK, f"m3r.{LINK}", link, json.dumps(link), log_ns)

    def _fail(self, reason: str) -> None:
        self._failed = True
        self._abandon_file()
        self._on_failure(f"flight record {self._path} is incomplete from here on: {reason}")

    def _tell_of_gaps(self, reason: str) -> None:
        if not self._told_of_gaps:
            self._told_of_gaps = True
            self._on_failure(f"flight record {self._path} has gaps: {reason}")

    def _abandon_file(self) -> None:
        try:
            self._file.close()
        except OSError:
            pass  # What could not be flushed before cannot be now; the failure itself is already being reported.


def _canonical(head: Mapping[str, str]) -> bytes:
    """The metadata as one text, whatever the order of its keys."""
    return json.dumps(head, sort_keys=True).encode()


def _json(value: object) -> str:
    return json.dumps(plain(value, lossless=True), allow_nan=False)


_JSON_TYPES = {bool: "boolean", int: "number", float: "number", str: "string"}


def _schema_of(value: Any) -> dict[str, Any]:
    """A JSON schema in which a viewer finds the fields of a message like this one."""
    if isinstance(value, dict):
        return {"type": "object", "properties": {key: _schema_of(item) for key, item in value.items()}}
    if isinstance(value, list):
        return {"type": "array", "items": _schema_of(value[0]) if value else {}}
    kind = _JSON_TYPES.get(type(value))
    return {"type": kind} if kind else {}


@dataclass(frozen=True)
class RecordHeader:
    """What a record says of itself. complete: it was closed; False for that of a killed app or a full disk."""

    metadata: dict[str, Any]
    complete: bool


def read_header(path: Path) -> RecordHeader:
    """The metadata of a flight record. Raises RecordError."""
    for record in _records(path):
        if isinstance(record, Metadata) and record.name == METADATA_NAME:
            try:
                metadata = {key: restored(json.loads(text)) for key, text in record.metadata.items()}
                newer = metadata["schema_version"] > SCHEMA_VERSION
            except (KeyError, TypeError, ValueError, RecursionError):
                raise RecordError(f"flight record {path} is damaged: what it says of itself cannot be read") from None
            if newer:
                raise RecordError(
                    f"{path} has record version {metadata['schema_version']}, this m3r reads up to {SCHEMA_VERSION}: "
                    "use a newer m3r"
                )
            return RecordHeader(metadata, _ends_with_magic(path))
    raise RecordError(f"{path} is not a flight record made by m3r")


def read_record(path: Path) -> Iterator[tuple[str, float, dict[str, Any]]]:
    """(topic, t_s, data) of every message in the order in which they were recorded, Foxglove's copies left out.

    Reading ends where a record is cut off or at the first damaged chunk; `read_header` tells whether it is complete.
    Raises RecordError if the file cannot be read or is no flight record.
    """
    read_header(path)
    for topic, message in _messages(path):
        if not topic.startswith(VIEW_PREFIX) and topic not in TYPED:
            data = restored(_object(path, topic, message))
            t_s = data.pop("t")
            yield topic, t_s, data


def read_lines(path: Path, wanted: Collection[str]) -> Iterator[tuple[str, dict[str, Any]]]:
    """(topic, JSON as it stands) of every message of these topics, in their order. Raises RecordError."""
    for topic, message in _messages(path):
        if topic in wanted:
            yield topic, _object(path, topic, message)


def _object(path: Path, topic: str, message: bytes) -> dict[str, Any]:
    """One message with its time. Raises RecordError for what is no such thing: somebody has changed the record."""
    try:
        told = json.loads(message)
    except (ValueError, RecursionError):
        told = None
    t_s = told.get("t") if isinstance(told, dict) else None
    if (
        not isinstance(told, dict)
        or isinstance(t_s, bool)
        or not isinstance(t_s, int | float)
        or not math.isfinite(t_s)
    ):
        raise RecordError(f"flight record {path} is damaged: a {topic} message cannot be read")
    return told


def read_attachments(path: Path) -> Iterator[tuple[str, bytes]]:
    """(name, content) of every attachment. Raises RecordError."""
    for record in _records(path):
        if isinstance(record, Attachment) and record.media_type == PACKED:
            try:
                yield record.name, ZstdDecompressor().decompress(record.data)
            except ZstdError:
                raise RecordError(
                    f"flight record {path} is damaged: its attachment {record.name} cannot be read"
                ) from None


def read_parts(path: Path) -> Iterator[tuple[str, bytes]]:
    """(kind, content) of all that the chain of hashes covers, and its links, in their order. Raises RecordError.

    Attachments are not among them: a message names them by their sha256.
    """
    topics: dict[int, str] = {}
    for record in _records(path):
        match record:
            case Channel():
                topics[record.id] = record.topic
            case Message():
                yield _topic(path, topics, record), record.data
            case Metadata():
                yield record.name, _canonical(record.metadata)


def _messages(path: Path) -> Iterator[tuple[str, bytes]]:
    topics: dict[int, str] = {}
    for record in _records(path):
        if isinstance(record, Channel):
            topics[record.id] = record.topic
        elif isinstance(record, Message):
            yield _topic(path, topics, record), record.data


def _topic(path: Path, topics: dict[int, str], message: Message) -> str:
    topic = topics.get(message.channel_id)
    if topic is None:
        raise RecordError(f"flight record {path} is damaged: a message is of no topic")
    return topic


def _records(path: Path) -> Iterator[object]:
    """Every MCAP record up to the end or the first damage, without seeking."""
    try:
        with path.open("rb") as file:
            if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
                raise RecordError(f"{path} is not a flight record (MCAP)")
            size = path.stat().st_size
            reader = StreamReader(file, skip_magic=True, validate_crcs=True, record_size_limit=size)
            try:
                yield from reader.records
            except _DAMAGE:
                return
    except OSError as error:
        raise RecordError(f"flight record {path} cannot be read: {error.strerror}") from None


def _ends_with_magic(path: Path) -> bool:
    with path.open("rb") as file:
        file.seek(-len(MCAP0_MAGIC), os.SEEK_END)
        return file.read() == MCAP0_MAGIC
