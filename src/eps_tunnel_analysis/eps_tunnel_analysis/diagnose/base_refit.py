# SPDX-License-Identifier: Apache-2.0
"""The base values of one axis refitted alone: P, D, delay and what else its drive declares.

Delay and D stand in for one another, and a base that is stuck in the wrong valley makes any effect look good.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.stats import qmc

from eps_tunnel_analysis.diagnose.refit import Refit
from eps_tunnel_analysis.diagnose.search import Search
from labyrinth_sim.trials import Array

LOOKS = 64  # values of the base tried before it is descended, and
STARTS = 5  # how many of them are descended
APART = 0.1  # of the bounds' span, between starts
NEAR = 0.2  # of the bounds' span, where half of them lie around the model's own
ROUNDS = 8  # of the last descent, half of them for the first ones


def base_refit(search: Search, known: Mapping[str, float] | None = None) -> Refit:
    """The base values alone: descended from where the model has them and from the best of many others.

    Args:
        known: what such a search found already; then from there instead of from many others.
    """
    if known is None:
        return base_from(search, base_starts(search, search.start, STARTS))
    found = search.start.copy()
    found[: len(search.library.base)] = [known[name] for name in search.library.base]
    return base_from(search, [search.start, found])


def base_starts(search: Search, values: Array, keep: int) -> list[Array]:
    """(K,) values, and those with other base values that fit best, out of many, each from a valley of its own."""
    size = len(search.library.base)
    drawn = qmc.Sobol(size, rng=0, scramble=True).random(LOOKS) if size else np.empty((0, 0))
    span = (search.high - search.low)[:size]
    points = np.tile(values, (len(drawn) + 1, 1))
    near = len(drawn) // 2
    points[1 : near + 1, :size] = search.start[:size] + (drawn[:near] - 0.5) * NEAR * span
    points[near + 1 :, :size] = search.low[:size] + drawn[near:] * span
    points = np.clip(points, search.low, search.high)
    cost = np.mean(search.residuals(points)[:, ~search.kept] ** 2, axis=1)
    cost[0] = -1.0  # the given ones are tried in any case
    chosen: list[Array] = []
    for i in np.argsort(np.nan_to_num(cost, nan=np.inf), kind="stable"):
        if all(np.any(np.abs(points[i] - other)[:size] > APART * span) for other in chosen):
            chosen.append(points[i])
    return chosen[:keep]


def base_from(search: Search, points: Sequence[Array]) -> Refit:
    """The base values alone, descended from (K,) values whose effects do not count."""
    size = len(search.library.base)
    starts = [np.concatenate([point[:size], search.start[size:]]) for point in points]
    early = search.refit([((), point) for point in starts], ROUNDS // 2)
    lowest = min(early, key=lambda r: r.cost)
    coarse = search.refit([((), lowest.values)], ROUNDS)[0]
    found = search.judged([((), coarse.values)], ROUNDS)[0]
    search.settle_at(found)
    return found
