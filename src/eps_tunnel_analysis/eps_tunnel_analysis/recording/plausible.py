# SPDX-License-Identifier: Apache-2.0
"""Values that can be read but are probably wrong: stray samples, and angles that look like degrees.

Nothing is left out because of them; a warning is given wherever the recording is used.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from eps_tunnel_analysis.outputs import shown_number
from labyrinth_sim.trials import Array

DEGREES = 180.0 / math.pi
TURN = 2.0 * math.pi
"""rad; targets beyond this, of a rig without stated limits, are rare enough to ask"""
FAR = 10.0
"""times the range of nearly all samples; what lies further out, and shortly, is a stray sample"""
SHORT = 3
"""samples that a stray run has at most"""
NEARLY_ALL = 0.95
LEAST_RANGE = 0.01
"""rad or m, for signals that stand still"""
SLACK = 0.01
"""of the limits' range; rounding and a servo's ticks reach that far"""


@dataclass(frozen=True)
class Samples:
    """Recorded samples of one signal or command in one trial.

    Attributes:
        what: as "command 'motor_x'".
        unit: "rad", "m" or others.
        where: the trial.
        time: (n,) s since its start.
        values: (n,) finite, in `unit`.
        limits: the lowest and highest target that the rig allows; None where that is not known, or for a measurement.
        commanded: whether it is a command.
    """

    what: str
    unit: str
    where: str
    time: Array
    values: Array
    limits: tuple[float, float] | None = None
    commanded: bool = False


def doubts(channels: Iterable[Samples], cure: str = "") -> list[str]:
    """One sentence for each channel and doubt, over all its trials; `cure` says what to do about degrees."""
    of: dict[str, list[Samples]] = {}
    for samples in channels:
        if len(samples.values):
            of.setdefault(samples.what, []).append(samples)
    sentences = [sentence for trials in of.values() for sentence in (_beyond(trials, cure), _stray(trials))]
    return [sentence for sentence in sentences if sentence]


def stray(values: Array) -> NDArray[np.intp]:
    """Indices of the samples (n,) that lie far outside the range of nearly all others, at most SHORT in a row."""
    if len(values) < 10 or not np.isfinite(values).all():
        return np.zeros(0, dtype=np.intp)
    low, high = np.quantile(values, [(1.0 - NEARLY_ALL) / 2.0, (1.0 + NEARLY_ALL) / 2.0])
    reach = FAR * max(float(high - low), LEAST_RANGE)
    far = np.flatnonzero((values < low - reach) | (values > high + reach))
    runs = np.split(far, np.flatnonzero(np.diff(far) > 1) + 1)
    return np.concatenate([run for run in runs if len(run) <= SHORT] or [far[:0]])


def _stray(trials: Sequence[Samples]) -> str:
    odd = [(samples, at) for samples in trials for at in stray(samples.values)]
    if not odd:
        return ""
    samples, at = max(odd, key=lambda pair: abs(pair[0].values[pair[1]]))
    rest = np.delete(samples.values, stray(samples.values))
    count = f"{len(odd)} stray sample{'s' * (len(odd) > 1)}"
    value, low, high = (shown_number(float(v), 4) for v in (samples.values[at], rest.min(), rest.max()))
    return (
        f"Warning: {samples.what} has {count}, {value} {samples.unit} at {samples.time[at]:.2f} s of {samples.where} "
        f"where the others lie from {low} to {high} {samples.unit}. They count like any other; "
        "look for a broken sensor or a lost byte, and record again."
    )


def _beyond(trials: Sequence[Samples], cure: str) -> str:
    """Whether the values, stray ones aside, leave what the rig allows, or reach a whole turn."""
    first = trials[0]
    if not first.commanded and first.limits is None:
        return ""
    values = np.concatenate([np.delete(samples.values, stray(samples.values)) for samples in trials])
    if not len(values):
        return ""
    low, high = first.limits or (-TURN, TURN)
    slack = SLACK * (high - low)
    share = float(np.mean((values < low - slack) | (values > high + slack)))
    if not share:
        return ""
    worst = float(values[np.argmax(np.abs(values - 0.5 * (low + high)))])
    bounds = f"{shown_number(low, 4)} to {shown_number(high, 4)} {first.unit}"
    allowed = f"the rig's limits, {bounds}" if first.limits else "a whole turn"
    degrees = f" ({shown_number(worst * DEGREES, 4)} deg)" if first.unit == "rad" else ""
    reached = f"{shown_number(worst, 4)} {first.unit}{degrees}"
    fits = first.unit == "rad" and low - slack <= values.min() / DEGREES and values.max() / DEGREES <= high + slack
    asked = f" As degrees they would fit: are they degrees, taken for rad?{cure}" if fits else ""
    return (
        f"Warning: {first.what} lies beyond {allowed}, in {shown_number(100.0 * share)} % of the samples, as far as "
        f"{reached}.{asked}"
    )
