# SPDX-License-Identifier: Apache-2.0
"""The tunnel of the command being played, as it fills sample by sample and trial by trial."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_sim.trials import Array

STEP = 0.01  # s between two rows
BRIDGED = 10  # rows; a longer gap between two samples stays as it was
LONGEST = 600.0  # s of a command that is shown
MEAN, LOWER, UPPER, SIMULATED, BEFORE = range(5)
UNSEEN, OUTSIDE, INSIDE = -1, 0, 1
DIGITS = 6  # decimals that are told; a microradian is finer than any screen


class TunnelTable:
    """One row per STEP of the command: mean, lower and upper limit of reality, the simulation, and that of the model
    before; whether it is inside.

    Attributes:
        revision: number that rows written from now on get.
    """

    def __init__(self) -> None:
        self.revision = 0
        self._began = 0
        self._key, self._signals, self._duration = "", tuple[str, ...](), 0.0
        self._values: Array = np.empty((0, 0, 5))
        self._alike: NDArray[np.int8] = np.empty((0, 0), dtype=np.int8)
        self._changed: NDArray[np.int64] = np.empty(0, dtype=np.int64)
        self._last = -1

    def start(self, key: str, duration: float) -> None:
        """A trial of a command begins: `key` tells commands apart, `duration` in s."""
        self._last = -1
        if key != self._key:
            self._key, self._duration = key, duration
            self._clear(())

    def add(
        self, time: float, signals: Sequence[str], mean: Array, lower: Array, upper: Array, simulated: Array,
        alike: Sequence[bool],
    ) -> None:  # fmt: skip
        """One sample at `time` s into the trial; lower and upper are deviations from the mean."""
        if not 0 <= time <= LONGEST:
            return
        if tuple(signals) != self._signals:
            self._clear(tuple(signals))
        row = round(time / STEP)
        self._grow(row + 1)
        new = self._values[row].copy()
        new[:, MEAN], new[:, LOWER], new[:, UPPER], new[:, SIMULATED] = mean, mean + lower, mean + upper, simulated
        inside = np.where(np.isfinite(new[:, :BEFORE]).all(axis=1), np.asarray(alike, dtype=np.int8), UNSEEN)
        first = self._last + 1 if 0 <= self._last < row <= self._last + BRIDGED else row
        if first < row:  # rows between this sample and the one before
            share = (np.arange(first, row) - self._last) / (row - self._last)
            old = self._values[self._last]
            between = old + share[:, None, None] * (new - old)
            self._values[first:row, :, :BEFORE] = between[:, :, :BEFORE]
            self._alike[first:row] = inside
        self._values[row, :, :BEFORE] = new[:, :BEFORE]
        self._alike[row] = inside
        self._changed[first : row + 1] = self.revision
        self._last = row

    def new_model(self) -> None:
        """The simulation runs another model: what it did so far is kept beside for comparison."""
        self._values[:, :, BEFORE] = self._values[:, :, SIMULATED]
        self._values[:, :, SIMULATED] = np.nan
        self._alike[:] = UNSEEN
        self._changed[:] = self.revision

    def changes(self, seen: int) -> dict[str, Any] | None:
        """Rows written after revision `seen`; None where there are none.

        rows: [row, [mean, lower, upper, simulated, before, inside] of each signal], None where unknown; inside is -1
        where a value is missing. `whole` says that all rows known before are gone.
        """
        rows = np.flatnonzero(self._changed > seen)
        whole = self._began > seen
        if not len(rows) and not whole:
            return None
        told = [
            [int(row), *([*_plain(self._values[row, s]), int(self._alike[row, s])] for s in range(len(self._signals)))]
            for row in rows
        ]
        return {
            "key": self._key, "signals": list(self._signals), "step": STEP, "duration": self._duration, "whole": whole,
            "rows": told,
        }  # fmt: skip

    def _clear(self, signals: tuple[str, ...]) -> None:
        self._signals, self._began, self._last = signals, self.revision, -1
        self._values = np.empty((0, len(signals), 5))
        self._alike = np.empty((0, len(signals)), dtype=np.int8)
        self._changed = np.empty(0, dtype=np.int64)
        self._grow(round(self._duration / STEP) + 1 if 0 < self._duration <= LONGEST else 1)

    def _grow(self, rows: int) -> None:
        more = rows - len(self._changed)
        if more > 0:
            shape = (more, len(self._signals))
            self._values = np.concatenate([self._values, np.full((*shape, 5), np.nan)])
            self._alike = np.concatenate([self._alike, np.full(shape, UNSEEN, dtype=np.int8)])
            self._changed = np.concatenate([self._changed, np.full(more, -1, dtype=np.int64)])


def _plain(values: Array) -> list[float | None]:
    return [round(value, DIGITS) if value == value else None for value in values.tolist()]
