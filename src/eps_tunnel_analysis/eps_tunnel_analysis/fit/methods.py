# SPDX-License-Identifier: Apache-2.0
"""The optimisers: the paper's evolution strategy, CMA-ES with restarts, multistart Gauss-Newton."""

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from eps_tunnel_analysis.fit.evaluations import Evaluations
from eps_tunnel_analysis.fit.lockstep import descend
from labyrinth_sim.trials import Array

DIFFERENCE = 1e-3  # finite differences to begin with, normalised
FIRM = 1e-3  # of the largest singular value: directions that may compensate
COMPENSATED = 2  # steps
HELPS = 0.01  # share of the fitness that one more search must gain to be followed by another


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
        import cma  # takes a second, which all that only might use this method does without

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


@dataclass(frozen=True)
class GaussNewton:
    """Multistart Gauss-Newton, each round of all descents in one batch.

    Values that can compensate for one another, such as P, D and delay, have several valleys in a row, so the search
    also goes on from points far from the best along the direction that it determines least. Least squares, also for the
    absolute error of equation 10: there it determines the values better, and that error is hardly larger.

    Attributes:
        scouts: random points evaluated in addition to the start, in one batch.
        starts: descents at once: from the best scouts, then from the best points along the weakest direction.
        rounds: of each descent, at most.
        tolerance: relative gain of a round below which a descent ends.
        response: by how much finite differences change the residuals, in shares of their root mean square. Smaller ones
            see the misfit's roughness from stiction, ticks and delays instead of its slope.
        patience: rounds after which a descent ends that still leaves `hopeless` times the best squared error.
        passes: searches along the weakest direction, as long as they help.
        away: nearest and farthest point there, in normalised units.
        scanned: points to either side.
    """

    scouts: int = 24
    starts: int = 3
    rounds: int = 12
    tolerance: float = 1e-3
    response: float = 0.5
    patience: int = 3
    hopeless: float = 4.0
    passes: int = 3
    away: tuple[float, float] = (0.01, 0.5)
    scanned: int = 8
    name: str = "gauss-newton"

    @property
    def budget(self) -> int:
        """A guess for the progress bar; a run that converges early takes fewer."""
        return self.scouts + 2 * self.starts * self.rounds * 4

    def run(self, evaluations: Evaluations, rng: np.random.Generator) -> None:
        """Minimise; the result is `evaluations.best`."""
        from scipy.stats import qmc  # half a second to import

        scouts = qmc.LatinHypercube(d=evaluations.problem.size, rng=rng).random(self.scouts)
        points = np.vstack([evaluations.best, scouts])
        order = np.argsort(evaluations.fitness(points), kind="stable")
        self._descend(evaluations, points[order[: self.starts]])
        for _ in range(self.passes):
            before = evaluations.best_fitness
            self._descend(evaluations, self._along_weakest(evaluations))
            if evaluations.best_fitness > (1.0 - HELPS) * before:
                break

    def _descend(self, evaluations: Evaluations, starts: Array) -> None:
        done = itertools.count(1)

        def hopeless(cost: Array) -> NDArray[np.bool_]:
            late = next(done) >= self.patience
            return late & (cost > self.hopeless * np.min(cost))

        if len(starts):
            free = np.ones(starts.shape, dtype=bool)
            descend(
                lambda z, _: _scaled(evaluations, z), starts, free, self.rounds, DIFFERENCE, self.tolerance,
                hopeless=hopeless, response=self.response, relative=True,
            )  # fmt: skip

    def _along_weakest(self, evaluations: Evaluations) -> Array:
        """(n, k) the lowest points to either side of the best one, along the direction that it determines least.

        The other directions compensate for each step along it, by the slopes at the best point.
        """
        z = evaluations.best
        _, slopes = evaluations.around(z, DIFFERENCE)
        left, sizes, right = np.linalg.svd(slopes, full_matrices=False)
        away = np.outer(np.geomspace(*self.away, self.scanned), right[-1])
        rows = np.clip(z + np.concatenate([away, -away]), 0.0, 1.0)
        firm = sizes[:-1] > FIRM * sizes[0]
        for _ in range(COMPENSATED):
            back = (_scaled(evaluations, rows) @ left[:, :-1])[:, firm] / sizes[:-1][firm]
            rows = np.clip(rows - back @ right[:-1][firm], 0.0, 1.0)
        costs = np.mean(_scaled(evaluations, rows) ** 2, axis=1).reshape(2, -1)
        padded = np.pad(costs, ((0, 0), (1, 1)), constant_values=np.inf)
        lowest = np.where(costs <= np.minimum(padded[:, :-2], padded[:, 2:]), costs, np.inf).ravel()
        order = np.argsort(lowest, kind="stable")[: self.starts]
        return rows[order[np.isfinite(lowest[order])]]


def _scaled(evaluations: Evaluations, z: Array) -> Array:
    """(n, R) residuals in the fitness's scaling; those of diverged roll-outs are large, so that no step goes there."""
    seen = evaluations.problem.fitness.scaled(evaluations.residuals(z))
    return np.nan_to_num(seen, nan=1e3, posinf=1e3, neginf=-1e3)
