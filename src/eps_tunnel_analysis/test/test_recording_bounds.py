# SPDX-License-Identifier: Apache-2.0
"""Bags made to break a reader: what they declare is refused before it costs memory or time."""

import struct
import tracemalloc
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import lz4.frame
import pytest
import yaml
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Chunk, DataEnd, Footer, Header, Message, Schema
from recording_cases import START, STORE, joints, write_bag
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.serde import SerdeError

from eps_tunnel_analysis.recording import read, repair
from eps_tunnel_analysis.recording.bag import MAGIC
from eps_tunnel_analysis.recording.decode import BALL_STATE, JOINT_STATE, typestore
from eps_tunnel_analysis.recording.unpack import MOST_UNPACKED
from labyrinth_sim.errors import InputError

SIX_GIB = 6 << 30
MOST_MEMORY = 64 << 20  # bytes, traced
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


def records(*content) -> bytes:
    builder = RecordBuilder()
    for record in content:
        record.write(builder)
    return bytes(builder.end())


def mcap_file(path: Path, *content, closed: bool = True) -> Path:
    """An MCAP file without a summary: rosbags then scans the whole of it."""
    ending = records(DataEnd(0), Footer(0, 0, 0)) + MAGIC if closed else b""
    path.write_bytes(MAGIC + records(Header("ros2", "test"), *content) + ending)
    return path


def topic(definition: str = "", type_: str = JOINT_STATE, name: str = "/real/joint_states"):
    """Its schema, encoded as a recorder does, and its channel."""
    schema = Schema(id=1, name=type_, encoding="ros2msg" if definition else "", data=definition.encode())
    return schema, Channel(id=1, topic=name, message_encoding="cdr", metadata={}, schema_id=1)


def message(at: int = START, data: bytes | None = None):
    return Message(1, at, data or joints(START, ["a"], [1.0]), at, 0)


def chunk(data: bytes, compression: str, size: int, crc: int = 0):
    return Chunk(compression=compression, data=data, message_start_time=START, message_end_time=START,
                 uncompressed_crc=crc, uncompressed_size=size)  # fmt: skip


def zstd_frame(size: int) -> bytes:
    """A frame header that declares `size` bytes of content, and one block of no bytes."""
    return ZSTD_MAGIC + bytes([0b11100000]) + struct.pack("<Q", size) + bytes([1, 0, 0])


@contextmanager
def little_memory() -> Iterator[None]:
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < MOST_MEMORY
    finally:
        tracemalloc.stop()


def told(path: Path) -> str:
    with little_memory(), pytest.raises(InputError) as caught:
        read(path)
    assert str(path) in str(caught.value)
    return str(caught.value)


BOMBS = {
    "zstd 6 GiB": chunk(zstd_frame(SIX_GIB), "zstd", SIX_GIB),
    "zstd 2^64 - 1": chunk(zstd_frame(2**64 - 3), "zstd", 2**64 - 1),
    "none 2^64 - 1": chunk(b"", "", 2**64 - 1),
    "frame says 6 GiB, chunk 10": chunk(zstd_frame(SIX_GIB), "zstd", 10),
    "lz4 512 MiB": chunk(lz4.frame.compress(bytes(1 << 20)) * 9, "lz4", 512 << 20),
}


@pytest.mark.parametrize("bomb", BOMBS.values(), ids=BOMBS)
def test_a_chunk_that_declares_too_much_is_refused_before_it_is_decompressed(tmp_path: Path, bomb) -> None:
    assert "declares" in told(mcap_file(tmp_path / "bomb.mcap", *topic(), bomb))


def test_frames_behind_the_first_and_frames_that_do_not_tell_their_size_are_bounded_too(tmp_path: Path) -> None:
    silent = zstandard.ZstdCompressor(write_content_size=False).compress(bytes(1 << 28))
    assert "bomb.mcap" in told(mcap_file(tmp_path / "bomb.mcap", *topic(), chunk(silent, "zstd", 10)))
    first = records(*topic(), message())
    two = zstandard.compress(first) + silent
    assert "unused data" in told(mcap_file(tmp_path / "two.mcap", chunk(two, "zstd", len(first))))


def test_many_chunks_may_not_become_more_than_one(tmp_path: Path) -> None:
    size = MOST_UNPACKED // 4 + 1
    data = zstandard.compress(records(message(data=bytes(size - 31))))
    content = [*topic(), *[chunk(data, "zstd", size)] * 4]
    with pytest.raises(InputError, match="declares"):
        read(mcap_file(tmp_path / "bomb.mcap", *content))


def test_chunks_within_chunks_and_behind_the_data_are_refused(tmp_path: Path) -> None:
    inner = chunk(b"", "", 0)
    outer = records(inner)
    assert "which only a file may" in told(mcap_file(tmp_path / "nested.mcap", chunk(outer, "", len(outer))))
    assert "behind the end" in told(mcap_file(tmp_path / "late.mcap", *topic(), message(), DataEnd(0), inner))


def test_chunks_of_anything_but_messages_take_no_time(tmp_path: Path) -> None:
    zeros = bytes(1 << 26)
    file = mcap_file(tmp_path / "zeros.mcap", chunk(zstandard.compress(zeros), "zstd", len(zeros)))
    with pytest.raises(InputError, match="a record of kind 0"):
        read(file)
    channels = records(topic()[1]) * 1_000_000
    file = mcap_file(tmp_path / "channels.mcap", chunk(zstandard.compress(channels), "zstd", len(channels)))
    with pytest.raises(InputError, match="more than 200000 schemas and channels"):
        read(file)


