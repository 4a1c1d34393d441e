# SPDX-License-Identifier: Apache-2.0
"""The values that a model has already, fitted before anything is added to it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.stats import qmc

from eps_tunnel_analysis.diagnose.axis_search import AxisPart, SearchOptions, axis_search
from eps_tunnel_analysis.diagnose.search import Refit, Search
from eps_tunnel_analysis.simulated import Play
from labyrinth_sim.build import axes_couple
from labyrinth_sim.model import Model
from labyrinth_sim.trials import Array

BASE_POINTS = 64  # values of the base tried before it is descended, and
BASE_STARTS = 8  # how many of them are descended
APART = 0.1  # of the bounds' span, between starts
NEAR = 0.2  # of the bounds' span, where half of them lie around the model's own
BASE_ROUNDS = 8  # of each descent
VALLEY_POINTS = 8  # to either side of the best, along what it determines least
BASE_FINALISTS = 3  # of the starts, descended to the end
SWEEPS = 3  # over all axes' base values, at most, and
SETTLED_BASE = 0.02  # relative change of an axis's cost below which they have settled


@dataclass(frozen=True)
class Bases:
    """Base values of several axes.

    Attributes:
        values: axis -> full name -> value; empty where there is one axis only.
        evaluations: roll-outs that it took.
    """

    values: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    evaluations: int = 0

    def among(self, model: Model, axis: str) -> Model:
        """The model as one axis is searched on it: the other axes with their refitted values."""
        others = {n: v for other, values in self.values.items() if other != axis for n, v in values.items()}
        return model.with_values(others, "refitted")


def fitted_bases(model: Model, plays: Sequence[Play], parts: Sequence[AxisPart], run: SearchOptions) -> Bases:
    """The base values of every axis, each fitted while the others move as they do; again until they have settled.

    Whatever couples to a wrong drive of another axis turns along wrongly: effects that couple, and inertia.
    """
    bases, costs, evaluations = Bases(), dict[str, float](), 0
    chosen = [p for p in parts if p.base] if len(parts) > 1 else []
    for _ in range(SWEEPS):
        settled = True
        for part in chosen:
            search = axis_search(bases.among(model, part.axis), plays, part, replace(run, only=()))
            refit = base_refit(search, bases.values.get(part.axis))
            values = dict(zip(search.library.base, (float(v) for v in refit.values), strict=False))
            settled &= abs(refit.cost - costs.get(part.axis, np.inf)) <= SETTLED_BASE * refit.cost
            costs[part.axis], evaluations = refit.cost, evaluations + search.evaluations
            bases = Bases({**bases.values, part.axis: values}, evaluations)
        if settled or not dynamics_couple(model):
            break
    return bases


def dynamics_couple(model: Model) -> bool:
    """Whether one axis carries another, so that its motion shakes the other's joints."""
    return axes_couple(model) or any(use.effect.couples for use in model.effects)


def base_refit(search: Search, known: Mapping[str, float] | None = None) -> Refit:
    """The base values alone: descended from where the model has them and from the best of many others.

    Delay and D stand in for one another, and a base that is stuck in the wrong valley makes any effect look good.

    Args:
        known: what such a search found already; then from there instead of from many others.
    """
    if known is None:
        return base_from(search, base_starts(search, search.start, BASE_STARTS), first=True)
    again = search.start.copy()
    again[: len(search.library.base)] = [known[name] for name in search.library.base]
    return base_from(search, [search.start, again], first=True)


def base_starts(search: Search, values: Array, keep: int) -> list[Array]:
    """(K,) values, and those with other base values that fit best, out of many, each from a valley of its own."""
    size = len(search.library.base) - search.library.rough
    drawn = qmc.Sobol(size, rng=0, scramble=True).random(BASE_POINTS) if size else np.empty((0, 0))
    span = (search.high - search.low)[:size]
    points = np.tile(values, (len(drawn) + 1, 1))
    near = len(drawn) // 2
    points[1 : near + 1, :size] = search.start[:size] + (drawn[:near] - 0.5) * NEAR * span
    points[near + 1 :, :size] = search.low[:size] + drawn[near:] * span
    points = np.clip(points, search.low, search.high)
    cost = np.mean(search.residuals(points) ** 2, axis=1)
    cost[0] = -1.0  # the given ones are tried in any case
    chosen: list[Array] = []
    for i in np.argsort(np.nan_to_num(cost, nan=np.inf), kind="stable"):
        if all(np.any(np.abs(points[i] - other)[:size] > APART * span) for other in chosen):
            chosen.append(points[i])
    return chosen[:keep]


def base_from(search: Search, points: Sequence[Array], first: bool = False) -> Refit:
    """The base values alone, descended from (K,) values whose effects do not count.

    Args:
        first: nothing was refitted before; then the noise floor is settled, too.
    """
    size = len(search.library.base)
    starts = [np.concatenate([point[:size], search.start[size:]]) for point in points]
    early = search.refit([((), point) for point in starts], BASE_ROUNDS, rough=False)
    best = sorted(early, key=lambda r: r.objective)[:BASE_FINALISTS]
    finer = search.refit([((), r.values) for r in best], BASE_ROUNDS, "fine", rough=False)
    away = along_valley(search, min(finer, key=lambda r: r.objective))
    finer += search.refit([((), point) for point in away], BASE_ROUNDS,
                          "fine", rough=False)  # fmt: skip
    finer = sorted(finer, key=lambda r: r.objective)[:BASE_FINALISTS]
    joints = sensed_joints(search)
    if first and joints:
        search.settle_start(finer[0], joints)
        search.see_ticks(finer[0].values)
    search.feel(finer[0])
    last = search.refit([((), r.values) for r in finer], BASE_ROUNDS, "fine")
    best_of_all = min(last, key=lambda r: r.objective)
    search.refine_at(best_of_all.values)
    result = search.judged([((), best_of_all.values)], BASE_ROUNDS)[0]
    search.settle_at(result)
    return result


def sensed_joints(search: Search) -> list[list[str]]:
    """For each joint whose position is compared its signals, the finest first."""
    found: dict[str, list[str]] = {}
    for axis in search.library.model.rig.axes:
        for m in axis.finest_first:
            if m.quantity == "position" and m.signal in search.evidence.signals:
                found.setdefault(m.joint, []).append(m.signal)
    return list(found.values())


def along_valley(search: Search, refit: Refit) -> list[Array]:
    """(K,) values far from a refit's along the direction that it determines least, the best to either side.

    Values that stand in for one another, as D and delay do, make a long valley with more than one hollow.
    """
    columns = search.fitted(refit)[: len(search.library.base) - search.library.rough]
    if len(columns) < 2:
        return []
    span = (search.high - search.low)[columns]
    slopes = search.jacobian(refit)[:, : len(columns)]
    weakest = np.linalg.svd(slopes, full_matrices=False)[2][-1]
    points = []
    for sign in (1.0, -1.0):
        here = (refit.values - search.low)[columns] / span
        way = sign * weakest
        with np.errstate(divide="ignore"):
            room = float(np.min(np.where(way > 0.0, (1.0 - here) / way, -here / way)))
        tried = np.tile(refit.values, (VALLEY_POINTS, 1))
        tried[:, columns] += np.linspace(0.0, room, VALLEY_POINTS + 1)[1:, None] * way * span
        tried = np.clip(tried, search.low, search.high)
        cost = np.mean(search.residuals(tried) ** 2, axis=1)
        points.append(tried[int(np.argmin(np.nan_to_num(cost, nan=np.inf)))])
    return points
