# SPDX-License-Identifier: Apache-2.0
"""Controls of drives that step within a sample of a roll-out, where a drive comes near its limit.

A mean over a sample asks for the mean control. A drive that gives all it has before the step, after it, or both does
not give the torque of the mean control then, but the mean of both torques; `drive_limit` adds what differs.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labyrinth_sim.drive_limit import BEGINNING, END
from labyrinth_sim.trials import Array

SPREAD = 2  # samples over which a delay may spread a step of a command
#: of what saturates a drive, beyond which a step counts, in full from twice this on; by when in a step it is limited
FAR = {END: 0.25, BEGINNING: 2.0}
EDGE = 1e-6  # of a sample: a step that is so near to its edge is at its edge
NEAR = 0.5  # of what saturates a drive: a step from which on it may come near its limit


@dataclass(frozen=True)
class CommandSteps:
    """s samples in which a command steps far, sorted by sample.

    Attributes:
        sim, sample, axis: (s,) where.
        share: (s,) of the sample after the step.
        part: (s,) 0 to 1, how far the step counts.
        before, after, mean: (s,) the control before it, after it, and its mean over the sample.
    """

    sim: NDArray[np.intp]
    sample: NDArray[np.intp]
    axis: NDArray[np.intp]
    share: Array
    part: Array
    before: Array
    after: Array
    mean: Array

    def jumps(self, sim: int) -> Array:
        """(k, 6) those of one simulation, as `labyrinth_sim.drive_limit` is told them: sample, axis, share, part, and
        by how much the control before and its mean are beside the one after.
        """
        own = self.sim == sim
        told = (self.sample, self.axis, self.share, self.part, self.before - self.after, self.mean - self.after)
        return np.column_stack([column[own] for column in told]).astype(float)


def command_steps(
    controls: Array, most: Array, limits: int, near: NDArray[np.bool_] | None = None
) -> tuple[Array, CommandSteps | None]:
    """Controls (nsim, T, u), means over each sample, and the steps; where one is far, it is what it is after it.

    A step goes from where the control was some samples before to where it is as much later, because a delay spreads it
    over two samples. Ramps go on as they came and are no steps. Of a law with a D part one step of the target makes
    two of the control, the second when its change is over.

    Args:
        most: (nsim, u) control at which each drive gives its most at rest; infinite where nothing limits it.
        limits: END or BEGINNING, when in a step drives are limited.
        near: (nsim, u) what `may_saturate` says of them, if that is known.
    """
    near = may_saturate(controls, most) if near is None else near
    found, parts = controls, []
    for axis, reach in enumerate(most.T):
        own = controls[:, :, axis]
        if own.shape[1] <= 2 * SPREAD:
            continue
        before, after, middle = own[:, : -2 * SPREAD], own[:, 2 * SPREAD :], own[:, SPREAD:-SPREAD]
        change = after - before
        least = FAR[limits] * reach[:, None]
        with np.errstate(invalid="ignore", divide="ignore"):
            if not (np.abs(change) > least).any():
                continue  # before ramps are looked for, which takes longer
            size = (np.abs(change) - _of_a_ramp(own, np.sign(change))) / least
            share = (middle - before) / change
            far = near[:, axis, None] & (size > 1.0) & (share > EDGE) & (share < 1.0 - EDGE)
        sim, sample = np.nonzero(far)
        part = np.minimum(np.log2(size[far]), 1.0)
        found = controls.copy() if found is controls else found
        found[sim, sample + SPREAD, axis] = after[far]
        parts.append((sim, sample + SPREAD, np.full(len(sim), axis), share[far], part, before[far], after[far],
                      middle[far]))  # fmt: skip
    if not parts:
        return controls, None
    columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
    order = np.argsort(columns[1], kind="stable")
    return found, CommandSteps(*(column[order] for column in columns))


def may_saturate(controls: Array, most: Array) -> NDArray[np.bool_]:
    """(nsim, u) whether controls (nsim, T, u) step so far that drives may come near their most (nsim, u)."""
    held = np.nan_to_num(controls)
    moved = np.abs(held[:, SPREAD:] - held[:, :-SPREAD]).max(axis=1, initial=0.0)
    return np.asarray(moved > NEAR * most)


def _of_a_ramp(controls: Array, sign: Array) -> Array:
    """(nsim, T - 2 SPREAD) how far controls (nsim, T) move that way in the 2 SPREAD samples before or after those."""
    width = 2 * SPREAD
    held = np.pad(controls, ((0, 0), (width, width)), mode="edge")
    moved = np.nan_to_num(held[:, width:] - held[:, :-width])
    return np.maximum(np.maximum(sign * moved[:, : -2 * width], sign * moved[:, 2 * width :]), 0.0)
