# SPDX-License-Identifier: Apache-2.0
"""One number for a roll-out: the paper's command error (equations 10 and 11) or the alikeness itself."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from labyrinth_sim.trials import Array, locked

#: Fitness of a roll-out that diverged: worse than any that did not, yet finite, so that an optimiser can rank it.
DIVERGED = 1e9


class Fitness(Protocol):
    """Smaller is better."""

    @property
    def name(self) -> str: ...

    def __call__(self, residuals: Array) -> Array:
        """(n, R) residuals to (n,) fitness."""
        ...

    def scaled(self, residuals: Array) -> Array:
        """(n, R) residuals weighted so that small sums of their size mean small fitness; for Gauss-Newton."""
        ...


@dataclass(frozen=True)
class CommandError:
    """F = sum over commands of E_C, E_C = 1/t_total * sum_k |phi_R - phi_S| dt (equations 10, 11).

    Attributes:
        weights: (R,) dt / t_total of the command and signal each residual belongs to.
    """

    weights: Array
    name: str = "error"

    def __post_init__(self) -> None:
        object.__setattr__(self, "weights", locked(self.weights))

    def __call__(self, residuals: Array) -> Array:
        errors = np.abs(residuals) @ self.weights
        return np.where(np.isfinite(errors), errors, DIVERGED)

    def scaled(self, residuals: Array) -> Array:
        # Every sample weighs alike within a command; commands of different length by their share.
        return residuals * (self.weights / self.weights.max())


@dataclass(frozen=True)
class Dissimilarity:
    """1 - alikeness over k (equation 13), made optimisable.

    The alikeness at one k is a step function: its slope is zero almost everywhere. A sample at distance d from the
    mean, in a tunnel of half-width delta, turns alike at k* = d / delta; the share of samples alike, averaged evenly
    over all k from 0 to `k_max`, is the mean of max(0, 1 - k*/k_max), which has a slope wherever a sample is inside at
    `k_max`. Outside it a slowly growing logarithm still points home.

    Attributes:
        lower, upper: (R,) half-widths of the measured tunnel, >= 0, in the residuals' units.
        k_max: the widest tunnel that counts.
        floor: least half-width, so that an exact recording does not divide by zero; the sensor's resolution.
    """

    lower: Array
    upper: Array
    k_max: float = 5.0
    floor: float = 1e-6
    name: str = "srg"

    def __post_init__(self) -> None:
        object.__setattr__(self, "lower", locked(np.maximum(self.lower, self.floor)))
        object.__setattr__(self, "upper", locked(np.maximum(self.upper, self.floor)))

    def scaled(self, residuals: Array) -> Array:
        """k* with the residual's sign, (n, R)."""
        return residuals / np.where(residuals >= 0.0, self.upper, self.lower)

    def __call__(self, residuals: Array) -> Array:
        k_star = np.abs(self.scaled(residuals)) / self.k_max
        cost = np.minimum(k_star, 1.0) + 0.05 * np.log1p(np.maximum(k_star - 1.0, 0.0))
        mean = cost.mean(axis=1)
        return np.where(np.isfinite(mean), mean, DIVERGED)
