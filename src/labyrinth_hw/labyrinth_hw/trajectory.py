# SPDX-License-Identifier: Apache-2.0
"""A path of joint angles through points in time, as in trajectory_msgs/JointTrajectory."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labyrinth_hw.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Path:
    """Angles over time: straight between points, or cubic where every point has a speed too.

    Attributes:
        times: (n,) s from the path's start, rising.
        positions: (n, u) rad.
        velocities: (n, u) rad/s, or None.
    """

    times: Array
    positions: Array
    velocities: Array | None = None

    @property
    def duration(self) -> float:
        """s."""
        return float(self.times[-1])

    def at(self, time: float) -> Array:
        """(u,) rad; the first point before the path, the last one after it."""
        if time <= self.times[0] or len(self.times) == 1:
            return self.positions[0]
        if time >= self.times[-1]:
            return self.positions[-1]
        i = int(np.searchsorted(self.times, time, side="right")) - 1
        span = self.times[i + 1] - self.times[i]
        s = (time - self.times[i]) / span
        a, b = self.positions[i], self.positions[i + 1]
        if self.velocities is None:
            return np.asarray(a + s * (b - a))
        # Cubic Hermite: meets both points with their speeds.
        m, n = span * self.velocities[i], span * self.velocities[i + 1]
        t = 1.0 - s
        return np.asarray((1 + 2 * s) * t**2 * a + s * t**2 * m + s**2 * (3 - 2 * s) * b - s**2 * t * n)


def path_through(
    start: Array, times: Sequence[float], positions: Sequence[Sequence[float]], velocities: Sequence[Sequence[float]]
) -> Path:
    """From where the joints are through points.

    Args:
        start: (u,) rad; the joints rest there at time 0, unless the first point is at 0.
        times: (n,) s from the start.
        positions: (n, u) rad.
        velocities: (n, u) rad/s; of a point without them an empty list.

    Raises:
        InputError: the points cannot be followed.
    """
    count = len(start)
    if not times:
        raise InputError("A trajectory without points.")
    if any(len(row) != count for row in positions):
        raise InputError(f"Every point needs {count} positions, one for each joint.")
    moments, rows = np.array(times, float), np.array(positions, float)
    if moments[0] < 0.0 or (np.diff(moments) <= 0.0).any() or not np.isfinite(moments).all():
        raise InputError(f"Times of the points must rise from 0 s on, got {', '.join(f'{t:g}' for t in times)} s.")
    if not np.isfinite(rows).all():
        raise InputError("Positions must be finite angles in rad.")
    cubic = all(len(row) == count for row in velocities)
    speeds = np.array(velocities, float) if cubic else None
    if speeds is not None and not np.isfinite(speeds).all():
        raise InputError("Velocities must be finite, in rad/s, or left out.")
    if moments[0] > 0.0:
        moments, rows = np.r_[0.0, moments], np.vstack([start, rows])
        speeds = None if speeds is None else np.vstack([np.zeros(count), speeds])
    return Path(moments, rows, speeds)
