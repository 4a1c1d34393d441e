# SPDX-License-Identifier: Apache-2.0
"""ROS 1 bags (.bag, format 2.0): their joint states as the ROS 2 messages that the same rig would send."""

import bz2
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from lz4.frame import LZ4FrameDecompressor
from rosbags.interfaces import Connection, MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag1 import Reader
from rosbags.rosbag1.reader import decompressors
from rosbags.typesys import Stores, get_typestore

from eps_tunnel_analysis.recording.unpack import Allowance, TooLargeError

READ = "sensor_msgs/msg/JointState"
"""the one type of both systems that is read; topics of other types are listed by name, without their messages"""


class Ros1File:
    """An open bag; rosbags names its types as ROS 2 does, `pkg/msg/Type`."""

    def __init__(self, file: Path, allowance: Allowance) -> None:
        self.reader = Reader(file)
        self._allowance = allowance
        self._store = get_typestore(Stores.ROS2_KILTED)  # its Header lacks the count that is left out, too
        self.connections: list[Connection] = []

    def __enter__(self) -> "Ros1File":
        reader = self.reader
        reader.open()
        bounded = {decompressors["bz2"]: self._bz2, decompressors["lz4"]: self._lz4}
        for position, chunk in reader.chunks.items():
            reader.chunks[position] = chunk._replace(decompressor=bounded.get(chunk.decompressor, chunk.decompressor))
        none = MessageDefinition(MessageDefinitionFormat.NONE, "")
        self.connections = [connection._replace(msgdef=none) for connection in reader.connections]
        return self

    def __exit__(self, *_: object) -> None:
        self.reader.close()

    def messages(self, connections: Iterable[Connection]) -> Iterator[tuple[Connection, int, bytes]]:
        """Connection, log time ns, CDR."""
        wanted = [c for c in self.reader.connections if c.msgtype == READ and c.id in {c.id for c in connections}]
        if not wanted:  # rosbags takes none for all
            return
        by_id = {connection.id: connection for connection in self.connections}
        for connection, log_time, data in self.reader.messages(wanted):
            yield by_id[connection.id], log_time, bytes(self._store.ros1_to_cdr(data, READ))

    def _bz2(self, data: bytes) -> bytes:
        return self._whole(bz2.BZ2Decompressor().decompress, data)

    def _lz4(self, data: bytes) -> bytes:
        return self._whole(LZ4FrameDecompressor().decompress, data)

    def _whole(self, decompress: Callable[..., bytes], data: bytes) -> bytes:
        unpacked = decompress(data, max_length=self._allowance.left + 1)
        if len(unpacked) > self._allowance.left:
            raise TooLargeError(f"a chunk becomes more than {self._allowance.left} bytes")
        return unpacked
