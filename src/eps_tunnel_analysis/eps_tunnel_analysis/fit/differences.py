# SPDX-License-Identifier: Apache-2.0
"""Finite differences within bounds, for every descent and every interval."""

import numpy as np
from numpy.typing import NDArray

from labyrinth_sim.trials import Array


def steps_within(at: Array, steps: Array | float, low: Array | float, high: Array | float) -> Array:
    """(k,) steps (k,) from values (k,), signed: downwards where only there is room, and within the bounds."""
    above, below = high - at, at - low
    return np.where((steps <= above) | (above >= below), np.minimum(steps, above), -np.minimum(steps, below))


def moved(
    z: Array, step: float | Array, columns: NDArray[np.int64] | None = None, width: Array | float = 1.0
) -> tuple[Array, Array]:
    """Points to evaluate for a Jacobian.

    Args:
        z: (K,) from 0 to width.
        step: one for all values or (K,).
        columns: (k,) of the values to move; all by default.
        width: of the box, one for all values or (K,).

    Returns:
        (k, K), z with one value moved in each row, and the (k,) signed steps.
    """
    which = np.arange(len(z)) if columns is None else columns
    size, most = (np.broadcast_to(np.asarray(x, dtype=np.float64), z.shape)[which] for x in (step, width))
    steps = steps_within(z[which], size, 0.0, most)
    points = np.tile(z, (len(which), 1))
    points[np.arange(len(which)), which] += steps
    return points, steps


def jacobian(at: Array, answers: Array, steps: Array) -> Array:
    """(R, k) from residuals (R,) and those of moved points (k, R) at steps (k,); 0 where a roll-out diverged."""
    return np.asarray(np.nan_to_num((answers - at) / steps[:, None]).T)


def directions(changes: Array) -> Array:
    """(R, <= k) orthonormal: the directions in which changes (R, k) move residuals."""
    vectors, sizes, _ = np.linalg.svd(changes, full_matrices=False)
    return np.asarray(vectors[:, sizes > 1e-6 * max(sizes.max(initial=0.0), 1e-300)])
