# SPDX-License-Identifier: Apache-2.0
"""Refitting every candidate on top of the model, in whole roll-outs, side by side.

First trial points: one roll-out at many values of every candidate, judged after taking away what the base values could
compensate to first order. Then a descent of the base values and the candidate's together, from the best of them.
"""

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from eps_tunnel_analysis.diagnose.candidates import Candidate, Library, is_rough, loosely_known, starts
from eps_tunnel_analysis.diagnose.evidence import Evidence
from eps_tunnel_analysis.diagnose.rank import worst_floors
from eps_tunnel_analysis.diagnose.refits import Job, Refit, TrialPoint, best_by_set, with_best_share, with_residuals
from eps_tunnel_analysis.diagnose.settings import SETTINGS
from eps_tunnel_analysis.diagnose.stated import residual_of, strain_of, weight_of
from eps_tunnel_analysis.fit.differences import directions, jacobian, steps_within
from eps_tunnel_analysis.fit.lockstep import Race, descend
from eps_tunnel_analysis.fit.problem import AT_BOUND
from labyrinth_sim.friction import SLOW
from labyrinth_sim.trials import Array

DIFFERENCE = 1e-3  # finite differences to begin with, normalised
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
FINEST = 4e-4  # s, of MuJoCo's steps, for each axis of a part: several have as many more values to fit
STEPS_LONGER = 4.0  # times, by which steps of descents may be longer than those that judge
STANDS = 0.1  # floors by which half the step may change an answer that is accurate enough
#: times its cost and the noise floor: a refit that longer steps get wrong by more goes on at shorter ones
ROUGH = 0.2

Level = Literal["coarse", "fine", "exact", "own"]


