# SPDX-License-Identifier: Apache-2.0
"""Refitting every candidate on top of the model, in whole roll-outs, side by side.

First a look at many values of every candidate: one roll-out each, judged after taking away what the base values could
compensate to first order. Then a descent of the base values and the candidate's together, from its best looks.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from eps_tunnel_analysis.diagnose.candidates import Candidate, Library, starts
from eps_tunnel_analysis.diagnose.refit import Job, Level, Look, Refit, best_by_set, refit_of
from eps_tunnel_analysis.fit.lockstep import descend
from eps_tunnel_analysis.fit.objective import Objective
from labyrinth_sim.trials import Array

DIFFERENCE = 1e-3  # finite differences, normalised; coarse enough to see over the ticks of a quantised sensor
TOLERANCE = 2e-3  # relative gain of a round below which a descent rests
AT_ONCE = 256  # roll-outs of one batch while looking
FEW_STARTS = 20
LOOK_STEP = 3  # rounds after which the hopeless are given up
SCAN = 24  # values tried around a tick
LEAST_JUDGED = 2
OUT_OF_REACH = 5.0  # times the best cost: no exact step brings that down
FINE_ROUNDS = 5  # of descent at the fine step, for those that are judged
PASSES = (0.6, 0.4)  # of these rounds, after each of which the exact step corrects
HOPELESS = 3.0  # times the best cost
# Times its cost and the noise floor: a refit that the coarse step gets wrong by more goes on at the fine one.
ROUGH = 0.2


class Search:
    """Roll-outs of a library of candidates, in units of the noise floor.

    Args:
        levels: over the library's model and all of its names, at three of MuJoCo's steps: the coarse one searches, the
            fine one takes over where that errs, and by the exact one refits are judged.
        scale: (n,) the noise floor at each of the objective's samples.
        kept: (objective's samples,) not fitted; candidates are judged on them.
        used: (n,) which of the objective's samples are compared, R of them; None for all.
        told: called with the number of roll-outs so far.
        difference: step of the finite differences, relative to the bounds' span.
    """

    def __init__(
        self,
        library: Library,
        levels: Mapping[Level, Objective],
        scale: Array,
        kept: NDArray[np.bool_],
        used: NDArray[np.int64] | None = None,
        told: Callable[[int], None] | None = None,
        difference: float = DIFFERENCE,
    ) -> None:
        self.library, self.levels = library, dict(levels)
        objective = self.objective = levels["coarse"]
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

    def residuals(self, values: Array, level: Level = "coarse") -> Array:
        """(n, K) values to (n, R) residuals in units of the noise floor."""
        self.evaluations += len(values)
        found = self.levels[level](values)[:, self.used] / self.scale
        if self.told:
            self.told(self.evaluations)
        return found + self.shift if level == "coarse" else found

    def settle_at(self, refit: Refit) -> None:
        """Corrects coarse roll-outs by what the exact step says at a refit."""
        self.shift = self.shift + refit.residuals - self.residuals(refit.values[None])[0]

    def columns(self, candidate: Candidate) -> list[int]:
        """Where the library's values hold a candidate's."""
        return [self._column[name] for name in candidate.parameters]

    def refit(
        self,
        jobs: Sequence[Job],
        rounds: int,
        level: Level = "coarse",
        shifts: Array | None = None,
    ) -> list[Refit]:
        """Descend jobs side by side, all of them to the end.

        Args:
            jobs: the candidates to fit together with the base values, and (K,) values to start from.
            shifts: (jobs, R) added to each one's residuals.
        """
        if not jobs:
            return []
        more = np.zeros((len(jobs), 1)) if shifts is None else shifts
        free = np.zeros((len(jobs), len(self.start)), dtype=bool)
        free[:, : len(self.library.base)] = True
        for row, (candidates, _) in enumerate(jobs):
            for candidate in candidates:
                free[row, self.columns(candidate)] = True
        span = self.high - self.low
        fitted = ~self.kept

        def scaled(z: Array, owners: NDArray[np.int64]) -> Array:
            found = self.residuals(np.clip(self.low + z * span, self.low, self.high), level) + more[owners]
            return found[:, fitted]

        z0 = (np.array([start for _, start in jobs]) - self.low) / span
        found = descend(scaled, z0, free, rounds, self.difference, TOLERANCE)
        values = np.clip(self.low + found.z * span, self.low, self.high)
        whole = self.residuals(values, level) + more
        return [
            refit_of(
                tuple(c.name for c in candidates), values[row], whole[row], self.kept, int(free[row].sum()),
                bool(found.converged[row]),
            )
            for row, (candidates, _) in enumerate(jobs)
        ]  # fmt: skip

    def best_of(self, jobs: Sequence[tuple[tuple[Candidate, ...], Array]], rounds: int, keep: int = 6) -> list[Refit]:
        """Descend all jobs a little, the promising ones to the end; the best refit of each set of effects, best first.

        Args:
            keep: how many sets go on at least; beyond them only those within HOPELESS times the best.
        """
        looked = self.refit(jobs, LOOK_STEP)
        rough = self._rough(looked)
        redone = self.refit([job for job, bad in zip(jobs, rough, strict=True) if bad], LOOK_STEP, "fine")
        early = best_by_set([*redone, *(r for r, bad in zip(looked, rough, strict=True) if not bad)])
        lowest = early[0].cost if early else np.inf
        going = [r for i, r in enumerate(early) if not r.converged and (i < keep or r.cost < HOPELESS * lowest)]
        finer = {id(r) for r in redone}
        late: list[Refit] = []
        for level in ("coarse", "fine"):
            mine = [r for r in going if (id(r) in finer) == (level == "fine")]
            late += self.refit([(self._candidates(r), r.values) for r in mine], rounds, level)
        ordered = best_by_set([*early, *late])
        ordered = best_by_set([*ordered, *self._scanned(ordered[:keep])])
        near = [r for i, r in enumerate(ordered[:keep]) if i < LEAST_JUDGED or r.cost < OUT_OF_REACH * ordered[0].cost]
        judged = self.judged([(self._candidates(r), r.values) for r in near], FINE_ROUNDS)
        return [*best_by_set(judged), *ordered[len(near) :]]

    def judged(self, jobs: Sequence[Job], rounds: int) -> list[Refit]:
        """Jobs descended at the fine step, corrected by the exact one at each one's own values, and judged by that."""
        if not jobs:
            return []
        points = np.array([values for _, values in jobs])
        shifts = self.residuals(points, "exact") - self.residuals(points, "fine")
        best: list[Refit] = []
        for share in PASSES:
            at = [(candidates, point) for (candidates, _), point in zip(jobs, points, strict=True)]
            found = self.refit(at, round(share * rounds), "fine", shifts)
            points = np.array([r.values for r in found])
            shown = self.residuals(points, "exact")
            shifts = shifts + shown - np.array([r.residuals for r in found])
            seen = [self._judged(r, row) for r, row in zip(found, shown, strict=True)]
            best = [min(pair, key=lambda r: r.cost) for pair in zip(best or seen, seen, strict=True)]
        return best

    def _rough(self, refits: Sequence[Refit]) -> list[bool]:
        """Which of the refits the coarse step gets wrong: a torque that saturates soon, say."""
        if not refits:
            return []
        finer = self.residuals(np.array([r.values for r in refits]), "fine")
        off = np.mean((finer - np.array([r.residuals for r in refits])) ** 2, axis=1)
        return [bool(o > ROUGH * max(r.cost, 1.0)) for o, r in zip(off, refits, strict=True)]

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
            basis = directions(self.changes(refit))[~self.kept]
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
        return self._judged(replace(like, values=values), self.residuals(values[None])[0])

    def _judged(self, refit: Refit, residuals: Array) -> Refit:
        """The refit with residuals (R,) at its values."""
        return refit_of(refit.effects, refit.values, residuals, self.kept, refit.free, refit.converged)

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

    def changes(self, refit: Refit) -> Array:
        """(R, k) by which each of the base values, and of effects fitted already, `moved`, changes residuals; 0 where
        they are not fitted.
        """
        found = np.nan_to_num(self.residuals(self.moved(refit)) - refit.residuals).T
        found[self.kept] = 0.0
        return found


def directions(changes: Array) -> Array:
    """(R, <= k) orthonormal: the directions in which changes (R, k) move residuals."""
    vectors, sizes, _ = np.linalg.svd(changes, full_matrices=False)
    return np.asarray(vectors[:, sizes > 1e-6 * max(sizes.max(initial=0.0), 1e-300)])
