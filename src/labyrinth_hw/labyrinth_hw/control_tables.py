# SPDX-License-Identifier: Apache-2.0
"""Control tables of the servos: registers with address, size and unit, from the makers' e-manuals.

A register's value in SI units is `(raw - offset) * unit`. `sign` says how raw negative numbers are written: "none",
"bit" (sign and magnitude, the bit above the magnitude's), or "two" (two's complement).
"""

from dataclasses import dataclass
from math import pi

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
        name, number: model name and model number, as a ping reports it.
        protocol: 1 or 2.
        registers: by name; the names are the same for all models where the meaning is.
        bulk_read: whether the firmware knows bulk read (protocol 1: MX only) and sync read (protocol 2: all).
        stall_torque: N m at the nominal voltage; turns a load share into a nominal torque.
        torque_constant: N m per A at the output; 0 where the servo reports no current.
        voltage: nominal V.
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
        """The register that the effort is read from: the load share if there is one, next to the position."""
        return "present_load" if "present_load" in self.registers else "present_current"

    @property
    def effort_per_unit(self) -> float:
        """N m (nominal) per SI unit of the effort register."""
        return self.torque_constant if self.effort_register == "present_current" else self.stall_torque


RPM = 2 * pi / 60  # rad/s

PROTOCOL_1_ERRORS = {
    0x01: "input voltage out of range",
    0x02: "goal angle beyond the angle limits",
    0x04: "overheating: internal temperature above its limit",
    0x08: "value out of range",
    0x10: "instruction checksum wrong",
    0x20: "overload: the load exceeds the maximum torque",
    0x40: "instruction unknown",
}
PROTOCOL_2_HARDWARE_ERRORS = {
    0x01: "input voltage out of range",
    0x04: "overheating: internal temperature above its limit",
    0x08: "motor encoder malfunction",
    0x10: "electrical shock or insufficient power",
    0x20: "overload: persistent load above the maximum output",
}
PROTOCOL_2_PACKET_ERRORS = {
    1: "result fail",
    2: "instruction unknown",
    3: "CRC wrong",
    4: "value out of range",
    5: "data length wrong",
    6: "value beyond its limit",
    7: "register is read-only, or locked while torque is on",
}


def _protocol_1(
    model: int, ticks: int, turn: float, speed: float, *, gains: bool, current: bool
) -> dict[str, Register]:
    """DX and MX servos: one byte addresses; sign and magnitude; position counts from one end, zero in the middle."""
    tick, middle = turn / ticks, ticks // 2
    table = {
        "model_number": Register(0, 2, initial=model),
        "firmware_version": Register(2, 1, initial=40),
        "id": Register(3, 1, writable=True, eeprom=True, initial=1),
        "baud_rate": Register(4, 1, writable=True, eeprom=True, initial=34),
        "return_delay": Register(5, 1, 2e-6, writable=True, eeprom=True, initial=250),
        "min_position": Register(6, 2, tick, offset=middle, writable=True, eeprom=True, initial=0),
        "max_position": Register(8, 2, tick, offset=middle, writable=True, eeprom=True, initial=ticks - 1),
        "temperature_limit": Register(11, 1, writable=True, eeprom=True, initial=80),
        "min_voltage": Register(12, 1, 0.1, writable=True, eeprom=True, initial=90),
        "max_voltage": Register(13, 1, 0.1, writable=True, eeprom=True, initial=180),
        "max_torque": Register(14, 2, 1 / 1023, writable=True, eeprom=True, initial=1023),
        "status_return_level": Register(16, 1, writable=True, eeprom=True, initial=2),
        "alarm_led": Register(17, 1, writable=True, eeprom=True, initial=36),
        "shutdown": Register(18, 1, writable=True, eeprom=True, initial=36),
        "torque_enable": Register(24, 1, writable=True),
        "led": Register(25, 1, writable=True),
        "goal_position": Register(30, 2, tick, offset=middle, writable=True, initial=middle),
        "goal_speed": Register(32, 2, speed, writable=True),
        "torque_limit": Register(34, 2, 1 / 1023, writable=True, initial=1023),
        "present_position": Register(36, 2, tick, offset=middle, initial=middle),
        "present_speed": Register(38, 2, speed, "bit"),
        "present_load": Register(40, 2, 1 / 1023, "bit"),
        "present_voltage": Register(42, 1, 0.1, initial=120),
        "present_temperature": Register(43, 1, initial=30),
        "registered": Register(44, 1),
        "moving": Register(46, 1),
        "lock": Register(47, 1, writable=True),
        "punch": Register(48, 2, 1 / 1023, writable=True, initial=32 if not gains else 0),
    }
    if gains:
        table |= {
            "d_gain": Register(26, 1, 4 / 1000, writable=True),
            "i_gain": Register(27, 1, 1000 / 2048, writable=True),
            "p_gain": Register(28, 1, 1 / 8, writable=True, initial=32),
        }
    else:
        table |= {
            "cw_compliance_margin": Register(26, 1, tick, writable=True, initial=1),
            "ccw_compliance_margin": Register(27, 1, tick, writable=True, initial=1),
            "cw_compliance_slope": Register(28, 1, tick, writable=True, initial=32),
            "ccw_compliance_slope": Register(29, 1, tick, writable=True, initial=32),
        }
    if current:
        table |= {
            "present_current": Register(68, 2, 4.5e-3, offset=2048, initial=2048),
            "torque_control_mode": Register(70, 1, writable=True),
            "goal_torque": Register(71, 2, 4.5e-3, "bit", writable=True),
        }
    return table


