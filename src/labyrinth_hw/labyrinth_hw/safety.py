# SPDX-License-Identifier: Apache-2.0
"""What may be sent to the servos: a state machine without clock, bus or ROS of its own.

    DISARMED --arm--> WAITING --first valid command--> ACTIVE <--fresh command / none for `timeout`--> HOLDING
    WAITING, HOLDING --silence for `disarm_after`--> DISARMED
    any --limit passed or alarm reported--> STOPPED --reset--> DISARMED

Torque is on in ACTIVE and HOLDING only. The timeout holds motor by motor: a motor whose command is old stays where it
is while others move.
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

    DISARMED = "disarmed, torque off; activate the node to arm it"
    WAITING = "armed, waiting for a first valid command, torque off"
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
class Goal:
    """Where a motor is to go, rad; `received`: s of the steady clock that `Safety.step` is given."""

    angle: float
    received: float


@dataclass(frozen=True)
class Order:
    """What to send now.

    Attributes:
        torque: on or off.
        goals: rad, of every motor; None for none.
        commanded: motors whose goal is a command, not where they hold.
        clipped: motors whose command lay beyond their limits.
    """

    torque: bool
    goals: Mapping[str, float] | None = None
    commanded: frozenset[str] = frozenset()
    clipped: frozenset[str] = frozenset()


OFF = Order(False)


@dataclass
class Safety:
    """The machine.

    Args:
        limits: by motor.
        timeout: s after which a command is old.
        disarm_after: s without a command after which it disarms itself; None never does.
        meanings: of alarm bits, by motor.
    """

    limits: Mapping[str, Limits]
    timeout: float = 0.2
    disarm_after: float | None = None
    meanings: Mapping[str, Mapping[int, str]] = field(default_factory=dict)
    state: State = field(default=State.DISARMED, init=False)
    reasons: tuple[str, ...] = field(default=(), init=False)
    _held: dict[str, float] = field(default_factory=dict, init=False)
    _armed_at: float = field(default=0.0, init=False)
    _newest: float = field(default=0.0, init=False)  # s, of the commands since it was armed
    _bad: dict[str, int] = field(default_factory=dict, init=False)

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
            raise InputError(complaints)

    def arm(self, now: float) -> None:
        """Obey commands that are received from `now` on, s. Raises InputError while stopped."""
        if self.state is State.STOPPED:
            raise InputError(f"Stopped: {'; '.join(self.reasons)}. Fix that, then call the reset service.")
        if self.state is State.DISARMED:
            self.state, self.reasons = State.WAITING, ()
            self._armed_at = self._newest = now

    def disarm(self, reason: str = "") -> None:
        """Torque off until armed again. A stop stays a stop."""
        self._held.clear()
        if self.state not in (State.STOPPED, State.DISARMED):
            self.state, self.reasons = State.DISARMED, (reason,) if reason else ()

    @property
    def armed(self) -> bool:
        """Whether a command would be obeyed."""
        return self.state not in (State.DISARMED, State.STOPPED)

    def step(self, now: float, measured: Mapping[str, MotorState], goals: Mapping[str, Goal]) -> Order:
        """One control period.

        Args:
            now: s, the same clock as `Goal.received`.
            measured: newest state of every motor.
            goals: newest of each motor that `check` let pass; motors never commanded are left out.
        """
        violations = tuple(self._violations(measured))
        if violations:
            self._held.clear()
            self.state, self.reasons = State.STOPPED, tuple(dict.fromkeys((*self.reasons, *violations)))
        if not self.armed:
            return OFF
        fresh = {name: goal for name, goal in goals.items() if self._fresh(goal, now)}
        if fresh:
            self.state = State.ACTIVE
            self._newest = max(goal.received for goal in fresh.values())
        elif self.state is State.ACTIVE:
            self.state = State.HOLDING
        elif self.disarm_after is not None and now - self._newest > self.disarm_after:
            self.disarm(f"no command for {self.disarm_after:g} s")
            return OFF
        if self.state is State.WAITING:
            return OFF
        wanted = {name: self._clip(name, goal.angle) for name, goal in fresh.items()}
        for name, motor in measured.items():
            if name in wanted:
                self._held.pop(name, None)
            else:
                # Where the motor is now, not where it was to go: motion ends here.
                self._held.setdefault(name, self._clip(name, motor.position))
        clipped = frozenset(name for name, goal in fresh.items() if goal.angle != wanted[name])
        return Order(True, {**self._held, **wanted}, frozenset(wanted), clipped)

    def lost_contact(self) -> None:
        """The bus was lost: earlier commands no longer apply, and a fresh one is needed."""
        self._held.clear()
        if self.armed:
            self.state = State.WAITING

    def reset(self) -> None:
        """Forget the stop. What was stopped is disarmed."""
        self._held.clear()
        self._bad.clear()
        if self.state is State.STOPPED:
            self.state, self.reasons = State.DISARMED, ()

    def _fresh(self, goal: Goal, now: float) -> bool:
        return goal.received >= self._armed_at and 0 <= now - goal.received <= self.timeout

    def _clip(self, name: str, angle: float) -> float:
        limit = self.limits[name].angle
        return max(-limit, min(limit, angle))

    def _violations(self, measured: Mapping[str, MotorState]) -> list[str]:
        violations = []
        for name, m in measured.items():
            limit, degrees = self.limits[name], math.degrees
            for bit, text in self.meanings.get(name, {}).items():
                if m.alarm & bit:
                    violations.append(f"{name}: the servo reports {text} (bit {bit:#04x})")
            if abs(m.position) > limit.angle + limit.overshoot and self.state in (State.ACTIVE, State.HOLDING):
                violations.append(
                    f"{name}: {degrees(m.position):.1f} deg passed the limit of {degrees(limit.angle):.1f} deg"
                )
            if m.speed is not None and self._lasts(f"{name} speed", abs(m.speed) > limit.speed, SPEEDING_SAMPLES):
                violations.append(
                    f"{name}: {degrees(m.speed):.0f} deg/s passed the limit of {degrees(limit.speed):.0f} deg/s"
                )
            if m.temperature is not None and m.temperature > limit.temperature:
                violations.append(f"{name}: {m.temperature:.0f} degC passed the limit of {limit.temperature:.0f} degC")
            low, high = limit.voltage
            if m.voltage is not None and self._lasts(f"{name} volts", not low <= m.voltage <= high, VOLTAGE_SAMPLES):
                violations.append(f"{name}: {m.voltage:.1f} V is outside {low:g} to {high:g} V")
        return violations

    def _lasts(self, what: str, bad: bool, samples: int) -> bool:
        """Whether something has been bad for so many samples in a row."""
        self._bad[what] = self._bad.get(what, 0) + 1 if bad else 0
        return self._bad[what] >= samples
