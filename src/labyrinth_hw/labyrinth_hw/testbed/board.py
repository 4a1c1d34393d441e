# SPDX-License-Identifier: Apache-2.0
"""Belt and board: a stiff or soft belt with play and inner friction, an unbalanced board between end stops."""

from types import SimpleNamespace

import numpy as np

from labyrinth_hw.testbed.friction import karnopp_step
from labyrinth_hw.testbed.parameters import Array

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
            beyond = stretch - np.clip(stretch, -self.slack, self.slack)
            torque = q.belt_stiffness * beyond + np.where(np.abs(stretch) >= self.slack, q.belt_damping * rate, 0.0)
        if self.hysteretic:
            # Prandtl's element: a spring that slips at the limit of its inner friction.
            self.inner = np.clip(self.inner + dt * rate, -self.inner_limit, self.inner_limit)
            torque = torque + q.belt_hysteresis_stiffness * self.inner
        if self.loose:
            surplus = np.sign(torque) * np.maximum(np.abs(torque) - q.mount_friction, 0.0)
            self.shift = np.clip(self.shift - dt * surplus / MOUNT_DRAG, -0.5 * q.mount_play, 0.5 * q.mount_play)
        return torque

    def on_board(self, q: SimpleNamespace, torque: Array) -> Array:
        """Torque on the board axes, N m: a belt led over the other axis pulls back there."""
        return torque - (q.cross_axis * torque)[:, ::-1] if self.crossed else torque


class Board:
    """What acts on the board besides the belt; forces that are nowhere at work are left out of the reckoning."""

    def __init__(self, q: SimpleNamespace) -> None:
        self.unbalanced = bool((q.gravity_moment != 0).any() or (q.gravity_height != 0).any())
        self.sprung = bool((q.return_spring != 0).any())
        self.lowest_stop = float(q.stop_angle.min())

    def speed(self, q: SimpleNamespace, angle: Array, speed: Array, push: Array, dt: float) -> Array:
        """Speed of the board, rad/s, one step later.

        Args:
            angle, speed: rad, rad/s.
            push: N m of the belt and of whatever else acts.
        """
        torque = push
        if self.unbalanced:
            torque = torque - q.gravity_moment * np.cos(angle) + q.gravity_height * np.sin(angle)
        if self.sprung:
            torque = torque - q.return_spring * angle
        if np.abs(angle).max() > self.lowest_stop:
            torque = torque - q.stop_stiffness * (angle - np.clip(angle, -q.stop_angle, q.stop_angle))
        return karnopp_step(speed, torque, q.board_inertia, q.board_friction, q.board_viscous, dt)