def _protocol_2(model: int, *, current: float | None, volts: tuple[int, int], p_gain: int) -> dict[str, Register]:
    """MX (2.0), XL330 and XL430: two byte addresses, two's complement, 4096 counts per turn, zero at 2048."""
    tick, speed = 2 * pi / 4096, 0.229 * RPM
    table = {
        "model_number": Register(0, 2, initial=model),
        "model_information": Register(2, 4),
        "firmware_version": Register(6, 1, initial=45),
        "id": Register(7, 1, writable=True, eeprom=True, initial=1),
        "baud_rate": Register(8, 1, writable=True, eeprom=True, initial=1),
        "return_delay": Register(9, 1, 2e-6, writable=True, eeprom=True, initial=250),
        "drive_mode": Register(10, 1, writable=True, eeprom=True),
        "operating_mode": Register(11, 1, writable=True, eeprom=True, initial=3),
        "homing_offset": Register(20, 4, tick, "two", writable=True, eeprom=True),
        "moving_threshold": Register(24, 4, speed, writable=True, eeprom=True, initial=10),
        "temperature_limit": Register(31, 1, writable=True, eeprom=True, initial=70),
        "max_voltage": Register(32, 2, 0.1, writable=True, eeprom=True, initial=volts[1]),
        "min_voltage": Register(34, 2, 0.1, writable=True, eeprom=True, initial=volts[0]),
        "pwm_limit": Register(36, 2, 1 / 885, writable=True, eeprom=True, initial=885),
        "velocity_limit": Register(44, 4, speed, writable=True, eeprom=True, initial=300),
        "max_position": Register(48, 4, tick, offset=2048, writable=True, eeprom=True, initial=4095),
        "min_position": Register(52, 4, tick, offset=2048, writable=True, eeprom=True, initial=0),
        "shutdown": Register(63, 1, writable=True, eeprom=True, initial=0x34),
        "torque_enable": Register(64, 1, writable=True),
        "led": Register(65, 1, writable=True),
        "status_return_level": Register(68, 1, writable=True, initial=2),
        "registered": Register(69, 1),
        "hardware_error": Register(70, 1),
        "velocity_i_gain": Register(76, 2, 1 / 65536, writable=True, initial=1920),
        "velocity_p_gain": Register(78, 2, 1 / 128, writable=True, initial=100),
        "d_gain": Register(80, 2, 1 / 16, writable=True),
        "i_gain": Register(82, 2, 1 / 65536, writable=True),
        "p_gain": Register(84, 2, 1 / 128, writable=True, initial=p_gain),
        "bus_watchdog": Register(98, 1, 20e-3, "two", writable=True),
        "goal_pwm": Register(100, 2, 1 / 885, "two", writable=True, initial=885),
        "goal_velocity": Register(104, 4, speed, "two", writable=True),
        "profile_acceleration": Register(108, 4, writable=True),
        "profile_velocity": Register(112, 4, speed, writable=True),
        "goal_position": Register(116, 4, tick, "two", 2048, writable=True, initial=2048),
        "realtime_tick": Register(120, 2, 1e-3),
        "moving": Register(122, 1),
        "present_pwm": Register(124, 2, 1 / 885, "two"),
        "present_speed": Register(128, 4, speed, "two"),
        "present_position": Register(132, 4, tick, "two", 2048, initial=2048),
        "present_voltage": Register(144, 2, 0.1, initial=120),
        "present_temperature": Register(146, 1, initial=30),
    }
    if current is None:
        table["present_load"] = Register(126, 2, 1e-3, "two")
    else:
        table |= {
            "current_limit": Register(38, 2, current, writable=True, eeprom=True, initial=1750),
            "goal_current": Register(102, 2, current, "two", writable=True, initial=1750),
            "present_current": Register(126, 2, current, "two"),
        }
    return table


