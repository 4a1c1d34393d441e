# SPDX-License-Identifier: Apache-2.0
"""Trials at their own stamps: what was commanded and measured, and when, before anything is put on a grid.

From stamped samples to an even grid: straight lines between measurements, steps between commands.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from labyrinth_sim.shown import shown
from labyrinth_sim.trials import Array, Trials, locked

ROUNDING = 1e-9  # s; a grid's end and a trial's are the same instant in other sums
CYCLE = 1.5e-3  # s; servos compute their effort about each millisecond, and stamps jitter
STRAIGHT = (np.arange(16) + 0.5) / 16.0 - 0.5  # of the time between two commands: held over all of these, straight
ALIGNED = 0.05  # s; commands of one trial further from those of the others were not the same messages


@shown
@dataclass(frozen=True)
class Series:
    """One channel: n values at strictly increasing times.

    Attributes:
        time: (n,) s since the trial's start; a command from before it has a negative time.
        values: (n,) SI units; a command NaN from where the drive was switched off.
    """

    time: Array
    values: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "time", locked(self.time))
        object.__setattr__(self, "values", locked(self.values))

    @property
    def interval(self) -> float:
        """s, mean time from one value to the next; inf if there is only one."""
        return float(np.mean(np.diff(self.time))) if len(self.time) > 1 else np.inf


@shown
@dataclass(frozen=True)
class StampedTrial:
    """One trial as it was recorded.

    Attributes:
        seconds: length of the trial.
        commands: channel -> what was commanded; each value holds until the next.
        signals: name -> what was measured; unseen samples are left out.
        bag: the recording that it is from; "" where that is unknown.
    """

    seconds: float
    commands: Mapping[str, Series]
    signals: Mapping[str, Series]
    bag: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "commands", MappingProxyType(dict(self.commands)))
        object.__setattr__(self, "signals", MappingProxyType(dict(self.signals)))

    def shifted(self, late: float) -> "StampedTrial":
        """The same trial on a clock that starts `late` s later."""
        move = {n: Series(s.time - late, s.values) for n, s in self.commands.items()}
        seen = {n: Series(s.time - late, s.values) for n, s in self.signals.items()}
        return StampedTrial(self.seconds, move, seen, self.bag)


def stamped_from_grid(trials: Trials) -> tuple[StampedTrial, ...]:
    """Trials of which only the grid is known: its times are the stamps."""
    time = trials.time - trials.time[0]
    stamped = []
    for values, commands in zip(trials.values, trials.commands, strict=True):
        signals = {}
        for column, name in enumerate(trials.signals):
            seen = np.isfinite(values[:, column])
            signals[name] = Series(time[seen], values[seen, column])
        sent = {name: Series(time, commands[:, u]) for u, name in enumerate(trials.command_channels)}
        stamped.append(StampedTrial(float(time[-1]), sent, signals))
    return tuple(stamped)


def aligned(trials: Sequence[StampedTrial]) -> tuple[StampedTrial, ...]:
    """The trials on clocks on which their commands come at the same time on average.

    A start mark and the first command are sent by one program and pass through others' loops, so trials are early or
    late by some milliseconds as a whole. Trials whose commands are not message for message the same are left alone.
    """
    first = trials[0].commands
    shifts = np.zeros((len(trials), len(first)))
    for column, (name, series) in enumerate(first.items()):
        for row, trial in enumerate(trials):
            other = trial.commands.get(name)
            if other is None or abs(len(other.time) - len(series.time)) > 1:
                return tuple(trials)
            both = min(len(other.time), len(series.time))  # a last message comes just before the end or just after it
            if not both or not np.allclose(other.values[:both], series.values[:both], equal_nan=True):
                return tuple(trials)
            late = float(np.median(other.time[:both] - series.time[:both]))
            if abs(late) > ALIGNED:
                return tuple(trials)
            shifts[row, column] = late
    own = shifts.mean(axis=1) if shifts.size else np.zeros(len(trials))
    return tuple(trial.shifted(float(late)) for trial, late in zip(trials, own - own.mean(), strict=True))


def setpoints(trials: Sequence[StampedTrial], channel: str, step: float, count: int) -> Array:
    """(count,) rad: the mean over trials of what was commanded during each step of an even grid that starts at 0.

    A command that changes within a step counts for the part of it that is left, so no stamp is moved to the grid; and
    the mean answer of trials whose stamps jitter is the answer to their mean command, to first order. NaN where most
    trials were switched off, or had got no command yet.

    A command is held until the next one. One that comes as often as a drive computes its effort goes straight to it
    instead, as late in the mean: held, it would make a drive that never rests between its computations push and let go
    in between.
    """
    edges = step * np.arange(count + 1)
    total, weight = np.zeros(count), np.zeros(count)
    for trial in trials:
        series = trial.commands[channel]
        if not len(series.time):
            continue
        on = np.isfinite(series.values)
        knots = np.append(series.time, max(edges[-1], series.time[-1]) + step)
        lengths = np.diff(knots)
        area = np.concatenate([[0.0], np.cumsum(np.where(on, series.values, 0.0) * lengths)])
        time_on = np.concatenate([[0.0], np.cumsum(on * lengths)])
        lasts = np.diff(np.interp(edges, knots, time_on))
        apart = series.interval
        if apart < CYCLE:
            near = [edges + shift * apart for shift in STRAIGHT]
            own, on_near = (sum(np.diff(np.interp(e, knots, sums)) for e in near) for sums in (area, time_on))
            total += lasts * own / np.maximum(on_near, 1e-300)
        else:
            total += np.diff(np.interp(edges, knots, area))
        weight += lasts
    share = weight / (step * len(trials))
    return np.where(share > 0.5, total / np.maximum(weight, 1e-300), np.nan)


@dataclass(frozen=True)
class Readings:
    """Repeated measurements of one signal, gathered into bins, and how a model is read at the same instants.

    Attributes:
        time: (b,) s, mean stamp of each bin.
        mean: (b,) mean of the samples in it, over all trials.
        reading: (b, K) sparse; times a model's values on its own grid (K,), what it says of each bin: the mean, over
            the same samples, of its value at their stamps.
        single: (p, b) what each trial says of each bin, brought to the bin's mean stamp along the motion's slope; NaN
            where it has no sample.
        stamps: (p, b) s, mean stamp of each trial's samples; NaN where it has none.
        counts: (p, b) how many samples each trial has in each bin.
    """

    time: Array
    mean: Array
    reading: sparse.csr_array
    single: Array
    stamps: Array
    counts: NDArray[np.int64]


def readings(
    series: Sequence[Series], seconds: float, step: float, count: int, width: float, from_time: float = 0.0,
    straight: bool = False,
) -> Readings:  # fmt: skip
    """Bins of equal width over all trials of one signal.

    Args:
        series: one for each trial.
        seconds: length of the trials.
        step, count: of the model's grid, which starts at 0.
        width: s, of a bin.
        from_time: s; earlier samples are left out.
        straight: read on straight lines between the grid's points, for what jumps; on cubics else.
    """
    bins = max(1, int(np.ceil(seconds / width)))
    times, values, owners = [], [], []
    for row, one in enumerate(series):
        # A sum of steps may fall short of the trial's length by its last bits.
        inside = (one.time >= from_time) & (one.time <= min(seconds, step * (count - 1)) + ROUNDING)
        times.append(one.time[inside])
        values.append(one.values[inside])
        owners.append(np.full(int(inside.sum()), row))
    time, value, owner = np.concatenate(times), np.concatenate(values), np.concatenate(owners)
    which = np.minimum((time / width).astype(np.int64), bins - 1)
    here = np.bincount(which, minlength=bins)
    kept = np.flatnonzero(here)
    place = np.full(bins, -1)
    place[kept] = np.arange(len(kept))
    row_of = place[which]
    share = 1.0 / np.maximum(here, 1)
    mean_time = np.bincount(row_of, time * share[which], len(kept)).astype(float)
    mean = np.bincount(row_of, value * share[which], len(kept)).astype(float)
    rows, columns, weights = _interpolation(time / step, count, 2 if straight else 4)
    entries = sparse.coo_array((weights * share[which[rows]], (row_of[rows], columns)), shape=(len(kept), count))
    slope = np.gradient(mean, mean_time) if len(kept) > 1 else np.zeros(len(kept))
    level = value - slope[row_of] * (time - mean_time[row_of])
    shape = (len(series), len(kept))
    flat = owner * len(kept) + row_of
    counts = np.bincount(flat, minlength=shape[0] * shape[1]).reshape(shape)
    sums = np.bincount(flat, level, shape[0] * shape[1]).reshape(shape)
    moments = np.bincount(flat, time, shape[0] * shape[1]).reshape(shape)
    with np.errstate(invalid="ignore"):
        single, stamps = sums / counts, moments / counts
    return Readings(mean_time, mean, entries.tocsr(), single, stamps, counts)


def _interpolation(place: Array, count: int, points: int) -> tuple[Array, Array, Array]:
    """Weights of a polynomial through the nearest points of a grid of so many, at places (n,) in steps from its start:
    for each of them the sample, the grid's point and the weight.
    """
    low = np.clip(np.floor(place).astype(np.int64) - (points // 2 - 1), 0, max(count - points, 0))
    x = place - low
    terms = min(points, count)
    rows, columns, weights = [], [], []
    for i in range(terms):
        weight = np.ones_like(x)
        for j in range(terms):
            if j != i:
                weight *= (x - j) / (i - j)
        rows.append(np.arange(len(place)))
        columns.append(low + i)
        weights.append(weight)
    return np.concatenate(rows), np.concatenate(columns), np.concatenate(weights)


def interpolate(stamps: NDArray[np.int64], values: Array, grid: NDArray[np.int64], max_gap: float) -> Array:
    """Linear interpolation, NaN outside the stamps and within gaps longer than `max_gap`.

    Args:
        stamps: (n,) ns, strictly increasing.
        values: (n,) finite.
        grid: (T,) ns.
        max_gap: s; a grid point that lies between two stamps further apart than this is NaN.
    """
    out = np.full(len(grid), np.nan)
    if not len(stamps):
        return out
    after = np.searchsorted(stamps, grid, side="left")  # first stamp at or after the grid point
    hit = (after < len(stamps)) & (stamps[np.minimum(after, len(stamps) - 1)] == grid)
    out[hit] = values[after[hit]]
    inside = (after > 0) & (after < len(stamps)) & ~hit
    right = after[inside]
    left = right - 1
    span = stamps[right] - stamps[left]
    share = (grid[inside] - stamps[left]) / span
    line = values[left] + share * (values[right] - values[left])
    out[inside] = np.where(span <= round(max_gap * 1e9), line, np.nan)
    return out


def hold(stamps: NDArray[np.int64], values: Array, grid: NDArray[np.int64], max_hold: float | None) -> Array:
    """The last command at each grid point; NaN before the first, and where a stream of commands has stopped.

    A drive keeps its last target, so a lost message changes nothing. But a stream that stays silent for longer than
    `max_hold` was switched off: from one usual period after its last command on there is no target. Commands sent
    only when they change (usual period above `max_hold`) are no stream and are held until the next.

    Args:
        stamps: (n,) ns, strictly increasing.
        values: (n,) rad.
        grid: (T,) ns.
        max_hold: s; None holds for ever.
    """
    out = np.full(len(grid), np.nan)
    if not len(stamps) or not len(grid):
        return out
    last = np.searchsorted(stamps, grid, side="right") - 1
    seen = last >= 0
    out[seen] = values[last[seen]]
    period, silent = _silences(stamps, int(grid[-1]), None if max_hold is None else max_hold * 1e9)
    out[seen & silent[last] & (grid - stamps[last] > period)] = np.nan
    return out


def _silences(times: NDArray[np.int64] | Array, end: float, longest: float | None) -> tuple[float, NDArray[np.bool_]]:
    """The usual period of a stream of commands at times (n,), and after which of them (n,) it is silent for longer than
    `longest`; after none if that is None or the usual period is longer. All in one unit of time.
    """
    apart = np.diff(times)
    period = float(np.median(apart)) if len(apart) else 0.0
    if longest is None or not 0.0 < period <= longest:
        return period, np.zeros(len(times), dtype=np.bool_)
    return period, np.append(apart, end - times[-1]) > longest


def switched_off(commands: Series, seconds: float, max_hold: float | None) -> Series:
    """Commands with a NaN where a stream of them falls silent, as `hold` has it.

    A stream that resumes within a period of the trial's start belongs to the trial. What was commanded before the
    silence, by a trial before, is then left out: whether a first message comes just before a start mark or just after
    it is chance.

    Args:
        commands: of one channel, from the one in force at the trial's start on.
        seconds: the trial's length.
        max_hold: s; None holds for ever.
    """
    period, silences = _silences(commands.time, seconds, max_hold)
    silent = np.flatnonzero(silences)
    if not len(silent):
        return commands
    time = np.insert(commands.time, silent + 1, commands.time[silent] + period)
    values = np.insert(commands.values, silent + 1, np.nan)
    first = int(np.searchsorted(time, 0.0, side="right"))
    resumed = 0 < first < len(time) and np.isnan(values[first - 1]) and time[first] <= period
    return Series(time[first:], values[first:]) if resumed else Series(time, values)
