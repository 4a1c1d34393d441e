# SPDX-License-Identifier: Apache-2.0
"""Refitting every candidate on top of the model, in whole roll-outs, side by side.

First a look at many values of every candidate: one roll-out each, judged after taking away what the base values could
compensate to first order. Then a descent of the base values and the candidate's together, from its best looks.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from eps_tunnel_analysis.diagnose.candidates import Candidate, Library, starts
from eps_tunnel_analysis.fit.lockstep import descend
from eps_tunnel_analysis.fit.objective import Objective
from labyrinth_sim.trials import Array

DIFFERENCE = 1e-3  # finite differences, normalised; coarse enough to see over the ticks of a quantised sensor
TOLERANCE = 2e-3  # relative gain of a round below which a descent rests
AT_ONCE = 256  # roll-outs of one batch while looking
FEW_STARTS = 20
LOOK_STEP = 3  # rounds after which the hopeless are given up
SCAN = 24  # values tried around a tick
FINE_ROUNDS = 5  # of descent at the fine step, for those that are judged
HOPELESS = 3.0  # times the best cost


@dataclass(frozen=True)
class Refit:
    """A set of effects refitted together with the base values.

    Attributes:
        effects: candidate names, in the order in which they were added; empty for the base alone.
        values: (K,) of all of the library's values, in their units.
        residuals: (R,) in units of the noise floor.
        cost: mean square of the residuals on the fitted samples.
        held_out: the same on the samples kept back.
        overall: the same on all.
        free: how many values were fitted.
        converged: the descent came to rest.
    """

    effects: tuple[str, ...]
    values: Array
    residuals: Array
    cost: float
    held_out: float
    overall: float
    free: int
    converged: bool


@dataclass(frozen=True)
class Look:
    """A candidate at (K,) values, and the cost promised: with as much of its change as helps, to first order.

    `on` counts the refits on top of which it was looked for.
    """

    candidate: Candidate
    values: Array
    promised: float
    on: int = 0


class Search:
    """Roll-outs of a library of candidates, in units of the noise floor.

    Args:
        objective: over the library's model and all of its names, at a coarse step.
        fine: the same at the rig's own step: refits are judged by it.
        scale: (n,) the noise floor at each of the objective's samples.
        kept: (objective's samples,) not fitted; candidates are judged on them.
        used: (n,) which of the objective's samples are compared, R of them; None for all.
        told: called with the number of roll-outs so far.
        difference: step of the finite differences, relative to the bounds' span.
    """

    def __init__(
        self,
        library: Library,
        objective: Objective,
        fine: Objective,
        scale: Array,
        kept: NDArray[np.bool_],
        used: NDArray[np.int64] | None = None,
        told: Callable[[int], None] | None = None,
        difference: float = DIFFERENCE,
    ) -> None:
        self.library, self.objective, self.fine = library, objective, fine
        self.used = np.arange(len(objective.mean)) if used is None else used
        self.kept = kept[self.used]
        infos = library.model.parameters()
        self.low = np.array([infos[name].low for name in library.names])
        self.high = np.array([infos[name].high for name in library.names])
        self.start = np.array([infos[name].value for name in library.names])
        self.blocks = objective.blocks[self.used]
        self.signal = self.blocks % len(objective.signals)
        self.scale = scale[self.used]
        self.shift = np.zeros(len(self.used))  # what the coarse step gets wrong, near where the search is
        self.evaluations = 0
        self.told, self.difference = told, difference
        self._column = {name: i for i, name in enumerate(library.names)}

    def residuals(self, values: Array, fine: bool = False) -> Array:
        """(n, K) values to (n, R) residuals in units of the noise floor."""
        self.evaluations += len(values)
        found = (self.fine if fine else self.objective)(values)[:, self.used] / self.scale
        if self.told:
            self.told(self.evaluations)
        return found if fine else found + self.shift

    def settle_at(self, refit: Refit) -> None:
        """Corrects coarse roll-outs by what the fine step says at a refit."""
        self.shift = self.shift + refit.residuals - self.residuals(refit.values[None])[0]

    def columns(self, candidate: Candidate) -> list[int]:
        """Where the library's values hold a candidate's."""
        return [self._column[name] for name in candidate.parameters]

    def refit(
        self, jobs: Sequence[tuple[tuple[Candidate, ...], Array]], rounds: int, fine: bool = False
    ) -> list[Refit]:
        """Descend jobs side by side, all of them to the end.

        Args:
            jobs: the candidates to fit together with the base values, and (K,) values to start from.
        """
        if not jobs:
            return []
        free = np.zeros((len(jobs), len(self.start)), dtype=bool)
        free[:, : len(self.library.base)] = True
        for row, (candidates, _) in enumerate(jobs):
            for candidate in candidates:
                free[row, self.columns(candidate)] = True
        span = self.high - self.low
        fitted = ~self.kept

        def scaled(z: Array, owners: NDArray[np.int64]) -> Array:
            return self.residuals(np.clip(self.low + z * span, self.low, self.high), fine)[:, fitted]

        z0 = (np.array([start for _, start in jobs]) - self.low) / span
        found = descend(scaled, z0, free, rounds, self.difference, TOLERANCE)
        values = np.clip(self.low + found.z * span, self.low, self.high)
        whole = self.residuals(values, fine)
        return [
            Refit(
                effects=tuple(c.name for c in candidates),
                values=values[row],
                residuals=whole[row],
                cost=mean_square(whole[row][fitted]),
                held_out=mean_square(whole[row][self.kept]),
                overall=mean_square(whole[row]),
                free=int(free[row].sum()),
                converged=bool(found.converged[row]),
            )
            for row, (candidates, _) in enumerate(jobs)
        ]

    def best_of(self, jobs: Sequence[tuple[tuple[Candidate, ...], Array]], rounds: int, keep: int = 6) -> list[Refit]:
        """Descend all jobs a little, the promising ones to the end; the best refit of each set of effects, best first.

        Args:
            keep: how many sets go on at least; beyond them only those within HOPELESS times the best.
        """
        early = _best_by_set(self.refit(jobs, LOOK_STEP))
        lowest = early[0].cost if early else np.inf
        going = [r for i, r in enumerate(early) if not r.converged and (i < keep or r.cost < HOPELESS * lowest)]
        late = self.refit([(self._candidates(r), r.values) for r in going], rounds)
        ordered = _best_by_set([*early, *late])
        ordered = _best_by_set([*ordered, *self._scanned(ordered[:keep])])
        judged = self.refit([(self._candidates(r), r.values) for r in ordered[:keep]], FINE_ROUNDS, fine=True)
        return [*_best_by_set(judged), *ordered[keep:]]

    def _candidates(self, refit: Refit) -> tuple[Candidate, ...]:
        return tuple(self.library.find(name) for name in refit.effects)

    def _scanned(self, refits: Sequence[Refit]) -> list[Refit]:
        """Refits from the best of values around each one's ticks, whose misfit has no slope to descend."""
        jobs = []
        for refit in refits:
            for name in (n for c in self._candidates(refit) for n in c.parameters if n.endswith(".tick")):
                column = self._column[name]
                around = np.tile(refit.values, (SCAN, 1))
                around[:, column] = np.clip(
                    refit.values[column] * np.geomspace(1 / 1.15, 1.15, SCAN), self.low[column], self.high[column]
                )
                cost = np.mean(self.residuals(around)[:, ~self.kept] ** 2, axis=1)
                jobs.append((self._candidates(refit), around[int(np.nanargmin(cost))]))
        return self.refit(jobs, LOOK_STEP)

    def looks(self, refits: Sequence[Refit], candidates: Sequence[Candidate]) -> list[Look]:
        """Every start of every candidate on top of each refit, by what it promises, best first.

        On top of refits after the first, candidates with many starts are left out.
        """
        found: list[Look] = []
        for number, refit in enumerate(refits):
            mine: list[tuple[Candidate, Array]] = []
            for candidate in (c for c in candidates if c.name not in refit.effects):
                rows = starts(candidate)
                for row in rows if number == 0 or len(rows) <= FEW_STARTS else ():
                    values = refit.values.copy()
                    values[self.columns(candidate)] = row
                    mine.append((candidate, values))
            basis = self._basis(refit)[~self.kept]
            here = refit.residuals[~self.kept]
            here = here - basis @ (basis.T @ here)
            for low in range(0, len(mine), AT_ONCE):
                answers = self.residuals(np.array([v for _, v in mine[low : low + AT_ONCE]]))[:, ~self.kept]
                # What the base values can compensate to first order does not count against a candidate.
                change = answers - (answers @ basis) @ basis.T - here
                share = np.clip(-(change @ here) / np.maximum(np.sum(change**2, axis=1), 1e-300), 0.0, 1.0)
                left = np.mean((here + share[:, None] * change) ** 2, axis=1)
                batch = zip(mine[low : low + AT_ONCE], left, strict=True)
                found += [Look(c, v, float(p), number) for (c, v), p in batch]
        return sorted((look for look in found if np.isfinite(look.promised)), key=lambda look: look.promised)

    def at(self, values: Array, like: Refit) -> Refit:
        """The refit that has these values (K,)."""
        whole = self.residuals(values[None])[0]
        return replace(
            like,
            values=values,
            residuals=whole,
            cost=mean_square(whole[~self.kept]),
            held_out=mean_square(whole[self.kept]),
            overall=mean_square(whole),
        )

    def moved(self, refit: Refit) -> Array:
        """(k, K) values of a refit with each of its fitted ones, the base's first, moved by a finite difference."""
        names = list(self.library.base)
        for name in refit.effects:
            names += self.library.find(name).parameters
        columns = [self._column[name] for name in names]
        moved = np.tile(refit.values, (len(columns), 1))
        steps = self.difference * (self.high - self.low)[columns]
        steps = np.where(refit.values[columns] + steps <= self.high[columns], steps, -steps)
        moved[np.arange(len(columns)), columns] += steps
        return moved

    def _basis(self, refit: Refit) -> Array:
        """(R, k) orthonormal: the directions in which the base values, and effects fitted already, move residuals."""
        slopes = np.nan_to_num(self.residuals(self.moved(refit)) - refit.residuals).T
        slopes[self.kept] = 0.0
        vectors, sizes, _ = np.linalg.svd(slopes, full_matrices=False)
        return np.asarray(vectors[:, sizes > 1e-6 * max(sizes.max(initial=0.0), 1e-300)])


def mean_square(residuals: Array) -> float:
    """NaN where there are none."""
    return float(np.mean(residuals**2)) if residuals.size else float("nan")


def _best_by_set(refits: Sequence[Refit]) -> list[Refit]:
    best: dict[frozenset[str], Refit] = {}
    for refit in refits:
        same = best.get(frozenset(refit.effects))
        if np.isfinite(refit.cost) and (same is None or refit.cost < same.cost):
            best[frozenset(refit.effects)] = refit
    return sorted(best.values(), key=lambda r: (r.cost, r.effects))
