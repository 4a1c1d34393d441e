# SPDX-License-Identifier: Apache-2.0
"""Bringing a rig to a pose, and knowing when it has come to rest."""

import math
import threading
from collections import deque

import numpy as np

from labyrinth_sim.trials import Array


def smooth_path(start: Array, end: Array, speed: float, rate: float) -> Array:
    """Targets (n, u) in rad from `start` to `end` (u,), the last equal to `end`, no channel faster than `speed` rad/s.

    A minimum-jerk path, s(x) = 10 x^3 - 15 x^4 + 6 x^5, whose greatest speed is 15/8 of the mean one.
    """
    distance = float(np.max(np.abs(end - start), initial=0.0))
    count = max(1, math.ceil(15 / 8 * distance / speed * rate))
    x = np.arange(1, count + 1)[:, None] / count
    path = np.asarray(start + (end - start) * (10 * x**3 - 15 * x**4 + 6 * x**5), dtype=np.float64)
    path[-1] = end  # free of rounding
    return path


class RestWatch:
    """Judges from noisy positions whether something moves.

    The speed is the difference between the means of the two halves of the last `window` seconds, so that the flicker
    of an encoder between two counts is no motion. It is at rest after it was no faster than `speed` for `window`
    seconds. One thread may add while another asks or resets.

    Args:
        window: s.
        speed: rad/s.
    """

    def __init__(self, window: float, speed: float) -> None:
        self.window, self.bound = window, speed
        self._samples: deque[tuple[float, Array]] = deque()
        self._slow_since: float | None = None
        self._lock = threading.Lock()
        self.speeds: Array = np.zeros(0)

    def add(self, time: float, positions: Array) -> None:
        """One measurement: time in s, positions (j,) in rad, NaN where not measured. Starts again if time goes back."""
        with self._lock:
            self._add(time, positions)

    def _add(self, time: float, positions: Array) -> None:
        if self._samples and (time <= self._samples[-1][0] or len(positions) != len(self._samples[-1][1])):
            self._reset()
        self._samples.append((time, positions))
        while len(self._samples) > 2 and self._samples[1][0] <= time - self.window:
            self._samples.popleft()
        if self._samples[0][0] > time - self.window:
            return
        times = np.array([sample[0] for sample in self._samples])
        values = np.array([sample[1] for sample in self._samples])
        late = times > time - self.window / 2
        if late.sum() < 2 or (~late).sum() < 2:
            self._slow_since = None
            return
        self.speeds = np.abs(values[late].mean(axis=0) - values[~late].mean(axis=0)) / (self.window / 2)
        # A joint that is not measured (NaN) cannot be waited for.
        if np.nanmax(self.speeds, initial=0.0) > self.bound:
            self._slow_since = None
        elif self._slow_since is None:
            self._slow_since = time

    def reset(self) -> None:
        """Forgets what was measured so far."""
        with self._lock:
            self._reset()

    def _reset(self) -> None:
        self._samples.clear()
        self._slow_since = None

    @property
    def at_rest(self) -> bool:
        with self._lock:
            return self._slow_since is not None and self._samples[-1][0] - self._slow_since >= self.window
