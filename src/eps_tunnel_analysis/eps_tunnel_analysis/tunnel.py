# SPDX-License-Identifier: Apache-2.0
"""The tunnel: the states that repeated runs of one command sequence passed through, sample by sample."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from labyrinth_sim.errors import InputError, unknown_name
from labyrinth_sim.shown import shown
from labyrinth_sim.trials import Array, Trials, locked

HALF_WIDTH = 5  # samples to either side, equation 12


@shown
@dataclass(frozen=True)
class Tunnel:
    """All states s with mean + lower <= s <= mean + upper (equation 3), of T samples and m signals.

    Attributes:
        time: (T,) s.
        signals: m names.
        units: m units, SI.
        mean: (T, m) average over the trials that saw the sample; NaN where none did.
        lower: (T, m) lowest deviation from the mean, <= 0; NaN where the mean is.
        upper: (T, m) highest deviation from the mean, >= 0; NaN where the mean is.
        seen: (T, m) how many trials saw the sample.
        trials: p, how many trials there were.
        smoothed: whether lower and upper were filtered by equation 12.
    """

    time: Array
    signals: tuple[str, ...]
    units: tuple[str, ...]
    mean: Array
    lower: Array
    upper: Array
    seen: NDArray[np.int64]
    trials: int
    smoothed: bool = False

    def __post_init__(self) -> None:
        for name in ("time", "mean", "lower", "upper"):
            object.__setattr__(self, name, locked(getattr(self, name)))
        seen = np.array(self.seen, dtype=np.int64)
        seen.setflags(write=False)
        object.__setattr__(self, "seen", seen)
        complaints = list(self._complaints())
        if complaints:
            raise InputError(complaints)

    def _complaints(self) -> Iterable[str]:
        shape = (len(self.time), len(self.signals))
        for name in ("mean", "lower", "upper", "seen"):
            if getattr(self, name).shape != shape:
                yield f"{name} must have shape (T, m) = {shape}, got {getattr(self, name).shape}."
        if len(self.units) != len(self.signals):
            yield f"{len(self.signals)} signals need as many units, got {len(self.units)}."
        if np.nanmax(self.lower, initial=0) > 0 or np.nanmin(self.upper, initial=0) < 0:
            yield "A tunnel needs lower <= 0 <= upper at every sample."

    @property
    def step(self) -> float:
        """Seconds between samples; 0 for a single sample."""
        return float((self.time[-1] - self.time[0]) / (len(self.time) - 1)) if len(self.time) > 1 else 0.0

    def bounds(self, k: float = 1.0) -> tuple[Array, Array]:
        """Lowest and highest state of the tunnel scaled by k, each (T, m)."""
        return self.mean + k * self.lower, self.mean + k * self.upper

    def index(self, signal: str) -> int:
        """Column of a signal. Raises InputError that lists the valid names."""
        if signal not in self.signals:
            raise InputError(unknown_name("signal", signal, self.signals))
        return self.signals.index(signal)


def build_tunnel(trials: Trials) -> Tunnel:
    """The tunnel of p trials, equations 1 to 3.

    The order of the trials does not change one bit of it, p equal trials give a width of exactly zero, and the mean
    lies inside: values are summed in sorted order and the rounded mean is kept between the extremes.
    """
    values = np.sort(trials.values, axis=0)  # (p, T, m), NaN last
    seen = np.sum(~np.isnan(values), axis=0)  # (T, m)
    lowest = values[0]
    highest = np.take_along_axis(values, np.maximum(seen - 1, 0)[None], axis=0)[0]
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.clip(np.nansum(values, axis=0) / seen, lowest, highest)  # (1)
    return Tunnel(
        time=trials.time,
        signals=trials.signals,
        units=trials.units,
        mean=mean,
        lower=lowest - mean,  # (2)
        upper=highest - mean,
        seen=seen,
        trials=trials.count,
    )


def smooth(tunnel: Tunnel, half_width: int = HALF_WIDTH) -> Tunnel:
    """The tunnel with its limits averaged over 2 * half_width + 1 samples, equation 12; the mean stays.

    At the ends, and next to samples that no trial saw, the average is over the samples that exist.

    Raises:
        InputError: the tunnel is smoothed already, or half_width is negative.
    """
    if tunnel.smoothed:
        raise InputError("This tunnel is smoothed already; smooth the one that build_tunnel gave.")
    if half_width < 0:
        raise InputError(f"half_width must be 0 or more samples, got {half_width}.")
    unseen = np.isnan(tunnel.mean)
    return replace(
        tunnel,
        lower=np.where(unseen, np.nan, -_moving_mean(np.abs(tunnel.lower), half_width)),
        upper=np.where(unseen, np.nan, _moving_mean(np.abs(tunnel.upper), half_width)),
        smoothed=True,
    )


def _moving_mean(values: Array, half_width: int) -> Array:
    """Mean of the values (T, m) that exist within half_width samples; NaN where none does."""
    t = len(values)
    exists = ~np.isnan(values)
    filled = np.where(exists, values, 0.0)
    total, count = np.zeros_like(filled), np.zeros(filled.shape, dtype=np.int64)
    # Sums of shifted copies, not a running sum: a width of zero must stay exactly zero.
    for shift in range(-min(half_width, t - 1), min(half_width, t - 1) + 1):
        to, source = slice(max(0, -shift), t - max(0, shift)), slice(max(0, shift), t - max(0, -shift))
        total[to] += filled[source]
        count[to] += exists[source]
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(count > 0, total / count, np.nan)
