# SPDX-License-Identifier: Apache-2.0
"""Refitting every candidate on top of the model, in whole roll-outs, side by side.

First trial points: one roll-out at many values of every candidate, judged after taking away what the base values could
compensate to first order. Then a descent of the base values and the candidate's together, from the best of them.
"""

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from eps_tunnel_analysis.diagnose.candidates import Candidate, Library, is_rough, starts
from eps_tunnel_analysis.diagnose.evidence import Evidence
from eps_tunnel_analysis.diagnose.refits import Job, Refit, TrialPoint, best_by_set, with_best_share, with_residuals
from eps_tunnel_analysis.diagnose.roll_outs import DIFFERENCE, STANDS, Level, RollOuts
from eps_tunnel_analysis.diagnose.settings import SETTINGS
from eps_tunnel_analysis.diagnose.stated import residual_of
from eps_tunnel_analysis.fit.differences import directions
from eps_tunnel_analysis.fit.lockstep import Race, descend
from labyrinth_sim.trials import Array

RESPONSE = 0.5  # noise floors by which they then change the residuals: visible over the roughness of stiction and ticks
TOLERANCE = 2e-3  # relative gain of a round below which a descent rests, if nothing else is asked
AT_ONCE = 256  # roll-outs of one batch of trial points
FEW_STARTS = 20
SHORTLIST = 5  # sets of effects refitted from their trial points; this many are never given up
FIRST_ROUNDS = 3  # after which the hopeless are given up
SCAN = 24  # values tried around a tick, and again around the best of them; the first within
SCANNED = 0.15  # of it; and around a value whose misfit is rough, of its span
LEAST_JUDGED = 2
OUT_OF_REACH = 5.0  # times the best cost: the correction by the exact step cannot make up for that
FINE_ROUNDS = 5  # of descent at the fine step, for those that are judged
OWN_ROUNDS = 4  # of descent at the model's own steps, in the end
VALLEY_ROUNDS = 10  # of descents from further away
AWAY = (0.4, 0.8)  # spans from a refit at which other valleys are looked for, along the direction it determines least
PASSES = (0.6, 0.4)  # of these rounds, after each of which the exact step corrects
HOPELESS = 3.0  # times the best cost
#: times its cost and the noise floor: a refit that longer steps get wrong by more goes on at shorter ones
ROUGH = 0.2


