# SPDX-License-Identifier: Apache-2.0
"""Bag: the serialised messages of a recording, by topic, as stored on disk; those of ROS 1 as in ROS 2.

A folder with metadata.yaml was closed by its recorder and must be complete. A folder without it was never closed (the
recorder was killed), and so is a lone .mcap file without a footer: those are read up to their last complete chunk.

A file whose recorder was killed has no index, so records are read in order rather than looked up; a complete file is
read the same way, which for long recordings is also several times faster than message by message in time order.
"""

import struct
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import Any

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Metadata, Schema
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.reader import DirectoryReader
from rosbags.rosbag2.storage_mcap import McapReader

from eps_tunnel_analysis.recording.ros1 import Ros1File
from eps_tunnel_analysis.recording.unpack import Allowance, check_file, chunk_records, message_data
from labyrinth_sim.errors import InputError
from labyrinth_sim.yaml_file import read_yaml

MAGIC = b"\x89MCAP0\r\n"
RECORD_HEADER = struct.Struct("<BQ")
"""of a record: opcode, length"""
MESSAGE_START = struct.Struct("<BQH4xQ8x")
"""start of a message record: opcode, length, channel, (sequence,) log time, (publish time)"""
DEFINITION_FORMATS = {"ros2msg": MessageDefinitionFormat.MSG, "ros2idl": MessageDefinitionFormat.IDL}
TORN = (ValueError, KeyError, OverflowError, RuntimeError, struct.error, McapError, zstandard.ZstdError)
"""What the parsers of records, text, checksums, lz4 and zstd raise on a torn record"""
DECLARATIONS = (Opcode.SCHEMA, Opcode.CHANNEL)
MOST_DECLARATIONS = 200_000
"""schemas and channels in a file, those that each chunk repeats included"""
LATEST = (1 << 63) - 1
"""ns since 1970, the latest stamp that a signed number holds, in the year 2262"""
ROS1_SUFFIX = ".bag"
ROS2_SUFFIXES = (".mcap", ".db3")
"""of files of which several in a folder are one recording; each of ROS 1 is one of its own"""
BAG_SUFFIXES = (*ROS2_SUFFIXES, ROS1_SUFFIX)
EXPECTED = (
    "a rosbag2 folder (with metadata.yaml), a single .mcap or .db3 file of ROS 2 messages, or a .bag file of ROS 1"
)


@dataclass
class RawTopic:
    """Messages of one topic, still serialised; grows while the bag is read."""

    name: str
    type: str
    definition: MessageDefinition
    log_times: list[int] = field(default_factory=list)
    """ns"""
    messages: list[bytes] = field(default_factory=list)
    """CDR"""


