# SPDX-License-Identifier: Apache-2.0
"""How trials differ from one another: no effect of a library changes from trial to trial by itself.

On a rig that drifts each trial lies beyond the one before; if commands or samples come at uneven times, trials differ
where the motion is fast. Both widen the noise floor until a wrong model looks complete.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.optimize import nnls

from eps_tunnel_analysis.diagnose.settings import SETTINGS
from labyrinth_sim.trials import Array, Trials

SMOOTH = 9  # samples
OUT_OF_STEP = 12**-0.5  # samples: deviation of an event at a random time within one, as when a loop waits for the next


@dataclass(frozen=True)
class Repeats:
    """How the trials of one signal differ.

    Attributes:
        signal, unit: which.
        drift: of the trials' means, from the first trial to the last, in the signal's unit; 0 where they scatter.
        jitter: s, deviation of the timing within trials that would explain the differences; 0 if it does not,
            or if loops out of step would explain them.
    """

    signal: str
    unit: str
    drift: float
    jitter: float

    @property
    def sentence(self) -> str:
        """The finding in words; empty if the trials repeat."""
        if self.drift:
            return (
                f"{self.signal} drifts from trial to trial, by {self.drift:+.2g} {self.unit} in all: something changes "
                "with time (warming, slipping), which no effect of the library does. Warm the rig up and record again."
            )
        if self.jitter:
            return (
                f"{self.signal} differs between trials where it moves fast, as if commands or samples came "
                f"{1e3 * self.jitter:.0f} ms early or late. Check the load of the computer and of the bus."
            )
        return ""


def repeats(trials: Trials, signals: Sequence[str]) -> tuple[Repeats, ...]:
    """How the trials of these signals differ."""
    return tuple(_repeats(s, trials.units[trials.index(s)], trials.values[:, :, trials.index(s)], trials.step)
                 for s in signals)  # fmt: skip


def _repeats(signal: str, unit: str, values: Array, step: float) -> Repeats:
    seen = np.isfinite(values).all(axis=0)
    values = values[:, seen]
    if len(values) < 3 or values.shape[1] < 10 * SMOOTH:
        return Repeats(signal, unit, 0.0, 0.0)
    mean = values.mean(axis=0)
    apart = values - mean
    rest = apart - apart.mean(axis=1)[:, None]
    drift = _drift(apart, step) if len(values) >= SETTINGS.drift_trials else 0.0
    speed = np.gradient(uniform_filter1d(mean, 5), step)
    jitter = _jitter(rest - _whole(rest, speed, step), speed)
    return Repeats(signal, unit, drift, jitter if jitter > step * OUT_OF_STEP else 0.0)


def _whole(rest: Array, speed: Array, step: float) -> Array:
    """How much each trial differs because it is early or late as a whole, by half a sample at most.

    Player, bus, servo and recorder each run their own loop, and the phase at which the first command meets each is
    random.
    """
    early = rest @ speed / max(float(speed @ speed), 1e-300)
    return np.clip(early, -0.5 * step, 0.5 * step)[:, None] * speed


def _drift(apart: Array, step: float) -> float:
    """Change of the trials' means from first to last if they go steadily one way; 0 if they do not.

    Of four trials every twelfth set goes one way by chance, but then not throughout each trial.

    Args:
        apart: (p, T) of each trial from the mean of all.
    """
    at = np.arange(len(apart), dtype=np.float64) - 0.5 * (len(apart) - 1)
    offsets = np.asarray(apart.mean(axis=1), dtype=np.float64)
    slope = _slope(at, offsets)
    between = float(np.sum((offsets - slope * at) ** 2) / (len(at) - 2) / (at @ at))
    parts = np.array_split(apart, max(2, round(apart.shape[1] * step / SETTINGS.block)), axis=1)
    each = np.array([_slope(at, np.asarray(part.mean(axis=1), dtype=np.float64)) for part in parts])
    scatter = max(between, float(each.var(ddof=1)) / len(each)) ** 0.5
    white = np.sqrt(0.5 * np.mean(np.diff(apart, axis=1) ** 2) / apart.shape[1])
    whole = slope * (len(at) - 1)
    one_way = bool(np.all(np.diff(offsets) > 0) or np.all(np.diff(offsets) < 0))
    plain = abs(slope) > SETTINGS.drift_slope * scatter and abs(whole) > SETTINGS.drift_noise * white
    return whole if one_way and plain else 0.0


def _slope(at: Array, offsets: Array) -> float:
    """Per trial, of offsets (p,) at places (p,) about 0."""
    return float(offsets @ at / (at @ at))


def _jitter(rest: Array, speed: Array) -> float:
    """Fits spread = noise + jitter^2 speed^2 over time."""
    spread = np.mean(rest**2, axis=0) * len(rest) / (len(rest) - 1)
    squared = speed**2
    if not squared.any() or not spread.any():
        return 0.0
    (_, slope), _ = nnls(np.column_stack([np.ones_like(squared), squared]), spread)
    smooth = [uniform_filter1d(a, SMOOTH) for a in (spread, squared)]
    follows = np.corrcoef(smooth[0], smooth[1])[0, 1] if all(np.ptp(a) > 0 for a in smooth) else 0.0
    share = slope * squared.mean() / spread.mean()
    return float(np.sqrt(slope)) if share > SETTINGS.timing_share and follows > SETTINGS.timing_follows else 0.0
