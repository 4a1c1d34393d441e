# SPDX-License-Identifier: Apache-2.0
"""BagWriter: all topics of one side into one rosbag2 MCAP bag that survives a crash of its recorder.

Every half second a thread turns the messages so far into one compressed chunk, hands it to the system and forces it to
the disk; a chunk can be read without anything after it. So a killed recorder loses half a second, and `read` opens what
it left. metadata.yaml is written last: where it is missing, the bag was never closed.
"""

import os
import struct
import threading
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import Any

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Metadata
from rosbags.interfaces import Connection, MessageDefinition, MessageDefinitionFormat, Qos
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer, WriterError
from rosbags.rosbag2.storage_mcap import McapWriter
from rosbags.typesys import TypesysError

from eps_tunnel_analysis.recording.bag import BAG_SUFFIXES, Bag, read_bag, recovered
from eps_tunnel_analysis.recording.decode import register, typestore
from labyrinth_sim.errors import InputError, unknown_name
from labyrinth_sim.whole_file import folder_of

FLUSH_PERIOD = 0.5
"""s between chunks; what a killed recorder loses at most, and the time that compressing it takes"""
METADATA_NAME = "eps_tunnel"
PUBLISH_TIME = struct.Struct("<Q")
PUBLISH_TIME_AT = 23
"""bytes from the start of a message record: opcode 1, length 8, channel 2, sequence 4, log time 8"""
DISTRO_LINE = "ros_distro: "


class RecordingError(OSError):
    """The bag cannot be written any further (disk full, folder gone). What was written before can be read."""


class _Storage(McapWriter):
    """An MCAP file whose messages have a publish time in addition to the log time, and whose metadata name the ROS
    release.

    Attributes:
        publish_time: ns, of the message that is written next.
        distro: ROS release of the recorder; empty where no ROS took part.
    """

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        super().__init__(path, compression)
        self.publish_time, self.distro = 0, ""
        self._publish_times: list[tuple[int, int]] = []  # place in the chunk, ns

    def write(self, connection: Connection, timestamp: int, data: bytes | memoryview) -> None:
        self._publish_times.append((self.chunk.bio.tell() + PUBLISH_TIME_AT, self.publish_time))
        super().write(connection, timestamp, data)

    def close_chunk(self) -> None:
        with self.chunk.bio.getbuffer() as content:
            for place, time in self._publish_times:
                PUBLISH_TIME.pack_into(content, place, time)
        self._publish_times.clear()
        super().close_chunk()

    def close(self, version: int, metadata: str) -> None:
        super().close(version, self.with_distro(metadata))

    def with_distro(self, metadata: str) -> str:
        """The metadata as rosbags writes them, with the ROS release instead of its own name."""
        return metadata.replace(f"{DISTRO_LINE}rosbags", f"{DISTRO_LINE}{self.distro}") if self.distro else metadata


class _Bag(Writer):
    STORAGE_PLUGINS = {StoragePlugin.MCAP: _Storage}  # noqa: RUF012


