# SPDX-License-Identifier: Apache-2.0
"""Motors by name, and what they tell, in SI units at the joint."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import radians

from labyrinth_hw.bus_time import BLOCKS, block
from labyrinth_hw.control_tables import servo_model
from labyrinth_hw.errors import BusError, InputError
from labyrinth_hw.registers import ServoModel


@dataclass(frozen=True)
class Motor:
    """One servo on the bus.

    Attributes:
        name: joint name.
        id: bus id.
        model: its control table.
        sign: +1, or -1 where the servo is mounted the other way round.
        zero: rad of the servo at joint angle 0.
    """

    name: str
    id: int
    model: ServoModel
    sign: int = 1
    zero: float = 0.0


@dataclass(frozen=True)
class MotorState:
    """What one servo told in one answer; None where a value was not read this time.

    Attributes:
        stamp: s, `time.monotonic()` at the middle of the exchange.
        position: rad, joint side.
        speed: rad/s.
        effort: N m, nominal: the load share or the current times the manual's torque.
        voltage: V.
        temperature: degC.
        alarm: bits of the error register (see `ServoModel.shutdown`); 0 is healthy.
    """

    stamp: float
    position: float
    speed: float | None = None
    effort: float | None = None
    voltage: float | None = None
    temperature: float | None = None
    alarm: int = 0


@dataclass
class BusCounters:
    """Packets since the port was opened."""

    sent: int = 0
    lost: int = 0
    corrupt: int = 0
    retried: int = 0
    failed: int = 0
    by_motor: dict[str, int] = field(default_factory=dict)


def motors_from(config: Mapping[str, Mapping[str, object]]) -> list[Motor]:
    """Motors of a `config/hw/*.yaml`: name -> {id, model, sign, zero_deg}.

    Raises:
        InputError: unknown model, missing id; all complaints at once.
    """
    complaints, motors = [], []
    for name, entry in config.items():
        unknown = set(entry) - {"id", "model", "sign", "zero_deg"}
        if unknown:
            complaints.append(f"Motor {name}: unknown keys {sorted(unknown)}; valid are id, model, sign, zero_deg.")
        try:
            motors.append(
                Motor(
                    name=name,
                    id=int(entry["id"]),  # type: ignore[call-overload]
                    model=servo_model(str(entry["model"])),
                    sign=int(entry.get("sign", 1)),  # type: ignore[call-overload]
                    zero=radians(float(entry.get("zero_deg", 0.0))),  # type: ignore[arg-type]
                )
            )
        except KeyError as error:
            complaints.append(f"Motor {name}: {error} is missing; a motor needs at least id and model.")
        except (InputError, TypeError, ValueError) as error:
            complaints.append(f"Motor {name}: {error}")
    if complaints:
        raise InputError(complaints)
    return motors


def motor_state(motor: Motor, data: bytes, alarm: int, stamp: float) -> MotorState:
    """What the bytes of an answer mean; the answer begins where the block of positions and speeds begins.

    Raises:
        BusError: the answer is too short to hold a position.
    """
    model = motor.model
    start, _ = block(model, BLOCKS[1])

    def value(name: str) -> float | None:
        register = model.register(model.effort_register if name == "effort" else name)
        at = register.address - start
        if at < 0 or at + register.size > len(data):
            return None
        return register.to_si(int.from_bytes(data[at : at + register.size], "little"))

    position, speed, effort = (value(name) for name in BLOCKS[1])
    if position is None:
        raise BusError(f"{motor.name}: the answer holds no position, only {len(data)} bytes.")
    return MotorState(
        stamp=stamp,
        position=motor.sign * (position - motor.zero),
        speed=None if speed is None else motor.sign * speed,
        effort=None if effort is None else motor.sign * effort * model.effort_per_unit,
        voltage=value("present_voltage"),
        temperature=value("present_temperature"),
        alarm=alarm,
    )
