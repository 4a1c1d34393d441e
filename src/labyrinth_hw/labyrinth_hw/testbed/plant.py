# SPDX-License-Identifier: Apache-2.0
"""The emulated rig in motion: servos, belts and boards, for any number of runs at once.

Semi-implicit Euler at half a millisecond on minimal coordinates, friction as a switching law, contact as play. Arrays
are (n, 2): rows are runs, columns the axes x and y.
"""

from types import SimpleNamespace

import numpy as np

from labyrinth_hw.errors import InputError
from labyrinth_hw.testbed.quantities import Array
from labyrinth_hw.testbed.servo import (
    WARM,
    DCMotor,
    Firmware,
    LuGre,
    clipped,
    cogging,
    karnopp_step,
    level,
    position_error,
)


class History:
    """A ring of past values (n, 2), one every `step` seconds.

    Args:
        first: (n, 2), taken as the value since ever.
        step: s between values.
        span: s that can be looked back.
    """

    def __init__(self, first: Array, step: float, span: float) -> None:
        self.step = step
        self.length = int(np.ceil(span / step)) + 2
        self.ring = np.repeat(first[None], self.length, axis=0)
        self.newest = 0
        self._rows, self._columns = np.indices(first.shape)

    def push(self, value: Array) -> None:
        """Add the value of now."""
        self.newest = (self.newest + 1) % self.length
        self.ring[self.newest] = value

    def at(self, age: Array) -> Array:
        """Values `age` seconds ago, (n, 2), interpolated linearly."""
        steps = age / self.step
        whole = np.floor(steps).astype(np.intp)
        if whole.max() > self.length - 2:
            raise InputError(f"A delay of {age.max():g} s exceeds the {self.step * (self.length - 2):g} s remembered.")
        part = steps - whole
        newer = self.ring[(self.newest - whole) % self.length, self._rows, self._columns]
        older = self.ring[(self.newest - whole - 1) % self.length, self._rows, self._columns]
        return newer + part * (older - newer)

    def held(self, age: Array) -> Array:
        """Values in force `age` seconds ago, (n, 2), without interpolation."""
        whole = np.minimum(np.rint(age / self.step).astype(np.intp), self.length - 1)
        return self.ring[(self.newest - whole) % self.length, self._rows, self._columns]


MOUNT_DRAG = 0.4  # N m s/rad with which a slipping mount moves


class Belt:
    """Torque between a servo and its board axis."""

    def __init__(self, q: SimpleNamespace) -> None:
        self.slack = 0.5 * q.play
        self.slackless = not (q.play > 0).any()
        self.inner = np.zeros_like(q.play)
        self.inner_limit = q.belt_hysteresis / q.belt_hysteresis_stiffness
        self.shift = np.zeros_like(q.play)
        self.hysteretic = bool((q.belt_hysteresis > 0).any())
        self.loose = bool((q.mount_play > 0).any())
        self.crossed = bool((q.cross_axis != 0).any())

    def torque(
        self, q: SimpleNamespace, servo: Array, servo_speed: Array, board: Array, speed: Array, dt: float
    ) -> Array:
        """Torque on the board, N m. Angles rad, speeds rad/s."""
        pull, rate = q.ratio * (servo + self.shift), q.ratio * servo_speed
        if self.crossed:
            pull, rate = pull + q.cross_axis * board[:, ::-1], rate + q.cross_axis * speed[:, ::-1]
        stretch, rate = pull - board, rate - speed
        if self.slackless:
            torque = q.belt_stiffness * stretch + q.belt_damping * rate
        else:
            beyond = stretch - clipped(stretch, -self.slack, self.slack)
            torque = q.belt_stiffness * beyond + np.where(np.abs(stretch) >= self.slack, q.belt_damping * rate, 0.0)
        if self.hysteretic:
            # Prandtl's element: a spring that slips at the limit of its inner friction.
            self.inner = clipped(self.inner + dt * rate, -self.inner_limit, self.inner_limit)
            torque = torque + q.belt_hysteresis_stiffness * self.inner
        if self.loose:
            surplus = np.sign(torque) * np.maximum(np.abs(torque) - q.mount_friction, 0.0)
            self.shift = clipped(self.shift - dt * surplus / MOUNT_DRAG, -0.5 * q.mount_play, 0.5 * q.mount_play)
        return torque

    def on_board(self, q: SimpleNamespace, torque: Array) -> Array:
        """Torque on the board axes, N m: a belt led over the other axis pulls back there."""
        return torque - (q.cross_axis * torque)[:, ::-1] if self.crossed else torque