@dataclass
class McapFile:
    """The intact part of one file.

    Attributes:
        topics: by name; messages in the order of the file.
        metadata: of all metadata records except rosbag2's own.
        complete: whether the file was read up to its proper end.
        fault: where and why reading ended before that.
        allowance: bytes that its chunks may still expand to.
    """

    allowance: Allowance
    topics: dict[str, RawTopic] = field(default_factory=dict)
    metadata: dict[str, str] = field(default_factory=dict)
    complete: bool = False
    fault: str = "it ends too early"
    _schemas: dict[int, Schema] = field(default_factory=dict)
    _channels: dict[int, RawTopic] = field(default_factory=dict)
    _sinks: dict[int, tuple[Callable[[int], None], Callable[[bytes], None]]] = field(default_factory=dict)
    _declared: int = 0

    def add_record(self, opcode: int, body: bytes) -> None:
        stream = ReadDataStream(BytesIO(body))
        if opcode == Opcode.CHUNK:
            self.add_records(chunk_records(Chunk.read(stream), self.allowance))
        elif opcode == Opcode.MESSAGE:
            self.add_records(RECORD_HEADER.pack(opcode, len(body)) + body)
        elif opcode in DECLARATIONS:
            self._declared += 1
            if self._declared > MOST_DECLARATIONS:
                raise ValueError(f"more than {MOST_DECLARATIONS} schemas and channels")
            if opcode == Opcode.CHANNEL:
                self.add_channel(Channel.read(stream))
            else:
                schema = Schema.read(stream)
                self._schemas[schema.id] = schema
        elif opcode == Opcode.METADATA:
            record = Metadata.read(stream)
            if record.name != "rosbag2":
                self.metadata.update(record.metadata)

    def add_channel(self, channel: Channel) -> None:
        if channel.id in self._channels:
            return
        schema = self._schemas.get(channel.schema_id)
        type_ = schema.name if schema else ""
        definition = MessageDefinition(MessageDefinitionFormat.NONE, "")
        if schema is not None and schema.encoding in DEFINITION_FORMATS:
            definition = MessageDefinition(DEFINITION_FORMATS[schema.encoding], schema.data.decode())
        topic = self.topics.setdefault(channel.topic, RawTopic(channel.topic, type_, definition))
        if topic.type != type_:
            raise TwoTypesError(f"topic '{topic.name}' has two types, {topic.type} and {type_}; expected one")
        self._channels[channel.id] = topic
        self._sinks[channel.id] = topic.log_times.append, topic.messages.append

    def add_records(self, data: bytes) -> None:
        """The records of one uncompressed chunk. The loop runs once per message, so it does little."""
        at, end, unpack, is_message, sinks = 0, len(data), MESSAGE_START.unpack_from, int(Opcode.MESSAGE), self._sinks
        while at < end:
            opcode = data[at]
            if opcode == is_message:
                _, length, channel, log_time = unpack(data, at)
                behind = at + RECORD_HEADER.size + length
                add_time, add_message = sinks[channel]
                add_time(log_time)
                add_message(data[at + MESSAGE_START.size : behind])
            elif opcode in DECLARATIONS:
                _, length = RECORD_HEADER.unpack_from(data, at)
                behind = at + RECORD_HEADER.size + length
                self.add_record(opcode, data[at + RECORD_HEADER.size : behind])
            else:
                raise ValueError(f"a chunk holds a record of kind {opcode}, which only a file may")
            at = behind
        if at != end:
            raise ValueError("a record reaches beyond its chunk")


class TwoTypesError(Exception):
    """One topic with messages of two types."""


def read_mcap(file: Path) -> McapFile:
    """Everything intact in a file that begins like an MCAP file. Raises TwoTypesError."""
    contents = McapFile(Allowance.of([file]))
    for at, opcode, body in _records(file):
        if opcode == Opcode.FOOTER:
            break
        try:
            if not contents.complete:
                contents.complete = opcode == Opcode.DATA_END
                contents.add_record(opcode, body)
            elif opcode == Opcode.CHUNK:
                raise ValueError("it lies behind the end of the data")
        except TORN as error:
            contents.complete = False
            contents.fault = f"{file.name}: the record at byte {at} is damaged, {error}"
            break
    return contents


def _records(file: Path) -> Iterator[tuple[int, int, bytes]]:
    """Where each record begins, its opcode and its content."""
    size = file.stat().st_size
    with file.open("rb") as stream:
        stream.seek(len(MAGIC))
        while len(header := stream.read(RECORD_HEADER.size)) == RECORD_HEADER.size:
            opcode, length = RECORD_HEADER.unpack(header)
            if stream.tell() + length > size:
                return
            yield stream.tell() - RECORD_HEADER.size, opcode, stream.read(length)


class _CheckedMcap(McapReader):
    """rosbags checks the index, but only of a file whose chunks are intact: it decompresses whatever they declare."""

    def open(self) -> None:
        self.content = read_mcap(Path(str(self.path)))
        if not self.content.complete:
            raise ValueError(self.content.fault)
        super().open()


class _CheckedDirectory(DirectoryReader):
    STORAGE_PLUGINS: Mapping[str, Any] = {**DirectoryReader.STORAGE_PLUGINS, "mcap": _CheckedMcap}


class _CheckedReader(Reader):
    STORAGE_PLUGINS: Mapping[str, Any] = {
        **Reader.STORAGE_PLUGINS, "dir": _CheckedDirectory, ".mcap": _CheckedMcap
    }  # fmt: skip


@dataclass(frozen=True)
class Bag:
    """Everything in one bag, still serialised; messages of each topic in log-time order."""

    path: Path
    topics: Mapping[str, RawTopic]
    metadata: Mapping[str, str]
    recovered: str | None
    """None for a bag that was closed properly, else one sentence on what was recovered"""

    @property
    def count(self) -> int:
        """Messages in the bag."""
        return sum(len(topic.messages) for topic in self.topics.values())