class Search:
    """Roll-outs of a library of candidates, in units of the noise floor.

    Args:
        levels: over the library's model and all of its names. The coarse one searches and gives slopes; the fine
            one judges refits; the exact one also has the drives' ticks, and is the fine one if there are none. The own
            level, if there is one, has the model's own steps.
        scale: (n,) the noise floor at each of the evidence's samples.
        used: (R,) which of the evidence's samples are compared.
        progress: called with the number of roll-outs so far.
        difference: step of the finite differences, in shares of each value's span.
        exhaustive: nothing is given up before its descent has ended.
    """

    def __init__(
        self,
        library: Library,
        levels: Mapping[Level, Evidence],
        scale: Array,
        used: NDArray[np.int64],
        progress: Callable[[int], None] | None = None,
        difference: float = DIFFERENCE,
        exhaustive: bool = False,
    ) -> None:
        self.library, self.levels, self.used = library, dict(levels), used
        self.evidence = levels["coarse"]
        infos = library.model.parameters()
        self.low = np.array([infos[name].low for name in library.names])
        self.high = np.minimum([infos[name].high for name in library.names], library.highest)
        self.start = np.clip([infos[name].value for name in library.names], self.low, self.high)
        self.blocks = self.evidence.blocks[used]
        self.signal = self.blocks % len(self.evidence.signals)
        self.scale = self._noise = scale[used]
        self.evaluations = 0
        self.progress, self.exhaustive = progress, exhaustive
        self.shift = np.zeros(len(used))  # (R,) added to coarse residuals: the step's error near where the search is
        self._column = {name: i for i, name in enumerate(library.names)}
        #: (K,) large changes of the values, of which the search moves them by shares
        self.spans = np.array([infos[name].span for name in library.names])
        #: (K,) how firmly each value is expected to be as stated, per share of its span; 0 for what is free.
        self.firmness = np.zeros(len(self.start))
        for column, name in enumerate(library.base[: len(library.base) - library.rough]):
            if loosely_known(library.model, name):
                share = SETTINGS.loose * abs(self.start[column]) / self.spans[column]
                self.firmness[column] = np.sqrt(SETTINGS.correlated) / share
        base = np.arange(len(library.base) - library.rough, len(library.base))
        span = self.spans[base]
        self._spread = SETTINGS.rough * np.where(self.start[base] != 0.0, np.abs(self.start[base]), span)
        # Beyond that it would stand in for an effect; `doubts` reports values that are further off.
        self.low[base] = np.maximum(self.low[base], self.start[base] - SETTINGS.farthest * self._spread)
        self.high[base] = np.minimum(self.high[base], self.start[base] + SETTINGS.farthest * self._spread)
        span = self.spans[base] = (self.high - self.low)[base]
        self.firmness[base] = np.sqrt(SETTINGS.correlated) * span / self._spread
        self.difference = np.full(len(self.start), difference)
        self.difference[base] = np.minimum(difference, 0.1 * self._spread / span)
        driven = {name.split(".")[1] for name in library.base if name.startswith("drive.")}
        self._finest = FINEST * max(1, len(driven))
        self._valleys: dict[tuple[tuple[str, ...], bytes], tuple[Refit, ...]] = {}
        self.idle = np.zeros(len(self.start), dtype=bool)  # base values that do not affect the recordings
        #: (K,) how gradually the model's own dry friction sets in, as long as that stays as stated
        self.sharp = np.zeros(len(self.start), dtype=bool)
        self.sharp[base] = [library.base[column].endswith(f".{SLOW.name}") for column in base]

    def residuals(self, values: Array, level: Level = "coarse") -> Array:
        """(n, K) values to (n, R) residuals in units of the noise floor."""
        self.evaluations += len(values)
        seen = self.levels[level](values)[:, self.used] / self.scale
        if self.progress:
            self.progress(self.evaluations)
        return seen + self.shift if level == "coarse" else seen

    def strain(self, values: Array) -> float:
        """How unlikely values (K,) are beside what is stated: minus twice the logarithm of their likelihood."""
        return float(np.sum(strain_of(self._off(values))))

    def firmness_at(self, values: Array) -> Array:
        """(K,) how firmly values (K,) are held where they are; less firmly far from what is stated."""
        return np.asarray(self.firmness * np.sqrt(weight_of(self._off(values))))

    def _off(self, values: Array) -> Array:
        """How far values (..., K) are from what is stated, in units of what is expected of each."""
        return np.asarray(self.firmness * (values - self.start) / self.spans / np.sqrt(SETTINGS.correlated))

    def held_at(self, values: Array) -> float:
        """What being far from what is stated adds to the cost of values (K,)."""
        return self.strain(values) * SETTINGS.correlated / len(self.used)

    def see_ticks(self, values: Array, agreement: Array | None = None) -> None:
        """Adds to the noise what the drives' own ticks do to the motion at these values (K,).

        Within one a drive stops anywhere. As long as the phases of the model's ticks and of the rig's are unknown, each
        of the two moves the motion by that much.

        Args:
            agreement: for each signal the share of what the model's ticks do to it that the rig's do as well.
        """
        moved = self._by_ticks(values)
        if moved is None:
            return
        each = np.bincount(self.blocks, moved**2) / np.maximum(np.bincount(self.blocks), 1)
        differ = 1.0 - (np.zeros(len(self.evidence.signals)) if agreement is None else agreement)
        scale = np.sqrt(self._noise**2 + 2.0 * differ[self.signal] * each[self.blocks])
        self.shift *= self.scale / scale
        self.scale = scale

    @property
    def folds(self) -> NDArray[np.int64]:
        """(R,) the stretch of time to which each residual belongs."""
        return self.levels["exact"].fold(SETTINGS.block)[self.used]

    def ticks_agree(self, refit: Refit) -> Array:
        """For each signal the share of what the model's ticks do to it at a refit that the rig's do as well.

        A lower bound, from stretches of time that are taken as independent, and never all of it, because noise shakes a
        rig's ticks.
        """
        shares, folds = np.zeros(len(self.evidence.signals)), self.folds
        moved = self._by_ticks(refit.values)
        if moved is None:
            return shares
        moved = moved / self.scale
        smooth = self.residuals(refit.values[None], "exact")[0] - moved
        for number in np.unique(self.signal):
            here = self.signal == number
            along, size = np.bincount(folds[here], -(smooth * moved)[here]), np.bincount(folds[here], moved[here] ** 2)
            if size.sum() > 0.0:
                share = along.sum() / size.sum()
                deviation = float(np.sqrt(np.sum((along - share * size) ** 2))) / size.sum()
                shares[number] = np.clip(share - SETTINGS.ticks_surely * deviation, 0.0, SETTINGS.ticks_agree)
        return shares

    def _by_ticks(self, values: Array) -> Array | None:
        """(R,) by which the drives' ticks move the signals at these values (K,), in their units; None without ticks."""
        exact, smooth = self.levels["exact"], self.levels["fine"].model
        if smooth.values() == exact.model.values():
            return None
        self.evaluations += 2
        both = np.vstack([exact(values[None]), exact.of(smooth)(values[None])])[:, self.used]
        return np.asarray(np.nan_to_num(both[0] - both[1]))

    def settle_start(self, refit: Refit, joints: Sequence[Sequence[str]]) -> None:
        """Moves the pose in which each play starts to where a refit puts it, as far as its sensors allow.

        A first sample is as coarse as any other, and a joint held by stiction keeps that error for long.

        Args:
            joints: for each joint the signals that measure its position, finest first.
        """
        exact = self.levels["exact"]
        plays = range(len(exact.plays))
        noise = np.array([[exact.start_noise(play, names[0]) for names in joints] for play in plays])
        here = self.residuals(refit.values[None], "exact")[0]
        slopes = []
        for names, column in zip(joints, noise.T, strict=True):
            moved = exact.started([dict.fromkeys(names, float(by)) for by in column])
            slopes.append(np.nan_to_num(moved(refit.values[None])[0, self.used] / self.scale - here))
            self.evaluations += 1
        own = self.blocks // len(exact.signals)
        less = SETTINGS.correlated * max(refit.cost, 1.0)  # samples are worth less, the more where something is missing
        shifts = []
        for play in plays:
            at = own == play
            change = np.column_stack([slope[at] for slope in slopes])
            normal = change.T @ change / less + np.eye(len(joints))
            by = np.linalg.solve(normal, -change.T @ here[at] / less)
            by = np.clip(by, -SETTINGS.farthest, SETTINGS.farthest) * noise[play]
            shifts.append({name: float(b) for names, b in zip(joints, by, strict=True) for name in names})
        self.levels = {level: evidence.started(shifts) for level, evidence in self.levels.items()}
        self.evidence = self.levels["coarse"]

    def settle_at(self, refit: Refit) -> None:
        """Corrects coarse roll-outs by the exact ones at a refit."""
        self.shift = self.shift + refit.residuals - self.residuals(refit.values[None])[0]

    def feel(self, refit: Refit) -> None:
        """Excludes from all later refits the roughly known values whose expected deviation does not show in the
        residuals.
        """
        base = np.arange(len(self.library.base) - self.library.rough, len(self.library.base))
        points = np.tile(refit.values, (2 * len(base), 1))
        for row, (column, spread) in enumerate(zip(base, self._spread, strict=True)):
            points[2 * row : 2 * row + 2, column] += (spread, -spread)
        moved = self.residuals(np.clip(points, self.low, self.high)) - self.residuals(refit.values[None])
        shows = np.nan_to_num(np.mean(moved**2, axis=1), nan=np.inf).reshape(-1, 2).max(axis=1)
        self.idle[base] = shows < SETTINGS.unfelt

    def refine_at(self, values: Array) -> bool:
        """Halves the steps of the level that judges until the answer at these values (K,) is accurate; whether any was.

        Descents begin with steps up to STEPS_LONGER times as long, corrected by that level.
        """
        shorter, here = False, self.residuals(values[None], "exact")[0]
        while self.levels["exact"].shortest > self._finest:
            finer = self.levels["exact"].finer()
            there = finer(values[None])[0, self.used] / self.scale
            self.evaluations += 1
            remaining, changed = worst_floors(here, self.signal), float(np.mean((there - here) ** 2))
            if finer.extrapolate:  # contacts and ticks change what is left by chance
                changed = max(changed, abs(worst_floors(there, self.signal) - remaining))
            if changed <= max(STANDS, SETTINGS.form * remaining):
                break
            self.levels["exact"], here, shorter = finer, there, True
        while self.levels["fine"].shortest > STEPS_LONGER * self.levels["exact"].shortest:
            self.levels["fine"] = self.levels["fine"].finer()
        return shorter

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
        other.idle = self.idle | (self.firmness > 0.0)
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

    def columns(self, candidate: Candidate) -> list[int]:
        """Columns of a candidate's values among the library's."""
        return [self._column[name] for name in candidate.parameters]

    def free_columns(self, candidate: Candidate) -> list[int]:
        """The same without those that are one of a few choices."""
        return [self._column[name] for name in candidate.free]

    def fitted(self, refit: Refit) -> list[int]:
        """Columns of the values that a refit fits among the library's, the base's first."""
        own = [column for c in self.library.of(refit.effects) for column in self.free_columns(c)]
        kept = self.idle | self.sharp
        return [column for column in (*range(len(self.library.base)), *own) if not kept[column]]

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
            values = np.clip(self.low + z * self.spans, self.low, self.high)
            expected = np.sqrt(SETTINGS.correlated) * residual_of(self._off(values)[:, stated])
            return np.concatenate([self.residuals(values, level) + more[owners], expected], axis=1)

        size, stated = len(self.used), self.firmness > 0.0
        begun = (np.array([start for _, start in jobs]) - self.low) / self.spans
        cheaper = partial(scaled, level="coarse") if level != "coarse" else None
        hopeless = None
        if race is not None and not self.exhaustive:
            hopeless = Race(FIRST_ROUNDS, HOPELESS, race * size / (size + stated.sum()))
        result = descend(scaled, begun, free, rounds, self.difference, tolerance, hopeless, RESPONSE, slopes=cheaper,
                         width=width, near=None if self.exhaustive else STANDS, certain=level == "exact")  # fmt: skip
        values = np.clip(self.low + result.z * self.spans, self.low, self.high)
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
        ordered = best_by_set([*ordered, *self._scanned(ordered[:SHORTLIST])])
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
        """A refit at the model's own steps, and those of the same effects in other valleys of the misfit, best first.

        Values that can compensate for one another, such as P, D and delay, may fit as well far from a descent's end.
        """
        key = (refit.effects, refit.values.tobytes())
        if key not in self._valleys:
            refits = [self.as_run(refit)]
            if "own" in self.levels:
                starts = self._along_weakest(refit) + self.beside_stated([refit], VALLEY_ROUNDS, "own")
                jobs = [(self.library.of(refit.effects), point) for point in starts]
                refits += self.refit(jobs, VALLEY_ROUNDS, "own", tolerance=STANDS / VALLEY_ROUNDS,
                                     race=refits[0].objective)  # fmt: skip
            self._valleys[key] = tuple(sorted(refits, key=lambda r: r.objective))
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

    def _along_weakest(self, refit: Refit) -> list[Array]:
        """(K,) values to either side of a refit's along the direction of the drive that it determines least."""
        columns, weakest = self.weakest(refit)
        if not columns:
            return []
        points = np.tile(refit.values, (2 * len(AWAY), 1))
        points[:, columns] += np.outer(
            [sign * by for by in AWAY for sign in (1.0, -1.0)], weakest * self.spans[columns]
        )
        return list(np.clip(points, self.low, self.high))

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
        around[:, column] = np.clip(scanned, self.low[column], self.high[column])
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
            changes = self.changes(refit)
            free = ~self._pressed(refit, changes)
            basis = directions(np.vstack([changes, self._held(refit)])[:, free])
            more = basis.shape[0] - len(refit.residuals)
            here = np.pad(refit.residuals, (0, more))
            here -= basis @ (basis.T @ here)
            for low in range(0, len(pending), AT_ONCE):
                answers = self.residuals(np.array([v for _, v in pending[low : low + AT_ONCE]]))
                alone = with_best_share(refit.residuals, answers - refit.residuals) / len(refit.residuals)
                # What the base values can compensate to first order does not count against a candidate.
                answers = np.pad(answers, ((0, 0), (0, more)))
                promised = with_best_share(here, answers - (answers @ basis) @ basis.T - here) / len(refit.residuals)
                batch = zip(pending[low : low + AT_ONCE], promised, alone, strict=True)
                points += [TrialPoint(c, v, float(p), number, float(a)) for (c, v), p, a in batch]
        return sorted((point for point in points if np.isfinite(point.promised)), key=lambda point: point.promised)

    def at(self, values: Array, like: Refit) -> Refit:
        """The refit that has these values (K,)."""
        there = replace(like, values=values, held=self.held_at(values))
        return with_residuals(there, self.residuals(values[None])[0])

    def moved(self, refit: Refit) -> Array:
        """(k, K) values of a refit with each of its fitted ones, the base's first, moved by a finite difference."""
        columns = self.fitted(refit)
        moved = np.tile(refit.values, (len(columns), 1))
        low, high = self.low[columns], self.high[columns]
        steps = steps_within(refit.values[columns], (self._steps(refit) * self.spans)[columns], low, high)
        moved[np.arange(len(columns)), columns] += steps
        return moved

    def _pressed(self, refit: Refit, changes: Array) -> NDArray[np.bool_]:
        """(k,) which of the values that `moved` moves lie at a bound, and would make up for more beyond it."""
        columns = self.fitted(refit)
        return self.at_bound(refit.values[columns], columns) & (changes.T @ refit.residuals > 0.0)

    def at_bound(self, values: Array, columns: Sequence[int] | NDArray[np.int64]) -> NDArray[np.bool_]:
        """(k,) which of the values (k,) of these columns lie at a bound."""
        room = np.minimum(values - self.low[columns], self.high[columns] - values)
        return np.asarray(room < AT_BOUND * self.spans[columns])

    def _held(self, refit: Refit) -> Array:
        """(k, k) how firmly each value that `moved` moves is held, per move."""
        columns = self.fitted(refit)
        return np.diag((self.firmness_at(refit.values) * self._steps(refit))[columns])

    def _steps(self, refit: Refit) -> Array:
        """(K,) finite differences, normalised."""
        return self.difference if refit.steps is None else refit.steps

    def changes(self, refit: Refit) -> Array:
        """(R, k) by which each value that `moved` moves changes residuals."""
        changes: Array = np.nan_to_num(self.residuals(self.moved(refit)) - refit.residuals).T
        return changes

    def jacobian(self, refit: Refit) -> Array:
        """(R, k) of a refit's residuals by its fitted values, each in shares of its span."""
        columns = self.fitted(refit)
        points = self.moved(refit)
        steps = np.diagonal((points - refit.values)[:, columns]) / self.spans[columns]
        answers = self.residuals(np.vstack([refit.values, points]))
        return jacobian(answers[0], answers[1:], steps)