def _servo(
    name: str, number: int, protocol: int, registers: dict[str, Register], figures: tuple[float, float, float]
) -> ServoModel:
    """figures: stall torque N m, torque constant N m/A (0 without current sensing), nominal V."""
    torque, constant, volts = figures
    return ServoModel(
        name=name,
        number=number,
        protocol=protocol,
        registers=registers,
        bulk_read=name != "DX-117",
        stall_torque=torque,
        torque_constant=constant,
        voltage=volts,
        shutdown=PROTOCOL_1_ERRORS if protocol == 1 else PROTOCOL_2_HARDWARE_ERRORS,
    )


def _models() -> dict[str, ServoModel]:
    ten_bit, twelve_bit = (1024, 300 * pi / 180), (4096, 2 * pi)
    speed = 0.114 * RPM
    mx64, mx106 = (6.0, 1.46, 12.0), (8.4, 1.62, 12.0)
    mx_volts, xl330_volts = (95, 160), (35, 70)
    models = (
        _servo(
            "DX-117",
            117,
            1,
            _protocol_1(117, *ten_bit, 0.111 * RPM, gains=False, current=False),
            (3.85, 0.0, 16.0),
        ),
        _servo(
            "MX-12W",
            360,
            1,
            _protocol_1(360, *twelve_bit, 0.916 * RPM, gains=True, current=False),
            (0.2, 0.0, 12.0),
        ),
        _servo("MX-64", 310, 1, _protocol_1(310, *twelve_bit, speed, gains=True, current=True), mx64),
        _servo("MX-106", 320, 1, _protocol_1(320, *twelve_bit, speed, gains=True, current=True), mx106),
        _servo("MX-64-2", 311, 2, _protocol_2(311, current=3.36e-3, volts=mx_volts, p_gain=850), mx64),
        _servo("MX-106-2", 321, 2, _protocol_2(321, current=3.36e-3, volts=mx_volts, p_gain=850), mx106),
        _servo(
            "XL330-M077",
            1190,
            2,
            _protocol_2(1190, current=1e-3, volts=xl330_volts, p_gain=400),
            (0.215, 0.146, 5.0),
        ),
        _servo(
            "XL330-M288",
            1200,
            2,
            _protocol_2(1200, current=1e-3, volts=xl330_volts, p_gain=400),
            (0.52, 0.354, 5.0),
        ),
        _servo(
            "XL430-W250",
            1060,
            2,
            _protocol_2(1060, current=None, volts=(65, 120), p_gain=800),
            (1.4, 0.0, 11.1),
        ),
    )
    return {model.name: model for model in models}


MODELS = _models()


def servo_model(name: str) -> ServoModel:
    """A servo model by name. Raises InputError that lists the valid names."""
    if name not in MODELS:
        raise InputError(unknown_name("servo model", name, MODELS))
    return MODELS[name]