def read_bag(path: Path) -> Bag:
    """All messages of a bag. The files are only read, never touched.

    Raises:
        InputError: there is no bag, or it is empty, truncated, damaged or of another kind.
    """
    path = Path(path)
    files = _files(path)
    if (path / "metadata.yaml").exists():
        return _closed(path, path)
    bags = [_lone_file(path, file) for file in files]
    notes = [bag.recovered for bag in bags if bag.recovered]
    metadata = {key: value for bag in bags for key, value in bag.metadata.items()}
    return Bag(path, _merged(path, (bag.topics for bag in bags)), metadata, " ".join(notes) or None)


def _files(path: Path) -> list[Path]:
    if not path.exists():
        raise InputError(f"{path}: no such bag. Expected {EXPECTED}.")
    if path.is_file():
        if path.name == "metadata.yaml":
            raise InputError(f"{path}: name the bag's folder, {path.parent}, not its metadata.yaml.")
        if path.suffix not in BAG_SUFFIXES:
            raise InputError(f"{path}: not a bag. Expected {EXPECTED}.")
        return [path]
    files = sorted(file for file in path.iterdir() if file.suffix in ROS2_SUFFIXES)
    if not files and not (path / "metadata.yaml").exists():
        inside = sorted(file.parent.name for file in path.glob("*/metadata.yaml"))
        inside += sorted(file.name for file in path.glob(f"*{ROS1_SUFFIX}"))
        hint = f" It holds bags, name them one by one: {', '.join(inside)}." if inside else ""
        raise InputError(f"{path}: no bag in this folder. Expected {EXPECTED}.{hint}")
    return files


def _closed(path: Path, source: Path) -> Bag:
    """A bag that must be complete. rosbags checks index and metadata; it also reads everything that is not MCAP."""
    try:
        if source.is_dir():
            _check_metadata(source)
        with _CheckedReader(source) as reader:
            stored: Any = reader.storage.metadata
            storages: list[Any] = getattr(reader.storage, "storages", [reader.storage])
            allowance = Allowance.of(storage.path for storage in storages)
            parts = [s.content.topics if isinstance(s, _CheckedMcap) else _iterated(s, allowance) for s in storages]
            if stored.compression_mode == "message":
                for topic in (topic for part in parts for topic in part.values()):
                    topic.messages = [message_data(message, allowance) for message in topic.messages]
            topics = _merged(path, parts)
            contents = [s.content for s in storages if isinstance(s, _CheckedMcap)]
            metadata = {key: value for content in contents for key, value in content.metadata.items()}
            for c in reader.connections:  # topics without a message stand in the index alone
                topics.setdefault(c.topic, RawTopic(c.topic, c.msgtype, c.msgdef))
            if not all(isinstance(word, str) for raw in topics.values() for word in (raw.name, raw.type)):
                raise ValueError("the name or type of a topic is no text")
            metadata |= {str(key): str(value) for key, value in (stored.custom or {}).items()}
            expected = int(stored.message_count)
    except InputError:
        raise
    except TwoTypesError as error:
        raise InputError(f"{path}: {error}.") from error
    except Exception as error:  # rosbags, apsw, zstd, lz4 and struct each raise classes of their own
        raise InputError(_damaged(path, error or type(error).__name__)) from error
    bag = Bag(path, topics, metadata, None)
    if bag.count < expected:
        raise InputError(_damaged(path, f"{bag.count} messages, but its metadata says {expected}"))
    return bag


def _check_metadata(folder: Path) -> None:
    """Raises before rosbags reads them if metadata.yaml is much too large, or a file expands to more than is
    allowed."""
    document = read_yaml(folder / "metadata.yaml")
    about = ("rosbag2_bagfile_information",)
    if str(document.value((*about, "compression_mode"))).lower() == "file":
        names = document.sequence((*about, "relative_file_paths"))
        files = [file for name in names if (file := folder / Path(str(name)).name).is_file()]
        allowance = Allowance.of(files)
        for file in files:
            check_file(file, allowance)


