# SPDX-License-Identifier: Apache-2.0
"""What a search tries, and what it finds."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from eps_tunnel_analysis.diagnose.candidates import Candidate
from labyrinth_sim.trials import Array

Level = Literal["coarse", "fine", "exact"]
Job = tuple[tuple[Candidate, ...], Array]
"""Candidates to fit together, and (K,) values to start from."""


@dataclass(frozen=True)
class Refit:
    """A set of effects refitted together with the base values.

    Attributes:
        effects: candidate names, in the order in which they were added; empty for the base alone.
        values: (K,) of all of the library's values, in their units.
        residuals: (R,) in units of the noise floor.
        cost: mean square of the residuals on the fitted samples.
        held_out: the same on the samples kept back.
        overall: the same on all.
        free: how many values were fitted.
        converged: the descent came to rest.
    """

    effects: tuple[str, ...]
    values: Array
    residuals: Array
    cost: float
    held_out: float
    overall: float
    free: int
    converged: bool


@dataclass(frozen=True)
class Look:
    """A candidate at (K,) values, and the cost promised: with as much of its change as helps, to first order.

    `on` counts the refits on top of which it was looked for.
    """

    candidate: Candidate
    values: Array
    promised: float
    on: int = 0


def refit_of(
    effects: tuple[str, ...], values: Array, residuals: Array, kept: NDArray[np.bool_], free: int, converged: bool
) -> Refit:
    """A refit with residuals (R,), of which `kept` were not fitted; a cost is NaN where it is over none."""

    def mean_square(part: Array) -> float:
        return float(np.mean(part**2)) if part.size else float("nan")

    cost, held_out = mean_square(residuals[~kept]), mean_square(residuals[kept])
    return Refit(effects, values, residuals, cost, held_out, mean_square(residuals), free, converged)


def best_by_set(refits: Sequence[Refit]) -> list[Refit]:
    """The refit of least cost of each set of effects, best first; those of no finite cost are left out."""
    best: dict[frozenset[str], Refit] = {}
    for refit in refits:
        same = best.get(frozenset(refit.effects))
        if np.isfinite(refit.cost) and (same is None or refit.cost < same.cost):
            best[frozenset(refit.effects)] = refit
    return sorted(best.values(), key=lambda r: (r.cost, r.effects))
