# SPDX-License-Identifier: Apache-2.0
"""Servos that answer Dynamixel packets from their control tables, protocol 1.0 and 2.0.

Written from the protocol's description (e-manual), apart from the SDK, so that the two check each other.
"""

from collections.abc import Iterator
from dataclasses import dataclass

from labyrinth_hw.control_tables import Register, ServoModel

BROADCAST = 0xFE
PING, READ, WRITE, REG_WRITE, ACTION, REBOOT = 1, 2, 3, 4, 5, 8
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


def status_packet(protocol: int, servo: int, error: int, parameters: bytes = b"") -> bytes:
    """A status packet."""
    if protocol == 1:
        body = bytes((servo, len(parameters) + 2, error)) + parameters
        return b"\xff\xff" + body + bytes((~sum(body) & 0xFF,))
    stuffed = (bytes((STATUS, error)) + parameters).replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
    head = b"\xff\xff\xfd\x00" + bytes((servo,)) + (len(stuffed) + 2).to_bytes(2, "little") + stuffed
    return head + crc16(head).to_bytes(2, "little")


class InstructionStream:
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


E1_RANGE, E1_CHECKSUM, E1_INSTRUCTION = 0x08, 0x10, 0x40
E2_INSTRUCTION, E2_CRC, E2_RANGE, E2_ACCESS, E2_ALERT = 2, 3, 4, 7, 0x80
CURRENT_MODE = 0
FIRED = 0xFF  # what the watchdog's register holds once it has stopped the motor


@dataclass
class Answer:
    """A status packet and how long the servo waits before it sends it, s."""

    data: bytes
    delay: float


class EmulatedServo:
    """One servo's registers.

    Args:
        model: control table.
        id: on the bus.
    """

    def __init__(self, model: ServoModel, id: int) -> None:
        self.model = model
        self.memory = bytearray(256)
        self.alarm = 0
        self._pending: tuple[int, bytes] | None = None
        self._goals = [register for name, register in model.registers.items() if name.startswith("goal_")]
        self.power_up()
        self.set("id", id)

    def power_up(self) -> None:
        """Every register as the factory set it."""
        self.memory[:] = bytes(len(self.memory))
        self.alarm = 0
        for register in self.model.registers.values():
            self._store(register, register.initial)

    def get(self, name: str) -> float:
        """A register in SI units."""
        register = self.model.register(name)
        return register.to_si(self.raw(name))

    def raw(self, name: str) -> int:
        """A register as counts."""
        r = self.model.register(name)
        return int.from_bytes(self.memory[r.address : r.address + r.size], "little")

    def set(self, name: str, value: float) -> None:
        """Set a register from SI units, as the firmware does."""
        register = self.model.register(name)
        self._store(register, register.to_raw(value))

    def _store(self, register: Register, raw: int) -> None:
        self.memory[register.address : register.address + register.size] = raw.to_bytes(register.size, "little")

    @property
    def id(self) -> int:
        """Bus id."""
        return self.raw("id")

    @property
    def torque_on(self) -> bool:
        """Whether the motor is driven."""
        return bool(self.raw("torque_enable"))

    @property
    def follows_current(self) -> bool:
        """Whether its EEPROM says that it follows currents."""
        return "goal_current" in self.model.registers and self.raw("operating_mode") == CURRENT_MODE

    def raise_alarm(self, bits: int) -> None:
        """Set hardware error bits; those in the shutdown register switch torque off until power-up or reset."""
        self.alarm |= bits
        if self.model.protocol == 2:
            self._store(self.model.register("hardware_error"), self.alarm)
        if bits & self.raw("shutdown"):
            self._store(self.model.register("torque_enable"), 0)

    def clear_alarm(self) -> None:
        """What a reboot does to the alarm."""
        self.alarm = 0
        if self.model.protocol == 2:
            self._store(self.model.register("hardware_error"), 0)

    def watch(self, silence: float) -> None:
        """Protocol 2: stop where the motor is once the bus was silent for longer than the watchdog allows, s."""
        if self.model.protocol == 1 or not self.torque_on:
            return
        allowed = self.raw("bus_watchdog")
        if 0 < allowed < 0x80 and silence > self.get("bus_watchdog"):
            self._store(self.model.register("bus_watchdog"), FIRED)
            self._store(self.model.register("goal_position"), self.raw("present_position"))
            if self.follows_current:
                self.set("goal_current", 0.0)

    def read(self, address: int, size: int) -> bytes:
        """Bytes of the control table."""
        return bytes(self.memory[address : address + size])

    def write(self, address: int, data: bytes) -> int:
        """Write bytes as an instruction would. Returns the error number (0 is none)."""
        two = self.model.protocol == 2
        end = address + len(data)
        touched = [r for r in self.model.registers.values() if r.address < end and address < r.address + r.size]
        if end > len(self.memory) or any(not r.writable for r in touched) or not touched:
            return E2_ACCESS if two else E1_RANGE
        if two and self.torque_on and any(r.eeprom for r in touched):
            return E2_ACCESS
        if two and self.raw("bus_watchdog") == FIRED and any(r in self._goals for r in touched):
            return E2_RANGE
        enable = self.model.register("torque_enable").address
        if address <= enable < end and data[enable - address] and self.alarm & self.raw("shutdown"):
            return E2_ACCESS if two else 0
        self.memory[address:end] = data
        return 0

    def status(self, error: int, parameters: bytes = b"") -> Answer:
        """A status packet with the error of this instruction and the alarm bits."""
        flags = error | self.alarm if self.model.protocol == 1 else error | (E2_ALERT if self.alarm else 0)
        delay = self.get("return_delay")
        return Answer(status_packet(self.model.protocol, self.id, flags, parameters), delay)


