# SPDX-License-Identifier: Apache-2.0
"""The ball is brought to the middle of an open board and held there."""

import numpy as np

from transfer_tasks import ball_control
from transfer_tasks.task import RATE, Array, Control, Task

GOAL = np.array([0.138, 0.1155])  # m
ARRIVED = 1.5  # s, from when on the distance counts


def control(values: Array) -> Control:
    """Feedback to a point at rest, values (n, 4)."""
    return ball_control.to_point(values, lambda t: (GOAL, np.zeros(2)))


def cost(board: Array, ball: Array | None) -> Array:
    """(n,) m, root mean square distance from the point once the ball should be there."""
    assert ball is not None
    away = ball_control.distances(ball, GOAL)[:, round(ARRIVED * RATE) :]
    return np.asarray(np.sqrt(np.mean(away**2, axis=1)))


TASK = Task(
    name="ball, held",
    unit="mm",
    scale=1e3,
    duration=4.0,
    values=ball_control.NAMES,
    low=ball_control.LOW,
    high=ball_control.HIGH,
    start=ball_control.START,
    control=control,
    cost=cost,
    worst=ball_control.LOST,
    generations=25,
    starts=((0.118, 0.165), (0.148, 0.066)),
)
