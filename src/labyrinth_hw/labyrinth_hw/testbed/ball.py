# SPDX-License-Identifier: Apache-2.0
"""The ball on the board: rolling down the tilt, held by walls, lost in holes. For any number of runs at once.

A ball that rolls without slipping on a tilted plane accelerates with 5/7 g sin(tilt). Positive `board_y` moves it to
+x, positive `board_x` to -y. Walls are boxes; the ball is a disc that bounces off the nearest point of each.
"""

from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray

from labyrinth_hw.testbed.quantities import Array
from labyrinth_hw.testbed.scene import Layout

GRAVITY = 9.81  # m/s^2
ROLLING = 5.0 / 7.0
SLOW = 0.004  # m/s below which a bounce ends


class Ball:
    """n balls on boards of one layout.

    Args:
        q: quantities; rolling_friction, restitution and not_level are used.
        layout: walls and holes, m.
        start: (n, 2) m, board frame.
    """

    def __init__(self, q: SimpleNamespace, layout: Layout, start: Array) -> None:
        self.q, self.radius = q, layout.ball_radius
        self.position = start.astype(float).copy()
        self.speed = np.zeros_like(self.position)
        boxes = np.array(layout.walls, dtype=float).reshape(-1, 4)
        self._low, self._high = boxes[:, :2], boxes[:, 2:]
        self._holes = np.array(layout.holes, dtype=float).reshape(-1, 2)
        self._hole_radius = layout.hole_radius
        self._size = np.array(layout.board, dtype=float)
        self.lost = np.zeros(len(start), dtype=bool)
        self.hole: NDArray[np.int_] = np.full(len(start), -1)

    def place(self, run: int, position: Array) -> None:
        """Put one ball at a position (2,), at rest."""
        self.position[run], self.speed[run], self.lost[run], self.hole[run] = position, 0.0, False, -1

    def step(self, board: Array, dt: float) -> None:
        """Roll for `dt` s on boards at these angles, (n, 2) rad."""
        tilt = board + self.q.not_level
        pull = ROLLING * GRAVITY * np.stack([np.sin(tilt[:, 1]), -np.sin(tilt[:, 0])], axis=1)
        free = self.speed + dt * pull
        # Rolling resistance holds a ball at rest and never pushes it.
        drag = dt * ROLLING * GRAVITY * self.q.rolling_friction[:, :1]
        size = np.linalg.norm(free, axis=1, keepdims=True)
        self.speed = free * np.maximum(0.0, 1.0 - drag / np.maximum(size, 1e-12))
        self.position = self.position + dt * self.speed
        self._bounce()
        self._fall()
        self.speed[self.lost] = 0.0

    def _bounce(self) -> None:
        self._off(np.clip(self.position, self.radius, self._size - self.radius) - self.position)
        if len(self._low):
            near = np.clip(self.position[:, None, :], self._low, self._high)
            away = self.position[:, None, :] - near
            distance = np.linalg.norm(away, axis=2)
            # Two walls may touch the ball in a corner; the deepest goes first, the other one in the next step.
            wall = distance.argmin(axis=1)
            rows = np.arange(len(wall))
            gap = distance[rows, wall][:, None]
            normal = away[rows, wall] / np.maximum(gap, 1e-9)
            self._off(np.where((gap < self.radius) & (gap > 0), (self.radius - gap) * normal, 0.0))

    def _off(self, push: Array) -> None:
        """Move balls out of what they touch by `push` (n, 2) m and turn their speed back."""
        depth = np.linalg.norm(push, axis=1, keepdims=True)
        normal = np.where(depth > 0, push / np.maximum(depth, 1e-12), 0.0)
        into = np.minimum((self.speed * normal).sum(axis=1, keepdims=True), 0.0)
        bounce = np.where(into < -SLOW, self.q.restitution[:, :1], 0.0)
        self.position = self.position + push
        self.speed = self.speed - (1.0 + bounce) * into * normal

    def _fall(self) -> None:
        if not len(self._holes):
            return
        distance = np.linalg.norm(self.position[:, None, :] - self._holes, axis=2)
        fallen = (distance.min(axis=1) < self._hole_radius) & ~self.lost
        self.hole = np.where(fallen, distance.argmin(axis=1) + 1, self.hole)
        self.lost |= fallen
