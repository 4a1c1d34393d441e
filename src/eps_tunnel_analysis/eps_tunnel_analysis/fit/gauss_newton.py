# SPDX-License-Identifier: Apache-2.0
"""Multistart Gauss-Newton (scipy) with each Jacobian as one batch, and a CMA-ES polish where it stalls."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import qmc

from eps_tunnel_analysis.fit.cma import CmaEs
from eps_tunnel_analysis.fit.evaluations import Evaluations
from labyrinth_sim.trials import Array


@dataclass(frozen=True)
class GaussNewton:
    """Attributes:
    scouts: random points looked at beside the start, in one batch.
    starts: local searches, from the best of them.
    difference: step of the finite differences, in normalised units.
    polish: evaluations of a CMA-ES from the best point, 0 for none. Delay and backlash have kinks at which
        Gauss-Newton stalls.
    """

    scouts: int = 32
    starts: int = 3
    difference: float = 1e-4
    iterations: int = 12
    polish: int = 120
    name: str = "gauss-newton"

    @property
    def budget(self) -> int:
        """A guess for the progress bar; a run that converges early takes fewer."""
        return self.scouts + self.starts * self.iterations * 8 + self.polish

    def run(self, evaluations: Evaluations, rng: np.random.Generator) -> None:
        """Minimise; the result is `evaluations.best`."""
        k = evaluations.problem.size
        scouts = qmc.LatinHypercube(d=k, rng=rng).random(self.scouts)
        points = np.vstack([evaluations.best, scouts])
        order = np.argsort(evaluations.fitness(points), kind="stable")
        for start in points[order[: self.starts]]:
            self._descend(evaluations, start, loss="linear")
        # Least squares first, for its wide basin; then near the absolute error that equation 10 asks for.
        self._descend(evaluations, evaluations.best, loss="soft_l1")
        if self.polish:
            CmaEs(budget=self.polish, sigma=0.01, restarts=0).run(evaluations, rng)

    def _descend(self, evaluations: Evaluations, start: Array, loss: Literal["linear", "soft_l1"]) -> None:
        scaled = evaluations.problem.fitness.scaled
        known: dict[bytes, Array] = {}

        def at(z: Array) -> Array:
            if z.tobytes() not in known:
                known.clear()
                known[z.tobytes()] = finite(scaled(evaluations.residuals(z[None, :])))[0]
            return known[z.tobytes()]

        def jacobian(z: Array) -> Array:
            # Step inward at the upper bound, so that every point stays in the box.
            h = np.where(z + self.difference <= 1.0, self.difference, -self.difference)
            moved = finite(scaled(evaluations.residuals(z + np.diag(h))))
            return ((moved - at(z)) / h[:, None]).T

        first = at(np.clip(start, 0.0, 1.0))
        scale = 0.1 * float(np.sqrt(np.mean(first**2))) or 1.0
        least_squares(
            at,
            np.clip(start, 1e-9, 1.0 - 1e-9),
            jac=jacobian,
            bounds=(0.0, 1.0),
            loss=loss,
            f_scale=scale,
            x_scale="jac",
            max_nfev=self.iterations,
            ftol=1e-8,
            xtol=1e-8,
            gtol=1e-10,
        )


def finite(residuals: Array) -> Array:
    """Residuals with diverged roll-outs made large rather than NaN, so that a step into them is taken back."""
    return np.nan_to_num(residuals, nan=1e3, posinf=1e3, neginf=-1e3)
