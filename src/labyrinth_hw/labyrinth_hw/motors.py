# SPDX-License-Identifier: Apache-2.0
"""Motors by name, and their measurements in SI units at the joint."""

from dataclasses import dataclass

from labyrinth_hw.control_tables import ServoModel
from labyrinth_hw.errors import BusError

OPERATING_MODES = {"current": 0, "position": 3, "extended_position": 4, "current_based_position": 5}  # of protocol 2
POSITION_MODES = ("position", "extended_position", "current_based_position")
BLOCKS = (
    ("present_position", "present_speed", "effort", "present_voltage", "present_temperature"),
    ("present_position", "present_speed", "effort"),
    ("present_position", "present_speed"),
    ("present_position",),
)


def block(model: ServoModel, what: tuple[str, ...]) -> tuple[int, int]:
    """First address and length of the smallest contiguous block that holds these registers."""
    names = [model.effort_register if name == "effort" else name for name in what]
    registers = [model.register(name) for name in names]
    start = min(r.address for r in registers)
    return start, max(r.address + r.size for r in registers) - start


@dataclass(frozen=True)
class CurrentLaw:
    """What a servo in current mode is driven by, once every control period: torque = K (goal - position) - C speed.

    Attributes:
        stiffness: K, N m/rad at the servo's shaft.
        damping: C, N m s/rad.
    """

    stiffness: float
    damping: float


@dataclass(frozen=True)
class Motor:
    """One servo on the bus.

    Attributes:
        name: joint name.
        id: bus id.
        model: its control table.
        sign: +1, or -1 where the servo is mounted the other way round.
        zero: rad of the servo at joint angle 0.
        operating_mode: number to be written to the servo (protocol 2); None leaves what it has.
        law: of a servo that follows currents; None for one that follows positions.
    """

    name: str
    id: int
    model: ServoModel
    sign: int = 1
    zero: float = 0.0
    operating_mode: int | None = None
    law: CurrentLaw | None = None

    def current(self, goal: float, state: "MotorState", share: float = 1.0) -> float:
        """A at the servo, signed as it counts, that its law asks for; at most `share` of the stall current.

        Args:
            goal: rad at the joint. state: what the servo measured last.
        """
        assert self.law is not None
        torque = self.law.stiffness * (goal - state.position) - self.law.damping * (state.speed or 0.0)
        most = share * self.model.stall_torque
        return self.sign * max(-most, min(most, torque)) / self.model.torque_constant


@dataclass(frozen=True)
class MotorState:
    """What one servo reported in one answer; None where a value was not read this time.

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
