# SPDX-License-Identifier: Apache-2.0
"""Reading an MCAP file that has no end: every whole record from the start, and nothing behind the first torn one."""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import breakup_chunk
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat

MCAP_MAGIC = b"\x89MCAP0\r\n"
RECORD_HEADER = struct.Struct("<BQ")  # opcode, length
FORMATS = {"ros2msg": MessageDefinitionFormat.MSG, "ros2idl": MessageDefinitionFormat.IDL}
TORN = (ValueError, KeyError, RuntimeError, struct.error, McapError, zstandard.ZstdError)
"""What the parsers of records, text, checksums, lz4 and zstd raise on a torn record"""
NO_DEFINITION = MessageDefinition(MessageDefinitionFormat.NONE, "")


@dataclass(frozen=True)
class RawMessage:
    """One serialised message with what is needed to read it."""

    topic: str
    type: str
    definition: MessageDefinition
    log_time: int
    """ns"""
    data: bytes


def scan(file: Path, metadata: dict[str, str]) -> Iterator[RawMessage]:
    """Messages in file order up to the last whole chunk; notes metadata records into `metadata` on the way."""
    schemas: dict[int, Schema] = {}
    channels: dict[int, tuple[str, str, MessageDefinition]] = {}
    for record in _whole_records(file):
        if isinstance(record, Metadata) and record.name != "rosbag2":
            metadata.update(record.metadata)
        elif isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            schema = schemas.get(record.schema_id)
            definition = NO_DEFINITION
            if schema is not None and schema.encoding in FORMATS:
                definition = MessageDefinition(FORMATS[schema.encoding], schema.data.decode())
            channels[record.id] = record.topic, schema.name if schema else "", definition
        elif isinstance(record, Message) and record.channel_id in channels:
            yield RawMessage(*channels[record.channel_id], record.log_time, record.data)


def head_metadata(file: Path) -> dict[str, str]:
    """What the recorder noted before the first message."""
    found: dict[str, str] = {}
    for record in _whole_records(file):
        if isinstance(record, Metadata) and record.name != "rosbag2":
            found.update(record.metadata)
        elif isinstance(record, Message):
            break
    return found


def _whole_records(file: Path) -> Iterator[McapRecord]:
    size = file.stat().st_size
    with file.open("rb") as stream:
        stream.seek(len(MCAP_MAGIC))
        while len(header := stream.read(RECORD_HEADER.size)) == RECORD_HEADER.size:
            opcode, length = RECORD_HEADER.unpack(header)
            if stream.tell() + length > size or opcode == Opcode.DATA_END:
                return
            try:
                records = _parse(opcode, stream.read(length))
            except TORN:
                return
            yield from records


def _parse(opcode: int, body: bytes) -> list[McapRecord]:
    stream = ReadDataStream(BytesIO(body))
    if opcode == Opcode.CHUNK:
        return breakup_chunk(Chunk.read(stream), validate_crc=True)
    if opcode == Opcode.MESSAGE:
        return [Message.read(stream, len(body))]
    if opcode == Opcode.SCHEMA:
        return [Schema.read(stream)]
    if opcode == Opcode.CHANNEL:
        return [Channel.read(stream)]
    return [Metadata.read(stream)] if opcode == Opcode.METADATA else []
