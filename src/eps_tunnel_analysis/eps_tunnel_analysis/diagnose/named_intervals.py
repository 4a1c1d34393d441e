# SPDX-License-Identifier: Apache-2.0
"""95 % intervals of the values of a model to which a diagnosis has added effects.

They have the same parts as a calibration's: autocorrelated noise, the pose in which a play starts, and, if more than
noise is left, the shift from another missing effect. They also include the step that the slopes still promise, because
a search ends when it gains little. Slopes say nothing about other valleys of the misfit; a valley whose values fit as
well, within chance and what steps may change, is in the interval, too.
"""

import copy
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from eps_tunnel_analysis.diagnose.axis import AxisDiagnosis
from eps_tunnel_analysis.diagnose.base_values import sensed_joints
from eps_tunnel_analysis.diagnose.discrepancy import shifts_of
from eps_tunnel_analysis.diagnose.rank import independent
from eps_tunnel_analysis.diagnose.refits import Refit
from eps_tunnel_analysis.diagnose.roll_outs import STANDS
from eps_tunnel_analysis.diagnose.search import Search
from eps_tunnel_analysis.diagnose.settings import SETTINGS
from eps_tunnel_analysis.fit.intervals import CHI2_95, intervals, widened
from labyrinth_sim.model import Model
from labyrinth_sim.trials import Array

PROFILED = (1e-3, 0.5)  # of a value's span, to either side, in
PROFILE_POINTS = 14
UNMOVED = 1e-9  # times the largest slope, below which a value moves nothing


def named_intervals(
    axes: Sequence[AxisDiagnosis], named: Collection[str], model: Model
) -> dict[str, tuple[float, float]]:
    """Full name of each fitted value -> its 95 % interval, in its unit, cut at its bounds.

    Args:
        named: effects that were added; none for the base values alone.
        model: with them, fitted.

    Returns:
        No entry for values that do not affect the recordings, which were left as stated.
    """
    values, infos = model.values(), model.parameters()
    bounds: dict[str, tuple[float, float]] = {}
    for axis in axes:
        search = copy.copy(axis.search)
        search.progress = None  # its display has ended
        best, *others = search.valleys(axis.acting(named))
        columns = search.fitted(best)
        half = _half_widths(search, best, columns) * search.spans[columns]
        own = [columns.index(i) for name in best.effects for i in search.free_columns(search.library.find(name))]
        half[own] = np.maximum(half[own], profiles(search, best, [columns[i] for i in own]))
        limit = min(r.objective for r in (best, *others)) + chance(search, best) + STANDS
        alike = [best.values, *(r.values for r in others if r.objective <= limit)]
        lowest, highest = np.min(alike, axis=0)[columns], np.max(alike, axis=0)[columns]
        for column, width, least, most in zip(columns, half, lowest, highest, strict=True):
            name = search.library.names[column]
            low, high = min(values[name], float(least)) - width, max(values[name], float(most)) + width
            bounds[name] = (float(max(low, infos[name].low)), float(min(high, infos[name].high)))
    return bounds


def intervals_json(bounds: Mapping[str, tuple[float, float]]) -> dict[str, list[float]]:
    """Name -> [low, high]."""
    return {name: [low, high] for name, (low, high) in bounds.items()}


def profiles(search: Search, refit: Refit, columns: Sequence[int]) -> Array:
    """(k,) half-widths of the 95 % intervals of values by their likelihood: slack, limits and friction have kinks, no
    slope.

    How far each value can move to either side while the misfit stays within chance, given the independent samples.
    """
    if not columns:
        return np.zeros(0)
    share = np.geomspace(*PROFILED, PROFILE_POINTS)
    steps = np.concatenate([share, -share])
    points = np.tile(refit.values, (len(columns), len(steps), 1))
    for row, column in zip(points, columns, strict=True):
        row[:, column] = np.clip(
            refit.values[column] + steps * search.spans[column], search.low[column], search.high[column]
        )
    search.settle_at(refit)
    answers = search.residuals(points.reshape(-1, len(refit.values)))
    cost = np.nan_to_num(np.mean(answers**2, axis=1), nan=np.inf).reshape(len(columns), 2, -1)
    limit = refit.cost + chance(search, refit)
    return np.array(
        [
            max(_reach(side, refit.cost, limit, share * search.spans[column]) for side in sides)
            for sides, column in zip(cost, columns, strict=True)
        ]
    )


