# SPDX-License-Identifier: Apache-2.0
"""Random trials for property tests, and the paper's equations written out one sample at a time."""

import math

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from labyrinth_sim.trials import Trials


def make_trials(values, step=0.01, unit="rad", commands=None, channels=None):
    """Trials of values (p, T, m), signals a, b, c, ..."""
    values = np.asarray(values, dtype=float)
    p, t, m = values.shape
    return Trials(
        time=np.arange(t) * step,
        signals=tuple("abcdefgh"[:m]),
        units=(unit,) * m,
        values=values,
        command_channels=channels if channels is not None else (() if commands is None else ("a",)),
        commands=np.zeros((p, t, 0)) if commands is None else commands,
    )


def numbers(holes=False):
    """Values of a size that sensors give; NaN among them if holes."""
    finite = st.floats(-100, 100, allow_nan=False, allow_subnormal=False)
    return st.one_of(finite, st.just(math.nan)) if holes else finite


@st.composite
def trials(draw, max_p=5, shape=None, p=None, holes=False):
    t, m = shape or (draw(st.integers(1, 16)), draw(st.integers(1, 3)))
    p = p or draw(st.integers(1, max_p))
    return make_trials(draw(arrays(np.float64, (p, t, m), elements=numbers(holes))))


@st.composite
def pairs(draw, holes=False, max_p=5):
    shape = (draw(st.integers(1, 16)), draw(st.integers(1, 3)))
    return draw(trials(shape=shape, holes=holes, max_p=max_p)), draw(trials(shape=shape, holes=holes, max_p=max_p))


def literal_tunnel(values):
    """Equations 1 and 2 as lists [t][m] of (mean, lower, upper), or None where no trial saw the sample."""
    p, t, m = values.shape
    out = []
    for n in range(t):
        row = []
        for j in range(m):
            seen = [values[i, n, j] for i in range(p) if not math.isnan(values[i, n, j])]
            if not seen:
                row.append(None)
                continue
            mean = sum(seen) / len(seen)
            row.append((mean, min(s - mean for s in seen), max(s - mean for s in seen)))
        out.append(row)
    return out


def literal_smooth(tunnel):
    """Equation 12 over the samples that exist."""
    t, m = len(tunnel), len(tunnel[0])
    out = []
    for n in range(t):
        row = []
        for j in range(m):
            near = [tunnel[n + k][j] for k in range(-5, 6) if 0 <= n + k < t and tunnel[n + k][j] is not None]
            if tunnel[n][j] is None:
                row.append(None)
            else:
                minus = sum(abs(lower) for _, lower, _ in near) / len(near)
                plus = sum(abs(upper) for _, _, upper in near) / len(near)
                row.append((tunnel[n][j][0], -minus, plus))
        out.append(row)
    return out


def literal_margin(real, sim, k_real, k_sim):
    """By how much equation 6 holds (>= 0: alike) at one sample."""
    mean_r, lower_r, upper_r = real
    mean_s, lower_s, upper_s = sim
    low, high = k_real * lower_r - k_sim * upper_s, k_real * upper_r - k_sim * lower_s
    return min((mean_s - mean_r) - low, high - (mean_s - mean_r))
