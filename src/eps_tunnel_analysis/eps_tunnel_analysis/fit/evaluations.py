# SPDX-License-Identifier: Apache-2.0
"""The one door between an optimiser and the simulator: counts, journals, remembers the best."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from eps_tunnel_analysis.fit.journal import Journal
from eps_tunnel_analysis.fit.problem import Problem
from labyrinth_sim.trials import Array

#: Called after each batch with (evaluations so far, best fitness so far). May raise KeyboardInterrupt to stop the fit.
Progress = Callable[[int, float], None]


class BudgetSpent(Exception):
    """No more evaluations are allowed; the best so far is the answer."""


@dataclass(frozen=True)
class Step:
    """Best fitness after so many evaluations."""

    evaluations: int
    fitness: float


class Evaluations:
    """Evaluates batches of normalised values; keeps what every method needs kept.

    Attributes:
        count: roll-out sets evaluated so far (one per parameter set; all commands count as one, as in the paper).
        best: (k,) normalised values of the best so far; the start until something was evaluated.
        best_fitness: its fitness.
        history: where the best improved.
        journal: remembers answers from run to run.
        progress: told after each batch.
        limit: evaluations after which the next batch raises BudgetSpent; None for no limit.
    """

    def __init__(
        self,
        problem: Problem,
        journal: Journal | None = None,
        progress: Progress | None = None,
        limit: int | None = None,
    ) -> None:
        self.problem = problem
        self.limit = limit
        self.count = 0
        self.best: Array = problem.to_unit(problem.start)
        self.best_fitness = float("inf")
        self.history: list[Step] = []
        self.journal = journal
        self.progress = progress

    def residuals(self, z: Array) -> Array:
        """(n, k) normalised values to (n, R) residuals; diverged roll-outs are rows of NaN."""
        question = np.clip(np.atleast_2d(z), 0.0, 1.0)

        def answer() -> Array:
            return self.problem.residuals(self.problem.from_unit(question))

        return self._ask(question, answer, self.problem.fitness)

    def fitness(self, z: Array) -> Array:
        """(n, k) normalised values to (n,) fitness. Journals one number a row instead of R."""
        question = np.clip(np.atleast_2d(z), 0.0, 1.0)

        def answer() -> Array:
            values = self.problem.residuals(self.problem.from_unit(question))
            return np.asarray(self.problem.fitness(values))[:, None]

        return self._ask(question, answer, lambda column: column[:, 0])[:, 0]

    def _ask(self, question: Array, answer: Callable[[], Array], fitness: Callable[[Array], Array]) -> Array:
        if self.limit is not None and self.count >= self.limit:
            raise BudgetSpent
        result = self.journal.recall(question) if self.journal else None
        if result is None:
            result = answer()
            if self.journal:
                self.journal.add(question, result)
        self._note(question, fitness(result))
        return result

    def _note(self, question: Array, fitness: Array) -> None:
        self.count += len(question)
        winner = int(np.argmin(fitness))
        if fitness[winner] < self.best_fitness:
            self.best_fitness = float(fitness[winner])
            self.best = question[winner].copy()
            self.history.append(Step(self.count, self.best_fitness))
        if self.progress:
            self.progress(self.count, self.best_fitness)
