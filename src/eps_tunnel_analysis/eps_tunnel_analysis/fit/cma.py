# SPDX-License-Identifier: Apache-2.0
"""CMA-ES (pycma) with restarts of doubled population, in the normalised box."""

from dataclasses import dataclass

import cma
import numpy as np

from eps_tunnel_analysis.fit.evaluations import Evaluations


@dataclass(frozen=True)
class CmaEs:
    """Attributes:
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
