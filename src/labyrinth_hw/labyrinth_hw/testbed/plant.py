# SPDX-License-Identifier: Apache-2.0
"""The emulated rig in motion: servos, belts and board, for any number of runs at once.

Semi-implicit Euler at half a millisecond on minimal coordinates, friction as a switching law, contact as play. Arrays
are (n, 2): rows are runs, columns the axes x and y.
"""

from types import SimpleNamespace

import numpy as np

from labyrinth_hw.testbed.board import Belt, Board
from labyrinth_hw.testbed.friction import LuGre, cogging, karnopp_step, level
from labyrinth_hw.testbed.history import History
from labyrinth_hw.testbed.parameters import Array
from labyrinth_hw.testbed.servo import WARM, Firmware, Motor, position_error

DT = 0.0005
CONTROL_EVERY = 2
PERIOD = DT * CONTROL_EVERY
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
        self.motor = Motor(q)
        self.firmware = Firmware(q, self.servo, PERIOD)
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
        self._goals = History(self.servo, PERIOD, LONGEST_DELAY)
        self._goal = self.servo.copy()
        measured = self.servo + q.error_reported * self._error()
        self._encoder = History(measured, PERIOD, LONGEST_DELAY)
        self._speeds = History(self.servo_speed, PERIOD, LONGEST_DELAY)
        self._pots = History(self.board, PERIOD, LONGEST_DELAY)
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

    def energy(self) -> Array:
        """Mechanical energy of motion and belt stretch, J, (n,)."""
        q = self.q
        beyond = q.ratio * self.servo - self.board
        beyond = beyond - np.clip(beyond, -self.belt.slack, self.belt.slack)
        parts = (
            q.rotor_inertia * self.servo_speed**2 + q.board_inertia * self.board_speed**2 + q.belt_stiffness * beyond**2
        )
        return np.asarray(0.5 * parts.sum(axis=1))

    def _measured(self) -> Array:
        if not (self._errs or self._warms):
            return self.servo
        return np.asarray(self.servo + self._error() + self._drift)

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
        self.motor.warm(q, PERIOD)
        if self._warms:
            warmed = q.thermal_warmup * -np.expm1(-(self.age[:, None] + self.time) / q.thermal_time)
            rise = warmed + np.maximum(self.motor.temperature - WARM - 5.0, 0.0)
            self._softening = np.clip(1.0 - q.thermal_friction * rise, 0.05, None)
            self._drift = q.thermal_bias * rise
        # Drift by warming is the encoder's own; the local error is not, for the reported angle has a sensor of its own.
        encoder, pot = self.servo + self.q.error_reported * self._error() + self._drift, self.board
        if self._lags:
            self._encoder_filter += (encoder - self._encoder_filter) * -np.expm1(
                -PERIOD / np.maximum(q.encoder_lag, 1e-9)
            )
            self._pot_filter += (pot - self._pot_filter) * -np.expm1(-PERIOD / np.maximum(q.pot_lag, 1e-9))
            encoder, pot = self._encoder_filter, self._pot_filter
        self._encoder.push(encoder)
        self._speeds.push(self.servo_speed)
        self._pots.push(pot)