class Board:
    """Forces on the board other than the belt's; those that are zero in every rig are not computed."""

    def __init__(self, q: SimpleNamespace) -> None:
        self.unbalanced = bool((q.gravity_moment != 0).any() or (q.gravity_height != 0).any())
        self.sprung = bool((q.return_spring != 0).any())
        self.lowest_stop = float(q.stop_angle.min())

    def speed(self, q: SimpleNamespace, angle: Array, speed: Array, push: Array, dt: float) -> Array:
        """Speed of the board, rad/s, one step later.

        Args:
            angle, speed: rad, rad/s.
            push: N m of the belt and of everything else that acts.
        """
        torque = push
        if self.unbalanced:
            torque = torque - q.gravity_moment * np.cos(angle) + q.gravity_height * np.sin(angle)
        if self.sprung:
            torque = torque - q.return_spring * angle
        if np.abs(angle).max() > self.lowest_stop:
            torque = torque - q.stop_stiffness * (angle - clipped(angle, -q.stop_angle, q.stop_angle))
        return karnopp_step(speed, torque, q.board_inertia, q.board_friction, q.board_viscous, dt)


DT = 0.0005
CONTROL_EVERY = 2
CONTROL_PERIOD = DT * CONTROL_EVERY
LONGEST_DELAY = 0.4
VARYING = ("static", "load_friction", "direction_friction", "thermal_friction")


