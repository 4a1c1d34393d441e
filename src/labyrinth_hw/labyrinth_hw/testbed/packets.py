# SPDX-License-Identifier: Apache-2.0
"""Dynamixel packets as a servo sees them: instructions cut out of a byte stream, status packets made.

Written from the protocol's description (e-manual, Protocol 1.0 and 2.0), apart from the SDK, so that the two check each
other.
"""

from collections.abc import Iterator
from dataclasses import dataclass

BROADCAST = 0xFE
PING, READ, WRITE, REG_WRITE, ACTION, FACTORY_RESET, REBOOT = 1, 2, 3, 4, 5, 6, 8
STATUS, SYNC_READ, SYNC_WRITE, BULK_READ, BULK_WRITE = 0x55, 0x82, 0x83, 0x92, 0x93


@dataclass(frozen=True)
class Instruction:
    """One instruction packet.

    Attributes:
        id: addressed servo, or BROADCAST.
        code: instruction.
        parameters: bytes after the instruction.
        intact: whether its checksum was right.
    """

    id: int
    code: int
    parameters: bytes
    intact: bool = True


def _crc_table() -> tuple[int, ...]:
    table = []
    for byte in range(256):
        value = byte << 8
        for _ in range(8):
            value = (value << 1) ^ 0x8005 if value & 0x8000 else value << 1
        table.append(value & 0xFFFF)
    return tuple(table)


_CRC = _crc_table()


def crc16(data: bytes) -> int:
    """CRC-16 with polynomial 0x8005, start 0 (protocol 2.0)."""
    value = 0
    for byte in data:
        value = ((value << 8) & 0xFFFF) ^ _CRC[(value >> 8) ^ byte]
    return value


def status(protocol: int, servo: int, error: int, parameters: bytes = b"") -> bytes:
    """A status packet."""
    if protocol == 1:
        body = bytes((servo, len(parameters) + 2, error)) + parameters
        return b"\xff\xff" + body + bytes((~sum(body) & 0xFF,))
    stuffed = (bytes((STATUS, error)) + parameters).replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
    head = b"\xff\xff\xfd\x00" + bytes((servo,)) + (len(stuffed) + 2).to_bytes(2, "little") + stuffed
    return head + crc16(head).to_bytes(2, "little")


class Stream:
    """Collects bytes and cuts instruction packets out of them."""

    def __init__(self, protocol: int) -> None:
        self.protocol = protocol
        self.buffer = bytearray()

    def feed(self, data: bytes) -> Iterator[Instruction]:
        """Add bytes; yields every packet that is complete, damaged ones marked as not intact."""
        self.buffer += data
        cut = self._cut_1 if self.protocol == 1 else self._cut_2
        while (packet := cut()) is not None:
            yield packet

    def _align(self, header: bytes) -> bool:
        at = self.buffer.find(header)
        if at < 0:
            del self.buffer[: max(0, len(self.buffer) - len(header) + 1)]
            return False
        del self.buffer[:at]
        return True

    def _cut_1(self) -> Instruction | None:
        while self._align(b"\xff\xff"):
            if len(self.buffer) < 4:
                return None
            length = self.buffer[3]
            if self.buffer[2] == 0xFF or length < 2:
                del self.buffer[:1]
                continue
            if len(self.buffer) < 4 + length:
                return None
            packet = bytes(self.buffer[: 4 + length])
            intact = ~sum(packet[2:-1]) & 0xFF == packet[-1]
            # A damaged length must not swallow the packets that follow, so only the header of a damaged one goes.
            del self.buffer[: 4 + length if intact else 2]
            return Instruction(packet[2], packet[4], packet[5:-1], intact)
        return None

    def _cut_2(self) -> Instruction | None:
        while self._align(b"\xff\xff\xfd"):
            if len(self.buffer) < 7:
                return None
            length = int.from_bytes(self.buffer[5:7], "little")
            if self.buffer[3] != 0 or not 3 <= length <= 1024:
                del self.buffer[:1]
                continue
            if len(self.buffer) < 7 + length:
                return None
            packet = bytes(self.buffer[: 7 + length])
            intact = crc16(packet[:-2]) == int.from_bytes(packet[-2:], "little")
            del self.buffer[: 7 + length if intact else 3]
            body = packet[7:-2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
            return Instruction(packet[4], body[0], body[1:], intact)
        return None
