# SPDX-License-Identifier: Apache-2.0
"""The ball is rolled along the first stretch of the maze's path, past holes, behind a point that moves evenly."""

import numpy as np

from transfer_tasks import ball_control
from transfer_tasks.task import RATE, Array, Control, Task

PATH = np.array([(0.09, 0.2205), (0.057, 0.2205), (0.057, 0.16), (0.072, 0.144), (0.072, 0.105)])  # m
PACE = 0.045  # m/s
ROUND = (
    PATH[0, 0] - PATH[1, 0]
) / PACE  # s, when the point is round the first corner; from there on the distance counts
_AT = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(PATH, axis=0), axis=1))])  # m along the path


def points(t: Array) -> Array:
    """(T, 2) m where the ball should be at times (T,) s."""
    along = np.minimum(PACE * t, _AT[-1])
    return np.column_stack([np.interp(along, _AT, PATH[:, i]) for i in range(2)])


def _goal(t: float) -> tuple[Array, Array]:
    now, next_ = points(np.array([t, t + 1.0 / RATE]))
    return now, RATE * (next_ - now)


def control(values: Array) -> Control:
    """Feedback to the point that moves, values (n, 4)."""
    return ball_control.to_point(values, _goal)


def cost(board: Array, ball: Array | None) -> Array:
    """(n,) m, root mean square distance from the point that moves, where the board's x axis rolls the ball."""
    assert ball is not None
    away = ball_control.distances(ball, points(np.arange(ball.shape[1]) / RATE))[:, round(ROUND * RATE) :]
    return np.asarray(np.sqrt(np.mean(away**2, axis=1)))


TASK = Task(
    name="ball, path",
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
    generations=20,
    starts=((0.09, 0.2205),),
    near=(0.0, 0.08, 0.185, 0.231),
)
