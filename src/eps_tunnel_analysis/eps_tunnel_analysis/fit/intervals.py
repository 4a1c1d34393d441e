# SPDX-License-Identifier: Apache-2.0
"""How well the data pin the fitted values down: 95 % intervals and what cannot be told apart.

Residuals of a roll-out are correlated in time, so the textbook covariance is far too narrow. The sandwich estimator of
Newey and West (Econometrica 55, 1987) is used, the scores weighted by Bartlett's window within each unbroken block.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.stats import norm

from labyrinth_sim.trials import Array


@dataclass(frozen=True)
class Intervals:
    """Attributes:
    deviation: (k,) standard deviations, normalised units.
    half_width: (k,) of the 95 % intervals, normalised units.
    loose: directions (d, k), unit length, along which the fit can move by more than `loose_bound` of the box
        without the data objecting; empty when all is identifiable.
    lag: window length, samples.
    """

    deviation: Array
    half_width: Array
    loose: Array
    lag: int


def unknown_intervals(k: int) -> Intervals:
    """What is said of k values when nobody had the time to look."""
    nothing = np.full(k, np.nan)
    return Intervals(nothing, nothing, np.empty((0, k)), 0)


def jacobian(residuals_at: Array, residuals_moved: Array, steps: Array) -> Array:
    """(R, k) from residuals (R,) and moved residuals (k, R) at steps (k,)."""
    return np.asarray(((residuals_moved - residuals_at) / steps[:, None]).T)


def intervals(jac: Array, residuals: Array, blocks: Array, loose_bound: float = 0.25) -> Intervals:
    """95 % intervals of a least-squares fit with autocorrelated residuals.

    Args:
        jac: (R, k) by normalised values.
        residuals: (R,) at the fit.
        blocks: (R,) which unbroken run of samples each belongs to.
        loose_bound: standard deviation, in normalised units, beyond which a direction counts as not identifiable.
    """
    k = jac.shape[1]
    lag = autocorrelation_length(residuals, blocks)
    _, sizes, right = np.linalg.svd(jac, full_matrices=False)
    # A direction that moves nothing has no finite variance; a floor keeps the numbers finite and the direction loose.
    floor = max(sizes.max(initial=0.0) * 1e-9, np.finfo(float).tiny)
    bread = (right.T / np.maximum(sizes, floor) ** 2) @ right
    covariance = bread @ _long_run(jac * residuals[:, None], blocks, lag) @ bread
    # Few parameters eat few degrees of freedom, but correlated samples are few too.
    independent = max(len(residuals) / (2 * lag + 1), k + 1.0)
    covariance *= independent / max(independent - k, 1.0)
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    variances, vectors = np.linalg.eigh(covariance)
    loose = vectors.T[np.sqrt(np.maximum(variances, 0.0)) > loose_bound]
    dead = right[sizes <= floor * 10]
    return Intervals(deviation, norm.ppf(0.975) * deviation, np.vstack([loose, dead]), lag)


def autocorrelation_length(residuals: Array, blocks: Array, most: int = 200) -> int:
    """Samples until the residuals' autocorrelation first falls below 0.05, at most `most`."""
    power, products = 0.0, np.zeros(most + 1)
    for part in _parts(blocks):
        r = residuals[part]
        power += float(r @ r)
        for shift in range(1, min(most, len(r) - 1) + 1):
            products[shift] += float(r[shift:] @ r[:-shift])
    if power == 0.0:
        return 0
    below = np.flatnonzero(products[1:] / power < 0.05)
    return int(below[0]) + 1 if len(below) else most


def _parts(blocks: Array) -> list[slice]:
    edges = np.flatnonzero(np.diff(blocks)) + 1
    ends = [0, *edges.tolist(), len(blocks)]
    return [slice(a, b) for a, b in pairwise(ends)]


def _long_run(scores: Array, blocks: Array, lag: int) -> Array:
    """(k, k) Bartlett-weighted sum of the scores' (R, k) autocovariances."""
    total = np.zeros((scores.shape[1], scores.shape[1]))
    for part in _parts(blocks):
        s = scores[part]
        total += s.T @ s
        for shift in range(1, min(lag, len(s) - 1) + 1):
            cross = s[shift:].T @ s[:-shift]
            total += (1.0 - shift / (lag + 1.0)) * (cross + cross.T)
    return total


def combination(direction: Array, names: tuple[str, ...], least: float = 0.2) -> str:
    """A loose direction in words: "0.71 drive.x.p - 0.71 drive.x.d"."""
    terms = [(float(w), n) for w, n in zip(direction, names, strict=True) if abs(w) >= least]
    text = " ".join(f"{'-' if w < 0 else '+'} {abs(w):.2f} {n}" for w, n in terms)
    return text.removeprefix("+ ")