class BagWriter:
    """Writes serialised messages; safe to call from several threads.

    Args:
        folder: the bag to make; its parents are made too.
        metadata: names and texts that describe what was recorded (sequence, sequence_hash, model, versions ...). They
            are at the head of the file, where a crash cannot damage them, and in metadata.yaml's custom_data.
        distro: ROS release under which it is recorded, e.g. `kilted`; empty where no ROS takes part.

    Raises:
        InputError: the folder exists; nothing is ever overwritten.
        RecordingError: the folder cannot be made or the disk is full.
    """

    def __init__(self, folder: Path, metadata: Mapping[str, str] | None = None, distro: str = "") -> None:
        self.path = Path(folder)
        if self.path.exists():
            raise InputError(f"{self.path}: exists already and is not overwritten. Name a folder that does not exist.")
        self._metadata = {str(key): str(value) for key, value in (metadata or {}).items()}
        self._writer = _Bag(self.path, version=9, storage_plugin=StoragePlugin.MCAP)
        self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        for key, value in self._metadata.items():
            self._writer.set_custom_data(key, value)
        self._store = typestore()
        self._topics: dict[str, Connection] = {}
        self._pending: deque[tuple[Connection, int, int, bytes]] = deque()
        self._lock = threading.Lock()  # for the file and the topics
        self._error: OSError | None = None
        self._closed = False
        self._stop = threading.Event()
        self._storage: Any = None
        try:
            self._writer.open()
            self._storage = self._writer.storage
            self._storage.distro = distro
            # A checksum distinguishes a chunk torn by a power loss from a complete one.
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

    def add_topic(self, topic: str, type_: str, definition: str | None = None, offered: Sequence[Qos] = ()) -> None:
        """Announces a topic before its first message; a second time does nothing.

        Args:
            topic: full name, e.g. `/real/joint_states`.
            type_: e.g. `sensor_msgs/msg/JointState`.
            definition: message definition (.msg text, followed by those of the types it uses); needed for types that
                are neither ROS 2's own nor of labyrinth_msgs.
            offered: quality of service of each publisher, by which a player of bags publishes it again.

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
                self._topics[topic] = self._writer.add_connection(
                    topic, type_, typestore=self._store, offered_qos_profiles=offered
                )
            except (WriterError, TypesysError) as error:
                raise InputError(f"{self.path}: topic '{topic}' of type {type_}: {error}") from error

    def write(self, topic: str, log_time: int, message: bytes | memoryview, publish_time: int | None = None) -> None:
        """Adds one message; only queues it, so it costs a microsecond and never waits for the disk.

        Args:
            topic: announced before.
            log_time: ns, when it was received.
            message: CDR, as a raw ROS subscription delivers it.
            publish_time: ns, when it was sent; the log time where that is not known.

        Raises:
            InputError: the topic was not announced.
            RecordingError: the bag cannot be written any further.
        """
        self._check()
        connection = self._topics.get(topic)
        if connection is None:
            raise InputError(f"{self.path}: {unknown_name('topic', topic, self._topics)} Announce it by add_topic.")
        sent = log_time if publish_time is None else publish_time
        self._pending.append((connection, log_time, sent, bytes(message)))

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
                self._name_distro()
            except OSError as error:
                raise self._failed(error) from error
            self._closed = True
        return self.path

    def _name_distro(self) -> None:
        """Puts the ROS release into metadata.yaml, which is replaced as a whole."""
        file = self.path / "metadata.yaml"
        text = file.read_text(encoding="utf-8")
        if (rewritten := self._storage.with_distro(text)) != text:
            new = file.with_suffix(".yaml.tmp")
            new.write_text(rewritten, encoding="utf-8")
            new.replace(file)

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
            connection, log_time, self._storage.publish_time, message = self._pending.popleft()
            self._writer.write(connection, log_time, message)
        if self._storage.chunk.msgs:
            self._storage.close_chunk()
        self._storage.bio.flush()

    def _check(self) -> None:
        if self._closed:
            raise RecordingError(f"{self.path}: the bag is closed; make another one.")
        if self._error is not None:
            raise self._failed(self._error)

    def _failed(self, error: OSError) -> RecordingError:
        """Gives up the file as it is, once, and says why."""
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


@contextmanager
def whole_bag(folder: Path, metadata: Mapping[str, str] | None = None) -> Iterator[BagWriter]:
    """A writer of a bag that is made from existing files, and so appears complete or not at all.

    Raises:
        InputError: the folder exists, or the bag cannot be written; nothing is left of it.
    """
    folder = Path(folder)
    if folder.exists() or folder.is_symlink():
        raise InputError(f"{folder}: exists already and is not overwritten. Name a folder that does not exist.")
    try:
        with folder_of(folder), TemporaryDirectory(prefix=f".{folder.name[:100]}.", dir=folder.parent) as scratch:
            made = Path(scratch) / folder.name
            with BagWriter(made, metadata) as writer:
                yield writer
            if folder.exists():
                raise InputError(f"{folder}: another program created it in the meantime; it is left as it is.")
            made.rename(folder)
    except OSError as error:
        reason = (error.__cause__ or error) if isinstance(error, RecordingError) else error
        words = getattr(reason, "strerror", None) or reason
        raise InputError(f"{folder}: cannot be written ({words}). Nothing is left of it.") from error


def repair(bag: Path, out: Path) -> str:
    """Copies every intact chunk of `bag` into the new folder `out`; the original is not changed.

    Returns:
        One sentence on what was saved.

    Raises:
        InputError: there is no bag, nothing intact in it, or `out` exists or cannot be written.
    """
    bag, out = Path(bag), Path(out)
    whole = _whole(bag)
    with whole_bag(out, whole.metadata) as writer:
        for name, topic in whole.topics.items():
            writer.add_topic(name, topic.type, topic.definition.data or None)
        messages = (
            (t, name, m) for name, raw in whole.topics.items() for t, m in zip(raw.log_times, raw.messages, strict=True)
        )
        for log_time, name, message in sorted(messages, key=lambda entry: entry[0]):
            writer.write(name, log_time, message)
    count = sum(len(raw.messages) for raw in whole.topics.values())
    return f"{out}: {count} messages saved. {whole.recovered or 'The bag was complete.'}"


def _whole(bag: Path) -> Bag:
    try:
        return read_bag(bag)
    except InputError:
        files = [bag] if bag.is_file() else sorted(file for file in bag.glob("*") if file.suffix in BAG_SUFFIXES)
        if len(files) != 1 or files[0].suffix != ".mcap":
            raise
        return recovered(bag, files[0])
