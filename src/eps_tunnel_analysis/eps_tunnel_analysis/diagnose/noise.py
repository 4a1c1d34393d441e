# SPDX-License-Identifier: Apache-2.0
"""The noise floor: how close to the measured mean any model can come."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from eps_tunnel_analysis.stamped import Readings
from labyrinth_sim.trials import Array, locked, runs

DRIFT = 0.3  # s over which deviations of trials are pooled to see them drift
REST = 1.0  # s, of a stretch of rest
RESTS = 4  # such stretches at least
BENT = 2  # degree of the parabola that is taken off each
CHANCE = 1.5
TICK_SHARE = 1.1  # of a known tick: how accurately the one in the samples is found
MEDIAN = 0.6745  # of the size of a Gaussian of deviation 1
BENDS = 20.0  # variance of third differences of noise of variance 1
HARMONICS = 5  # of a sensor's ticks
INDEPENDENT = 2.0 / 3.0  # share of changes from bin to bin that are independent, for white noise
LEAST_FREEDOM = 6.0  # degrees of freedom of a variance at least
TOO_FINE = 1e-3  # of the usual change: finer ticks are not looked for
SAME_READING = 1e-6  # of the range: readings that differ by less differ by the numbers' own rounding
WHOLE = 0.9  # share of a quantised signal's changes that are multiples of its tick


@dataclass(frozen=True)
class SignalNoise:
    """One signal of one play, b bins, in its unit.

    Attributes:
        time: (b,) s.
        mean: (b,) over the trials.
        single: standard deviation of one trial's bins about the mean, of the part that changes from bin to bin.
        tick: smallest difference that the sensor resolves, 0 if it is fine.
        floor: (b,) standard deviation of the mean about a perfect model: single trials' noise over the root of their
            number; rounding, as far as trials round alike; slow drift between trials, in full, because their mean is
            then not a motion that any of them made; and the tolerance.
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
    still: NDArray[np.bool_] | None = None,
) -> SignalNoise:
    """Noise of one signal of one play.

    Args:
        bins: the trials' readings; a single trial shows its ticks and its roughness, but not how well it repeats.
        raw: each trial's samples as recorded.
        width: s, of the bins.
        known_tick: the coarsest tick that the sensor is known to have, 0 for none. A coarser one is no property of the
            sensor but something that a model may lack, so it is not counted.
        tolerance: share of the motion's root mean square that does not matter.
        timing: s, by how much one trial may be early or late.
        still: (b,) bins in which nothing has been commanded for long; what moves there moves by itself, which shows how
            well a single trial would repeat, at least. None if that is unknown.
    """
    trials, samples = bins.single.shape[0], bins.counts.sum(axis=0)
    # A bin with samples of only one trial says nothing about repeatability.
    repeated = np.where((bins.counts > 0).sum(axis=0) > 1, bins.counts, 0)
    with np.errstate(divide="ignore"):
        alone = np.where(repeated > 0, 1.0 / repeated - 1.0 / samples, np.nan)  # variance of a deviation, per sample's
    deviations = np.where(repeated > 0, bins.single - bins.mean, np.nan)
    jumps = np.diff(deviations, axis=1)
    squares, freedom = np.nansum(repeated * deviations**2, axis=0), np.nansum(repeated * alone, axis=0)
    changes, turns = np.nansum(jumps**2, axis=0), np.nansum(alone[:, 1:] + alone[:, :-1], axis=0)
    repeats = bool(turns.any())
    repeat = squares.sum() / freedom.sum() if repeats else 0.0
    often = float(np.mean(samples)) / trials  # samples of a trial in a bin
    white = min(changes.sum() / turns.sum(), repeat) / often if repeats else _roughness(bins.single[0])
    tick = resolution(raw)
    if tick > TICK_SHARE * (known_tick or np.inf):
        tick = 0.0
    window = max(1, round(DRIFT / width))
    around: float | Array = white  # an effort, say, is noisier in motion than at rest
    slow: float | Array = 0.0
    if repeats:
        # By chance alone a window of white noise exceeds its mean a little; only what goes beyond is drift.
        inside = _sum(freedom, window)
        spread = _variance(_sum(squares, window), inside, repeat) / often
        changing = _variance(_sum(np.append(changes, 0.0), window), _sum(np.append(turns, 0.0), window), white * often)
        around = np.minimum(changing / often, spread)
        slow = np.maximum(spread - CHANCE * around, 0.0)
        # What is divided by a deviation known from few samples has Student's distribution, which is wider.
        known = np.maximum(INDEPENDENT * inside, LEAST_FREEDOM)
        around *= known / (known - 2.0)
    elif still is not None:
        slow = max(_unrest(bins.single[0], still, round(REST / width)) - CHANCE * white, 0.0)
    motion = float(np.sqrt(np.var(bins.mean)))
    rounding = _rounding(bins, tick, max(white - tick**2 / 12.0, 0.0))
    early = timing / np.sqrt(trials) * _slope(bins)
    allowed = (tolerance * motion) ** 2 + early**2
    floor = np.sqrt(around * often / samples + rounding + slow + allowed)
    # A recording without any noise (a simulation's, say) still has the numbers' own rounding.
    least = 1e-7 * max(float(np.ptp(bins.mean)), 1e-3)
    return SignalNoise(bins.time, bins.mean, float(np.sqrt(white)), tick, np.maximum(floor, least))


