# SPDX-License-Identifier: Apache-2.0
"""The messages of an MCAP file, read from its start: every whole record, and nothing behind the first torn one.

A file whose recorder was killed has no index, so records are walked rather than looked up; a whole file is read the
same way, which for long recordings is also several times faster than message by message in time order.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Metadata, Schema
from mcap.stream_reader import get_chunk_data_stream
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat

MAGIC = b"\x89MCAP0\r\n"
HEADER = struct.Struct("<BQ")
"""of a record: opcode, length"""
MESSAGE = struct.Struct("<BQH4xQ8x")
"""start of a message record: opcode, length, channel, (sequence,) log time, (publish time)"""
FORMATS = {"ros2msg": MessageDefinitionFormat.MSG, "ros2idl": MessageDefinitionFormat.IDL}
TORN = (ValueError, KeyError, RuntimeError, struct.error, McapError, zstandard.ZstdError)
"""What the parsers of records, text, checksums, lz4 and zstd raise on a torn record"""


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
    """What is whole in one file.

    Attributes:
        topics: by name; messages in the order of the file.
        metadata: of all metadata records except rosbag2's own.
        complete: whether the file was read up to its proper end.
    """

    topics: dict[str, RawTopic] = field(default_factory=dict)
    metadata: dict[str, str] = field(default_factory=dict)
    complete: bool = False
    _schemas: dict[int, Schema] = field(default_factory=dict)
    _channels: dict[int, RawTopic] = field(default_factory=dict)

    def add_record(self, opcode: int, body: bytes) -> None:
        stream = ReadDataStream(BytesIO(body))
        if opcode == Opcode.CHUNK:
            inside, length = get_chunk_data_stream(Chunk.read(stream), validate_crc=True)
            self.add_records(inside.read(length))
        elif opcode == Opcode.MESSAGE:
            self.add_records(HEADER.pack(opcode, len(body)) + body)
        elif opcode == Opcode.SCHEMA:
            schema = Schema.read(stream)
            self._schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            self.add_channel(Channel.read(stream))
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
        if schema is not None and schema.encoding in FORMATS:
            definition = MessageDefinition(FORMATS[schema.encoding], schema.data.decode())
        topic = self.topics.setdefault(channel.topic, RawTopic(channel.topic, type_, definition))
        if topic.type != type_:
            raise TwoTypesError(f"topic '{topic.name}' has two types, {topic.type} and {type_}; expected one")
        self._channels[channel.id] = topic

    def add_records(self, data: bytes) -> None:
        """The records of one uncompressed chunk. The loop runs once a message, so it does little."""
        at, end, unpack, is_message = 0, len(data), MESSAGE.unpack_from, int(Opcode.MESSAGE)
        sinks = {key: (topic.log_times.append, topic.messages.append) for key, topic in self._channels.items()}
        while at < end:
            opcode = data[at]
            if opcode == is_message:
                _, length, channel, log_time = unpack(data, at)
                behind = at + HEADER.size + length
                add_time, add_message = sinks[channel]
                add_time(log_time)
                add_message(data[at + MESSAGE.size : behind])
            else:
                _, length = HEADER.unpack_from(data, at)
                behind = at + HEADER.size + length
                self.add_record(opcode, data[at + HEADER.size : behind])
                sinks = {key: (topic.log_times.append, topic.messages.append) for key, topic in self._channels.items()}
            at = behind
        if at != end:
            raise ValueError("a record reaches beyond its chunk")


class TwoTypesError(Exception):
    """One topic with messages of two types."""


def read_mcap(file: Path) -> McapFile:
    """All that is whole in a file that begins as an MCAP file does. Raises TwoTypesError."""
    found = McapFile()
    for opcode, body in _records(file):
        if opcode == Opcode.DATA_END:
            found.complete = True
            break
        try:
            found.add_record(opcode, body)
        except TORN:
            break
    return found


def _records(file: Path) -> Iterator[tuple[int, bytes]]:
    size = file.stat().st_size
    with file.open("rb") as stream:
        stream.seek(len(MAGIC))
        while len(header := stream.read(HEADER.size)) == HEADER.size:
            opcode, length = HEADER.unpack(header)
            if stream.tell() + length > size:
                return
            yield opcode, stream.read(length)
