# SPDX-License-Identifier: Apache-2.0
"""Sets of effects, refitted, and points to begin from."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from eps_tunnel_analysis.diagnose.candidates import Candidate
from labyrinth_sim.shown import shown
from labyrinth_sim.trials import Array

Job = tuple[tuple[Candidate, ...], Array]
"""Candidates to fit together, and (K,) values to start from."""


@shown
@dataclass(frozen=True)
class Refit:
    """A set of effects refitted together with the base values.

    Attributes:
        effects: candidate names, in the order in which they were added; empty for the base alone.
        values: (K,) of all of the library's values, in their units.
        residuals: (R,) in units of the noise floor.
        cost: mean square of the residuals.
        free: how many values were fitted.
        converged: no set that it contains fits better.
        held: what a descent adds to the cost for values far from what is stated.
        steps: (K,) finite differences, normalised, that suit it; None for the initial ones.
    """

    effects: tuple[str, ...]
    values: Array
    residuals: Array
    cost: float
    free: int
    converged: bool
    held: float = 0.0
    steps: Array | None = None

    @property
    def several(self) -> bool:
        """Whether it has more than one effect."""
        return len(self.effects) > 1

    @property
    def objective(self) -> float:
        """What a descent minimises."""
        return self.cost + self.held


@dataclass(frozen=True)
class TrialPoint:
    """A candidate at (K,) values.

    Attributes:
        promised: the lowest cost with a share of its change, to first order.
        on: which of the refits it was tried on top of.
        alone: the same while the base values stay as they are; `promised` lets them make up for as much as they can to
            first order, which may be more than their bounds allow.
    """

    candidate: Candidate
    values: Array
    promised: float
    on: int
    alone: float


def with_best_share(residuals: Array, changes: Array) -> Array:
    """(n,) sums of squares of residuals (R,), each with the best share, none to all, of one of changes (n, R)."""
    size = np.maximum(np.sum(changes**2, axis=1), 1e-300)
    share = np.clip(-(changes @ residuals) / size, 0.0, 1.0)
    return np.asarray(np.sum((residuals + share[:, None] * changes) ** 2, axis=1))


def best_by_set(refits: Sequence[Refit]) -> list[Refit]:
    """The best refit of each set of effects, best first; those of no finite cost are left out."""
    best: dict[frozenset[str], Refit] = {}
    for refit in refits:
        same = best.get(frozenset(refit.effects))
        if np.isfinite(refit.cost) and (same is None or refit.objective < same.objective):
            best[frozenset(refit.effects)] = refit
    return sorted(best.values(), key=lambda r: (r.objective, r.effects))


def base_and_sets(refits: Sequence[Refit]) -> tuple[Refit, list[Refit]]:
    """The best refit of the base alone, and that of each set of effects, best first."""
    by_set = best_by_set(refits)
    return next(r for r in by_set if not r.effects), [r for r in by_set if r.effects]


def with_residuals(refit: Refit, residuals: Array) -> Refit:
    """The refit with residuals (R,) at its values."""
    return replace(refit, residuals=residuals, cost=float(np.mean(residuals**2)))


def lowest(refits: Sequence[Refit]) -> Refit:
    """The best refit; among equal ones, the one with the fewest effects."""
    return min(refits, key=lambda r: (r.objective, len(r.effects)))
