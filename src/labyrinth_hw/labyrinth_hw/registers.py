# SPDX-License-Identifier: Apache-2.0
"""What a control table is: registers with address, size and unit, and the servo they belong to.

A register's value in SI units is `(raw - offset) * unit`. `sign` tells how raw negative numbers are written: "none",
"bit" (sign and magnitude, the bit above the magnitude's), or "two" (two's complement).
"""

from dataclasses import dataclass

from labyrinth_hw.errors import InputError, unknown_name


@dataclass(frozen=True)
class Register:
    """One entry of a control table.

    Attributes:
        address: first byte.
        size: bytes, little-endian.
        unit: SI units per count (rad, rad/s, V, degC, A, s; 1 for plain numbers, shares of the maximum 0..1).
        sign: "none", "bit" or "two".
        offset: raw count that means zero.
        writable: whether a write is allowed.
        eeprom: writable only while torque is off.
        initial: raw value after power-up.
    """

    address: int
    size: int
    unit: float = 1.0
    sign: str = "none"
    offset: int = 0
    writable: bool = False
    eeprom: bool = False
    initial: int = 0

    def to_si(self, raw: int) -> float:
        """SI value of a raw register content."""
        if self.sign == "two" and raw >= 1 << (8 * self.size - 1):
            raw -= 1 << (8 * self.size)
        elif self.sign == "bit":
            raw = -(raw & 0x3FF) if raw & 0x400 else raw & 0x3FF
        return (raw - self.offset) * self.unit

    def to_raw(self, value: float) -> int:
        """Nearest raw register content, clipped to what the register can hold."""
        count = round(value / self.unit) + self.offset
        if self.sign == "two":
            half = 1 << (8 * self.size - 1)
            return max(-half, min(half - 1, count)) % (1 << (8 * self.size))
        if self.sign == "bit":
            return min(abs(count), 0x3FF) | (0x400 if count < 0 else 0)
        return max(0, min((1 << (8 * self.size)) - 1, count))


@dataclass(frozen=True)
class ServoModel:
    """One servo with one protocol.

    Attributes:
        name, number: model name and model number, as a ping tells it.
        protocol: 1 or 2.
        registers: by name; the names are the same for all models where the meaning is.
        bulk_read: whether the firmware knows bulk read (protocol 1: MX only) and sync read (protocol 2: all).
        stall_torque: N m at the nominal voltage; turns a load share into a nominal torque.
        torque_constant: N m per A at the output; 0 where the servo reports no current.
        voltage: nominal V.
        no_load_speed: rad/s at the nominal voltage.
        shutdown: names of the bits of the error or hardware error register.
    """

    name: str
    number: int
    protocol: int
    registers: dict[str, Register]
    bulk_read: bool
    stall_torque: float
    torque_constant: float
    voltage: float
    no_load_speed: float
    shutdown: dict[int, str]

    def register(self, name: str) -> Register:
        """A register by name. Raises InputError that lists the valid names."""
        if name not in self.registers:
            raise InputError(unknown_name(f"{self.name} register", name, self.registers))
        return self.registers[name]

    @property
    def tick(self) -> float:
        """rad per encoder count."""
        return self.registers["present_position"].unit

    @property
    def effort_register(self) -> str:
        """The register that the effort is read from: the load share where there is one, beside the position."""
        return "present_load" if "present_load" in self.registers else "present_current"

    @property
    def effort_per_unit(self) -> float:
        """N m (nominal) per SI unit of the effort register."""
        return self.torque_constant if self.effort_register == "present_current" else self.stall_torque
