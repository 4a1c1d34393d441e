# SPDX-License-Identifier: Apache-2.0
"""The values that a search moves: their bounds, what is expected of them, and which of them a fit is free to move."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from eps_tunnel_analysis.diagnose.candidates import Candidate, Library, loosely_known
from eps_tunnel_analysis.diagnose.refits import Refit
from eps_tunnel_analysis.diagnose.settings import SETTINGS
from eps_tunnel_analysis.diagnose.stated import strain_of, weight_of
from eps_tunnel_analysis.fit.problem import AT_BOUND
from labyrinth_sim.friction import SLOW
from labyrinth_sim.trials import Array


class Room:
    """The K values of a library: the base's first, those that are known roughly last among them, then the effects'.

    Attributes:
        library: the base values and the candidates.
        low, high: (K,) bounds, in the values' units.
        start: (K,) what the model states.
        spans: (K,) large changes of the values, of which a search moves them by shares.
        firmness: (K,) how firmly each value is expected to be as stated, per share of its span; 0 for what is free.
        spread: (r,) the expected deviation of each of the values that are known roughly, in their units.
        idle: (K,) base values that do not affect the recordings.
        sharp: (K,) how gradually the model's own dry friction sets in, as long as that stays as stated.
    """

    def __init__(self, library: Library) -> None:
        self.library = library
        infos = library.model.parameters()
        self.low = np.array([infos[name].low for name in library.names])
        self.high = np.minimum([infos[name].high for name in library.names], library.highest)
        self.start = np.clip([infos[name].value for name in library.names], self.low, self.high)
        self.spans = np.array([infos[name].span for name in library.names])
        self._column = {name: i for i, name in enumerate(library.names)}
        self.firmness = np.zeros(len(self.start))
        for column, name in enumerate(library.base[: len(library.base) - library.rough]):
            if loosely_known(library.model, name):
                share = SETTINGS.loose * abs(self.start[column]) / self.spans[column]
                self.firmness[column] = np.sqrt(SETTINGS.correlated) / share
        base, span = self.roughly_known, self.spans[self.roughly_known]
        spread = SETTINGS.rough * np.where(self.start[base] != 0.0, np.abs(self.start[base]), span)
        self.spread = spread
        # Beyond that it would stand in for an effect; `doubts` reports values that are further off.
        self.low[base] = np.maximum(self.low[base], self.start[base] - SETTINGS.farthest * spread)
        self.high[base] = np.minimum(self.high[base], self.start[base] + SETTINGS.farthest * spread)
        self.spans[base] = (self.high - self.low)[base]
        self.firmness[base] = np.sqrt(SETTINGS.correlated) * self.spans[base] / spread
        self.idle = np.zeros(len(self.start), dtype=bool)
        self.sharp = np.zeros(len(self.start), dtype=bool)
        self.sharp[base] = [library.base[column].endswith(f".{SLOW.name}") for column in base]

    @property
    def roughly_known(self) -> NDArray[np.int64]:
        """(r,) columns of the base values that are known roughly."""
        return np.arange(len(self.library.base) - self.library.rough, len(self.library.base))

    @property
    def stated(self) -> NDArray[np.bool_]:
        """(K,) values for which something is expected."""
        return np.asarray(self.firmness > 0.0)

    def within(self, values: Array) -> Array:
        """Values (..., K), each moved to its nearest bound where it is beyond."""
        return np.clip(values, self.low, self.high)

    def columns(self, candidate: Candidate) -> list[int]:
        """Columns of a candidate's values among the library's."""
        return [self._column[name] for name in candidate.parameters]

    def free_columns(self, candidate: Candidate) -> list[int]:
        """The same without those that are one of a few choices."""
        return [self._column[name] for name in candidate.free]

    def fitted(self, refit: Refit) -> list[int]:
        """Columns of the values that a refit fits among the library's, the base's first."""
        kept = self.idle | self.sharp
        every = (*range(len(self.library.base)), *self.own_columns(refit))
        return [column for column in every if not kept[column]]

    def own_columns(self, refit: Refit) -> list[int]:
        """Columns of the values of its effects that a refit fits."""
        return [column for c in self.library.of(refit.effects) for column in self.free_columns(c)]

    def off(self, values: Array) -> Array:
        """How far values (..., K) are from what is stated, in units of what is expected of each."""
        return np.asarray(self.firmness * (values - self.start) / self.spans / np.sqrt(SETTINGS.correlated))

    def strain(self, values: Array) -> float:
        """How unlikely values (K,) are beside what is stated: minus twice the logarithm of their likelihood."""
        return float(np.sum(strain_of(self.off(values))))

    def distance(self, values: Array) -> float:
        """How far the base values among values (K,) are from what the model states, together, in their spans."""
        size = len(self.library.base)
        return float(np.linalg.norm((values - self.start)[:size] / self.spans[:size]))

    def firmness_at(self, values: Array) -> Array:
        """(K,) how firmly values (K,) are held where they are; less firmly far from what is stated."""
        return np.asarray(self.firmness * np.sqrt(weight_of(self.off(values))))

    def at_bound(self, values: Array, columns: Sequence[int] | NDArray[np.int64]) -> NDArray[np.bool_]:
        """(k,) which of the values (k,) of these columns lie at a bound."""
        room = np.minimum(values - self.low[columns], self.high[columns] - values)
        return np.asarray(room < AT_BOUND * self.spans[columns])