class EmulatedBus:
    """Servos of one protocol on one line.

    Args:
        servos: on this bus.
    """

    def __init__(self, servos: list[EmulatedServo]) -> None:
        self.servos = servos
        self.protocol = servos[0].model.protocol
        self.stream = InstructionStream(self.protocol)
        self.received = 0

    def feed(self, data: bytes) -> Iterator[Answer]:
        """Bytes from the host; yields the answers in the order in which they are sent."""
        for instruction in self.stream.feed(data):
            self.received += 1
            yield from self._answer(instruction)

    def _answer(self, instruction: Instruction) -> Iterator[Answer]:
        code, parameters = instruction.code, instruction.parameters
        by_id = {servo.id: servo for servo in self.servos}
        if not instruction.intact:
            if instruction.id in by_id:
                yield by_id[instruction.id].status(E1_CHECKSUM if self.protocol == 1 else E2_CRC)
        elif code == SYNC_WRITE:
            self._sync_write(by_id, parameters)
        elif code == SYNC_READ and self.protocol == 2:
            start, size = int.from_bytes(parameters[:2], "little"), int.from_bytes(parameters[2:4], "little")
            yield from self._reads(by_id, [(servo, start, size) for servo in parameters[4:]])
        elif code == BULK_READ:
            yield from self._reads(by_id, self._bulk(parameters))
        elif code == BULK_WRITE and self.protocol == 2:
            self._bulk_write(by_id, parameters)
        elif code == ACTION:
            for servo in self.servos:
                if servo._pending is not None:
                    servo.write(*servo._pending)
                    servo._pending = None
        else:
            for servo in self.servos:
                if instruction.id in (servo.id, BROADCAST):
                    answer = self._single(servo, code, parameters)
                    if answer is not None and (instruction.id != BROADCAST or (code == PING and self.protocol == 2)):
                        yield answer

    def _single(self, servo: EmulatedServo, code: int, parameters: bytes) -> Answer | None:
        level = servo.raw("status_return_level")
        wide = 2 if self.protocol == 2 else 1
        if code == PING:
            model = servo.read(0, 2) + bytes((servo.raw("firmware_version"),))
            return servo.status(0, model if self.protocol == 2 else b"")
        if code == READ:
            size = int.from_bytes(parameters[wide:], "little")
            return (
                servo.status(0, servo.read(int.from_bytes(parameters[:wide], "little"), size)) if level >= 1 else None
            )
        if code in (WRITE, REG_WRITE):
            address, data = int.from_bytes(parameters[:wide], "little"), parameters[wide:]
            if code == REG_WRITE:
                servo._pending, error = (address, data), 0
            else:
                error = servo.write(address, data)
            return servo.status(error) if level >= 2 else None
        if code == REBOOT and self.protocol == 2:
            servo.clear_alarm()
            servo.set("torque_enable", 0)
            return servo.status(0) if level >= 2 else None
        return servo.status(E1_INSTRUCTION if self.protocol == 1 else E2_INSTRUCTION)

    def _bulk(self, parameters: bytes) -> list[tuple[int, int, int]]:
        if self.protocol == 1:
            triples = [parameters[i : i + 3] for i in range(1, len(parameters) - 2, 3)]
            return [(servo, start, size) for size, servo, start in triples]
        fives = [parameters[i : i + 5] for i in range(0, len(parameters) - 4, 5)]
        return [(p[0], int.from_bytes(p[1:3], "little"), int.from_bytes(p[3:5], "little")) for p in fives]

    def _reads(self, by_id: dict[int, EmulatedServo], wanted: list[tuple[int, int, int]]) -> Iterator[Answer]:
        for id_, start, size in wanted:
            if id_ not in by_id:
                return  # each servo waits for the one before it, so a missing one silences the rest
            if by_id[id_].model.bulk_read:
                yield by_id[id_].status(0, by_id[id_].read(start, size))

    def _sync_write(self, by_id: dict[int, EmulatedServo], parameters: bytes) -> None:
        wide = 2 if self.protocol == 2 else 1
        start, size = int.from_bytes(parameters[:wide], "little"), int.from_bytes(parameters[wide : 2 * wide], "little")
        for i in range(2 * wide, len(parameters) - size, size + 1):
            if parameters[i] in by_id:
                by_id[parameters[i]].write(start, parameters[i + 1 : i + 1 + size])

    def _bulk_write(self, by_id: dict[int, EmulatedServo], parameters: bytes) -> None:
        at = 0
        while at + 5 <= len(parameters):
            start, size = (int.from_bytes(parameters[at + i : at + i + 2], "little") for i in (1, 3))
            if parameters[at] in by_id:
                by_id[parameters[at]].write(start, parameters[at + 5 : at + 5 + size])
            at += 5 + size
