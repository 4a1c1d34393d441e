# SPDX-License-Identifier: Apache-2.0
"""How well the data determine the fitted values: 95 % intervals, and combinations that are not identifiable.

Residuals of a roll-out are correlated in time, so the textbook covariance is far too narrow. In the sandwich estimator
used here the residuals' autocovariance stands between the slopes, weighted by Bartlett's window within each unbroken
block. Products of the scores themselves (Newey and West, Econometrica 55, 1987) come out too small: a fit has made
their sum zero.
"""

from dataclasses import dataclass, replace
from itertools import combinations, pairwise

import numpy as np
from scipy.special import ndtri

from labyrinth_sim.trials import Array

CHI2_95 = 3.84  # quantile of chi-squared with one degree of freedom
TRADE_OFF = 0.97  # correlation from which two values are reported together: a quarter of either one's width is left


@dataclass(frozen=True)
class Intervals:
    """Attributes:
    deviation: (k,) standard deviations, normalised units.
    half_width: (k,) of the 95 % intervals, normalised units.
    loose: directions (d, k), unit length, along which the fit can move by more than `loose_bound` of the box
        without the data objecting; empty when all is identifiable.
    lag: window length, samples.
    covariance: (k, k), normalised units.
    """

    deviation: Array
    half_width: Array
    loose: Array
    lag: int
    covariance: Array


def unknown_intervals(k: int) -> Intervals:
    """Intervals of k values that were not computed."""
    nothing = np.full(k, np.nan)
    return Intervals(nothing, nothing, np.empty((0, k)), 0, np.full((k, k), np.nan))


def intervals(
    jac: Array,
    residuals: Array,
    blocks: Array,
    loose_bound: float = 0.25,
    held: Array | None = None,
    held_variance: float = 1.0,
) -> Intervals:
    """95 % intervals of a least-squares fit with autocorrelated residuals.

    Args:
        jac: (R, k) by normalised values.
        residuals: (R,) at the fit.
        blocks: (R,) which unbroken run of samples each belongs to.
        loose_bound: standard deviation, in normalised units, beyond which a direction counts as not identifiable.
        held: (k,) how firmly the fit held each value where it was stated, as slopes of further residuals; each of these
            has `held_variance`.
    """
    k = jac.shape[1]
    lag = autocorrelation_length(residuals, blocks)
    firm = np.zeros(k) if held is None else held
    _, sizes, right = np.linalg.svd(np.vstack([jac, np.diag(firm)]) if firm.any() else jac, full_matrices=False)
    # A direction that moves nothing has no finite variance; a floor keeps the numbers finite and the direction loose.
    floor = max(sizes.max(initial=0.0) * 1e-9, np.finfo(float).tiny)
    bread = (right.T / np.maximum(sizes, floor) ** 2) @ right
    covariance = bread @ (_long_run(jac, residuals, blocks, lag) + held_variance * np.diag(firm**2)) @ bread
    # Few parameters eat few degrees of freedom, but correlated samples are few too.
    independent = max(len(residuals) / (2 * lag + 1), k + 1.0)
    covariance *= independent / max(independent - k, 1.0)
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    variances, vectors = np.linalg.eigh(covariance)
    loose = vectors.T[np.sqrt(np.maximum(variances, 0.0)) > loose_bound]
    dead = right[sizes <= floor * 10]
    return Intervals(deviation, ndtri(0.975) * deviation, np.vstack([loose, dead]), lag, covariance)


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


def _long_run(jac: Array, residuals: Array, blocks: Array, lag: int) -> Array:
    """(k, k) slopes (R, k) on both sides of the residuals' autocovariance, Bartlett-weighted."""
    total = np.zeros((jac.shape[1], jac.shape[1]))
    parts = _parts(blocks)
    for shift in range(lag + 1):
        weight = (1.0 - shift / (lag + 1.0)) / len(residuals)
        pairs = [(residuals[p], jac[p]) for p in parts if p.stop - p.start > shift]
        shared = weight * sum(float(r[shift:] @ r[: len(r) - shift]) for r, _ in pairs)
        for _, slopes in pairs:
            cross = slopes[shift:].T @ slopes[: len(slopes) - shift]
            total += shared * (cross if shift == 0 else cross + cross.T)
    return total


def widened(found: Intervals, more: Array) -> Intervals:
    """Intervals with (k,) more of deviation, normalised units."""
    deviation = np.hypot(found.deviation, more)
    return replace(found, deviation=deviation, half_width=ndtri(0.975) * deviation)


def trade_offs(
    found: Intervals, values: Array, span: Array, names: tuple[str, ...], shifts: Array | None = None
) -> list[str]:
    """What is known about two values together if neither is known well by itself, one sentence for each such pair.

    Args:
        values, span: (k,) of the fit and of the bounds, in the values' units.
        shifts: (n, k) by which what may be missing would have shifted them, normalised units; a combination that it
            shifts as much as the values is not known better.
    """
    sentences: list[str] = []
    covariance = found.covariance * np.outer(span, span)
    size = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    if not np.isfinite(covariance).all():
        return sentences
    for i, j in combinations(range(len(names)), 2):
        if size[i] * size[j] <= 0.0:
            continue
        correlation = covariance[i, j] / (size[i] * size[j])
        if abs(correlation) < TRADE_OFF:
            continue
        share = -covariance[i, j] / covariance[j, j]
        known = size[i] * np.sqrt(max(1.0 - correlation**2, 0.0))
        if shifts is not None and len(shifts):
            known = np.hypot(known, np.abs((shifts * span)[:, [i, j]] @ [1.0, share]).max())
        half = ndtri(0.975) * known
        if half > np.sqrt(1.0 - TRADE_OFF**2) * found.half_width[i] * span[i]:
            continue
        sign, both = "-" if share < 0.0 else "+", values[i] + share * values[j]
        sentences.append(
            f"{names[i]} and {names[j]} trade off: {names[i]} {sign} {abs(share):.3g} {names[j]} = {both:.4g} ± "
            f"{half:.2g} is known better than either."
        )
    return sentences


def combination(direction: Array, names: tuple[str, ...], least: float = 0.2) -> str:
    """A loose direction in words: "0.71 drive.x.p - 0.71 drive.x.d"."""
    terms = [(float(w), n) for w, n in zip(direction, names, strict=True) if abs(w) >= least]
    text = " ".join(f"{'-' if w < 0 else '+'} {abs(w):.2f} {n}" for w, n in terms)
    return text.removeprefix("+ ")