def test_the_damaged_part_is_named(tmp_path: Path) -> None:
    good = records(*topic(), message())
    head = len(MAGIC + records(Header("ros2", "test")))
    complaint = told(mcap_file(tmp_path / "bad.mcap", chunk(good, "", len(good), crc=zlib.crc32(good) ^ 1)))
    assert f"bad.mcap: the record at byte {head} is damaged, a chunk fails its checksum" in complaint


def test_what_an_unfinished_file_holds_before_such_a_chunk_is_read(tmp_path: Path) -> None:
    good = records(*topic(), message(), message(START + 1, joints(START + 1, ["a"], [2.0])))
    file = mcap_file(tmp_path / "cut.mcap", chunk(good, "", len(good)), BOMBS["zstd 6 GiB"], closed=False)
    with little_memory():
        assert len(read(file).topics["/real/joint_states"]) == 2


@pytest.mark.parametrize("at", [1 << 63, (1 << 64) - 1])
@pytest.mark.parametrize("closed", [True, False])
def test_a_log_time_that_no_signed_number_holds_is_refused(tmp_path: Path, at: int, closed: bool) -> None:
    file = mcap_file(tmp_path / "late.mcap", *topic(), message(), message(at), closed=closed)
    complaint = told(file)
    assert f"topic '/real/joint_states': the log time of a message is {at} ns" in complaint
    with pytest.raises(InputError, match="log time"):
        repair(file, tmp_path / "out")


SEPARATOR = "=" * 80 + "\n"
DEFINITIONS = {
    "labyrinth_msgs/BallState inner\n": "contains itself",
    f"other_msgs/A x\n{SEPARATOR}MSG: other_msgs/A\nother_msgs/B y\n{SEPARATOR}MSG: other_msgs/B\nother_msgs/A z\n": (
        "other_msgs/msg/A contains itself"
    ),
    "other_msgs/Missing x\n": "is not defined",
    "geometry_msgs/Point[4000000000] x\n": "12000000000 fields",
    "other_msgs/A0 x\nother_msgs/A0 y\n"
    + "".join(f"{SEPARATOR}MSG: other_msgs/A{i}\nother_msgs/A{i + 1} x\nother_msgs/A{i + 1} y\n" for i in range(60))
    + f"{SEPARATOR}MSG: other_msgs/A60\nfloat64 x\n": "fields; expected at most",
    "float64 x\n" * 20_000: "in 20000 lines",
    "# " + "x" * 200_000 + "\nfloat64 x\n": "characters in",
    "float64 X=1e999\n": "cannot be read",
    "\0\n": "cannot be read",
    "float64 x\nfloat64 y\n": "lacks a field",
}


@pytest.mark.parametrize("definition", DEFINITIONS, ids=range(len(DEFINITIONS)))
def test_a_definition_that_contains_itself_or_is_out_of_all_bounds_is_refused(tmp_path: Path, definition: str) -> None:
    state = topic(definition, BALL_STATE, "/real/ball")
    complaint = told(mcap_file(tmp_path / "bag.mcap", *state, message(data=bytes([0, 1, 0, 0]) + bytes(16))))
    assert DEFINITIONS[definition] in complaint


def test_metadata_out_of_all_bounds_is_refused(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", seconds=0.1)
    file = bag / "metadata.yaml"
    whole = yaml.safe_load(file.read_text())
    bomb = "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}' if i else 'lol'] * 10)}]\n" for i in range(12))
    for change in ({"message_count": "abc"}, {"message_count": None}, {"relative_file_paths": 7},
                   {"topics_with_message_count": [{}]}, {"duration": []}):  # fmt: skip
        file.write_text(yaml.safe_dump({"rosbag2_bagfile_information": whole["rosbag2_bagfile_information"] | change}))
        assert "not a complete bag" in told(bag)
    number = yaml.safe_load(yaml.safe_dump(whole))
    number["rosbag2_bagfile_information"]["topics_with_message_count"][0]["topic_metadata"]["name"] = 7
    file.write_text(yaml.safe_dump(number))
    assert "no text" in told(bag)
    file.write_text(bomb + yaml.safe_dump(whole))
    assert "more than 20000 values" in told(bag)


@pytest.mark.parametrize("mode", [CompressionMode.MESSAGE, CompressionMode.FILE])
def test_compressed_messages_and_files_are_bounded(tmp_path: Path, mode: CompressionMode) -> None:
    writer = Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.SQLITE3)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/real/joint_states", JOINT_STATE, typestore=STORE)
        for at in range(2):
            writer.write(connection, START + at, bytes(MOST_UNPACKED // 2 + 1))
    with pytest.raises(InputError, match="are left of what such a file may become"):
        read(tmp_path / "bag")


def test_a_sequence_in_a_message_declares_no_more_than_it_holds() -> None:
    data = bytearray(joints(START, ["a"], [1.0]))
    at = data.index(struct.pack("<I", 1) + struct.pack("<I", 2))  # one name, of two bytes with its zero
    data[at : at + 4] = struct.pack("<I", 2**32 - 1)
    with little_memory(), pytest.raises(SerdeError):
        typestore().deserialize_cdr(bytes(data), JOINT_STATE)
