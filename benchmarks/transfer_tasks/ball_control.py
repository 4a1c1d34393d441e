# SPDX-License-Identifier: Apache-2.0
"""Feedback that tilts the board so that the ball rolls to a point, which may move."""

from collections.abc import Callable

import numpy as np

from labyrinth_hw.testbed.offline import Seen
from transfer_tasks.task import RATE, Array, Control, Task

ROLLS = 5.0 / 7.0 * 9.81  # m/s^2 for each rad of tilt
SMOOTHING = 0.04  # s, of the ball's speed
TILT = 0.06  # rad, the most
MOST = 0.02  # rad, of the integral's part
LOST = 0.05  # m, the distance that counts once the ball is lost

NAMES = ("P 1/s^2", "D 1/s", "I 1/s^3", "trim of board_x rad")
LOW, HIGH = np.array([1.0, 0.5, 0.0, -0.02]), np.array([40.0, 12.0, 40.0, 0.02])
START = np.array([6.0, 3.5, 2.0, 0.0])


def to_point(values: Array, goal: Callable[[float], tuple[Array, Array]]) -> Control:
    """n controllers (n, 4) with one goal.

    Args:
        goal: s -> (2,) m where the ball should be and (2,) m/s how fast it should go there.
    """
    p, d, i, trim = values.T[:, :, None]
    total, speed, before = np.zeros((len(values), 2)), np.zeros((len(values), 2)), None
    last = np.zeros((len(values), 2))

    def control(seen: Seen) -> Array:
        nonlocal total, speed, before, last
        assert seen.ball is not None
        point, pace = goal(seen.time)
        change = np.zeros_like(speed) if before is None else RATE * (seen.ball - before)
        speed = speed + (change - speed) / (1.0 + SMOOTHING * RATE)
        error, before = point - seen.ball, seen.ball
        total = np.clip(total + i * error / RATE, -MOST * ROLLS, MOST * ROLLS)
        wanted = (p * error + d * (pace - speed) + total) / ROLLS
        tilt = np.clip(np.column_stack([-wanted[:, 1] + trim[:, 0], wanted[:, 0]]), -TILT, TILT)
        last = np.where(np.isfinite(tilt), tilt, 0.0)  # level once the ball is lost
        return last

    return control


def ball_task(
    name: str,
    goal: Callable[[float], tuple[Array, Array]],
    points: Callable[[Array], Array],
    arrived: float,
    generations: int,
    starts: tuple[tuple[float, float], ...],
    near: tuple[float, float, float, float] | None = None,
) -> Task:
    """A task whose cost is the root mean square distance of the ball from where it should be.

    Args:
        goal: as in `to_point`.
        points: (T,) s -> (T, 2) or (2,) m, where the ball should be.
        arrived: s, from when on the distance counts; LOST at most, and once the ball is lost.
        generations, starts, near: as in `Task`.
    """

    def cost(board: Array, ball: Array | None) -> Array:
        assert ball is not None
        away = np.linalg.norm(ball - points(np.arange(ball.shape[1]) / RATE), axis=2)
        counted = np.minimum(np.nan_to_num(away, nan=LOST), LOST)[:, round(arrived * RATE) :]
        return np.asarray(np.sqrt(np.mean(counted**2, axis=1)))

    return Task(
        name=name, unit="mm", scale=1e3, duration=4.0, values=NAMES, low=LOW, high=HIGH, start=START,
        control=lambda values: to_point(values, goal), cost=cost, worst=LOST, generations=generations, starts=starts,
        near=near,
    )  # fmt: skip
