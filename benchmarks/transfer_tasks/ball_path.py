# SPDX-License-Identifier: Apache-2.0
"""The ball is rolled along the first stretch of the maze's path, past holes, behind a point that moves evenly."""

import numpy as np

from transfer_tasks.ball_control import ball_task
from transfer_tasks.task import RATE, Array

PATH = np.array([(0.09, 0.2205), (0.057, 0.2205), (0.057, 0.16), (0.072, 0.144), (0.072, 0.105)])  # m
PACE = 0.045  # m/s
# s, when the point is round the first corner, from where the board's x axis rolls the ball
ROUND = (PATH[0, 0] - PATH[1, 0]) / PACE
_AT = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(PATH, axis=0), axis=1))])  # m along the path


def points(t: Array) -> Array:
    """(T, 2) m where the ball should be at times (T,) s."""
    along = np.minimum(PACE * t, _AT[-1])
    return np.column_stack([np.interp(along, _AT, PATH[:, i]) for i in range(2)])


def _goal(t: float) -> tuple[Array, Array]:
    now, next_ = points(np.array([t, t + 1.0 / RATE]))
    return now, RATE * (next_ - now)


TASK = ball_task(
    name="ball, path",
    goal=_goal,
    points=points,
    arrived=ROUND,
    generations=20,
    starts=((0.09, 0.2205),),
    near=(0.0, 0.08, 0.185, 0.231),
)
