# SPDX-License-Identifier: Apache-2.0
"""What a fit is given: free parameters with bounds, and the residuals of one roll-out per recorded command.

The optimisers see no simulator. They work on normalised values z in [0, 1] (0 = lower bound, 1 = upper bound), as the
paper does, and ask for whole batches at once.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from eps_tunnel_analysis.fit.fitness import Fitness
from labyrinth_sim.errors import InputError
from labyrinth_sim.trials import Array, locked

Residuals = Callable[[Array], Array]


@dataclass(frozen=True)
class Problem:
    """A least-error problem over k bounded parameters and R residual samples.

    Attributes:
        names: k full parameter names, e.g. "drive.x.p".
        units: k units.
        low, high: (k,) bounds in those units.
        start: (k,) the values to start from, within the bounds.
        residuals: maps values (n, k) in their units to simulated minus measured (n, R), in the signals' units; a row of
            NaN tells a roll-out that diverged.
        fitness: maps residuals (n, R) to one number each (n,), smaller is better.
        blocks: (R,) int, which unbroken run of samples (command and signal) each residual belongs to.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    low: Array
    high: Array
    start: Array
    residuals: Residuals
    fitness: Fitness
    blocks: Array

    def __post_init__(self) -> None:
        for name in ("low", "high", "start", "blocks"):
            object.__setattr__(self, name, locked(getattr(self, name)))
        k = len(self.names)
        complaints = []
        if k == 0:
            complaints.append("There is nothing to fit: no free parameter was named.")
        for name in ("low", "high", "start"):
            if getattr(self, name).shape != (k,):
                complaints.append(f"{name} must have shape ({k},), got {getattr(self, name).shape}.")
        if not complaints:
            for name, low, start, high in zip(self.names, self.low, self.start, self.high, strict=True):
                if not low < high:
                    complaints.append(f"{name}: the lower bound {low:g} must lie below the upper bound {high:g}.")
                elif not low <= start <= high:
                    complaints.append(f"{name}: the start {start:g} lies outside its bounds [{low:g}, {high:g}].")
        if complaints:
            raise InputError(complaints)

    @property
    def size(self) -> int:
        """k, the number of free parameters."""
        return len(self.names)

    def to_unit(self, values: Array) -> Array:
        """Values (..., k) in their units to z in [0, 1]."""
        return (np.asarray(values, dtype=np.float64) - self.low) / (self.high - self.low)

    def from_unit(self, z: Array) -> Array:
        """z (..., k) in [0, 1] to values in their units."""
        return self.low + np.clip(z, 0.0, 1.0) * (self.high - self.low)