def _reach(cost: Array, least: float, limit: float, away: Array) -> float:
    """How far from the least cost the limit is, from costs (n,) at distances (n,) to one side."""
    within = np.flatnonzero(cost <= limit)
    if not len(within):
        return float(away[0])
    last = int(within[-1])
    if last + 1 == len(away):
        return float(away[-1])
    here, beyond = max(cost[last], least), cost[last + 1]
    share = (limit - here) / (beyond - here) if np.isfinite(beyond) and beyond > here else 0.0
    return float(away[last] + share * (away[last + 1] - away[last]))


def chance(search: Search, refit: Refit) -> float:
    """By how much a mean square may exceed the least one by chance, at 95 %."""
    return CHI2_95 / max(independent(refit.residuals, search.blocks), 1.0) * refit.cost


def _half_widths(search: Search, refit: Refit, columns: Sequence[int]) -> Array:
    """(k,) of the 95 % intervals of the values that a refit fits, in shares of their spans; NaN if a slope diverges,
    inf for a value that moves nothing.
    """
    if not columns:
        return np.zeros(0)
    slopes, firm = search.jacobian(refit), search.firmness_at(refit.values)[list(columns)]
    if not np.isfinite(slopes).all():
        return np.full(len(columns), np.nan)
    blocks = search.blocks.astype(float)
    statistical = intervals(slopes, refit.residuals, blocks, held=firm, held_variance=SETTINGS.correlated)
    inverse = np.linalg.pinv(np.vstack([slopes, np.diag(firm)]))
    off = firm * ((refit.values - search.start) / search.spans)[list(columns)]
    step = inverse @ np.concatenate([refit.residuals, off])
    inverse = inverse[:, : len(slopes)]
    more = np.hypot(_by_start(search, refit, inverse), _by_effects(search, refit, slopes, inverse))
    half = widened(statistical, np.hypot(more, step)).half_width
    size = np.hypot(np.linalg.norm(slopes, axis=0), firm)
    return np.where(size > UNMOVED * size.max(), half, np.inf)


def _by_start(search: Search, refit: Refit, inverse: Array) -> Array:
    """(k,) by how much values move with the noise of the pose in which each play starts; a standard deviation."""
    exact = search.levels["exact"]
    here = search.residuals(refit.values[None], "exact")[0]
    own = search.blocks // len(exact.signals)
    total = np.zeros(len(inverse))
    for names in sensed_joints(search):
        noise = [exact.start_noise(play, names[0]) for play in range(len(exact.plays))]
        moved = exact.started([dict.fromkeys(names, by) for by in noise])
        change = np.nan_to_num(moved(refit.values[None])[0, search.used] / search.scale - here)
        for play in range(len(exact.plays)):
            total += (inverse @ np.where(own == play, change, 0.0)) ** 2
    return np.sqrt(total)


def _by_effects(search: Search, refit: Refit, slopes: Array, inverse: Array) -> Array:
    """(k,) by how much an effect that is still missing may have shifted values."""
    if refit.cost <= SETTINGS.healthy:
        return np.zeros(len(inverse))
    others = [c for c in search.library.candidates if c.name not in refit.effects]
    search.settle_at(refit)
    return shifts_of(
        search.residuals,
        search.library,
        others,
        refit.values,
        refit.residuals,
        slopes,
        inverse,
        search.blocks.astype(float),
    ).deviation
