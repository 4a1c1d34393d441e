# SPDX-License-Identifier: Apache-2.0
"""The board follows a path with quick reversals: by a learned feed-forward, and with feedback from its sensor too."""

import numpy as np

from labyrinth_hw.testbed.offline import Seen
from transfer_tasks.task import RATE, REACH, Array, Control, Task

SINES = ((np.radians(2.2), 0.55, 0.0), (np.radians(1.0), 1.3, 0.7), (np.radians(0.4), 2.6, 1.9))  # rad, Hz, rad
SLOW = 0.05  # rad/s, about which the sign of the speed turns
SMOOTHING = 0.03  # s, of the error's derivative
MOST = 0.05  # rad, of the integral's part


def path(t: Array) -> tuple[Array, Array, Array]:
    """The board's angle, speed and acceleration at times t, rad."""
    ramp = np.clip(t / 0.5, 0.0, 1.0)
    terms = [(a, 2 * np.pi * f, 2 * np.pi * f * t + phase) for a, f, phase in SINES]
    return (
        np.asarray(ramp * sum(a * np.sin(x) for a, _, x in terms)),
        np.asarray(ramp * sum(a * w * np.cos(x) for a, w, x in terms)),
        np.asarray(ramp * sum(-a * w * w * np.sin(x) for a, w, x in terms)),
    )


def feed_forward(values: Array, t: float) -> Array:
    """(n,) rad of n feed-forwards (n, 5) at a time."""
    gain, lead, inertia, friction, offset = values.T
    angle, speed, acceleration = path(t + lead)
    return np.asarray(gain * angle + inertia * acceleration + friction * np.tanh(speed / SLOW) + offset)


def by_feed_forward(values: Array) -> Control:
    """Commands that are known beforehand."""

    def control(seen: Seen) -> Array:
        return _on_x(feed_forward(values, seen.time))

    return control


def with_feedback(values: Array) -> Control:
    """The feed-forward and a PID on the board's angle, values (n, 8)."""
    p, i, d = values[:, 5:].T
    total, slope, before = np.zeros(len(values)), np.zeros(len(values)), None

    def control(seen: Seen) -> Array:
        nonlocal total, slope, before
        error = path(np.array(seen.time))[0] - seen.board[:, 0]
        change = RATE * (error - (error if before is None else before))
        slope = slope + (change - slope) / (1.0 + SMOOTHING * RATE)
        total, before = np.clip(total + i * error / RATE, -MOST, MOST), error
        return _on_x(feed_forward(values[:, :5], seen.time) + p * error + total + d * slope)

    return control


def _on_x(command: Array) -> Array:
    return np.column_stack([np.clip(command, -REACH, REACH), np.zeros(len(command))])


def cost(board: Array, ball: Array | None) -> Array:
    """(n,) root mean square distance of boards (n, T, 2) from the path, rad."""
    t = np.arange(board.shape[1]) / RATE
    return np.asarray(np.sqrt(np.mean((board[:, :, 0] - path(t)[0]) ** 2, axis=1)))


FEED_FORWARD = Task(
    name="board, feed-forward",
    unit="mrad",
    scale=1e3,
    duration=5.0,
    values=("gain", "lead s", "rad per rad/s^2", "rad with the sign of the speed", "offset rad"),
    low=np.array([0.8, 0.0, -0.002, -0.015, -0.015]),
    high=np.array([1.3, 0.12, 0.004, 0.02, 0.015]),
    start=np.array([1.0, 0.03, 0.0, 0.0, 0.0]),
    control=by_feed_forward,
    cost=cost,
    worst=1.0,
    generations=30,
)
FEEDBACK = Task(
    name="board, feedback",
    unit="mrad",
    scale=1e3,
    duration=5.0,
    values=(*FEED_FORWARD.values, "P", "I 1/s", "D s"),
    low=np.array([*FEED_FORWARD.low, 0.0, 0.0, 0.0]),
    high=np.array([*FEED_FORWARD.high, 3.0, 30.0, 0.1]),
    start=np.array([*FEED_FORWARD.start, 0.3, 2.0, 0.005]),
    control=with_feedback,
    cost=cost,
    worst=1.0,
    generations=30,
)
