# SPDX-License-Identifier: Apache-2.0
"""Errors between measured and simulated trajectories, per signal."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from eps_tunnel_analysis.tunnel import build_tunnel
from labyrinth_sim.trials import Array, Trials


@dataclass(frozen=True)
class SignalError:
    """How far the simulated mean of one signal is from the measured mean, in the signal's unit.

    Attributes:
        signal, unit: what it is.
        command_error: equation 10, the absolute error integrated over time and divided by the time.
        rms: root of the mean squared error.
        bias: mean of simulation minus real.
        worst: largest absolute error.
        worst_time: s, when.
        range: highest minus lowest measured mean, to set the others in relation.
        repeat_rms: the repeat spread, RMS of the trials about their mean, what the real system itself does not repeat
            (p - 1 in the denominator); NaN with one trial.
        samples: how many samples both sides saw.
    """

    signal: str
    unit: str
    command_error: float
    rms: float
    bias: float
    worst: float
    worst_time: float
    range: float
    repeat_rms: float
    samples: int


def command_error(real: Array, sim: Array) -> float:
    """E_C of equation 10 for one trajectory (T,) or several (T, ...), averaged over the latter.

    Each sample stands for one step dt and t_total is the number of seen samples times dt, so dt cancels and E_C has
    the unit of the signal. NaN samples are left out.
    """
    error = np.abs(np.asarray(real, dtype=np.float64) - np.asarray(sim, dtype=np.float64))
    return float(np.nanmean(error)) if np.isfinite(error).any() else math.nan


def error_unit(units: Sequence[str]) -> str:
    """Unit of one number for signals in these units: rad if some turn, otherwise m if some slide."""
    return next((unit for unit in ("rad", "m") if unit in units), units[0])


def mean_error(errors: Sequence[float], units: Sequence[str], unit: str = "") -> float:
    """Mean over the signals in one unit: in `unit`, or else in their `error_unit`; NaN where no such signal was seen.

    Args:
        errors: of each signal, equation 10 say.
        units: theirs.
    """
    chosen = unit or error_unit(units)
    own = np.array([e for e, its in zip(errors, units, strict=True) if its == chosen])
    return float(np.nanmean(own)) if not np.isnan(own).all() else math.nan


def signal_errors(real: Trials, sim: Trials) -> tuple[SignalError, ...]:
    """One SignalError per signal, of the two means (equation 1). Both sides need the same signals and time."""
    mean_real, mean_sim = build_tunnel(real).mean, build_tunnel(sim).mean
    return tuple(_signal_error(real, i, mean_real[:, i], mean_sim[:, i], real.time) for i in range(len(real.signals)))


def _signal_error(real: Trials, i: int, mean_real: Array, mean_sim: Array, time: Array) -> SignalError:
    error = mean_sim - mean_real
    seen = np.isfinite(error)
    name, unit, nan = real.signals[i], real.units[i], math.nan
    if not seen.any():
        return SignalError(name, unit, nan, nan, nan, nan, nan, nan, repeat_spread(real.values[:, :, i]), 0)
    e = error[seen]
    worst = int(np.argmax(np.abs(e)))
    return SignalError(
        signal=name,
        unit=unit,
        command_error=command_error(mean_real, mean_sim),
        rms=float(np.sqrt(np.mean(e**2))),
        bias=float(np.mean(e)),
        worst=float(abs(e[worst])),
        worst_time=float(time[seen][worst]),
        range=float(np.ptp(mean_real[seen])),
        repeat_rms=repeat_spread(real.values[:, :, i]),
        samples=int(seen.sum()),
    )


def repeat_spread(values: Array) -> float:
    """Pooled standard deviation of p trials (p, T) about their mean, over samples that two or more saw."""
    count = np.sum(np.isfinite(values), axis=0)
    values = values[:, count > 1]
    freedom = float(np.sum(count[count > 1] - 1))
    if not freedom:
        return math.nan
    return float(np.sqrt(np.nansum((values - np.nanmean(values, axis=0)) ** 2) / freedom))
