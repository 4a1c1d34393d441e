# SPDX-License-Identifier: Apache-2.0
"""What may be sent to the servos: a state machine without clock, bus or ROS of its own.

    WAITING --first valid command--> ACTIVE <--fresh command / no command for `timeout`--> HOLDING
    any --limit passed or alarm told--> STOPPED --reset--> WAITING

Torque is on in ACTIVE and HOLDING only.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

from labyrinth_hw.errors import InputError
from labyrinth_hw.motors import MotorState

SPEEDING_SAMPLES = 3
VOLTAGE_SAMPLES = 5  # a dip while the motors start is no fault


class State(Enum):
    """Of the safety machine."""

    WAITING = "waiting for a first valid command, torque off"
    ACTIVE = "following commands"
    HOLDING = "no fresh command, holding still"
    STOPPED = "torque off until reset"


@dataclass(frozen=True)
class Limits:
    """What one motor may do.

    Attributes:
        angle: rad, both ways; goals are clipped to it, and a measured angle beyond it by `overshoot` stops.
        speed: rad/s; measured beyond it for three samples in a row stops.
        temperature: degC.
        voltage: V, lowest and highest.
        overshoot: rad.
    """

    angle: float = math.radians(6.0)
    speed: float = math.radians(400.0)
    temperature: float = 70.0
    voltage: tuple[float, float] = (0.0, 100.0)
    overshoot: float = math.radians(4.0)


@dataclass(frozen=True)
class Command:
    """Goals, rad, by motor; `received`: s of the steady clock that `Safety.step` is given."""

    goals: Mapping[str, float]
    received: float


@dataclass(frozen=True)
class Order:
    """What to send now: torque on or off, goals (rad) or none, and whether goals were clipped."""

    torque: bool
    goals: Mapping[str, float] | None
    clipped: tuple[str, ...] = ()


@dataclass
class Safety:
    """The machine.

    Args:
        limits: by motor.
        timeout: s after which a command is old.
        meanings: of alarm bits, by motor.
    """

    limits: Mapping[str, Limits]
    timeout: float = 0.2
    meanings: Mapping[str, Mapping[int, str]] = field(default_factory=dict)
    state: State = State.WAITING
    reasons: tuple[str, ...] = ()
    rejected: int = 0
    _goals: dict[str, float] | None = None
    _bad: dict[str, int] = field(default_factory=dict)

    def check(self, goals: Mapping[str, float]) -> None:
        """Whether goals are valid. Raises InputError that says what is wrong with them."""
        complaints = [
            f"Motor '{name}' is not on this rig; its motors: {sorted(self.limits)}."
            for name in goals
            if name not in self.limits
        ]
        complaints += [
            f"Goal of {name} must be a finite angle in rad, got {goal}."
            for name, goal in goals.items()
            if not math.isfinite(goal)
        ]
        if not goals:
            complaints.append(f"The command names no motor; expected some of {sorted(self.limits)}.")
        if complaints:
            self.rejected += 1
            raise InputError(complaints)

    def step(self, now: float, measured: Mapping[str, MotorState], command: Command | None) -> Order:
        """One control period.

        Args:
            now: s, the same clock as `Command.received`.
            measured: newest state of every motor.
            command: newest command that `check` let pass, or None.
        """
        found = tuple(self._violations(measured))
        if found:
            self.state, self.reasons = State.STOPPED, tuple(dict.fromkeys((*self.reasons, *found)))
        if self.state is State.STOPPED:
            self._goals = None
            return Order(False, None)
        fresh = command is not None and 0 <= now - command.received <= self.timeout
        if command is not None and fresh:
            self.state = State.ACTIVE
            self._goals = {
                n: max(-self.limits[n].angle, min(self.limits[n].angle, g)) for n, g in command.goals.items()
            }
            clipped = tuple(n for n, g in command.goals.items() if g != self._goals[n])
            return Order(True, self._goals, clipped)
        if self.state is State.ACTIVE:
            # Where the motors are now, not where they were told to go: motion ends here.
            self.state = State.HOLDING
            self._goals = {
                n: max(-self.limits[n].angle, min(self.limits[n].angle, m.position)) for n, m in measured.items()
            }
        return Order(self.state is State.HOLDING, self._goals)

    def stop(self, reason: str) -> None:
        """Stop for a reason that others found."""
        self.state, self.reasons = State.STOPPED, tuple(dict.fromkeys((*self.reasons, reason)))

    def lost_contact(self) -> None:
        """The bus was gone: what was ordered no longer holds. A stop stays a stop."""
        self._goals = None
        if self.state is not State.STOPPED:
            self.state = State.WAITING

    def reset(self) -> None:
        """Forget the stop; the next valid command moves again."""
        self.state, self.reasons, self._goals = State.WAITING, (), None
        self._bad.clear()

    def _violations(self, measured: Mapping[str, MotorState]) -> list[str]:
        found = []
        for name, m in measured.items():
            limit, degrees = self.limits[name], math.degrees
            for bit, text in self.meanings.get(name, {}).items():
                if m.alarm & bit:
                    found.append(f"{name}: the servo reports {text} (bit {bit:#04x})")
            if abs(m.position) > limit.angle + limit.overshoot and self.state in (State.ACTIVE, State.HOLDING):
                found.append(
                    f"{name}: {degrees(m.position):.1f} deg passed the limit of {degrees(limit.angle):.1f} deg"
                )
            if m.speed is not None and self._lasts(f"{name} speed", abs(m.speed) > limit.speed, SPEEDING_SAMPLES):
                found.append(
                    f"{name}: {degrees(m.speed):.0f} deg/s passed the limit of {degrees(limit.speed):.0f} deg/s"
                )
            if m.temperature is not None and m.temperature > limit.temperature:
                found.append(f"{name}: {m.temperature:.0f} degC passed the limit of {limit.temperature:.0f} degC")
            low, high = limit.voltage
            if m.voltage is not None and self._lasts(f"{name} volts", not low <= m.voltage <= high, VOLTAGE_SAMPLES):
                found.append(f"{name}: {m.voltage:.1f} V is outside {low:g} to {high:g} V")
        return found

    def _lasts(self, what: str, bad: bool, samples: int) -> bool:
        """Whether something has been bad for so many samples in a row."""
        self._bad[what] = self._bad.get(what, 0) + 1 if bad else 0
        return self._bad[what] >= samples
