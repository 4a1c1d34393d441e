# SPDX-License-Identifier: Apache-2.0
"""Commands that step within a sample of a roll-out, where a drive saturates.

A mean over a sample asks for the mean target. A drive that gives all it has before the step, after it, or both does not
give the torque of the mean target then, but the mean of both torques. What differs acts as an additional torque.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from labyrinth_sim.drive_torques import DriveTorques
from labyrinth_sim.trials import Array

SPREAD = 2  # samples over which a delay may spread a step of a command
FAR = 2.0  # times what saturates a drive, beyond which a step counts so, in full from this times that on
EDGE = 1e-6  # of a sample: a step that is so near to its edge is at its edge
HALF = 0.5  # share of a sample from which on its target is the later one


@dataclass(frozen=True)
class CommandSteps:
    """s samples in which a command steps far, sorted by sample.

    Attributes:
        sim, sample, axis: (s,) where.
        share: (s,) of the sample after the step.
        part: (s,) 0 to 1, how far the step counts.
        before, after, mean, target: (s,) rad: of the command, its mean over the sample, and what the drive is given.
    """

    sim: NDArray[np.intp]
    sample: NDArray[np.intp]
    axis: NDArray[np.intp]
    share: Array
    part: Array
    before: Array
    after: Array
    mean: Array
    target: Array

    @property
    def samples(self) -> list[int]:
        """Those in which a command of any simulation steps."""
        return [int(k) for k in np.unique(self.sample)]

    def at(self, sample: int) -> "CommandSteps":
        """Those of one sample."""
        return self._rows(slice(*np.searchsorted(self.sample, [sample, sample + 1])))

    def of(self, sim: int) -> "CommandSteps":
        """Those of one simulation."""
        return self._rows(self.sim == sim)

    def _rows(self, which: slice | NDArray[np.bool_]) -> "CommandSteps":
        return replace(self, **{name: values[which] for name, values in vars(self).items()})


def command_steps(targets: Array, reaches: Sequence[Array | None]) -> tuple[Array, CommandSteps | None]:
    """Targets (nsim, T, u) rad, means over each sample, and the steps; where one is far, its target is replaced.

    A step goes from where the command was some samples before to where it is as much later, because a delay spreads it
    over two samples. Ramps go on as they came and are no steps.

    Args:
        reaches: (nsim,) rad for each axis, error at which its drive gives its most; None where nothing limits it.
    """
    found, parts = targets, []
    for axis, reach in enumerate(reaches):
        own = targets[:, :, axis]
        if reach is None or own.shape[1] <= 2 * SPREAD:
            continue
        before, after, middle = own[:, : -2 * SPREAD], own[:, 2 * SPREAD :], own[:, SPREAD:-SPREAD]
        change = after - before
        least = FAR * reach[:, None]
        with np.errstate(invalid="ignore", divide="ignore"):
            if not (np.abs(change) > least).any():
                continue  # before ramps are looked for, which takes longer
            size = (np.abs(change) - _of_a_ramp(own, np.sign(change))) / least
            share = (middle - before) / change
            far = (size > 1.0) & (share > EDGE) & (share < 1.0 - EDGE)
        sim, sample = np.nonzero(far)
        part = np.minimum(np.log(size[far]) / np.log(FAR), 1.0)
        nearest = np.where(share[far] >= HALF, after[far], before[far])
        target = middle[far] + part * (nearest - middle[far])
        found = targets.copy() if found is targets else found
        found[sim, sample + SPREAD, axis] = target
        parts.append((sim, sample + SPREAD, np.full(len(sim), axis), share[far], part,
                      before[far], after[far], middle[far], target))  # fmt: skip
    if not parts:
        return targets, None
    columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
    order = np.argsort(columns[1], kind="stable")
    return found, CommandSteps(*(column[order] for column in columns))


class StepTorques:
    """What is missing of the drives' mean torque over samples in which a command steps.

    Args:
        drives: what they give.
        gains: (nsim,) control per radian of the target, for each drive.
    """

    def __init__(self, drives: DriveTorques, gains: Sequence[Array]) -> None:
        self.drives, self._gain = drives, np.column_stack(gains)

    def __call__(self, steps: CommandSteps, control: Array, angle: Array, speed: Array) -> Array:
        """(s,) N m on the axes' degrees of freedom, in addition to what the drives give.

        Args:
            control: (s,) that is given with the steps' targets.
            angle, speed: (s,) rad, rad/s, of the drives' joints at the samples' start.
        """
        i, a = steps.sim, steps.axis

        def torque(target: Array) -> Array:
            asked = control + self._gain[i, a] * (target - steps.target)
            return self.drives(i, a, asked, angle, speed)

        mean = steps.share * torque(steps.after) + (1.0 - steps.share) * torque(steps.before)
        return steps.part * mean + (1.0 - steps.part) * torque(steps.mean) - torque(steps.target)


def _of_a_ramp(targets: Array, sign: Array) -> Array:
    """(nsim, T - 2 SPREAD) how far targets (nsim, T) move that way in the 2 SPREAD samples before or after those."""
    width = 2 * SPREAD
    held = np.pad(targets, ((0, 0), (width, width)), mode="edge")
    moved = np.nan_to_num(held[:, width:] - held[:, :-width])
    return np.maximum(np.maximum(sign * moved[:, : -2 * width], sign * moved[:, 2 * width :]), 0.0)
