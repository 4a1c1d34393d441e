# SPDX-License-Identifier: Apache-2.0
"""The optimisers: the paper's evolution strategy, CMA-ES with restarts, multistart Gauss-Newton."""

from contextlib import suppress
from dataclasses import dataclass
from typing import Literal

import cma
import numpy as np
from scipy.optimize import least_squares
from scipy.stats import qmc

from eps_tunnel_analysis.fit.differences import jacobian, moved
from eps_tunnel_analysis.fit.evaluations import Evaluations
from labyrinth_sim.trials import Array


@dataclass(frozen=True)
class EvolutionStrategy:
    """The paper's (5 + 100) evolution strategy (section 4.3).

    (mu + lambda): the best `parents` of parents and offspring together are the next parents.

    Attributes:
        parents: mu.
        offspring: lambda.
        generations: 150 in the paper.
        sigma: step size of the first parent, in normalised units.
    """

    parents: int = 5
    offspring: int = 100
    generations: int = 150
    sigma: float = 0.1
    name: str = "es"

    @property
    def budget(self) -> int:
        """Evaluations a whole run takes: the first parent and all offspring."""
        return 1 + self.generations * self.offspring

    def run(self, evaluations: Evaluations, rng: np.random.Generator) -> None:
        """Minimise; the result is `evaluations.best`."""
        z: Array = evaluations.best[None, :]
        sigma: Array = np.array([self.sigma])
        fitness: Array = evaluations.fitness(z)
        for _ in range(self.generations):
            chosen = rng.integers(len(z), size=self.offspring)
            child_sigma = sigma[chosen] * rng.standard_normal(self.offspring) ** 2  # equation 9
            steps = rng.standard_normal((self.offspring, z.shape[1]))
            children = np.clip(z[chosen] + child_sigma[:, None] * steps, 0.0, 1.0)
            everyone = np.concatenate([z, children])
            all_sigma = np.concatenate([sigma, child_sigma])
            all_fitness = np.concatenate([fitness, evaluations.fitness(children)])
            best = np.argsort(all_fitness, kind="stable")[: self.parents]
            z, sigma, fitness = everyone[best], all_sigma[best], all_fitness[best]


@dataclass(frozen=True)
class CmaEs:
    """CMA-ES (pycma) with restarts of doubled population, in the normalised box.

    Attributes:
        budget: evaluations, over all restarts.
        sigma: initial step size, in normalised units.
        restarts: at most so many, each with twice the population.
        tolerance: a run ends when its fitness values agree to this.
    """

    budget: int = 3000
    sigma: float = 0.2
    restarts: int = 4
    tolerance: float = 1e-9
    name: str = "cma"

    def run(self, evaluations: Evaluations, rng: np.random.Generator) -> None:
        """Minimise; the result is `evaluations.best`."""
        k = evaluations.problem.size
        population = 4 + int(3 * np.log(k))
        end = evaluations.count + self.budget
        for restart in range(self.restarts + 1):
            start = evaluations.best if restart == 0 else rng.random(k)
            options = {
                "bounds": [0.0, 1.0],
                "popsize": population * 2**restart,
                "seed": int(rng.integers(1, 2**31)),
                "tolfun": self.tolerance,
                "tolfunhist": self.tolerance,
                "verbose": -9,
                "maxfevals": end - evaluations.count,
            }
            # pycma needs at least two dimensions; a second one that nothing depends on does no harm.
            padded = np.append(start, 0.5) if k == 1 else start
            strategy = cma.CMAEvolutionStrategy(padded, self.sigma, options)
            while not strategy.stop():
                candidates = strategy.ask()
                strategy.tell(candidates, list(evaluations.fitness(np.array(candidates)[:, :k])))
            if evaluations.count >= end:
                return


class _Enough(Exception):
    """This descent has stalled, or will not beat the best."""


@dataclass(frozen=True)
class GaussNewton:
    """Multistart Gauss-Newton (scipy) with each Jacobian as one batch, and a CMA-ES polish where it stalls.

    Attributes:
        scouts: random points evaluated in addition to the start, in one batch.
        starts: local searches, from the best of them.
        difference: step of the finite differences, in normalised units.
        iterations: of each local search, at most.
        patience: iterations after which a search ends that has gained less than the share `gain` in them, or that is
            still `hopeless` times worse than the best.
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
            """Residuals (R,) and Jacobian (R, k) in one batch; steps are seldom rejected, so the latter is needed."""
            if z.tobytes() not in known:
                points, steps = moved(z, self.difference)
                answers = evaluations.residuals(np.vstack([z, points]))
                scaled = finite(problem.fitness.scaled(answers))
                tried.append((float(problem.fitness(answers[:1])[0]), float(scaled[0] @ scaled[0])))
                if len(tried) > self.patience and (self._stalled(tried) or min(tried)[0] > self.hopeless * best):
                    raise _Enough
                known.clear()
                known[z.tobytes()] = scaled[0], jacobian(scaled[0], scaled[1:], steps)
            return known[z.tobytes()]

        def residuals(z: Array) -> Array:
            return look(z)[0]

        def slopes(z: Array) -> Array:
            return look(z)[1]

        first = np.clip(start, 1e-9, 1.0 - 1e-9)
        scale = 0.1 * float(np.sqrt(np.mean(look(first)[0] ** 2))) or 1.0
        with suppress(_Enough):
            least_squares(
                residuals,
                first,
                jac=slopes,
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
    """Residuals with diverged roll-outs made large rather than NaN, so that a step into them is rejected."""
    return np.nan_to_num(residuals, nan=1e3, posinf=1e3, neginf=-1e3)
