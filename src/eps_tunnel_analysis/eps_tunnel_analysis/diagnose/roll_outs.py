# SPDX-License-Identifier: Apache-2.0
"""Roll-outs of a library of candidates beside what was measured, in units of the noise floor, at several steps."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from eps_tunnel_analysis.diagnose.candidates import Library
from eps_tunnel_analysis.diagnose.evidence import Evidence
from eps_tunnel_analysis.diagnose.rank import worst_floors
from eps_tunnel_analysis.diagnose.refits import Refit, with_residuals
from eps_tunnel_analysis.diagnose.room import Room
from eps_tunnel_analysis.diagnose.settings import SETTINGS
from eps_tunnel_analysis.fit.differences import jacobian, steps_within
from labyrinth_sim.trials import Array

DIFFERENCE = 1e-3  # finite differences to begin with, normalised
FINEST = 4e-4  # s, of MuJoCo's steps, for each axis of a part: several have as many more values to fit
STEPS_LONGER = 4.0  # times, by which steps of descents may be longer than those that judge
STANDS = 0.1  # floors by which half the step may change an answer that is accurate enough

Level = Literal["coarse", "fine", "exact", "own"]


class RollOuts(Room):
    """What each set of values leaves of the recordings.

    Args:
        levels: over the library's model and all of its names. The coarse one searches and gives slopes; the fine
            one judges refits; the exact one also has the drives' ticks, and is the fine one if there are none. The own
            level, if there is one, has the model's own steps.
        scale: (n,) the noise floor at each of the evidence's samples.
        used: (R,) which of the evidence's samples are compared.
        progress: called with the number of roll-outs so far, and the effects that explain most so far.
        difference: step of the finite differences, in shares of each value's span.
    """

    def __init__(
        self,
        library: Library,
        levels: Mapping[Level, Evidence],
        scale: Array,
        used: NDArray[np.int64],
        progress: Callable[[int, Sequence[str]], None] | None = None,
        difference: float = DIFFERENCE,
    ) -> None:
        super().__init__(library)
        self.levels, self.used, self.progress = dict(levels), used, progress
        self.evidence = levels["coarse"]
        self.blocks = self.evidence.blocks[used]
        self.signal = self.blocks % len(self.evidence.signals)
        self.scale = self._noise = scale[used]
        self.evaluations = 0
        self.leading: tuple[str, ...] = ()  # effects that explain most so far, for whoever watches
        self.shift = np.zeros(len(used))  # (R,) added to coarse residuals: the step's error near where the search is
        self.difference = np.full(len(self.start), difference)
        base = self.roughly_known
        self.difference[base] = np.minimum(difference, 0.1 * self.spread / self.spans[base])
        driven = {name.split(".")[1] for name in library.base if name.startswith("drive.")}
        self._finest = FINEST * max(1, len(driven))

    def residuals(self, values: Array, level: Level = "coarse") -> Array:
        """(n, K) values to (n, R) residuals in units of the noise floor."""
        self.evaluations += len(values)
        seen = self.levels[level](values)[:, self.used] / self.scale
        if self.progress:
            self.progress(self.evaluations, self.leading)
        return seen + self.shift if level == "coarse" else seen

    def held_at(self, values: Array) -> float:
        """What being far from what is stated adds to the cost of values (K,)."""
        return self.strain(values) * SETTINGS.correlated / len(self.used)

    def at(self, values: Array, like: Refit) -> Refit:
        """The refit that has these values (K,)."""
        there = replace(like, values=values, held=self.held_at(values))
        return with_residuals(there, self.residuals(values[None])[0])

    def steps_of(self, refit: Refit) -> Array:
        """(K,) finite differences, normalised."""
        return self.difference if refit.steps is None else refit.steps

    def moved(self, refit: Refit) -> Array:
        """(k, K) values of a refit with each of its fitted ones, the base's first, moved by a finite difference."""
        columns = self.fitted(refit)
        moved = np.tile(refit.values, (len(columns), 1))
        low, high = self.low[columns], self.high[columns]
        steps = steps_within(refit.values[columns], (self.steps_of(refit) * self.spans)[columns], low, high)
        moved[np.arange(len(columns)), columns] += steps
        return moved

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

    @property
    def folds(self) -> NDArray[np.int64]:
        """(R,) the stretch of time to which each residual belongs."""
        return self.levels["exact"].fold(SETTINGS.block)[self.used]

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
        base = self.roughly_known
        points = np.tile(refit.values, (2 * len(base), 1))
        for row, (column, spread) in enumerate(zip(base, self.spread, strict=True)):
            points[2 * row : 2 * row + 2, column] += (spread, -spread)
        moved = self.residuals(self.within(points)) - self.residuals(refit.values[None])
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
