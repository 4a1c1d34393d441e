# SPDX-License-Identifier: Apache-2.0
"""From stamped samples to an even grid: straight lines between measurements, steps between commands."""

import numpy as np
from numpy.typing import NDArray

from labyrinth_sim.trials import Array


def interpolate(stamps: NDArray[np.int64], values: Array, grid: NDArray[np.int64], max_gap: float) -> Array:
    """Linear interpolation, NaN outside the stamps and within gaps longer than `max_gap`.

    Args:
        stamps: (n,) ns, strictly increasing.
        values: (n,) finite.
        grid: (T,) ns.
        max_gap: s; a grid point that lies between two stamps further apart than this is NaN.
    """
    out = np.full(len(grid), np.nan)
    if not len(stamps):
        return out
    after = np.searchsorted(stamps, grid, side="left")  # first stamp at or after the grid point
    hit = (after < len(stamps)) & (stamps[np.minimum(after, len(stamps) - 1)] == grid)
    out[hit] = values[after[hit]]
    inside = (after > 0) & (after < len(stamps)) & ~hit
    right = after[inside]
    left = right - 1
    span = stamps[right] - stamps[left]
    share = (grid[inside] - stamps[left]) / span
    line = values[left] + share * (values[right] - values[left])
    out[inside] = np.where(span <= round(max_gap * 1e9), line, np.nan)
    return out


def hold(stamps: NDArray[np.int64], values: Array, grid: NDArray[np.int64], max_hold: float | None) -> Array:
    """The last command at each grid point; NaN before the first, and where a stream of commands has stopped.

    A drive keeps its last target, so a lost message changes nothing. But a stream that stays silent for longer than
    `max_hold` was switched off: from one usual period after its last command on there is no target. Commands sent
    only when they change (usual period above `max_hold`) are no stream and are held until the next.

    Args:
        stamps: (n,) ns, strictly increasing.
        values: (n,) rad.
        grid: (T,) ns.
        max_hold: s; None holds for ever.
    """
    out = np.full(len(grid), np.nan)
    if not len(stamps):
        return out
    last = np.searchsorted(stamps, grid, side="right") - 1
    seen = last >= 0
    out[seen] = values[last[seen]]
    period = int(np.median(np.diff(stamps))) if len(stamps) > 1 else 0
    if max_hold is not None and 0 < period <= max_hold * 1e9:
        silence = np.append(np.diff(stamps), np.iinfo(np.int64).max)  # after each command, until the next
        silence[-1] = max(int(grid[-1] - stamps[-1]), 0)
        off = seen & (silence[last] > max_hold * 1e9) & (grid - stamps[last] > period)
        out[off] = np.nan
    return out
