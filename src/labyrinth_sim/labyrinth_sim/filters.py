# SPDX-License-Identifier: Apache-2.0
"""Filters on streams of samples, (nsim, K) in and out. A stream cut into blocks anywhere gives the same samples."""

from collections.abc import Callable

import numba
import numpy as np
from numpy.typing import NDArray

from labyrinth_sim.law import CACHED
from labyrinth_sim.normal import ndtr
from labyrinth_sim.trials import Array

#: (nsim, K) samples of a channel and (nsim, K, channels) of all to (nsim, K).
Filter = Callable[[Array, Array], Array]


class Map:
    """Sample by sample, without memory."""

    def __init__(self, function: Callable[[Array], Array]) -> None:
        self.function = function

    def __call__(self, own: Array, every: Array) -> Array:
        return self.function(own)


class Added:
    """Adds a function of each of some other channels, sample by sample; NaN (a drive that is off) counts as 0."""

    def __init__(self, function: Callable[[Array], Array], channels: tuple[int, ...]) -> None:
        self.function, self.channels = function, channels

    def __call__(self, own: Array, every: Array) -> Array:
        out = own
        for channel in self.channels:
            out = out + self.function(np.nan_to_num(every[:, :, channel]))
        return out


class Chain:
    """One filter after the other."""

    def __init__(self, *filters: Filter) -> None:
        self.filters = filters

    def __call__(self, own: Array, every: Array) -> Array:
        for filter_ in self.filters:
            own = filter_(own, every)
        return own


class Blend:
    """The samples of one filter, and in their place this share (nsim,) of another's."""

    def __init__(self, filter_: Filter, other: Filter, share: Array) -> None:
        self.filter, self.other, self.share = filter_, other, share[:, None]

    def __call__(self, own: Array, every: Array) -> Array:
        return (1.0 - self.share) * self.filter(own, every) + self.share * self.other(own, every)


class WithSpeed:
    """y = f(u, u'): of each sample and its speed over the step before it, from rest at `start` (nsim,)."""

    def __init__(self, function: Callable[[Array, Array], Array], step: float, start: Array) -> None:
        self.function, self.step, self.past = function, step, np.asarray(start, float)[:, None]

    def __call__(self, own: Array, every: Array) -> Array:
        speed = np.diff(own, axis=1, prepend=self.past) / self.step
        self.past = own[:, -1:].copy()  # the caller may refill `own`
        return self.function(own, speed)


class Delay:
    """y(t) = u(t - delay), linear between the two samples around t - delay.

    Samples before the first are `start` (nsim,). Where either neighbour is NaN (drive off) the nearer one counts.

    Args:
        smooth: take a parabola, through one sample further back too: for what moves smoothly, as a measured angle does,
            and not for commands, which are held between samples.
    """

    def __init__(self, delay: Array, step: float, start: Array, smooth: bool = False) -> None:
        whole = np.floor(delay / step + 1e-9)
        self.back = whole.astype(int)[:, None]
        self.part = np.maximum(delay / step - whole, 0.0)[:, None]
        self.past = np.repeat(np.asarray(start, float)[:, None], int(self.back.max(initial=0)) + 2, axis=1)
        self.bent = 0.5 * self.part * (self.part - 1.0) if smooth else None

    def __call__(self, own: Array, every: Array) -> Array:
        depth = self.past.shape[1]
        stream = np.concatenate([self.past, own], axis=1)
        here = np.arange(depth, depth + own.shape[1])[None, :] - self.back
        newer = np.take_along_axis(stream, here, axis=1)
        older = np.take_along_axis(stream, here - 1, axis=1)
        self.past = stream[:, -depth:]
        mixed = (1.0 - self.part) * newer + self.part * older
        if self.bent is not None:
            oldest = np.take_along_axis(stream, here - 2, axis=1)
            mixed += np.nan_to_num(self.bent * (newer - 2.0 * older + oldest))
        mixed = np.where(self.part == 0.0, newer, mixed)
        return np.where(np.isnan(mixed), np.where(self.part < 0.5, newer, older), mixed)


