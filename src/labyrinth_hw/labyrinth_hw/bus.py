# SPDX-License-Identifier: Apache-2.0
"""Servos on one bus, by name, in SI units, on top of the Dynamixel SDK.

A control cycle occupies the bus for its bytes on the wire at ten bits each, half duplex.
"""

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

from dynamixel_sdk import COMM_RX_CORRUPT, COMM_SUCCESS, GroupSyncWrite, PacketHandler

from labyrinth_hw.control_tables import PROTOCOL_2_PACKET_ERRORS, ServoModel
from labyrinth_hw.errors import BusError, InputError, PortError, unknown_name
from labyrinth_hw.motors import BLOCKS, OPERATING_MODES, POSITION_MODES, Motor, MotorState, block, motor_state
from labyrinth_hw.serial_port import GONE, Port

RETRIES = 2


def bytes_per_cycle(models: list[ServoModel], what: tuple[str, ...]) -> int:
    """Bytes on the wire to read `what` from every servo and to write every goal position in one packet."""
    lengths = [block(model, what)[1] for model in models]
    goal = models[0].register("goal_position").size
    if models[0].protocol == 1:
        grouped = len(models) > 1 and all(m.bulk_read for m in models) and len({m.name for m in models}) == 1
        request = 7 + 3 * len(models) if grouped else 8 * len(models)
        return request + sum(6 + n for n in lengths) + 8 + len(models) * (goal + 1)
    grouped = len(models) > 1 and len({m.name for m in models}) == 1
    request = 14 + len(models) if grouped else 14 * len(models)
    return request + sum(11 + n for n in lengths) + 14 + len(models) * (goal + 1)


def cycle_time(models: list[ServoModel], baud: int, period: float, share: float = 0.9) -> tuple[tuple[str, ...], float]:
    """The largest block of state that fits into a share of the period, and the seconds its cycle takes.

    Raises:
        InputError: not even positions fit; names the least baud rate.
    """
    for what in BLOCKS:
        seconds = 10 * bytes_per_cycle(models, what) / baud
        if seconds <= share * period:
            return what, seconds
    count = bytes_per_cycle(models, BLOCKS[-1])
    raise InputError(
        f"{len(models)} servos need {count} bytes a cycle, {10 * count / baud * 1e3:.1f} ms at {baud} baud, more than "
        f"{share:.0%} of the period of {period * 1e3:g} ms. Use at least {10 * count / (share * period):.0f} baud."
    )


@dataclass
class BusCounters:
    """Packets since the port was opened."""

    sent: int = 0
    lost: int = 0
    corrupt: int = 0
    retried: int = 0
    failed: int = 0


