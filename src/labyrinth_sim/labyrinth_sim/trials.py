# SPDX-License-Identifier: Apache-2.0
"""Trials: repeated runs of one command sequence on one even time grid, measured or simulated."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from labyrinth_sim.errors import InputError, unknown_name
from labyrinth_sim.shown import shown

Array = NDArray[np.float64]


def locked(values: object) -> Array:
    """A read-only float64 copy of `values`."""
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


def runs(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First index, and the one behind the last, of each unbroken run of true flags (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return [(int(low), int(high)) for low, high in edges.reshape(-1, 2)]


@shown
@dataclass(frozen=True)
class Trials:
    """p runs of the same command sequence, T samples of m signals each.

    Attributes:
        time: (T,) s, strictly increasing in even steps.
        signals: m names, each a legal ROS topic word.
        units: m units, SI ("rad", "rad/s", "m", "A", "1").
        values: (p, T, m) in those units; NaN where a signal was not seen.
        command_channels: u names.
        commands: (p, T, u) rad; NaN before the first command and where the drive was off.
    """

    time: Array
    signals: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    command_channels: tuple[str, ...]
    commands: Array

    def __post_init__(self) -> None:
        for name in ("time", "values", "commands"):
            object.__setattr__(self, name, locked(getattr(self, name)))
        for name in ("signals", "units", "command_channels"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        complaints = list(self._complaints())
        if complaints:
            raise InputError(complaints)

    def _complaints(self) -> Iterable[str]:
        t, m, u = self.time.shape[0] if self.time.ndim == 1 else -1, len(self.signals), len(self.command_channels)
        if t < 1:
            yield f"time must have shape (T,) with T >= 1, got {self.time.shape}."
            return
        if len(set(self.signals)) != m:
            yield f"Signal names must differ from one another, got {list(self.signals)}."
        if len(self.units) != m:
            yield f"{m} signals need {m} units, got {len(self.units)}."
        if self.values.ndim != 3 or self.values.shape[0] < 1 or self.values.shape[1:] != (t, m):
            yield f"values must have shape (p, {t}, {m}) with p >= 1, got {self.values.shape}."
        elif self.commands.shape != (self.values.shape[0], t, u):
            yield f"commands must have shape ({self.values.shape[0]}, {t}, {u}), got {self.commands.shape}."
        if t > 1:
            steps = np.diff(self.time)
            if not steps.min() > 0 or not np.allclose(steps, steps.mean(), rtol=1e-6, atol=1e-9):
                yield f"time must increase in even steps, got steps from {steps.min():g} to {steps.max():g} s."
        if np.isinf(self.values).any() or np.isinf(self.commands).any():
            yield "values and commands must be finite or NaN; infinite values came. Look for a broken sensor channel."

    @property
    def count(self) -> int:
        """p, the number of trials."""
        return int(self.values.shape[0])

    @property
    def step(self) -> float:
        """Seconds between samples; 0 for a single sample."""
        return float((self.time[-1] - self.time[0]) / (len(self.time) - 1)) if len(self.time) > 1 else 0.0

    def index(self, signal: str) -> int:
        """Column of a signal. Raises InputError that lists the valid names."""
        if signal not in self.signals:
            raise InputError(unknown_name("signal", signal, self.signals))
        return self.signals.index(signal)

    def select(self, signals: Iterable[str]) -> "Trials":
        """The same trials with these signals only, in this order."""
        names = tuple(signals)
        columns = [self.index(name) for name in names]
        return replace(
            self,
            signals=names,
            units=tuple(self.units[c] for c in columns),
            values=self.values[:, :, columns],
        )
