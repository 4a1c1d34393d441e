# SPDX-License-Identifier: Apache-2.0
"""Multistart Gauss-Newton (scipy) with each Jacobian as one batch, and a CMA-ES polish where it stalls."""

from contextlib import suppress
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import qmc

from eps_tunnel_analysis.fit.cma import CmaEs
from eps_tunnel_analysis.fit.evaluations import Evaluations
from labyrinth_sim.trials import Array


class _Enough(Exception):
    """This descent stands still, or will not beat the best."""


@dataclass(frozen=True)
class GaussNewton:
    """Attributes:
    scouts: random points looked at beside the start, in one batch.
    starts: local searches, from the best of them.
    difference: step of the finite differences, in normalised units.
    iterations: of each local search, at most.
    patience: iterations after which a search ends that has gained less than the share `gain` in them, or that is still
        `hopeless` times worse than the best.
    polish: evaluations of a CMA-ES from the best point, 0 for none. Delay and backlash have kinks at which
        Gauss-Newton stalls.
    """

    scouts: int = 32
    starts: int = 3
    difference: float = 1e-4
    iterations: int = 12
    patience: int = 3
    gain: float = 2e-3
    hopeless: float = 1.5
    polish: int = 96
    name: str = "gauss-newton"

    @property
    def budget(self) -> int:
        """A guess for the progress bar; a run that converges early takes fewer."""
        return self.scouts + self.starts * self.iterations * 5 + self.polish

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
        problem = evaluations.problem
        known: dict[bytes, tuple[Array, Array]] = {}
        tried: list[tuple[float, float]] = []  # fitness and sum of squares
        best = evaluations.best_fitness

        def look(z: Array) -> tuple[Array, Array]:
            """Residuals (R,) and Jacobian (R, k) in one batch; a step is seldom taken back, so the latter is needed."""
            if z.tobytes() not in known:
                # Step inward at the upper bound, so that every point stays in the box.
                h = np.where(z + self.difference <= 1.0, self.difference, -self.difference)
                answers = evaluations.residuals(np.vstack([z, z + np.diag(h)]))
                scaled = finite(problem.fitness.scaled(answers))
                tried.append((float(problem.fitness(answers[:1])[0]), float(scaled[0] @ scaled[0])))
                if len(tried) > self.patience and (self._stalled(tried) or min(tried)[0] > self.hopeless * best):
                    raise _Enough
                known.clear()
                known[z.tobytes()] = scaled[0], ((scaled[1:] - scaled[0]) / h[:, None]).T
            return known[z.tobytes()]

        def residuals(z: Array) -> Array:
            return look(z)[0]

        def jacobian(z: Array) -> Array:
            return look(z)[1]

        first = np.clip(start, 1e-9, 1.0 - 1e-9)
        scale = 0.1 * float(np.sqrt(np.mean(look(first)[0] ** 2))) or 1.0
        with suppress(_Enough):
            least_squares(
                residuals,
                first,
                jac=jacobian,
                bounds=(0.0, 1.0),
                loss=loss,
                f_scale=scale,
                x_scale="jac",
                max_nfev=self.iterations,
                ftol=1e-4,
                xtol=1e-5,
                gtol=1e-10,
            )

    def _stalled(self, tried: list[tuple[float, float]]) -> bool:
        before, now = np.min(tried[: -self.patience], axis=0), np.min(tried, axis=0)
        return bool((now > (1.0 - self.gain) * before).all())


def finite(residuals: Array) -> Array:
    """Residuals with diverged roll-outs made large rather than NaN, so that a step into them is taken back."""
    return np.nan_to_num(residuals, nan=1e3, posinf=1e3, neginf=-1e3)