class Plant:
    """n rigs side by side.

    Args:
        q: quantities as (n, 2) arrays, from `parameters.stack`.
        start: (n, 2) rad, servo angles; the board follows them.
        age: (n,) s that each rig has been running before, for its warming.
    """

    def __init__(self, q: SimpleNamespace, start: Array, age: Array | None = None) -> None:
        self.q = q
        self.servo = start.astype(float).copy()
        self.servo_speed = np.zeros_like(self.servo)
        self.board = q.ratio * self.servo
        self.board_speed = np.zeros_like(self.servo)
        self.belt, self.tilting = Belt(q), Board(q)
        self.belt_torque = np.zeros_like(self.servo)
        self.motor = DCMotor(q)
        self.firmware = Firmware(q, self.servo, CONTROL_PERIOD)
        self.lugre = LuGre(q)
        self.torque_on = np.ones_like(self.servo, dtype=bool)
        self.push = np.zeros_like(self.servo)
        self.steps = 0
        self.age = np.zeros(len(start)) if age is None else age
        self.delay = q.command_delay.copy()
        self._cogs = bool((q.cogging != 0).any())
        self._errs = bool((q.error_amplitude != 0).any() or (q.error_slope != 0).any())
        self._warms = bool((q.thermal_warmup != 0).any())
        self._rubs = any(bool((getattr(q, name) != 0).any()) for name in VARYING)
        self._all_on = True
        self._lags = bool((q.encoder_lag > 0).any() or (q.pot_lag > 0).any())
        self._softening = np.ones_like(self.servo)
        self._drift = np.zeros_like(self.servo)
        self._goals = History(self.servo, CONTROL_PERIOD, LONGEST_DELAY)
        self._goal = self.servo.copy()
        measured = self._reported()
        self._encoder = History(measured, CONTROL_PERIOD, LONGEST_DELAY)
        self._speeds = History(self.servo_speed, CONTROL_PERIOD, LONGEST_DELAY)
        self._pots = History(self.board, CONTROL_PERIOD, LONGEST_DELAY)
        self._encoder_filter, self._pot_filter = measured.copy(), self.board.copy()

    @property
    def time(self) -> float:
        """s since the start."""
        return self.steps * DT

    def command(self, goal: Array, jitter: Array | None = None) -> None:
        """New goals, (n, 2) rad; NaN keeps the old one. `jitter` (n, 2) s is added to their delay."""
        self._goal = np.where(np.isfinite(goal), goal, self._goal)
        if jitter is not None:
            self.delay = np.clip(self.q.command_delay + jitter, 0.0, LONGEST_DELAY)

    def advance(self, periods: int) -> None:
        """Let this many control periods of 1 ms pass."""
        for _ in range(periods):
            self._control()
            for _ in range(CONTROL_EVERY):
                self._move()
            self._remember()

    def encoder(self, age: Array) -> tuple[Array, Array]:
        """Servo angle (rad) and speed (rad/s) as the servo measures them, `age` (n, 2) s ago."""
        past = age + self.q.encoder_delay
        return self._encoder.at(past), self._speeds.at(past)

    def pots(self, age: Array) -> Array:
        """Board angle (rad) as the potentiometers see it, `age` (n, 2) s ago."""
        return self._pots.at(age + self.q.pot_delay)

    def _measured(self) -> Array:
        if not (self._errs or self._warms):
            return self.servo
        return np.asarray(self.servo + self._error() + self._drift)

    def _reported(self) -> Array:
        """The angle that the servo reports, before its lag.

        Drift by warming is the encoder's own; the local error is not, for the reported angle has a sensor of its own.
        """
        if not (self._errs or self._warms):
            return self.servo
        return np.asarray(self.servo + self.q.error_reported * self._error() + self._drift)

    def _error(self) -> Array:
        return position_error(self.q, self.servo) if self._errs else np.zeros_like(self.servo)

    def _control(self) -> None:
        self._goals.push(self._goal)
        self.firmware.update(
            self.q, self._goals.held(self.delay), self._measured(), self.servo_speed, self.motor.supply
        )
        self._all_on = bool(self.torque_on.all())
        if not self._all_on:
            self.firmware.duty = np.where(self.torque_on, self.firmware.duty, 0.0)

    def _move(self) -> None:
        q, dt = self.q, DT
        self.belt_torque = self.belt.torque(q, self.servo, self.servo_speed, self.board, self.board_speed, dt)
        pull = self.belt.on_board(q, self.belt_torque) + self.push
        self.board_speed = self.tilting.speed(q, self.board, self.board_speed, pull, dt)
        load = q.ratio * self.belt_torque
        drive = self.motor.torque(q, self.firmware.duty, self.servo_speed)
        if not self._all_on:
            drive = np.where(self.torque_on, drive, 0.0)
        torque = drive - load
        if self._cogs:
            torque = torque + cogging(q, self.servo)
        dry = level(q, self.servo_speed, drive + load, self._softening) if self._rubs else q.coulomb
        if not self._all_on:
            dry = np.where(self.torque_on, dry, dry + q.idle_friction)
        if self.lugre.any:
            torque = torque - self.lugre.torque(q, self.servo_speed, dry, dt)
            dry = np.where(self.lugre.active, 0.0, dry)
        self.servo_speed = karnopp_step(self.servo_speed, torque, q.rotor_inertia, dry, q.viscous, dt)
        self.servo = self.servo + dt * self.servo_speed
        self.board = self.board + dt * self.board_speed
        self.steps += 1

    def _remember(self) -> None:
        q = self.q
        self.motor.warm(q, CONTROL_PERIOD)
        if self._warms:
            warmed = q.thermal_warmup * -np.expm1(-(self.age[:, None] + self.time) / q.thermal_time)
            rise = warmed + np.maximum(self.motor.temperature - WARM - 5.0, 0.0)
            self._softening = np.clip(1.0 - q.thermal_friction * rise, 0.05, None)
            self._drift = q.thermal_bias * rise
        encoder, pot = self._reported(), self.board
        if self._lags:
            self._encoder_filter += (encoder - self._encoder_filter) * -np.expm1(
                -CONTROL_PERIOD / np.maximum(q.encoder_lag, 1e-9)
            )
            self._pot_filter += (pot - self._pot_filter) * -np.expm1(-CONTROL_PERIOD / np.maximum(q.pot_lag, 1e-9))
            encoder, pot = self._encoder_filter, self._pot_filter
        self._encoder.push(encoder)
        self._speeds.push(self.servo_speed)
        self._pots.push(pot)
