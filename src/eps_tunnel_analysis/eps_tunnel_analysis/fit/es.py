# SPDX-License-Identifier: Apache-2.0
"""The paper's (5 + 100) evolution strategy (section 4.3), to the letter."""

from dataclasses import dataclass

import numpy as np

from eps_tunnel_analysis.fit.evaluations import Evaluations
from labyrinth_sim.trials import Array


@dataclass(frozen=True)
class EvolutionStrategy:
    """(mu + lambda): the best `parents` of parents and offspring together are the next parents.

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
