# SPDX-License-Identifier: Apache-2.0
"""Marks that effects leave in the data, each a number: the share of a difference that the mark explains, 0 to 1.

All compare a signal with the effect and without it, sample by sample.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labyrinth_sim.trials import Array


@dataclass(frozen=True)
class Pair:
    """One signal with and without an effect. All (T,); `other` is the other axis's, or zeros; `step` in s."""

    step: float
    command: Array
    without: Array
    with_it: Array
    other: Array

    @property
    def difference(self) -> Array:
        return self.with_it - self.without


def late(pair: Pair) -> float:
    """The signal trails by a constant time."""
    best = 0.0
    for shift in range(1, min(40, len(pair.without) // 4)):
        moved = np.concatenate([np.repeat(pair.without[:1], shift), pair.without[:-shift]])
        best = max(best, _explained(pair.difference, moved - pair.without, free=False))
    return best


def offset(pair: Pair) -> float:
    """The signal is shifted by a constant."""
    return _explained(pair.difference, np.ones_like(pair.difference))


def scaled(pair: Pair) -> float:
    """The signal is larger or smaller by a constant factor."""
    return _explained(pair.difference, pair.without)


def loop(pair: Pair) -> float:
    """The signal differs by a constant against the direction that the command last moved in."""
    return _explained(pair.difference, -_direction(pair.command))


def one_sided(pair: Pair) -> float:
    """The signal differs by one constant going up and by another going down."""
    up = _direction(pair.command) > 0
    fit = np.where(up, _mean(pair.difference, up), _mean(pair.difference, ~up))
    return _explained(pair.difference, fit)


def by_angle(pair: Pair) -> float:
    """The difference is a function of the command's value, whatever its direction."""
    bins = np.digitize(pair.command, np.linspace(pair.command.min(), pair.command.max(), 16)[1:-1])
    fit = np.array([_mean(pair.difference, bins == b) for b in range(15)])[bins]
    return _explained(pair.difference, fit)


def passing(pair: Pair) -> float:
    """The difference comes with motion and is gone at rest."""
    moving = np.abs(np.gradient(pair.without, pair.step)) + np.abs(np.gradient(pair.with_it, pair.step)) > 0.02
    size = pair.difference**2
    return float(1.0 - size[~moving].sum() / max(size.sum(), 1e-30))


def stairs(pair: Pair) -> float:
    """The signal stands still at times when it would otherwise move: share of that time."""
    fast, slow = (np.abs(np.diff(signal)) for signal in (pair.without, pair.with_it))
    moving = fast > 0.2 * fast[fast > 0].mean()
    return float((slow[moving] < 0.25 * fast[moving]).mean())


def adrift(pair: Pair) -> float:
    """The signal moves before the command does: share of that travel which is new."""
    moves = np.flatnonzero(np.diff(pair.command))
    first = int(moves[0]) + 1 if moves.size else len(pair.command)
    ways = [np.abs(np.diff(signal[:first])).sum() for signal in (pair.with_it, pair.without)]
    return float(np.clip(1.0 - ways[1] / ways[0], 0.0, 1.0)) if ways[0] > 1e-6 else 0.0


def coupled(pair: Pair) -> float:
    """The difference follows what the other axis does."""
    return _explained(pair.difference, pair.other)


def calmer(pair: Pair) -> float:
    """The signal travels less: share of the travel that is gone."""
    ways = [np.abs(np.diff(signal)).sum() for signal in (pair.with_it, pair.without)]
    return float(np.clip(1.0 - ways[0] / ways[1], 0.0, 1.0))


def livelier(pair: Pair) -> float:
    """The signal travels more: share of the travel that is new."""
    ways = [np.abs(np.diff(signal)).sum() for signal in (pair.with_it, pair.without)]
    return float(np.clip(1.0 - ways[1] / ways[0], 0.0, 1.0))


MARKS: dict[str, Callable[[Pair], float]] = {
    mark.__name__: mark
    for mark in (late, offset, scaled, loop, one_sided, by_angle, passing, stairs, adrift, coupled, calmer, livelier)
}


def _explained(difference: Array, shape: Array, free: bool = True) -> float:
    """Share of the difference's squares that `shape` explains, its size free or not."""
    total = float(difference @ difference)
    if total == 0.0:
        return 0.0
    size = float(shape @ difference) / max(float(shape @ shape), 1e-30) if free else 1.0
    rest = difference - size * shape
    return float(np.clip(1.0 - float(rest @ rest) / total, 0.0, 1.0))


def _direction(command: Array) -> Array:
    """(T,) +1 or -1, of the command's last motion; 0 before the first."""
    steps = np.sign(np.diff(command, prepend=command[0]))
    last = np.maximum.accumulate(np.where(steps != 0, np.arange(len(steps)), 0))
    return np.asarray(steps[last])


def _mean(values: Array, where: NDArray[np.bool_]) -> float:
    return float(values[where].mean()) if where.any() else 0.0