class Search(RollOuts):
    """Descents of candidates on top of the base values; see `RollOuts` for the arguments.

    Args:
        exhaustive: nothing is given up before its descent has ended.
    """

    def __init__(
        self,
        library: Library,
        levels: Mapping[Level, Evidence],
        scale: Array,
        used: NDArray[np.int64],
        progress: Callable[[int, Sequence[str]], None] | None = None,
        difference: float = DIFFERENCE,
        exhaustive: bool = False,
    ) -> None:
        super().__init__(library, levels, scale, used, progress, difference)
        self.exhaustive = exhaustive
        self._valleys: dict[tuple[tuple[str, ...], bytes], tuple[Refit, ...]] = {}

    def over(self, library: Library) -> "Search":
        """A search over other candidates on top of the same base values, with the same samples, floor and steps."""
        stepped: dict[int, Evidence] = {}
        for evidence in self.levels.values():
            ticks = {n: v for n, v in evidence.model.values().items() if n.endswith(".feedback_tick")}
            model = library.model.with_values(ticks, "as stated")
            stepped.setdefault(id(evidence), evidence.of(model, library.names))
        scale = np.ones(len(self.evidence.mean))
        scale[self.used] = self.scale
        levels = {level: stepped[id(evidence)] for level, evidence in self.levels.items()}
        other = Search(library, levels, scale, self.used, self.progress, exhaustive=self.exhaustive)
        size = len(library.base)
        for name in ("idle", "sharp", "difference"):
            getattr(other, name)[:size] = getattr(self, name)[:size]
        other._noise, other.shift, other.evaluations = self._noise, self.shift, self.evaluations
        return other

    def as_stated(self) -> "Search":
        """The same, with the base values fixed for which the model states an expectation."""
        other = copy(self)
        other.idle = self.idle | self.stated
        return other

    def beside_stated(self, refits: Sequence[Refit], rounds: int, level: Level = "coarse") -> list[Array]:
        """(K,) values of those refits whose base deviates from what the model states, fitted again from the stated
        values, with those held for which an expectation is stated.
        """
        jobs = [
            (self.library.of(r.effects), self.library.with_base(r.values, self.start))
            for r in refits
            if self.strain(r.values) >= SETTINGS.strained
        ]
        firm = self.as_stated()
        from_stated = firm.refit(jobs, rounds, level)
        self.evaluations = firm.evaluations
        return [r.values for r in from_stated]

    def refit(
        self, jobs: Sequence[Job], rounds: int, level: Level = "coarse", shifts: Array | None = None,
        rough: bool = True, tolerance: float = TOLERANCE, race: float | None = None,
    ) -> list[Refit]:  # fmt: skip
        """Descends jobs side by side, all of them to the end unless they race or meet.

        Args:
            jobs: the candidates to fit together with the base values, and (K,) values to start from.
            shifts: (jobs, R) added to each one's residuals.
            rough: move also the base values that are known roughly.
            tolerance: relative gain of a round below which a descent rests.
            race: objective of what was fitted before; a descent that after its first rounds is HOPELESS times above
                that, or above the best of the others, is given up.
        """
        if not jobs:
            return []
        more = np.zeros((len(jobs), 1)) if shifts is None else shifts
        free = np.zeros((len(jobs), len(self.start)), dtype=bool)
        free[:, : len(self.library.base) - (0 if rough else self.library.rough)] = True
        for row, (candidates, _) in enumerate(jobs):
            for candidate in candidates:
                free[row, self.free_columns(candidate)] = True
        free &= ~(self.idle | self.sharp)
        width = (self.high - self.low) / self.spans

        def scaled(z: Array, owners: NDArray[np.int64], level: Level = level) -> Array:
            values = self.within(self.low + z * self.spans)
            expected = np.sqrt(SETTINGS.correlated) * residual_of(self.off(values)[:, stated])
            return np.concatenate([self.residuals(values, level) + more[owners], expected], axis=1)

        size, stated = len(self.used), self.stated
        begun = (np.array([start for _, start in jobs]) - self.low) / self.spans
        cheaper = partial(scaled, level="coarse") if level != "coarse" else None
        hopeless = None
        if race is not None and not self.exhaustive:
            hopeless = Race(FIRST_ROUNDS, HOPELESS, race * size / (size + stated.sum()))
        result = descend(scaled, begun, free, rounds, self.difference, tolerance, hopeless, RESPONSE, slopes=cheaper,
                         width=width, near=None if self.exhaustive else STANDS, certain=level == "exact")  # fmt: skip
        values = self.within(self.low + result.z * self.spans)
        return [
            Refit(tuple(c.name for c in candidates), values[row], result.residuals[row, :size],
                  float(np.mean(result.residuals[row, :size] ** 2)), int(free[row].sum()), bool(result.converged[row]),
                  self.held_at(values[row]), result.steps[row])
            for row, (candidates, _) in enumerate(jobs)
        ]  # fmt: skip

    def best_of(self, jobs: Sequence[Job], rounds: int, known: float = np.inf) -> list[Refit]:
        """Descends all jobs a little, the promising ones to the end; the best refit of each set of effects, best first.

        A shortlist of sets goes on until one leaves only noise; the others only within HOPELESS times the best.

        Args:
            known: floors that the best set leaves which was fitted before.
        """
        begun = self.refit(jobs, FIRST_ROUNDS)
        rough = self._rough(begun)
        redone = self.refit([job for job, bad in zip(jobs, rough, strict=True) if bad], FIRST_ROUNDS, "fine")
        early = best_by_set([*redone, *(r for r, bad in zip(begun, rough, strict=True) if not bad)])
        lowest = early[0].cost if early else np.inf
        few = SHORTLIST if min(lowest, known) > SETTINGS.healthy else LEAST_JUDGED
        certain = len(early) if self.exhaustive else few
        reach = HOPELESS * min(lowest, max(known, 1.0))
        going = [r for i, r in enumerate(early) if not r.converged and (i < certain or r.cost < reach)]
        finer = {id(r) for r in redone}
        late: list[Refit] = []
        for level in ("coarse", "fine"):
            here = [r for r in going if (id(r) in finer) == (level == "fine")]
            late += self.refit([(self.library.of(r.effects), r.values) for r in here], rounds, level)
        ordered = best_by_set([*early, *late])
        more = [*self._scanned(ordered[:SHORTLIST]), *self._awakened(ordered[:SHORTLIST], rounds)]
        ordered = best_by_set([*ordered, *more])
        best = ordered[:SHORTLIST]
        near = [r for i, r in enumerate(best) if i < LEAST_JUDGED or r.cost < OUT_OF_REACH * best[0].cost]
        judged = self.judged([(self.library.of(r.effects), r.values) for r in near], FINE_ROUNDS)
        return [*best_by_set([*judged, *self._looked_around(judged)]), *ordered[len(near) :]]

    def judged(self, jobs: Sequence[Job], rounds: int) -> list[Refit]:
        """Jobs descended at the fine level, corrected at each one's own values by the exact one, and judged by that.

        If the exact one only has shorter steps, the last rounds take these; and all rounds of a job that the fine level
        gets wrong, as it may where a joint creeps.
        """
        if self.levels["exact"] is self.levels["fine"]:
            return self.refit(jobs, rounds, "fine")
        if not jobs:
            return []
        points = np.array([values for _, values in jobs])
        first = self.residuals(points, "exact")
        shifts = first - self.residuals(points, "fine")
        if not self.levels["exact"].extrapolate:
            return self._corrected(jobs, rounds, first, shifts, PASSES)
        wrong = self._differ(shifts, np.mean(first**2, axis=1))
        direct = iter(self.refit([job for job, bad in zip(jobs, wrong, strict=True) if bad], rounds, "exact"))
        others = [job for job, bad in zip(jobs, wrong, strict=True) if not bad]
        begun = self._corrected(others, rounds, first[~wrong], shifts[~wrong], PASSES[:1])
        last = [(self.library.of(refit.effects), refit.values) for refit in begun]
        near = iter(self.refit(last, round(PASSES[1] * rounds), "exact"))
        return [next(direct if bad else near) for bad in wrong]

    def _corrected(
        self, jobs: Sequence[Job], rounds: int, first: Array, shifts: Array, passes: Sequence[float]
    ) -> list[Refit]:
        """Jobs descended at the fine level with `shifts` (jobs, R) added.

        Args:
            first: (jobs, R) their exact residuals.
            passes: shares of the rounds, after each of which the exact level corrects.
        """
        points = np.array([values for _, values in jobs])
        best: list[Refit] = []
        for share in passes if jobs else ():
            at = [(candidates, point) for (candidates, _), point in zip(jobs, points, strict=True)]
            refits = self.refit(at, round(share * rounds), "fine", shifts)
            if not best:  # a correction that misleads leaves each where it was
                begun = (replace(r, values=p, held=self.held_at(p)) for r, p in zip(refits, points, strict=True))
                best = [with_residuals(r, row) for r, row in zip(begun, first, strict=True)]
            points = np.array([r.values for r in refits])
            shown = self.residuals(points, "exact")
            shifts = shifts + shown - np.array([r.residuals for r in refits])
            exact = [with_residuals(r, row) for r, row in zip(refits, shown, strict=True)]
            best = [min(pair, key=lambda r: r.objective) for pair in zip(best, exact, strict=True)]
        return best

    @staticmethod
    def _differ(shifts: Array, costs: Array) -> NDArray[np.bool_]:
        """(n,) whether residuals that steps change by shifts (n, R) are wrong, beside costs (n,)."""
        return np.asarray(np.mean(shifts**2, axis=1) > ROUGH * np.maximum(costs, 1.0))

    def as_run(self, refit: Refit) -> Refit:
        """A refit with its values fitted at the model's own steps, so that they allow for these steps' error."""
        if "own" not in self.levels:
            return refit
        return self.refit([(self.library.of(refit.effects), refit.values)], OWN_ROUNDS, "own")[0]

    def valleys(self, refit: Refit) -> tuple[Refit, ...]:
        """A refit at the model's own steps, and those of the same effects in other valleys of the misfit: first the one
        nearest to what the model states, of those that fit as well as the best as far as steps can tell; then by fit.

        Values that can compensate for one another, such as P, D and delay, may fit as well far from a descent's end.
        """
        key = (refit.effects, refit.values.tobytes())
        if key not in self._valleys:
            refits = [self.as_run(refit)]
            if "own" in self.levels:
                starts = self.along_weakest(refit) + self.beside_stated([refit], VALLEY_ROUNDS, "own")
                jobs = [(self.library.of(refit.effects), point) for point in starts]
                refits += self.refit(jobs, VALLEY_ROUNDS, "own", tolerance=STANDS / VALLEY_ROUNDS,
                                     race=refits[0].objective)  # fmt: skip
            refits.sort(key=lambda r: r.objective)
            alike = [r for r in refits if r.objective <= refits[0].objective + STANDS]
            nearest = min(alike, key=lambda r: self.distance(r.values))
            self._valleys[key] = (nearest, *(r for r in refits if r is not nearest))
        return self._valleys[key]

    def weakest(self, refit: Refit) -> tuple[list[int], Array]:
        """Columns of the drive's values that a refit fits, and (k,) the direction in which it determines them least, in
        shares of their spans; none if it fits fewer than two.
        """
        columns = self.fitted(refit)[: len(self.library.base) - self.library.rough]
        if len(columns) < 2:
            return [], np.zeros(0)
        slopes = self.jacobian(refit)[:, : len(columns)]
        return columns, np.asarray(np.linalg.svd(slopes, full_matrices=False)[2][-1])

    def along_weakest(self, refit: Refit) -> list[Array]:
        """(K,) values to either side of a refit's along the direction of the drive that it determines least."""
        columns, weakest = self.weakest(refit)
        if not columns:
            return []
        points = np.tile(refit.values, (2 * len(AWAY), 1))
        points[:, columns] += np.outer(
            [sign * by for by in AWAY for sign in (1.0, -1.0)], weakest * self.spans[columns]
        )
        return list(self.within(points))

    def _rough(self, refits: Sequence[Refit]) -> list[bool]:
        """Which of the refits the coarse step gets wrong: a torque that saturates soon, say."""
        if not refits:
            return []
        finer = self.residuals(np.array([r.values for r in refits]), "fine")
        shifts = finer - np.array([r.residuals for r in refits])
        return [bool(wrong) for wrong in self._differ(shifts, np.array([r.cost for r in refits]))]

    def _scanned(self, refits: Sequence[Refit]) -> list[Refit]:
        """Refits from the best of values around each one's ticks, whose misfit has no slope to descend."""
        jobs = []
        for refit in refits:
            for name in (n for c in self.library.of(refit.effects) for n in c.parameters if n.endswith(".tick")):
                best, column = refit.values, self._column[name]
                for reach in (SCANNED, SCANNED / SCAN):
                    scanned = best[column] * np.geomspace(1.0 / (1.0 + reach), 1.0 + reach, SCAN)
                    best, _ = self._best_of_column(best, column, scanned)
                jobs.append((self.library.of(refit.effects), best))
        return self.refit(jobs, FIRST_ROUNDS)

    def _awakened(self, refits: Sequence[Refit], rounds: int) -> list[Refit]:
        """Refits from the best of values over the whole range of each of their effects' values that lies at a
        bound, or shows nothing, where a descent left it, as a limit that is not reached. It has no slope to descend.
        """
        jobs = []
        for refit in refits:
            own = np.array(self.own_columns(refit), dtype=np.int64)
            if len(own) < 2 or refit.cost < SETTINGS.healthy:
                continue  # an effect that shows nothing at all is none, and noise has nothing to gain
            moved = np.nan_to_num(self.residuals(self.moved(refit)[-len(own) :]) - refit.residuals, nan=np.inf)
            silent = np.mean(moved**2, axis=1) < SETTINGS.unfelt
            columns = own[silent | self.at_bound(refit.values[own], own)]
            if not len(columns):
                continue
            uncompensated = self._uncompensated(refit)
            for column in columns:
                points = np.tile(refit.values, (SCAN, 1))
                low, high = self.low[column], self.high[column]
                points[:, column] = np.geomspace(low, high, SCAN) if low > 0.0 else np.linspace(low, high, SCAN)
                costs = np.sum(uncompensated(self.residuals(points)) ** 2, axis=1) / len(refit.residuals)
                best = int(np.argmin(np.nan_to_num(costs, nan=np.inf)))
                if costs[best] < refit.cost - SETTINGS.material:
                    jobs.append((self.library.of(refit.effects), points[best]))
        return self.refit(jobs, rounds)

    def _looked_around(self, refits: Sequence[Refit]) -> list[Refit]:
        """Refits at the best of values around each one's rough ones, for which the misfit's slope says little."""
        best_refits = []
        for refit in refits:
            for column in (i for c in self.library.of(refit.effects) if is_rough(c) for i in self.columns(c)):
                reach = SCANNED * self.spans[column]
                scanned = refit.values[column] + np.linspace(-reach, reach, SCAN)
                best, residuals = self._best_of_column(refit.values, column, scanned, "exact")
                best_refits.append(with_residuals(replace(refit, values=best, held=self.held_at(best)), residuals))
        return best_refits

    def _best_of_column(
        self, values: Array, column: int, scanned: Array, level: Level = "coarse"
    ) -> tuple[Array, Array]:
        """(K,) the best of values with each of (n,) in one place, within its bounds, and its (R,) residuals."""
        around = np.tile(values, (len(scanned), 1))
        around[:, column] = scanned
        around = self.within(around)
        residuals = self.residuals(around, level)
        best = int(np.nanargmin(np.mean(residuals**2, axis=1)))
        return around[best], residuals[best]

    def trial_points(
        self, refits: Sequence[Refit], candidates: Sequence[Candidate], given: Mapping[str, Array] | None = None
    ) -> list[TrialPoint]:
        """Every start of every candidate on top of each refit, by promised cost, best first.

        On top of refits after the first, candidates with many starts are left out. Where starts (s, k) are `given` for
        a candidate, by its name, they replace its own.
        """
        points: list[TrialPoint] = []
        for number, refit in enumerate(refits):
            pending: list[tuple[Candidate, Array]] = []
            for candidate in (c for c in candidates if c.name not in refit.effects):
                rows = starts(candidate) if given is None or candidate.name not in given else given[candidate.name]
                for row in rows if number == 0 or len(rows) <= FEW_STARTS else ():
                    values = refit.values.copy()
                    values[self.columns(candidate)] = row
                    pending.append((candidate, values))
            uncompensated = self._uncompensated(refit)
            here = uncompensated(refit.residuals)
            for low in range(0, len(pending), AT_ONCE):
                answers = self.residuals(np.array([v for _, v in pending[low : low + AT_ONCE]]))
                alone = with_best_share(refit.residuals, answers - refit.residuals) / len(refit.residuals)
                # What the base values can compensate to first order does not count against a candidate.
                promised = with_best_share(here, uncompensated(answers) - here) / len(refit.residuals)
                batch = zip(pending[low : low + AT_ONCE], promised, alone, strict=True)
                points += [TrialPoint(c, v, float(p), number, float(a)) for (c, v), p, a in batch]
        return sorted((point for point in points if np.isfinite(point.promised)), key=lambda point: point.promised)

    def _uncompensated(self, refit: Refit) -> Callable[[Array], Array]:
        """What leaves of residuals (..., R) only what the values that a refit fits cannot make up for, to first order:
        (..., R and as many more as values are held).
        """
        changes = self.changes(refit)
        basis = directions(np.vstack([changes, self._held(refit)])[:, ~self._pressed(refit, changes)])
        more = basis.shape[0] - len(refit.residuals)

        def uncompensated(residuals: Array) -> Array:
            padded = np.concatenate([residuals, np.zeros((*residuals.shape[:-1], more))], axis=-1)
            return np.asarray(padded - (padded @ basis) @ basis.T)

        return uncompensated

    def _pressed(self, refit: Refit, changes: Array) -> NDArray[np.bool_]:
        """(k,) which of the values that `moved` moves lie at a bound, and would make up for more beyond it."""
        columns = self.fitted(refit)
        return self.at_bound(refit.values[columns], columns) & (changes.T @ refit.residuals > 0.0)

    def _held(self, refit: Refit) -> Array:
        """(k, k) how firmly each value that `moved` moves is held, per move."""
        columns = self.fitted(refit)
        return np.diag((self.firmness_at(refit.values) * self.steps_of(refit))[columns])
