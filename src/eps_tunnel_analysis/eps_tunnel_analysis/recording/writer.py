# SPDX-License-Identifier: Apache-2.0
"""BagWriter: all topics of one side into one rosbag2 MCAP bag that survives a crash of its recorder.

Every half second a thread turns the messages so far into one compressed chunk, hands it to the system and forces it to
the disk; a chunk needs nothing behind it to be read. So a killed recorder loses half a second, and `read` opens what
it left. metadata.yaml is written last: where it is missing, the bag was never closed.
"""

import os
import threading
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from types import TracebackType
from typing import Any

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Metadata
from rosbags.interfaces import Connection, MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer, WriterError
from rosbags.typesys import TypesysError

from eps_tunnel_analysis.recording.message_types import register, typestore
from labyrinth_sim.errors import InputError, unknown_name

FLUSH_PERIOD = 0.5
"""s between chunks; what a killed recorder loses at most, and the time that compressing it takes"""
METADATA_NAME = "eps_tunnel"


class RecordingError(OSError):
    """The bag cannot be written any further (disk full, folder gone). What was written before can be read."""


class BagWriter:
    """Writes serialised messages; safe to call from several threads.

    Args:
        folder: the bag to make; its parents are made too.
        metadata: names and texts that tell what was recorded (sequence, sequence_hash, model, versions ...). They
            stand at the head of the file, where a crash cannot reach them, and in metadata.yaml's custom_data.

    Raises:
        InputError: the folder exists; nothing is ever overwritten.
        RecordingError: the folder cannot be made or the disk is full.
    """

    def __init__(self, folder: Path, metadata: Mapping[str, str] | None = None) -> None:
        self.path = Path(folder)
        if self.path.exists():
            raise InputError(f"{self.path}: exists already and is not overwritten. Name a folder that does not exist.")
        self._metadata = {str(key): str(value) for key, value in (metadata or {}).items()}
        self._writer = Writer(self.path, version=9, storage_plugin=StoragePlugin.MCAP)
        self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        for key, value in self._metadata.items():
            self._writer.set_custom_data(key, value)
        self._store = typestore()
        self._topics: dict[str, Connection] = {}
        self._pending: deque[tuple[Connection, int, bytes]] = deque()
        self._lock = threading.Lock()  # for the file and the topics
        self._error: OSError | None = None
        self._closed = False
        self._stop = threading.Event()
        self._storage: Any = None
        try:
            self._writer.open()
            self._storage = self._writer.storage
            # A checksum tells a chunk that lost power has torn from a whole one.
            self._storage.compressor = zstandard.ZstdCompressor(write_checksum=True).compress
            self._write_head()
        except OSError as error:
            raise self._failed(error) from error
        self._flusher = threading.Thread(target=self._flush_regularly, name=f"flush {self.path.name}", daemon=True)
        self._flusher.start()

    def _write_head(self) -> None:
        record = RecordBuilder()
        Metadata(name=METADATA_NAME, metadata=self._metadata).write(record)
        self._storage.bio.write(record.end())
        self._storage.bio.flush()

    def add_topic(self, topic: str, type_: str, definition: str | None = None) -> None:
        """Announces a topic before its first message; a second time does nothing.

        Args:
            topic: full name, e.g. `/real/joint_states`.
            type_: e.g. `sensor_msgs/msg/JointState`.
            definition: message definition (.msg text, followed by those of the types it uses); needed for types that
                are neither ROS 2's own nor of labyrinth_msgs.

        Raises:
            InputError: the type is unknown and no definition came, or the topic was announced with another type.
        """
        with self._lock:
            self._check()
            known = self._topics.get(topic)
            if known is not None:
                if known.msgtype != type_:
                    raise InputError(f"{self.path}: topic '{topic}' is of type {known.msgtype}, not {type_}.")
                return
            try:
                if definition is not None and type_ not in self._store.fielddefs:
                    register(self._store, type_, MessageDefinition(MessageDefinitionFormat.MSG, definition))
                if type_ not in self._store.fielddefs:
                    raise InputError(
                        f"{self.path}: topic '{topic}': the type {type_} is unknown. Source the workspace that "
                        "defines it, or pass its definition."
                    )
                self._topics[topic] = self._writer.add_connection(topic, type_, typestore=self._store)
            except (WriterError, TypesysError) as error:
                raise InputError(f"{self.path}: topic '{topic}' of type {type_}: {error}") from error

    def write(self, topic: str, log_time: int, message: bytes | memoryview) -> None:
        """Adds one message; only queues it, so it costs a microsecond and never waits for the disk.

        Args:
            topic: announced before.
            log_time: ns, when it was received.
            message: CDR, as a raw ROS subscription delivers it.

        Raises:
            InputError: the topic was not announced.
            RecordingError: the bag cannot be written any further.
        """
        self._check()
        connection = self._topics.get(topic)
        if connection is None:
            raise InputError(f"{self.path}: {unknown_name('topic', topic, self._topics)} Announce it by add_topic.")
        self._pending.append((connection, log_time, bytes(message)))

    def flush(self) -> None:
        """Hands everything written so far to the disk. Raises RecordingError where that fails."""
        with self._lock:
            self._check()
            try:
                self._flush_chunk()
            except OSError as error:
                raise self._failed(error) from error

    def close(self) -> Path:
        """Writes index and metadata.yaml; returns the bag's path. The second call does nothing.

        Raises:
            RecordingError: the bag cannot be finished; what was flushed before can be read.
        """
        self._stop.set()
        self._flusher.join()
        with self._lock:
            if self._closed:
                return self.path
            self._check()
            try:
                self._flush_chunk()
                self._storage.chunk.bio = BytesIO()  # topics without a message; the index names them anyway
                self._writer.close()
            except OSError as error:
                raise self._failed(error) from error
            self._closed = True
        return self.path

    def __enter__(self) -> "BagWriter":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if not isinstance(error, RecordingError):
            self.close()  # Ctrl-C and a failing caller leave a whole bag, too

    def _flush_regularly(self) -> None:
        while not self._stop.wait(FLUSH_PERIOD):
            with self._lock:
                if self._error is not None:
                    return
                try:
                    self._flush_chunk()
                    descriptor = os.dup(self._storage.bio.fileno())
                except OSError as error:
                    self._failed(error)
                    return
            try:
                os.fsync(descriptor)  # outside the lock: a slow disk must not hold up the messages
            except OSError as error:
                with self._lock:
                    self._failed(error)
                return
            finally:
                os.close(descriptor)

    def _flush_chunk(self) -> None:
        while self._pending:
            self._writer.write(*self._pending.popleft())
        if self._storage.chunk.msgs:
            self._storage.close_chunk()
        self._storage.bio.flush()

    def _check(self) -> None:
        if self._closed:
            raise RecordingError(f"{self.path}: the bag is closed; make another one.")
        if self._error is not None:
            raise self._failed(self._error)

    def _failed(self, error: OSError) -> RecordingError:
        """Gives up the file as it is, once, and tells why."""
        if self._error is None:
            self._error = error
            if self._storage is not None:
                _abandon(self._storage.bio)
        reason = error.strerror or str(error)
        return RecordingError(
            f"{self.path}: recording stopped ({reason}). What was written before can be read. "
            "Free space or choose another disk, then record again."
        )


def _abandon(stream: Any) -> None:
    """Closes a file without its unwritten rest, which would fail again."""
    with suppress(OSError):
        stream.raw.close()