def _sum(values: Array, window: int) -> Array:
    """(b,) sums of values (b,) over a window around each."""
    return window * uniform_filter1d(np.asarray(values, dtype=np.float64), window, mode="nearest")


def _variance(squares: Array, freedom: Array, otherwise: float) -> Array:
    """(b,) variances from sums of squares (b,) and their degrees of freedom (b,); `otherwise` where there are none."""
    return np.where(freedom > 1e-9, squares / np.maximum(freedom, 1e-9), otherwise)


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
        phasor = np.abs(_mean(np.exp(1j * turn * angle))) ** 2
        total += tick**2 / (2.0 * np.pi**2 * k**2) * phasor * np.exp(-(turn**2) * noise)
    return np.nan_to_num(total)


def _roughness(values: Array) -> float:
    """Variance of white noise on a smooth motion (b,), from third differences, in which a motion hardly shows.

    Their median is taken, because they are large where the motion turns sharply.
    """
    bends = np.abs(np.diff(values, 3))
    bends = bends[np.isfinite(bends)]
    return float(np.median(bends) / MEDIAN) ** 2 / BENDS if len(bends) else 0.0


def _unrest(values: Array, still: NDArray[np.bool_], window: int) -> float:
    """Variance of a signal (b,) within stretches of `still` bins (b,) that are a window long, about parabolas, which
    take what still settles; the median of the stretches, 0 if there are fewer than RESTS.
    """
    rests = runs(still & np.isfinite(values))
    starts = [s for low, high in rests for s in range(low, high - window + 1, window)]
    if len(starts) < RESTS or window <= BENT + 1:
        return 0.0
    stretches = np.array([values[s : s + window] for s in starts])
    basis = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, window), BENT + 1))[0]
    left = stretches - stretches @ basis @ basis.T
    return float(np.median(np.sum(left**2, axis=1))) / (window - BENT - 1)


def _slope(bins: Readings) -> Array:
    """(b,) by how much the mean changes in a second."""
    return np.gradient(bins.mean, bins.time) if len(bins.time) > 1 else np.zeros(len(bins.time))


def _mean(values: Array) -> Array:
    """(b,) means of values (p, b) over the trials that have them, NaN where none has."""
    seen = np.isfinite(values)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(seen, values, 0.0).sum(axis=0) / seen.sum(axis=0))


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
        return 0.0  # a signal that stands still except for the numbers' own rounding has no ticks
    if np.ptp(small) <= 1e-6 * top:
        # A slow signal takes one tick now and then; what changes by as much at every sample moves at a constant speed.
        return top if np.mean(every == 0.0) > share and _whole(changes, top) > WHOLE else 0.0
    counts, edges = np.histogram(small, bins=200)
    peak = int(np.argmax(counts))
    near = changes[(changes >= edges[max(peak - 1, 0)]) & (changes <= edges[min(peak + 2, len(edges) - 1)])]
    tick = float(np.median(near))
    spread = float(edges[1] - edges[0])
    if tick >= 5 * spread and len(near) >= share * len(changes):
        for part in (4, 3, 2):  # a fast signal takes several ticks at a time
            if np.mean(np.abs(changes - tick / part) < spread) > 0.5 * share:
                tick /= part
                break
        if _whole(changes, tick) > WHOLE:
            return tick
    # The commonest change may be the motion in a sample; a tick is what all changes are multiples of.
    least = float(changes[changes > 1e-6 * top].min())
    return least if least > TOO_FINE * top and _whole(changes, least) > WHOLE else 0.0


def largest_tick(trials: Sequence[Array]) -> float:
    """The coarsest tick that a sensor of whole ticks can have: two of its readings are never closer together.

    Args:
        trials: (n,) samples of each; inf if all are alike.
    """
    widest = np.inf
    for values in trials:
        seen = np.unique(values[np.isfinite(values)])
        gaps = np.diff(seen)
        gaps = gaps[gaps > SAME_READING * (seen[-1] - seen[0])] if len(gaps) else gaps
        if len(gaps):
            widest = min(widest, float(np.median(gaps)))
    return widest


def _whole(changes: Array, tick: float) -> float:
    """Share of changes (n,) that are multiples of a tick."""
    parts = changes / tick
    return float(np.mean(np.abs(parts - np.round(parts)) < 0.1))
