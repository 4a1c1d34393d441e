# SPDX-License-Identifier: Apache-2.0
"""Whether recordings of the same rig agree on its values: one Gauss-Newton step from the joint fit for each of them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from eps_tunnel_analysis.diagnose.discrepancy import start_changes
from eps_tunnel_analysis.fit.intervals import intervals
from eps_tunnel_analysis.fit.problem import Objective, Problem
from eps_tunnel_analysis.outputs import shown_value
from eps_tunnel_analysis.recorded_play import Play
from labyrinth_sim.trials import Array

WRONGLY = 0.05  # share of fits to consistent recordings in which one is wrongly reported to differ


@dataclass(frozen=True)
class Differing:
    """A value that one recording by itself puts elsewhere.

    Attributes:
        bag: the recording.
        name, unit: the full parameter name and its unit.
        value: by all recordings together.
        alone: by this one, in the same unit, and
        half_width: of its interval, widened for the number of recordings and values.
    """

    bag: str
    name: str
    unit: str
    value: float
    alone: float
    half_width: float

    @property
    def sentence(self) -> str:
        """In the units that people read."""
        alone, half, value = (shown_value(v, self.unit) for v in (self.alone, self.half_width, self.value))
        return (
            f"Recordings disagree: {self.bag} by itself puts {self.name} at {alone} ± {half}, all together at {value}. "
            "The rig was not the same, or not in the same state; fit them separately, or run `eps-tunnel changes`."
        )


def differing(
    objective: Objective, plays: Sequence[Play], problem: Problem, z: Array, residuals: Array, slopes: Array,
    missing: Array,
) -> tuple[Differing, ...]:  # fmt: skip
    """The values that a recording by itself puts beyond its interval; none for a single recording.

    Args:
        plays: that were fitted.
        z: (k,) the fit, normalised; values at their bounds stay there.
        residuals, slopes: (R,) and (R, k) there, in the fitness's scaling.
        missing: (k,) by how much a missing effect may have shifted values; counts for recordings of only some
            commands, because each command is shifted in its own way.
    """
    bags = list(dict.fromkeys(bag for play in plays for bag in _bags(play)))
    free = np.flatnonzero((z > 0.0) & (z < 1.0))
    if len(bags) < 2 or not len(free) or not np.isfinite(slopes).all():
        return ()
    values, span = problem.from_unit(z), (problem.high - problem.low)[free]
    simulated = objective(values[None])[0] + objective.mean
    starts = list(start_changes(objective, plays, problem, z, residuals))
    quantile = ndtri(1.0 - 0.5 * WRONGLY / (len(bags) * len(free)))
    differences = []
    for bag in bags:
        mean, share = _mean_of(objective, plays, bag)
        seen = np.isfinite(mean)
        raw = np.where(seen, simulated - np.nan_to_num(mean), 0.0)
        own, jac = problem.fitness.scaled(raw[None])[0][seen], slopes[np.ix_(seen, free)]
        inverse = np.linalg.pinv(jac)
        step = -inverse @ own
        blocks = objective.blocks[seen]
        deviation = intervals(jac, own + jac @ step, blocks.astype(float)).deviation
        for change in starts:
            apart = (change * share)[seen]
            for block in np.unique(blocks // len(objective.signals)):
                here = blocks // len(objective.signals) == block
                deviation = np.hypot(deviation, inverse @ np.where(here, apart, 0.0))
        if not seen.all():
            deviation = np.hypot(deviation, missing[free])
        half = quantile * deviation
        for i in np.flatnonzero(np.abs(step) > half):
            at = free[i]
            differences.append(Differing(bag, problem.names[at], problem.units[at], float(values[at]),
                                   float(values[at] + step[i] * span[i]), float(half[i] * span[i])))  # fmt: skip
    return tuple(differences)


def _bags(play: Play) -> list[str]:
    """The recording of each trial; empty if that is unknown."""
    bags = [trial.bag for trial in play.stamped]
    return bags if len(bags) == play.trials.count and all(bags) else []


def _mean_of(objective: Objective, plays: Sequence[Play], bag: str) -> tuple[Array, Array]:
    """(R,) mean over a recording's own trials, NaN where it has none, and (R,) by how much its noise is larger than
    that of the mean over all trials.
    """
    mean, larger = np.full(len(objective.mean), np.nan), np.zeros(len(objective.mean))
    for number, play in enumerate(plays):
        own = np.array([name == bag for name in _bags(play)], dtype=bool)
        if not own.any():
            continue
        for column, signal in enumerate(objective.signals):
            here = objective.blocks == number * len(objective.signals) + column
            values = play.trials.values[own][:, :, play.trials.index(signal)]
            mean[here] = values[:, objective.samples[here]].mean(axis=0)
            larger[here] = np.sqrt(len(own) / own.sum())
    return mean, larger