def _iterated(storage: Any, allowance: Allowance) -> dict[str, RawTopic]:
    """The topics of a file that is not MCAP."""
    topics: dict[str, RawTopic] = {}
    for connection in storage.connections:
        topic = topics.setdefault(connection.topic, RawTopic(connection.topic, connection.msgtype, connection.msgdef))
        if topic.type != connection.msgtype:
            raise TwoTypesError(f"topic '{topic.name}' has two types, {topic.type} and {connection.msgtype}")
    for connection, log_time, data in storage.messages(storage.connections):
        if not isinstance(log_time, int) or not isinstance(data, bytes):
            raise ValueError("the log time of a message is no whole number, or its data are no bytes")
        allowance.take(len(data), "a message")
        topic = topics[connection.topic]
        topic.log_times.append(log_time)
        topic.messages.append(data)
    return topics


def _merged(path: Path, parts: Iterable[Mapping[str, RawTopic]]) -> dict[str, RawTopic]:
    """The topics of a bag's files, each in log-time order: chunks and publishers may overlap."""
    topics: dict[str, RawTopic] = {}
    for part in parts:
        for name, raw in part.items():
            topic = topics.setdefault(name, raw)
            if topic.type != raw.type:
                raise InputError(f"{path}: topic '{name}' has two types, {topic.type} and {raw.type}; expected one.")
            if topic is not raw:
                topic.log_times += raw.log_times
                topic.messages += raw.messages
    for topic in topics.values():
        times = topic.log_times
        if times and not 0 <= min(times) <= max(times) <= LATEST:
            wrong = next(time for time in times if not 0 <= time <= LATEST)
            raise InputError(
                f"{path}: topic '{topic.name}': the log time of a message is {wrong} ns; expected 0 to {LATEST} ns "
                "(year 2262). Record again, or leave the topic out."
            )
        if any(later < earlier for earlier, later in pairwise(times)):
            order = sorted(range(len(times)), key=times.__getitem__)
            topic.log_times = [times[i] for i in order]
            topic.messages = [topic.messages[i] for i in order]
    return topics


def _damaged(path: Path, reason: object) -> str:
    return (
        f"{path}: not a complete bag ({reason}). Expected {EXPECTED}. If a recording was cut or damaged, "
        "`eps-tunnel repair BAG --out NEW` may save the intact part into a new bag."
    )


def _lone_file(path: Path, file: Path) -> Bag:
    """A file without metadata.yaml next to it."""
    if file.suffix == ROS1_SUFFIX:
        return _ros1(path, file)
    if file.suffix != ".mcap":
        return _closed(path, file)
    size = file.stat().st_size
    if not size:
        raise InputError(f"{path}: {file.name} is empty (0 bytes). Expected {EXPECTED}.")
    with file.open("rb") as stream:
        if stream.read(len(MAGIC)) != MAGIC:
            raise InputError(f"{path}: {file.name} is not an MCAP file. Expected {EXPECTED}.")
        stream.seek(max(len(MAGIC), size - len(MAGIC)))
        closed = stream.read() == MAGIC
    return _closed(path, file) if closed else recovered(path, file)


def _ros1(path: Path, file: Path) -> Bag:
    """A file of ROS 1, which must be complete and have its index."""
    try:
        allowance = Allowance.of([file])
        with Ros1File(file, allowance) as opened:
            topics = _iterated(opened, allowance)
    except TwoTypesError as error:
        raise InputError(f"{path}: {error}.") from error
    except Exception as error:  # rosbags asserts and raises classes of its own, bz2 and lz4 theirs
        raise InputError(
            f"{path}: {file.name} is not a complete ROS 1 bag ({error or type(error).__name__}). Expected {EXPECTED}. "
            "`rosbag reindex` may repair one whose recorder was killed."
        ) from error
    return Bag(path, _merged(path, [topics]), {}, None)


def recovered(path: Path, file: Path) -> Bag:
    """The intact part of an MCAP file that was never closed or was damaged.

    Raises:
        InputError: nothing is intact.
    """
    try:
        contents = read_mcap(file)
    except TwoTypesError as error:
        raise InputError(f"{path}: {error}.") from error
    bag = Bag(path, _merged(path, [contents.topics]), contents.metadata, None)
    times = [time for raw in bag.topics.values() if raw.log_times for time in (raw.log_times[0], raw.log_times[-1])]
    if not times:
        raise InputError(f"{path}: {file.name} was not closed properly and holds no complete chunk of messages.")
    note = (
        f"{file.name} was not closed properly; recovered {bag.count} messages "
        f"up to {(max(times) - min(times)) * 1e-9:.2f} s after its first."
    )
    return Bag(path, bag.topics, bag.metadata, note)