class Lag:
    """First-order lag: tau y' + y = u, exact for u that goes on parabolas. NaN passes and restarts it.

    Between two samples u is taken to bend as it did over the last three.
    """

    def __init__(self, time_constant: Array, step: float) -> None:
        self._none = time_constant <= 0
        self._steps = (np.maximum(time_constant, 1e-12) / step)[:, None]
        self._keep = np.where(self._none, 0.0, np.exp(-1.0 / self._steps[:, 0]))
        self._past = np.full((len(time_constant), 2), np.nan)
        self._last = np.zeros(len(time_constant))

    def __call__(self, own: Array, every: Array) -> Array:
        stream = np.concatenate([self._past, own], axis=1)
        first, before, now = stream[:, :-2], stream[:, 1:-1], stream[:, 2:]
        a = self._steps
        rise = now - before
        bend = np.nan_to_num(rise - (before - first))
        # u - a u' + a^2 u'' solves the equation for a parabola; what differs from it dies away.
        here = now - a * (rise + 0.5 * bend) + a**2 * bend
        there = before - a * (rise - 0.5 * bend) + a**2 * bend
        put = np.where(self._none[:, None], now, here - self._keep[:, None] * there).T.copy()
        restarts = np.any(np.isnan(put), axis=1)
        keep, last = self._keep, self._last
        out = np.empty_like(put)
        for k, restart in enumerate(restarts):
            last = put[k] + keep * last
            if restart:
                out[k] = np.where(np.isnan(last), now[:, k], last)
                last = np.nan_to_num(out[k])
            else:
                out[k] = last
        self._past, self._last = stream[:, -2:].copy(), last  # the caller may refill `own`
        return out.T


class Mean:
    """y(t) = mean of u over the last `width` s, as of a moving average or of an exposure; u itself where that is 0.

    Exact for u that goes on parabolas: between two samples it is taken to bend as it did over the last three. Samples
    before the first are `start` (nsim,). NaN passes, and counts as the sample before it in later means.
    """

    def __init__(self, width: Array, step: float, start: Array) -> None:
        self._none = (width <= 0)[:, None]
        self._steps = np.where(self._none, 1.0, width[:, None] / step)
        self._back = np.floor(self._steps + 1e-9).astype(int)
        self._part = np.maximum(self._steps - self._back, 0.0)
        depth = int(self._back.max(initial=0)) + 1
        self._start = np.asarray(start, float)[:, None]
        self._past = np.full((len(width), depth + 2), np.nan)
        self._areas = np.zeros((len(width), depth))  # until each sample, of u - start, in steps

    def __call__(self, own: Array, every: Array) -> Array:
        stream = np.concatenate([self._past, own], axis=1)
        bend = np.nan_to_num(np.diff(stream, 2, axis=1))
        kept = np.maximum.accumulate(np.where(np.isnan(stream), 0, np.arange(stream.shape[1])), axis=1)
        full = np.take_along_axis(stream, kept, axis=1)
        full = np.where(np.isnan(full), self._start, full)
        depth, value, rise = self._areas.shape[1], full[:, 2:], np.diff(full, axis=1)[:, 1:]
        added = (value - 0.5 * rise - bend / 12.0 - self._start)[:, depth:]
        areas = np.concatenate([self._areas, added], axis=1)
        areas[:, depth - 1 :] = np.cumsum(areas[:, depth - 1 :], axis=1)
        begins = np.arange(depth, depth + own.shape[1]) - self._back  # of the sample after which a mean begins
        value, rise, bend = (np.take_along_axis(part, begins, axis=1) for part in (value, rise, bend))
        part = self._part
        after = part * (value - self._start) - 0.5 * part**2 * (rise + 0.5 * bend) + part**3 * bend / 6.0
        mean = self._start + (areas[:, depth:] - np.take_along_axis(areas, begins, axis=1) + after) / self._steps
        self._past, self._areas = stream[:, -depth - 2 :], areas[:, -depth:].copy()
        return np.where(self._none | np.isnan(own), own, mean)


