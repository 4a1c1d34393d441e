# SPDX-License-Identifier: Apache-2.0
"""The noise floor: how close to the measured mean any model can come."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from labyrinth_sim.trials import Array, Trials, locked

DRIFT = 0.3  # s over which deviations of trials are pooled to see them drift
CHANCE = 1.5
TICK_SHARE = 1.1  # of a known tick: how well the one in the samples is seen


@dataclass(frozen=True)
class NoiseFloor:
    """Per signal, in its unit.

    Attributes:
        signals: m names.
        repeat: (m,) standard deviation of single trials about their mean, pooled over time.
        resolution: (m,) smallest difference between values that the sensor tells apart, 0 where it is fine.
        floor: (m,) root of white^2 / p + resolution^2 / 12, white being the part of `repeat` that changes from sample
            to sample: the deviation of the mean from what was really there. Rounding is not averaged away by trials
            that repeat well, so it counts in full.
        local: (T, m) the floor at each sample. Where trials drift apart for a while, as a load that floats in its
            slack, their mean is no motion that any of them made, so what they differ by slowly counts in full too.
    """

    signals: tuple[str, ...]
    repeat: Array
    resolution: Array
    floor: Array
    local: Array

    def __post_init__(self) -> None:
        for name in ("repeat", "resolution", "floor", "local"):
            object.__setattr__(self, name, locked(getattr(self, name)))


def noise_floor(trials: Trials, known: Mapping[str, float] | None = None) -> NoiseFloor:
    """Noise floor of repeated trials.

    Args:
        trials: at least one; with a single one only the sensor's resolution is known.
        known: signal -> the coarsest tick that its sensor is known to have. A coarser one is no property of the sensor
            but something that a model may lack, so it is not counted.
    """
    values = trials.values
    deviations = values - mean_over_trials(values)
    seen = np.sum(~np.isnan(deviations), axis=(0, 1))
    freedom = np.maximum(seen * (1.0 - 1.0 / trials.count), 1.0)
    repeat = np.sqrt(np.nansum(deviations**2, axis=(0, 1)) / freedom)
    steps = np.array([resolution(values[:, :, i]) for i in range(len(trials.signals))])
    coarsest = np.array([(known or {}).get(signal, 0.0) or np.inf for signal in trials.signals])
    steps = np.where(steps > TICK_SHARE * coarsest, 0.0, steps)
    p = max(trials.count, 2)
    jumps = np.diff(deviations, axis=1)
    white = np.minimum(np.sqrt(0.5 * np.nan_to_num(_mean(jumps**2, (0, 1))) * p / (p - 1)), repeat)
    span = np.nanmax(values, axis=(0, 1)) - np.nanmin(values, axis=(0, 1))
    # A recording without any noise (a simulation's, say) still has the numbers' own rounding.
    floor = np.maximum(np.sqrt(white**2 / trials.count + steps**2 / 12.0), 1e-7 * np.maximum(span, 1e-3))
    spread = np.nan_to_num(_mean(deviations**2, 0)) * p / (p - 1)
    width = max(1, round(DRIFT / trials.step)) if trials.step else 1
    # By chance alone a window of white noise exceeds its mean a little; only what goes beyond is drift.
    slow = np.maximum(uniform_filter1d(spread, width, axis=0, mode="nearest") - CHANCE * white**2, 0.0)
    return NoiseFloor(trials.signals, repeat, steps, floor, np.sqrt(floor**2 + slow))


def _mean(values: Array, axis: int | tuple[int, ...]) -> Array:
    """Mean of the seen values, NaN where there are none."""
    seen = np.isfinite(values)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(seen, values, 0.0).sum(axis=axis) / seen.sum(axis=axis))


def mean_over_trials(values: Array) -> Array:
    """(p, T, ...) to (T, ...) over the trials that saw a sample; NaN where none did."""
    return _mean(values, 0)


def resolution(values: Array, share: float = 0.2) -> float:
    """Tick of a quantised signal (p, T): the commonest small change between neighbours, 0 if none stands out.

    Interpolation onto a grid blurs some values but leaves most whole ticks apart where the signal was sampled at about
    the grid's rate; `share` of the moving samples must agree.
    """
    changes = np.abs(np.diff(values, axis=1))
    changes = changes[np.isfinite(changes) & (changes > 0)]
    if len(changes) < 20:
        return 0.0
    top = float(np.quantile(changes, 0.5))
    counts, edges = np.histogram(changes[changes <= 2.0 * top], bins=200)
    peak = int(np.argmax(counts))
    near = changes[(changes >= edges[max(peak - 1, 0)]) & (changes <= edges[min(peak + 2, len(edges) - 1)])]
    tick = float(np.median(near))
    spread = float(edges[1] - edges[0])
    if tick < 5 * spread or len(near) < share * len(changes):
        return 0.0
    for part in (4, 3, 2):  # a fast signal takes several ticks at a time
        if np.mean(np.abs(changes - tick / part) < spread) > 0.5 * share:
            return tick / part
    return tick
