# SPDX-License-Identifier: Apache-2.0
"""The noise floor: how close to the measured mean any model can come."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from eps_tunnel_analysis.stamped import Readings
from labyrinth_sim.trials import Array, locked

DRIFT = 0.3  # s over which deviations of trials are pooled to see them drift
CHANCE = 1.5
TICK_SHARE = 1.1  # of a known tick: how well the one in the samples is seen
MEDIAN = 0.6745  # of the size of a Gaussian of deviation 1
BENDS = 20.0  # variance of third differences of noise of variance 1
HARMONICS = 5  # of a sensor's ticks
WHOLE = 0.9  # share of a quantised signal's changes that are multiples of its tick


@dataclass(frozen=True)
class SignalNoise:
    """One signal of one play, b bins, in its unit.

    Attributes:
        time: (b,) s.
        mean: (b,) over the trials.
        single: standard deviation of one trial's bins about the mean, of the part that changes from bin to bin.
        tick: smallest difference that the sensor tells apart, 0 where it is fine.
        floor: (b,) standard deviation of the mean about what a perfect model says: single trials' noise over the root
            of their number; rounding, as far as trials round alike; what trials drift apart by slowly, in full, for
            their mean is then no motion that any of them made; and the tolerance.
    """

    time: Array
    mean: Array
    single: float
    tick: float
    floor: Array

    def __post_init__(self) -> None:
        for name in ("time", "mean", "floor"):
            object.__setattr__(self, name, locked(getattr(self, name)))


def signal_noise(
    bins: Readings,
    raw: Sequence[Array],
    width: float,
    known_tick: float = 0.0,
    tolerance: float = 0.0,
    timing: float = 0.0,
) -> SignalNoise:
    """Noise of one signal of one play.

    Args:
        bins: what the trials say; with a single trial its ticks and its roughness are known, not what it repeats.
        raw: each trial's samples as recorded.
        width: s, of the bins.
        known_tick: the coarsest tick that the sensor is known to have, 0 for none. A coarser one is no property of the
            sensor but something that a model may lack, so it is not counted.
        tolerance: share of the motion's root mean square that does not matter.
        timing: s, by how much one trial may be early or late.
    """
    trials = bins.single.shape[0]
    mean = _mean(bins.single, 0)
    deviations = bins.single - mean
    share = trials / max(trials - 1, 1)
    repeat = _mean(deviations**2, None) * share
    jumps = np.diff(deviations, axis=1)
    white = min(0.5 * _mean(jumps**2, None) * share, repeat) if trials > 1 else _roughness(bins.single[0])
    tick = resolution(raw)
    if tick > TICK_SHARE * (known_tick or np.inf):
        tick = 0.0
    window = max(1, round(DRIFT / width))
    around: float | Array = white  # an effort, say, is noisier in motion than at rest
    slow: float | Array = 0.0
    if trials > 1:
        # By chance alone a window of white noise exceeds its mean a little; only what goes beyond is drift.
        spread = _around(_mean(deviations**2, 0), window) * share
        around = np.minimum(0.5 * _around(_mean(jumps**2, 0), window, len(bins.time)) * share, spread)
        slow = np.maximum(spread - CHANCE * around, 0.0)
    motion = float(np.sqrt(np.var(bins.mean)))
    rounding = _rounding(bins, tick, max(white - tick**2 / 12.0, 0.0))
    early = timing / np.sqrt(trials) * _slope(bins)
    allowed = (tolerance * motion) ** 2 + early**2
    floor = np.sqrt(around / trials + rounding + slow + allowed)
    # A recording without any noise (a simulation's, say) still has the numbers' own rounding.
    least = 1e-7 * max(float(np.ptp(bins.mean)), 1e-3)
    return SignalNoise(bins.time, bins.mean, float(np.sqrt(white)), tick, np.maximum(floor, least))


def _around(values: Array, window: int, length: int | None = None) -> Array:
    """(b,) running means of values, (b,) or one fewer where `length` is b."""
    means = uniform_filter1d(np.nan_to_num(values), window, mode="nearest")
    return means if length is None else np.append(means, means[-1:])[:length]


def _rounding(bins: Readings, tick: float, noise: float) -> Array:
    """(b,) variance of the mean over trials of what rounding to ticks adds.

    The error of rounding is a sum of harmonics of the angle, sum_k q / (pi k) sin(2 pi k angle / q). Noise before the
    rounding, of this variance, softens each; and trials that were read at different instants of a motion are at
    different places within a tick.
    """
    if tick <= 0.0:
        return np.zeros(len(bins.time))
    angle = _slope(bins) * (bins.stamps - bins.time)
    total = np.zeros(len(bins.time))
    for k in range(1, HARMONICS + 1):
        turn = 2.0 * np.pi * k / tick
        phasor = np.abs(_mean(np.exp(1j * turn * angle), 0)) ** 2
        total += tick**2 / (2.0 * np.pi**2 * k**2) * phasor * np.exp(-(turn**2) * noise)
    return np.nan_to_num(total)


def _roughness(values: Array) -> float:
    """Variance of white noise on a smooth motion (b,), from third differences, in which a motion hardly shows.

    Their median is taken, for where the motion turns sharply they are large.
    """
    bends = np.abs(np.diff(values, 3))
    bends = bends[np.isfinite(bends)]
    return float(np.median(bends) / MEDIAN) ** 2 / BENDS if len(bends) else 0.0


def _slope(bins: Readings) -> Array:
    """(b,) by how much the mean changes in a second."""
    return np.gradient(bins.mean, bins.time) if len(bins.time) > 1 else np.zeros(len(bins.time))


def _mean(values: Array, axis: int | None) -> Array:
    """Mean of the seen values, NaN where there are none."""
    seen = np.isfinite(values)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(seen, values, 0.0).sum(axis=axis) / seen.sum(axis=axis))


def resolution(trials: Sequence[Array], share: float = 0.2) -> float:
    """Tick of a quantised signal: the commonest small change between neighbours, 0 if none stands out.

    Args:
        trials: (n,) samples of each.
        share: of the changes that must agree.
    """
    every = np.abs(np.concatenate([np.diff(values) for values in trials]))
    changes = every[np.isfinite(every) & (every > 0)]
    if len(changes) < 20:
        return 0.0
    top = float(np.quantile(changes, 0.5))
    small = changes[changes <= 2.0 * top]
    if top < 1e-12:
        return 0.0  # what stands still but for the numbers' own rounding has no ticks
    if np.ptp(small) <= 1e-6 * top:
        # A slow signal takes one tick now and then; what changes by as much at every sample moves at a constant speed.
        return top if np.mean(every == 0.0) > share and _whole(changes, top) > WHOLE else 0.0
    counts, edges = np.histogram(small, bins=200)
    peak = int(np.argmax(counts))
    near = changes[(changes >= edges[max(peak - 1, 0)]) & (changes <= edges[min(peak + 2, len(edges) - 1)])]
    tick = float(np.median(near))
    spread = float(edges[1] - edges[0])
    if tick < 5 * spread or len(near) < share * len(changes):
        return 0.0
    for part in (4, 3, 2):  # a fast signal takes several ticks at a time
        if np.mean(np.abs(changes - tick / part) < spread) > 0.5 * share:
            tick /= part
            break
    if _whole(changes, tick) > WHOLE:
        return tick
    # At constant speed the commonest change is what is moved in a sample; ticks are what all changes are multiples of.
    least = float(changes[changes > 1e-6 * top].min())
    return least if _whole(changes, least) > WHOLE else 0.0


def _whole(changes: Array, tick: float) -> float:
    """Share of changes (n,) that are multiples of a tick."""
    parts = changes / tick
    return float(np.mean(np.abs(parts - np.round(parts)) < 0.1))