class RateLimit:
    """Moves towards its input no faster than `rate` (nsim,) per s, from `start` (nsim,). NaN passes and restarts it.

    What comes out is held for a sample, so it is the mean over that sample.
    """

    def __init__(self, rate: Array, free: NDArray[np.bool_], step: float, start: Array) -> None:
        self.most, self.free, self.last = rate * step, free, np.array(start, float)

    def __call__(self, own: Array, every: Array) -> Array:
        return _rate_limited(np.ascontiguousarray(own), self.most, self.free, self.last)


@numba.njit(error_model="numpy")  # type: ignore[untyped-decorator]
def _straight(ahead: float, most: float) -> tuple[float, float]:
    """The way of one sample towards what is `ahead`, at most `most`, and by how much its mean is behind its end."""
    way = min(max(ahead, -most), most)
    return way, 0.5 * way * abs(way) / most


@numba.njit(cache=CACHED, error_model="numpy")  # type: ignore[untyped-decorator]
def _rate_limited(own: Array, most: Array, free: NDArray[np.bool_], last: Array) -> Array:
    """The samples that `RateLimit` gives; `last` becomes where it stands."""
    out = np.empty_like(own)
    for i in range(own.shape[0]):
        at, limit = last[i], most[i]
        for k in range(own.shape[1]):
            now = own[i, k]
            if free[i] or np.isnan(at) or np.isnan(now):
                at = out[i, k] = now
            else:
                way, behind = _straight(now - at, limit)
                at = at + way
                out[i, k] = at - behind
        last[i] = at
    return out


class Profile:
    """A setpoint that follows its input on trapezoids of speed, (nsim,) each; NaN passes and restarts it at rest.

    Each sample it takes the highest speed from which it can still stop at the target, as a sampled profile generator
    does. What comes out is held for a sample, so it is the mean over that sample.

    Args:
        acceleration, speed: limits, per s^2 and per s; infinite where there is none.
        step: s between samples.
        start: where the setpoint stands.
    """

    def __init__(self, acceleration: Array, speed: Array, step: float, start: Array) -> None:
        self.abrupt: NDArray[np.bool_] = np.isinf(acceleration)
        self.free = self.abrupt & np.isinf(speed)
        self.acceleration, self.speed = np.where(self.abrupt, 0.0, acceleration), speed
        self.step = step
        self.at, self.moving = np.array(start, float), np.zeros_like(start)

    def __call__(self, own: Array, every: Array) -> Array:
        limits = (self.acceleration, self.speed, self.abrupt, self.free)
        return _profiled(np.ascontiguousarray(own), *limits, self.step, self.at, self.moving)


@numba.njit(cache=CACHED, error_model="numpy")  # type: ignore[untyped-decorator]
def _profiled(
    own: Array, acceleration: Array, speed: Array, abrupt: NDArray[np.bool_], free: NDArray[np.bool_], step: float,
    at: Array, moving: Array,
) -> Array:  # fmt: skip
    """The samples that `Profile` gives; `at` and `moving` become where it stands and its speed."""
    out = np.empty_like(own)
    for i in range(own.shape[0]):
        here, before = at[i], moving[i]
        slowing, most = acceleration[i] * step, speed[i] * step
        for k in range(own.shape[1]):
            goal = own[i, k]
            if free[i] or np.isnan(here) or np.isnan(goal):
                here, before = goal, 0.0
                out[i, k] = goal
            elif abrupt[i]:  # it moves at full speed until it is there, as `RateLimit` does
                way, behind = _straight(goal - here, most)
                out[i, k] = here + (way - behind)
                here, before = here + way, 0.0
            else:
                ahead = goal - here - 0.5 * before * step
                stoppable = np.sqrt((0.5 * slowing) ** 2 + 2.0 * acceleration[i] * abs(ahead)) - 0.5 * slowing
                wanted = np.copysign(min(stoppable, speed[i]), ahead)
                after = min(max(wanted, before - slowing), before + slowing)
                out[i, k] = here + (2.0 * before + after) * step / 6.0
                here, before = here + 0.5 * (before + after) * step, after
        at[i], moving[i] = here, before
    return out