class ServoBus:
    """Named servos on one serial port.

    Args:
        path: serial device.
        baud: bits per second.
        motors: on this bus; all speak the same protocol.
        period: s, the control period that reads and writes must fit in.
        patience: s beyond the wire time before an answer counts as lost. USB adapters need their latency timer here.
    """

    def __init__(self, path: str, baud: int, motors: list[Motor], period: float = 0.01, patience: float = 0.02) -> None:
        protocols = {motor.model.protocol for motor in motors}
        if len(protocols) != 1:
            listing = ", ".join(f"{m.name}: {m.model.name} speaks {m.model.protocol}.0" for m in motors)
            raise InputError(f"All servos on one bus must speak the same protocol, got {listing or 'no servo at all'}.")
        self.motors = {motor.name: motor for motor in motors}
        self.protocol = protocols.pop()
        self.counters = BusCounters()
        self.port = Port(path, baud, patience)
        self.packets = PacketHandler(float(self.protocol))
        self.period = period
        self._state_block, self.cycle = cycle_time([m.model for m in motors], baud, period)
        self._turn = 0

    def connect(self) -> None:
        """Open the port, hold it alone, and check that every servo is there and is what was expected.

        Raises:
            PortError: port missing or in use.
            BusError: servos missing or of another model; names what was expected and what answered.
        """
        self.port.openPort()
        answered_models: dict[int, int] = {}
        for motor in self.motors.values():
            for _ in range(RETRIES + 1):
                number, result, _ = self._guarded(self.packets.ping, motor.id)
                if result == COMM_SUCCESS:
                    answered_models[motor.id] = number
                    break
        missing = [m for m in self.motors.values() if m.id not in answered_models]
        wrong = [m for m in self.motors.values() if m.id in answered_models and answered_models[m.id] != m.model.number]
        if missing or wrong:
            expected = ", ".join(
                f"{m.name}: id {m.id}, {m.model.name} ({m.model.number})" for m in self.motors.values()
            )
            answered = ", ".join(f"id {i}: model number {n}" for i, n in sorted(answered_models.items())) or "nothing"
            names = ", ".join(m.name for m in missing) or "none"
            others = ", ".join(m.name for m in wrong) or "none"
            self.port.closePort()
            raise BusError(
                f"{self.port.port_name} at {self.port.baudrate} baud, protocol {self.protocol}.0: "
                f"missing {names}; wrong model {others}. Expected {expected}. Found {answered}. "
                "Check power, cable, id, baud rate and protocol."
            )
        for name in self.motors:
            if self.read(name, "return_delay") > 0:
                self.write(name, "torque_enable", 0.0)  # it locks the register
                self.write(name, "return_delay", 0.0)

    def close(self) -> None:
        """Close the port; torque stays as it is."""
        self.port.closePort()

    def motor(self, name: str) -> Motor:
        """A motor by name. Raises InputError that lists the valid names."""
        if name not in self.motors:
            raise InputError(unknown_name("motor", name, self.motors))
        return self.motors[name]

    def read(self, name: str, register: str) -> float:
        """A register in SI units. Raises BusError after the retries."""
        motor = self.motor(name)
        entry = motor.model.register(register)
        data, _ = self._read(motor, entry.address, entry.size)
        return entry.to_si(int.from_bytes(data, "little"))

    def write(self, name: str, register: str, value: float) -> None:
        """Write a register in SI units. Raises BusError after the retries, or where the servo refuses."""
        motor = self.motor(name)
        entry = motor.model.register(register)
        raw = list(entry.to_raw(value).to_bytes(entry.size, "little"))
        why = ""
        for attempt in range(RETRIES + 1):
            result, error = self._guarded(self.packets.writeTxRx, motor.id, entry.address, entry.size, raw)
            if result == COMM_SUCCESS:
                number = error & 0x7F if self.protocol == 2 else error & 0x5C
                if number:
                    meaning = PROTOCOL_2_PACKET_ERRORS if self.protocol == 2 else motor.model.shutdown
                    why = " and ".join(
                        text
                        for bit, text in meaning.items()
                        if (number == bit or (self.protocol == 1 and number & bit))
                    )
                    raise BusError(f"{name} (id {motor.id}) refused to write {value:g} to {register}: {why or number}.")
                return
            why = self._count(motor, result, attempt)
        raise BusError(f"{name} (id {motor.id}) did not confirm {register} = {value:g} in {RETRIES + 1} tries: {why}.")

    def set_torque(self, on: bool, names: list[str] | None = None) -> None:
        """Switch torque of these motors, of all if None. Off is tried on every motor before an error is raised."""
        errors = []
        for name in names if names is not None else list(self.motors):
            try:
                self.write(name, "torque_enable", float(on))
            except (BusError, PortError) as error:
                errors.append(str(error))
        if errors:
            raise BusError(" ".join(errors))

    def arm_watchdog(self, seconds: float) -> bool:
        """Let the servos stop by themselves when no packet came for `seconds` (20 ms to 2.54 s) while torque is on.

        Clears a watchdog that has fired. Returns False where the servos have none: protocol 1. Raises BusError.
        """
        if self.protocol == 1:
            return False
        for name in self.motors:
            self.write(name, "bus_watchdog", 0.0)
            self.write(name, "bus_watchdog", min(max(seconds, 0.02), 2.54))
        return True

    def reboot(self, name: str) -> None:
        """Reboot a servo (protocol 2 only), which clears its alarm. Raises BusError where it does not confirm."""
        motor = self.motor(name)
        result, _ = self._guarded(self.packets.reboot, motor.id)
        if result != COMM_SUCCESS:
            raise BusError(f"{name} (id {motor.id}) did not reboot: {self.packets.getTxRxResult(result)}")

    @contextmanager
    def torque_disabled(self) -> Iterator[None]:
        """Torque off inside the block, and as it was afterwards."""
        before = [name for name in self.motors if self.read(name, "torque_enable") > 0]
        self.set_torque(False)
        try:
            yield
        finally:
            self.set_torque(True, before)

    def prepare(self, name: str, torque_share: float | None = None) -> None:
        """Check that a motor follows goal positions, or currents where it has a law, and limit its torque.

        The operating mode lies in the servo's EEPROM: it is written only where the motor's configuration states one and
        the servo has another. The limits lie in its RAM.

        Args:
            name: motor.
            torque_share: largest torque as a share of the maximum, 0..1; None leaves it.

        Raises:
            BusError: the servo's operating mode does not follow what will be sent, or cannot limit the torque.
        """
        motor = self.motor(name)
        model = motor.model
        if torque_share is not None and not 0 < torque_share <= 1:
            raise InputError(f"torque_share must lie in (0, 1], got {torque_share:g}.")
        if model.protocol == 1:
            self.write(name, "torque_limit", 1.0 if torque_share is None else torque_share)
            return
        mode = int(self.read(name, "operating_mode"))
        if motor.operating_mode is not None and mode != motor.operating_mode:
            with self.torque_disabled():
                self.write(name, "operating_mode", motor.operating_mode)
            mode = motor.operating_mode
        with_current = "goal_current" in model.registers
        if motor.law is not None:
            wanted = ["current"]
        else:
            wanted = ["current_based_position"] if torque_share is not None and with_current else list(POSITION_MODES)
        if mode not in (OPERATING_MODES[each] for each in wanted):
            raise BusError(
                f"{name} (id {motor.id}) is in operating mode {mode}; expected "
                f"{' or '.join(f'{OPERATING_MODES[each]} ({each})' for each in wanted)}"
                f"{_purpose(motor, torque_share is not None and with_current)}. Nothing was written: "
                f"state `operating_mode: {wanted[0]}` for this motor to have it set, or set it with the "
                "manufacturer's tool."
            )
        if motor.law is not None:
            self.write(name, "goal_current", 0.0)
        elif torque_share is not None and with_current:
            self.write(name, "goal_current", torque_share * model.stall_torque / model.torque_constant)
        elif torque_share is not None:
            self.write(name, "goal_pwm", torque_share)

    def read_states(self) -> dict[str, MotorState]:
        """Position of every motor, and what else fits into the period; voltage and temperature of one motor in turn.

        Raises:
            BusError: a motor did not answer after the retries.
            PortError: the port is gone.
        """
        names = list(self.motors)
        self._turn = (self._turn + 1) % (10 * len(names))
        full = names[self._turn // 10] if self._turn % 10 == 0 else None
        answers = self._read_all(self._state_block, skip=full)
        if full is not None:
            answers[full] = self._read_block(self.motors[full], BLOCKS[0])
        return {name: self._state(self.motors[name], *answers[name]) for name in names}

    def _state(self, motor: Motor, data: bytes, error: int, stamp: float) -> MotorState:
        if self.protocol == 1:
            return motor_state(motor, data, error, stamp)
        alarm = int(self.read(motor.name, "hardware_error")) if error & 0x80 else 0
        return motor_state(motor, data, alarm, stamp)

    def write_goals(self, goals: Mapping[str, float]) -> None:
        """Send goal positions, rad at the joint, to all named motors in one packet."""
        motors = [self.motor(name) for name in goals]
        entry = motors[0].model.register("goal_position")
        group = GroupSyncWrite(self.port, self.packets, entry.address, entry.size)
        for motor in motors:
            register = motor.model.register("goal_position")
            raw = register.to_raw(motor.sign * goals[motor.name] + motor.zero)
            group.addParam(motor.id, list(raw.to_bytes(register.size, "little")))
        self.counters.sent += 1
        result = self._guarded(group.txPacket)
        if result != COMM_SUCCESS:
            raise BusError(f"Goal positions could not be sent: {self.packets.getTxRxResult(result)}")

    def write_currents(self, goals: Mapping[str, float], states: Mapping[str, MotorState], share: float = 1.0) -> None:
        """Send to motors that follow currents what their laws ask for at these goals, rad, in one packet.

        Args:
            states: what the motors measured last.
            share: of the stall current, at most.
        """
        motors = [self.motor(name) for name in goals]
        entry = motors[0].model.register("goal_current")
        group = GroupSyncWrite(self.port, self.packets, entry.address, entry.size)
        for motor in motors:
            raw = entry.to_raw(motor.current(goals[motor.name], states[motor.name], share))
            group.addParam(motor.id, list(raw.to_bytes(entry.size, "little")))
        self.counters.sent += 1
        result = self._guarded(group.txPacket)
        if result != COMM_SUCCESS:
            raise BusError(f"Goal currents could not be sent: {self.packets.getTxRxResult(result)}")

    def _read_all(self, what: tuple[str, ...], skip: str | None) -> dict[str, tuple[bytes, int, float]]:
        motors = [motor for name, motor in self.motors.items() if name != skip]
        if (
            len(motors) < 2
            or not all(motor.model.bulk_read for motor in motors)
            or len({m.model.name for m in motors}) > 1
        ):
            return {motor.name: self._read_block(motor, what) for motor in motors}
        start, length = block(motors[0].model, what)
        self.counters.sent += 1
        begun = time.monotonic()
        if self.protocol == 1:
            # The SDK's group bulk read passes one argument too many for protocol 1; the packet handler is asked.
            request = [byte for motor in motors for byte in (length, motor.id, start)]
            result = self._guarded(self.packets.bulkReadTx, request, len(request))
        else:
            result = self._guarded(self.packets.syncReadTx, start, length, [m.id for m in motors], len(motors), False)
        answers: dict[str, tuple[bytes, int, float]] = {}
        for motor in motors if result == COMM_SUCCESS else ():
            data, result, error = self._guarded(self.packets.readRx, motor.id, length)
            if result != COMM_SUCCESS:
                self._count(motor, result, 0)
                break
            answers[motor.name] = (bytes(data), error, 0.5 * (begun + time.monotonic()))
        self.port.is_using = False
        return {m.name: answers[m.name] if m.name in answers else self._read_block(m, what) for m in motors}

    def _read_block(self, motor: Motor, what: tuple[str, ...]) -> tuple[bytes, int, float]:
        start, length = block(motor.model, what)
        begun = time.monotonic()
        data, error = self._read(motor, start, length)
        return data, error, 0.5 * (begun + time.monotonic())

    def _read(self, motor: Motor, address: int, size: int) -> tuple[bytes, int]:
        why = ""
        for attempt in range(RETRIES + 1):
            data, result, error = self._guarded(self.packets.readTxRx, motor.id, address, size)
            if result == COMM_SUCCESS and len(data) == size:
                return bytes(data), error
            why = self._count(motor, result, attempt)
        raise BusError(f"{motor.name} (id {motor.id}) did not answer in {RETRIES + 1} tries: {why}.")

    def _guarded(self, call, *arguments):  # type: ignore[no-untyped-def]  # the SDK has no types
        """Call the SDK; a port that vanished becomes a PortError."""
        bound = getattr(call, "__self__", None)
        self.counters.sent += bound is self.packets and call.__name__ not in ("readRx",)
        try:
            return call(self.port, *arguments) if bound is self.packets else call(*arguments)
        except IndexError:
            # The SDK's ping takes a late, shorter answer for its own and reads beyond its end.
            self.port.is_using = False
            return 0, COMM_RX_CORRUPT, 0
        except GONE as error:
            self.port.is_using = False
            raise PortError(f"Serial port {self.port.port_name} is gone: {error}.") from error

    def _count(self, motor: Motor, result: int, attempt: int) -> str:
        text = str(self.packets.getTxRxResult(result)).removeprefix("[TxRxResult] ").rstrip("!")
        lost = "no status packet" in text
        self.counters.lost += lost
        self.counters.corrupt += not lost
        # What is still on its way must not be taken for the answer to the next request.
        time.sleep(0.002)
        if attempt < RETRIES:
            self.counters.retried += 1
        else:
            self.counters.failed += 1
        return text


def _purpose(motor: Motor, limited: bool) -> str:
    """Why a mode is expected."""
    return " for current_law" if motor.law is not None else " for torque_share" if limited else ""
