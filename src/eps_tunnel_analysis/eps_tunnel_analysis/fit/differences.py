# SPDX-License-Identifier: Apache-2.0
"""Finite differences in the box [0, 1], as every descent and every interval takes them."""

import numpy as np
from numpy.typing import NDArray

from labyrinth_sim.trials import Array


def moved(z: Array, step: float | Array, columns: NDArray[np.int64] | None = None) -> tuple[Array, Array]:
    """Points to ask for a Jacobian.

    Args:
        z: (K,) in [0, 1].
        step: one for all values or (K,).
        columns: (k,) of the values to move; all by default.

    Returns:
        (k, K), z with one value moved in each row, and the (k,) signed steps: downwards where upwards leaves the box.
    """
    which = np.arange(len(z)) if columns is None else columns
    steps = np.broadcast_to(np.asarray(step, dtype=np.float64), z.shape)[which]
    steps = np.where(z[which] + steps <= 1.0, steps, -steps)
    points = np.tile(z, (len(which), 1))
    points[np.arange(len(which)), which] += steps
    return points, steps


def jacobian(at: Array, answers: Array, steps: Array) -> Array:
    """(R, k) from residuals (R,) and those of moved points (k, R) at steps (k,); 0 where a roll-out diverged."""
    return np.asarray(np.nan_to_num((answers - at) / steps[:, None]).T)