class Play:
    """Backlash as the play operator: the output follows once the input has crossed the gap of `width` (nsim,)."""

    def __init__(self, width: Array) -> None:
        self.half = width / 2
        self.last: Array | None = None

    def __call__(self, own: Array, every: Array) -> Array:
        out = np.empty_like(own)
        last = own[:, 0] if self.last is None else self.last
        for k in range(own.shape[1]):
            now = own[:, k]
            last = np.where(self.half == 0.0, now, np.minimum(np.maximum(last, now - self.half), now + self.half))
            out[:, k] = last
        self.last = last
        return out


class Swing:
    """What lies behind a damped spring whose other end is the input: y'' = w^2 (u - y) + 2 d w (u' - y').

    It is at rest at first. What comes out is the input and a share of y - u, solved for inputs that are linear between
    samples.

    Args:
        share: (nsim,) of the stretch y - u that is seen.
        frequency: (nsim,) rad/s, w; `damping` (nsim,), d.
        step: s between samples.
    """

    def __init__(self, share: Array, frequency: Array, damping: Array, step: float) -> None:
        self.share = share[:, None]
        self.behind: Array | None = None
        self.last: Array = np.empty(0)
        # The stretch x = y - u and its rate: x'' + 2 d w x' + w^2 x = -u'', and u' jumps at samples alone.
        decay, root = damping * frequency, frequency * np.sqrt(damping**2 - 1.0 + 1e-12j)
        even, odd = np.cosh(root * step).real, (np.sinh(root * step) / root).real
        turn = np.array([[even + decay * odd, odd], [-(frequency**2) * odd, even - decay * odd]])
        self.turn, self.step = np.exp(-decay * step)[:, None, None] * turn.transpose(2, 0, 1), step

    def __call__(self, own: Array, every: Array) -> Array:
        if self.behind is None:
            self.behind, self.last = np.zeros((len(own), 3)), own[:, 0]
        x, rate, speed = self.behind.T
        stretch = np.empty_like(own)
        for k in range(own.shape[1]):
            now = (own[:, k] - self.last) / self.step
            rate = rate - np.nan_to_num(now - speed)
            x, rate = (np.einsum("nij,nj->ni", self.turn, np.column_stack([x, rate]))).T
            stretch[:, k], speed, self.last = x, now, own[:, k].copy()
        self.behind = np.column_stack([x, rate, np.nan_to_num(speed)])
        return own + self.share * stretch


def rounded(values: Array, tick: Array) -> Array:
    """`values` (nsim, K) to the nearest multiple of `tick` (nsim,); unchanged where the tick is 0."""
    tick = tick[:, None]
    safe = np.where(tick > 0, tick, 1.0)
    return np.where(tick > 0, np.round(values / safe) * safe, values)


def dithered(values: Array, tick: Array, noise: Array) -> Array:
    """What `rounded` gives on average of values with Gaussian noise of this standard deviation (nsim,).

    Exact to 1e-3 ticks up to a noise of half a tick; beyond, rounding hardly shows and the value itself is as good.
    """
    here = tick[:, None]
    safe = np.where(here > 0, here, 1.0)
    spread = np.minimum(np.maximum(noise[:, None] / safe, 1e-9), 0.5)
    share = values / safe
    low = np.floor(share)
    ups = sum(ndtr((share - low - 0.5 - k) / spread) for k in (-1, 0, 1)) - 1.0
    return np.where((here > 0) & (noise[:, None] > 0), (low + ups) * safe, rounded(values, tick))
