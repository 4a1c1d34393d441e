# SPDX-License-Identifier: Apache-2.0
"""By how much a missing effect, or the noise of the pose in which plays start, may have shifted values, to first order.

A fit absorbs as much of a missing effect into its values as these can imitate; the residuals show only how strong the
rest is. So each effect of the library is tried: the part that the values cannot imitate is scaled to the residuals, and
the shift from the other part is scaled with it. Intervals widen by the largest shift among the effects that explain
about as much as the best one.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from eps_tunnel_analysis.diagnose.candidates import Candidate, Library, library, starts
from eps_tunnel_analysis.diagnose.evidence import play_evidence
from eps_tunnel_analysis.diagnose.settings import SETTINGS
from eps_tunnel_analysis.fit.intervals import autocorrelation_length
from eps_tunnel_analysis.fit.problem import Objective, Problem, copied
from eps_tunnel_analysis.recorded_play import Play
from labyrinth_sim.rig import BALL_SIGNALS
from labyrinth_sim.trials import Array

STRENGTHS_TRIED = 4  # strengths at which an effect is tried
TRIED_AGAIN = 8  # effects that are tried again at the strength that explains most
STRONGEST = 3.0  # times a strength that was tried
COUNTS_FROM = 0.02  # likelihood, over that of the best effect, from which one counts


@dataclass(frozen=True)
class Discrepancy:
    """Attributes:
    shifts: (n, k) by which each effect that may be missing would have shifted the values, normalised units.
    likely: the effect that explains most, to first order; "" if only noise is left.
    """

    shifts: Array
    likely: str = ""

    @property
    def deviation(self) -> Array:
        """(k,) by how much a missing effect may have shifted each value, normalised units."""
        return np.asarray(np.abs(self.shifts).max(axis=0, initial=0.0))


@dataclass(frozen=True)
class _TriedEffects:
    """Effects that were tried: (n, K) values, names, the (n,) strength that explains most, the (n, k) shift of the
    fitted values, and (n,) mean square that is left.
    """

    values: Array
    names: tuple[str, ...]
    strength: Array
    shift: Array
    left: Array


def discrepancy(
    objective: Objective, plays: Sequence[Play], problem: Problem, z: Array, residuals: Array, slopes: Array
) -> Discrepancy:
    """How a missing effect may have changed a fit.

    Args:
        plays: that were fitted.
        z: (k,) the fit, normalised.
        residuals, slopes: (R,) and (R, k) there, in the fitness's scaling.
    """
    nothing = Discrepancy(np.empty((0, problem.size)))
    values = problem.from_unit(z)
    if not np.isfinite(slopes).all() or _misfit(objective, plays, objective(values[None])[0]) <= SETTINGS.healthy:
        return nothing
    model = objective.model.with_values(dict(zip(problem.names, values.tolist(), strict=True)))
    lib = library(model, (), any(s in objective.signals for s in BALL_SIGNALS))
    infos = lib.model.parameters()
    effects = copied(objective)
    effects.model, effects.free = lib.model, lib.names

    def answer(rows: Array) -> Array:
        return problem.fitness.scaled(effects(rows))

    off = np.array([infos[n].value for n in lib.names])
    inverse = np.asarray(np.linalg.pinv(slopes), dtype=np.float64)
    return shifts_of(answer, lib, lib.candidates, off, residuals, slopes, inverse, problem.blocks)


def shifts_of(
    answer: Callable[[Array], Array], lib: Library, candidates: Sequence[Candidate], off: Array, residuals: Array,
    slopes: Array, inverse: Array, blocks: Array,
) -> Discrepancy:  # fmt: skip
    """How each of some effects may have changed a fit, if it is the one that is missing.

    Args:
        answer: maps values (n, K) of all of the library's names to residuals (n, R).
        candidates: effects of the library to try.
        off: (K,) values of the fit, with these effects switched off.
        residuals, slopes: (R,) and (R, k) there.
        inverse: (k, R) from residuals to values.
        blocks: (R,) which unbroken run of samples each belongs to.
    """
    rows, names = _rows(lib, candidates, off)
    if not names:
        return Discrepancy(np.empty((0, slopes.shape[1])))
    worth = len(residuals) / (2.0 * autocorrelation_length(residuals, blocks) + 1.0)

    def tried(rows: Array, names: tuple[str, ...]) -> _TriedEffects:
        """The part that the values cannot imitate, scaled to what is left; and the shift from the other part."""
        change = np.nan_to_num(answer(rows)) - residuals
        imitated = change @ inverse.T
        rest = change - imitated @ slopes.T
        size = np.maximum(np.sum(rest**2, axis=1), 1e-300)
        strength = np.clip(-(rest @ residuals) / size, 0.0, STRONGEST)
        remaining = np.mean((residuals + strength[:, None] * rest) ** 2, axis=1)
        return _TriedEffects(rows, names, strength, -strength[:, None] * imitated, remaining)

    first = tried(rows, names)
    best = _best_of_each(first)[:TRIED_AGAIN]
    again = tried(_stronger(lib, off, first, best), tuple(first.names[i] for i in best))
    squares = np.concatenate([first.left, again.left])
    shift = np.concatenate([first.shift, again.shift])
    near = -0.5 * worth * np.log(np.maximum(squares, 1e-300) / max(squares.min(), 1e-300)) >= np.log(COUNTS_FROM)
    likely = (*first.names, *again.names)[int(np.argmin(squares))]
    return Discrepancy(shift[near], likely)


def _misfit(objective: Objective, plays: Sequence[Play], raw: Array) -> float:
    """Mean square of residuals (R,) in units of the noise floor."""
    floors = np.concatenate(
        [[float(np.median(n.floor)) for n in play_evidence(objective.model, play, objective.signals).noise]
         for play in plays]
    )  # fmt: skip
    return float(np.mean((np.nan_to_num(raw) / floors[objective.blocks]) ** 2))


def _rows(lib: Library, candidates: Sequence[Candidate], off: Array) -> tuple[Array, tuple[str, ...]]:
    """(n, K) values of a few strengths of every effect, and the names of the effects."""
    rows, names = [], []
    for candidate in candidates:
        strengths = starts(candidate)
        chosen = np.unique(np.linspace(0, len(strengths) - 1, STRENGTHS_TRIED).round().astype(int))
        columns = [lib.names.index(n) for n in candidate.parameters]
        for strength in strengths[chosen]:
            row = off.copy()
            row[columns] = strength
            rows.append(row)
            names.append(candidate.name)
    return np.array(rows), tuple(names)


def _best_of_each(tried: _TriedEffects) -> list[int]:
    """For each effect the row that leaves least, the effect that explains most first."""
    best: dict[str, int] = {}
    for i in np.argsort(tried.left, kind="stable"):
        best.setdefault(tried.names[int(i)], int(i))
    return list(best.values())


def _stronger(lib: Library, off: Array, tried: _TriedEffects, which: Sequence[int]) -> Array:
    """(n, K) values of effects at the strength that explains most, within their bounds."""
    infos = lib.model.parameters()
    rows = []
    for i in which:
        row = tried.values[i].copy()
        candidate = lib.find(tried.names[i])
        for name, p in zip(candidate.parameters, candidate.declared, strict=True):
            if p.off is not None:
                at = lib.names.index(name)
                moved = off[at] + max(tried.strength[i], 0.05) * (row[at] - off[at])
                row[at] = min(max(moved, infos[name].low), infos[name].high)
        rows.append(row)
    return np.array(rows)


def start_pose_deviation(
    objective: Objective, plays: Sequence[Play], problem: Problem, z: Array, residuals: Array, slopes: Array
) -> Array:
    """(k,) standard deviations, normalised, of fitted values due to noise in the poses in which plays start.

    The starts of different plays and positions are independent.

    Args:
        plays: that were fitted.
        z: (k,) the fit, normalised.
        residuals, slopes: (R,) and (R, k) there, in the fitness's scaling.
    """
    total = np.zeros(problem.size)
    if not np.isfinite(slopes).all():
        return total
    inverse = np.linalg.pinv(slopes)
    of_play = objective.blocks // len(objective.signals)
    for change in start_changes(objective, plays, problem, z, residuals):
        for number in range(len(plays)):
            total += (inverse @ np.where(of_play == number, change, 0.0)) ** 2
    return np.sqrt(total)


def start_changes(
    objective: Objective, plays: Sequence[Play], problem: Problem, z: Array, residuals: Array
) -> Iterator[Array]:
    """For each position, the change (R,) of the residuals when every play's start moves by the noise of its mean."""
    values = problem.from_unit(z)[None]
    runs = objective.rollouts
    for signal, start in runs.initial.items():
        noise = np.array([_noise_of_mean(play, signal) for play in plays])
        if noise.any():
            moved = copied(objective)
            moved.rollouts = replace(runs, initial={**runs.initial, signal: start + noise[runs.play]})
            yield np.nan_to_num(problem.fitness.scaled(moved(values))[0] - residuals)


def _noise_of_mean(play: Play, signal: str) -> float:
    """Standard deviation of a signal's mean over a play's trials; 0 for a single trial, whose noise is unknown."""
    if signal not in play.trials.signals or play.trials.count < 2:
        return 0.0
    values = play.trials.values[:, :, play.trials.index(signal)]
    seen = values[:, np.isfinite(values).all(axis=0)]
    return float(np.sqrt(np.mean(np.var(seen, axis=0, ddof=1)) / len(seen))) if seen.size else 0.0
