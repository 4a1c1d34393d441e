# SPDX-License-Identifier: Apache-2.0
"""Probabilities of what is missing, from the predictions of each hypothesis for samples that it was not fitted to.

Each hypothesis is cross-validated over stretches of time, and the stretches are drawn anew with random weights (the
Bayesian bootstrap; Yao, Vehtari, Simpson, Gelman: Using stacking to average Bayesian predictive distributions, Bayesian
Analysis 13, 2018, section 3.4, "pseudo-BMA+"). So a probability says how far the recording as a whole supports it, and
depends neither on how bags are cut nor on the density of the samples.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from eps_tunnel_analysis.diagnose.refits import Refit
from eps_tunnel_analysis.diagnose.settings import SETTINGS
from eps_tunnel_analysis.fit.intervals import autocorrelation_length
from labyrinth_sim.curve import KNOTS
from labyrinth_sim.shown import shown
from labyrinth_sim.trials import Array

NONE, UNKNOWN = "none", "unknown"
OVERLOOKED = "overlooked"
"""Effects of the library that explain what is missing, but that no descent found."""
IMITATED = "imitated"
"""Something else that behaves like the effects named, so that no recording at hand tells it from them."""
UNEXPLAINED = (UNKNOWN, OVERLOOKED, IMITATED)
"""Hypotheses that something is missing, but not what."""
NAMELESS = (NONE, *UNEXPLAINED)
"""Hypotheses that are not sets of effects."""
LEAST = 1e-4  # probabilities below are not listed
FEWEST = 30  # samples of a signal that is judged by itself
ALIKE = 1e-6  # share of a value's influence below which others could do the same, as seen by finite differences
TINY = 1e-12
UNAIDED = 2.0 * SETTINGS.width  # log of the times above what is healthy from which no effect has to explain it


@shown
@dataclass(frozen=True)
class Hypothesis:
    """A refit and its predictions for stretches of time that were left out of the fit.

    Attributes:
        refit: on all samples.
        left_out: (R,) residuals of each sample by values fitted to the other stretches, in units of the noise floor.
        contains: sets of effects that it can imitate, in addition to its own subsets.
        strain: how unlikely its values are beside what is stated: minus twice the logarithm of their likelihood.
        inexact: share of the base's misfit explained by those of its effects that occur in several forms.
        unused: how many of its effects' values lie at a bound, and so are not free.
        kinds: of how many equally likely kinds its effects may be, one of which it is.
    """

    refit: Refit
    left_out: Array
    contains: tuple[frozenset[str], ...] = ()
    strain: float = 0.0
    inexact: float = 1.0
    unused: int = 0
    kinds: int = 1

    @property
    def cost(self) -> float:
        """Floors that it leaves on samples that it was not fitted to."""
        return float(np.mean(self.left_out**2))


@dataclass(frozen=True)
class Ranked:
    """One hypothesis on one axis.

    Attributes:
        effects: candidate names; empty for the base alone.
        probability: 0 to 1.
        cost: floors that it leaves on the samples that it was fitted to.
        held_out: the same for stretches of time that were left out.
        explained: share of the base's misfit beyond the noise that is gone, held out, with a 90 % interval.
    """

    effects: tuple[str, ...]
    probability: float
    cost: float
    held_out: float
    explained: float
    explained_interval: tuple[float, float]

    @property
    def name(self) -> str:
        return name_of(self.effects)

    @property
    def itself(self) -> float:
        """Its probability without the part that is for something which behaves like its effects."""
        return itself(self.probability) if self.effects else self.probability


@dataclass(frozen=True)
class Ranking:
    """What one axis lacks.

    Attributes:
        ranked: most probable first, the base among them.
        unknown: probability of something that no hypothesis explains.
        unknown_but: the free curve that explains clearly more than every named effect, None if none does.
    """

    ranked: tuple[Ranked, ...]
    unknown: float
    unknown_but: str | None = None

    @property
    def probabilities(self) -> dict[str, float]:
        """Name of a set of effects, "none" or "unknown" -> probability."""
        return {r.name: r.probability for r in self.ranked} | {UNKNOWN: self.unknown}

    @property
    def marginals(self) -> dict[str, float]:
        """Effect -> probability that it is missing, whatever else is."""
        totals: dict[str, float] = {}
        for ranked in self.ranked:
            for name in ranked.effects:
                totals[name] = totals.get(name, 0.0) + ranked.probability
        return dict(sorted(totals.items(), key=lambda item: -item[1]))


def name_of(effects: Sequence[str]) -> str:
    """How a set of effects is written: "a + b"; "none" for the empty one."""
    return " + ".join(sorted(effects)) if effects else NONE


def left_out(
    jacobian: Array,
    residuals: Array,
    folds: NDArray[np.int64],
    room: tuple[Array, Array],
    firmness: Array | None = None,
) -> Array:
    """(R,) residuals of each stretch of time by values fitted to all others, to first order.

    Args:
        jacobian: (R, k) at the fit to all.
        residuals: (R,) there.
        folds: (R,) number of the stretch that each belongs to.
        room: how far down and up each value may go, (k,) each.
        firmness: (k,) how firmly each value is expected to be as stated; None if all are free.
    """
    predicted = residuals.copy()
    if not jacobian.shape[1]:
        return predicted
    whole = jacobian.T @ jacobian
    if firmness is not None:
        whole += np.diag(firmness**2)
    most = max(float(np.diag(whole).max(initial=0.0)), np.finfo(float).tiny)
    unit = 1.0 / np.sqrt(np.maximum(np.diag(whole), 1e-9 * most))  # each value in units of its influence
    whole = unit[:, None] * whole * unit + ALIKE * np.eye(len(whole))
    for fold in np.unique(folds):
        here = folds == fold
        own = jacobian[here] * unit
        less = whole - (1.0 - SETTINGS.kept) * own.T @ own
        change = _within(less, own.T @ residuals[here], -room[0] / unit, room[1] / unit)
        predicted[here] = residuals[here] + own @ change
    return predicted


def _within(matrix: Array, right: Array, low: Array, high: Array) -> Array:
    """(k,) the minimum of x A x / 2 - b x, with A (k, k) positive definite, between two bounds that include 0."""
    solution = np.linalg.solve(matrix, right)
    if np.any((solution < low) | (solution > high)):
        half = np.linalg.cholesky(matrix)
        solution = lsq_linear(half.T, np.linalg.solve(half, right), (low, np.maximum(high, low + TINY))).x
    return np.asarray(solution)


def independent(residuals: Array, blocks: NDArray[np.int64]) -> float:
    """How many independent samples residuals (R,), in unbroken runs `blocks` (R,), are worth."""
    return len(residuals) / (2.0 * autocorrelation_length(residuals, blocks.astype(float)) + 1.0)


def rank(
    base: Hypothesis,
    hypotheses: Sequence[Hypothesis],
    folds: NDArray[np.int64],
    blocks: NDArray[np.int64],
    tried: int,
    curves: Sequence[Hypothesis] = (),
    level: float = 0.0,
    drifts: bool = False,
    floor: bool = True,
    signals: NDArray[np.int64] | None = None,
    asked: NDArray[np.bool_] | None = None,
) -> Ranking:
    """Probabilities of the base alone, of every hypothesis, and of something unknown.

    Args:
        base: the base values alone.
        hypotheses: sets of effects on top; nested or not, in any order.
        folds: (R,) stretches of time.
        blocks: (R,) unbroken runs of samples.
        tried: number of candidates.
        curves: free curves, which have no name but may explain more.
        level: floors that the base left before effects were added in earlier steps.
        drifts: whether the rig drifts from trial to trial, which means that something is missing in any case.
        floor: whether the noise floor is known. If not, the base is one hypothesis among the others, in units of what
            the best leaves; whichever is likeliest, if it leaves far more than the sensors' noise, and an effect than
            its form may leave, something is unknown.
        signals: (R,) number of each one's signal. The worst signal decides whether anything is left, because
            others with a wide floor would hide it; without `signals`, all samples together.
        asked: (R,) samples that decide whether anything is left; all by default. What explains it is judged by all in
            any case.
    """
    everything = [base, *hypotheses, *curves]
    best = min(everything, key=lambda h: h.cost)
    unit = 1.0 if floor else max(best.cost, 1e-12)
    residuals = [h.left_out for h in everything]
    weights = _draws(len(np.unique(folds)))
    costs = _costs(residuals, folds, weights) / unit  # (draws, hypotheses)
    parts = np.zeros(len(folds), dtype=np.int64) if signals is None else signals
    # The fit shows whether anything is left, the predictions what explains it: a motion that occurs only once is
    # predicted badly even by the right effect.
    fitted = [h.refit.residuals for h in everything]
    here = np.ones(len(folds), dtype=bool) if asked is None else asked
    worst = _of_worst_signal(fitted, folds, weights, parts, here) / unit
    # Whether something is missing, or left, is a fact of the recording; what explains it is resampled.
    left = _of_worst_signal(fitted, folds, np.ones((1, weights.shape[1])), parts, here)[0] / unit
    worst[:, 0] = left[0]
    worth = independent(best.left_out, blocks)
    first = 1 + len(hypotheses)
    lowest_curve = worst[:, first:].min(axis=1) if curves else np.full(len(costs), np.inf)
    none, shares, unknown = _probabilities(
        base, hypotheses, costs[:, :first], worst[:, :first], left[1:first], lowest_curve, worth, tried, level / unit,
        floor, unit,
    )  # fmt: skip
    if not floor:
        beyond = _above(worst[:, 0] * unit, SETTINGS.unrepeated * SETTINGS.healthy)
        none, unknown = none * (1.0 - beyond), none * beyond
        allowed = SETTINGS.unrepeated * with_form(_kept(hypotheses), left[0] * unit, level)
        more = _above(left[1:first] * unit, allowed)
        shares, unknown = shares * (1.0 - more), unknown + (shares * more).sum(axis=1)
    lacking = SETTINGS.odd if drifts else 0.0
    unknown_total = float(np.mean(unknown)) * (1.0 - lacking) + lacking
    ranked = [
        _ranked(h, float(np.mean(shares[:, i])) * (1.0 - lacking), costs[:, 0] * unit, costs[:, 1 + i] * unit)
        for i, h in enumerate(hypotheses)
    ]
    ranked.append(_ranked(base, float(np.mean(none)) * (1.0 - lacking), costs[:, 0] * unit, costs[:, 0] * unit))
    ordered = tuple(sorted(ranked, key=lambda r: (-r.probability, r.cost, r.effects)))
    named, curve = (min(some, key=lambda h: h.cost, default=None) for some in (hypotheses, curves))
    better = curve is not None and _nameless(curve, named or base, base, unit)
    return Ranking(ordered, unknown_total, curve.refit.effects[0] if better and curve is not None else None)


def _nameless(curve: Hypothesis, named: Hypothesis, base: Hypothesis, unit: float) -> bool:
    """Whether a free curve explains clearly more than the best named set does."""
    room = _curve_room(base.cost / unit, curve.cost / unit) * unit
    several = named.refit.several
    return bool(named.cost - curve.cost > room or (several and curve.cost <= SETTINGS.healthy * unit < named.cost))


def _ranked(h: Hypothesis, probability: float, costs0: Array, costs: Array) -> Ranked:
    """A hypothesis by what the base (d,) and it (d,) leave, in floors."""
    gone = 1.0 - np.maximum(costs - 1.0, 0.0) / np.maximum(costs0 - 1.0, 1e-12)
    gone = np.where(costs0 > 1.0, np.clip(gone, -1.0, 1.0), 0.0) if h.refit.effects else np.zeros(1)
    low, high = (float(q) for q in np.quantile(gone, (0.05, 0.95)))
    return Ranked(h.refit.effects, probability, h.refit.cost, h.cost, float(np.median(gone)), (low, high))


def _costs(
    residuals: Sequence[Array], folds: NDArray[np.int64], weights: Array, here: NDArray[np.bool_] | None = None
) -> Array:
    """(draws, h) mean squares of the samples `here` (R,) where stretches of time count by weights (draws, f)."""
    _, which = np.unique(folds, return_inverse=True)
    counts = np.bincount(which, here, weights.shape[1])
    sums = np.array([np.bincount(which, r**2, weights.shape[1]) for r in residuals])
    return np.asarray((weights @ sums.T) / np.maximum(weights @ counts, 1e-300)[:, None])


def worst_floors(residuals: Array, signal: NDArray[np.int64]) -> float:
    """Mean square of residuals (R,) in units of the noise floor: of the signal (R,) that has most, or of all samples.

    A signal with few samples is not judged by itself.
    """
    count = np.bincount(signal)
    each = np.bincount(signal, residuals**2) / np.maximum(count, 1)
    return float(max([np.mean(residuals**2), *each[count >= FEWEST]]))


def _of_worst_signal(
    residuals: Sequence[Array],
    folds: NDArray[np.int64],
    weights: Array,
    signals: NDArray[np.int64],
    asked: NDArray[np.bool_],
) -> Array:
    """(draws, h) like `_costs`, for the signal on which each leaves most; for all samples asked if that is more."""
    numbers, counts = np.unique(signals[asked], return_counts=True)
    parts: list[NDArray[np.bool_]] = [asked]
    parts += [signals == number for number in numbers[counts >= FEWEST]]
    columns = []
    for r in residuals:
        here = max(parts, key=lambda part: float(np.mean(r[part] ** 2)))
        columns.append(_costs([r * here], folds, weights, here)[:, 0])
    return np.column_stack(columns)


def _draws(folds: int) -> Array:
    """(draws, f) weights of stretches of time, the same for the same number of them."""
    return np.random.default_rng(0).dirichlet(np.ones(folds), SETTINGS.draws) * folds


def _probabilities(
    bare: Hypothesis,
    hypotheses: Sequence[Hypothesis],
    costs: Array,
    worst: Array,
    left: Array,
    curve: Array,
    worth: float,
    tried: int,
    level: float,
    floor: bool,
    unit: float,
) -> tuple[Array, Array, Array]:
    """For each draw: probability of none (d,), of each set (d, h), of something unknown (d,).

    Args:
        bare: the base alone.
        hypotheses: h of them.
        costs: (d, 1 + h) floors left by the base and by each, which decide between them.
        worst: the same for each one's worst signal.
        left: (h,) floors that each leaves on its worst signal in this recording, which show whether anything is left.
        curve: (d,) floors left by the best free curve.
        worth: independent samples.
        unit: of all costs, in floors; other than 1 where the floor is not known.
    """
    base, remaining = worst[:, 0], worst[:, 1:]
    if not len(hypotheses):
        # As if something had been tried that explains no more.
        lacking = _soft(np.log(np.maximum(base, 1e-12) / SETTINGS.healthy) - UNAIDED) if floor else np.zeros_like(base)
        return 1.0 - lacking, remaining, lacking
    known = 1.0 + SETTINGS.form * np.maximum(np.maximum(costs[:, 0], level) - 1.0, 0.0)  # because no form is exact
    before = np.maximum(base, level)
    beyond_noise = np.maximum(before - 1.0, 0.0)
    kept = _kept(hypotheses)
    noise = np.minimum(costs.min(axis=1, keepdims=True), 1.0) if floor else np.ones((len(costs), 1))
    scores = -0.5 * worth * _surprise(costs[:, 1:] / known[:, None])
    scores -= 0.5 * _of_forms(hypotheses, costs[:, 1:] / noise, worth)
    scores = _between_forms(hypotheses, scores, costs[:, 1:], remaining, beyond_noise, kept, worth, unit)
    scores -= np.array([len(h.refit.effects) for h in hypotheses]) * np.log(max(tried, 1))
    # Of hypotheses that fit equally well, the one with fewer values is likelier (Schwarz 1978).
    values = _free_values(hypotheses) - bare.refit.free
    scores -= 0.5 * np.log(max(worth, 1.0)) * np.maximum(values, 0)
    needed = _needed(hypotheses, base, remaining, beyond_noise, kept, unit)
    scores += np.log(np.maximum(needed, 1e-300))
    scores -= np.log([h.kinds for h in hypotheses])
    # A value far from the stated one counts as evidence like a misfit.
    scores -= 0.5 * np.array([h.strain for h in hypotheses])
    alone = -0.5 * worth * _surprise(costs[:, 0] / known) - 0.5 * bare.strain
    shares = np.exp(scores - scores.max(axis=1, keepdims=True))
    shares /= shares.sum(axis=1, keepdims=True)
    if not floor:
        top = scores.max(axis=1)
        others = top + np.log(np.exp(scores - top[:, None]).sum(axis=1))
        none = 1.0 / (1.0 + np.exp(np.clip(others - alone, -700.0, 700.0)))
        named = shares * needed * (1.0 - none)[:, None]  # many samples make the smallest gain sure
        return 1.0 - named.sum(axis=1), named, np.zeros_like(none)
    # What is little enough for a healthy rig is missing only as far as it also predicts what it was not fitted to.
    fitted, predicted = _gain(base, remaining.min(axis=1)), _gain(costs[:, 0], costs[:, 1:].min(axis=1))
    gain = np.maximum(np.minimum(fitted, predicted), _gain(base, curve)) - UNAIDED
    allowed = with_form(0.0, 1.0, level)
    none = 1.0 - _soft(np.log(np.maximum(base, 1e-12) / allowed) + np.minimum(gain, 0.5))
    # A sum of effects may leave nothing for its forms where one curve does without: it may only imitate that one.
    several = np.array([h.refit.several for h in hypotheses])
    enough = 1.0 - _above(curve, SETTINGS.healthy)
    kept = kept * np.where(several, 1.0 - enough[:, None], 1.0)
    beyond = _above(left, with_form(kept, base[:, None], level))
    excess = (remaining - curve[:, None]) / _curve_room(before, curve)[:, None]
    formless = _above(excess, 1.0)
    explained = (1.0 - beyond) * (1.0 - formless)
    named = shares * explained * (1.0 - none)[:, None]
    return none, named, 1.0 - none - named.sum(axis=1)


def with_form(kept: Array | float, base: Array | float, level: float, healthy: float = SETTINGS.healthy) -> Array:
    """Floors of the worst signal that a set of effects may leave, because no form of an effect is exact.

    Args:
        kept: how much of what a form may leave it may.
        base: floors that the base leaves.
        level: floors that the base left before effects were added in earlier steps.
        healthy: floors that count as nothing missing.
    """
    missing = np.maximum(np.asarray(base) - 1.0, 0.0)
    return np.asarray(healthy + SETTINGS.form * np.maximum(kept * missing, max(level - 1.0, 0.0)))


def _kept(hypotheses: Sequence[Hypothesis]) -> Array:
    """(h,) how much of what its form may leave each hypothesis may."""
    return np.array([kept_of(h.inexact) for h in hypotheses])


def kept_of(inexact: float) -> float:
    """How much of what a form may leave effects may of which those of inexact form explain this share of a misfit."""
    return max(inexact, SETTINGS.exact)


def _gain(before: Array, after: Array) -> Array:
    """Logarithm of the factor by which a cost falls; 0 where it does not."""
    return np.asarray(np.log(np.maximum(before, 1e-12) / np.maximum(np.minimum(before, after), 1e-12)))


def _surprise(cost: Array) -> Array:
    """Minus twice the log-likelihood of a sample: Gaussian up to the noise, beyond it with the scale that fits best."""
    return np.where(cost < 1.0, cost, 1.0 + np.log(np.maximum(cost, 1.0)))


def _of_forms(hypotheses: Sequence[Hypothesis], costs: Array, worth: float) -> Array:
    """(d, h) minus twice the log-likelihood that errors of the forms add; costs (d, h) in units of the noise.

    An error that a form may well have is still no noise: it is a smooth curve, whose values at its knots have to be of
    that size (Kennedy and O'Hagan, Bayesian calibration of computer models, Journal of the Royal Statistical Society B
    63, 2001, make it a Gaussian process). It tells sets apart that both leave little of much. Beside more effects, or a
    more general form of the same, it does not count, because what these have more may be such a curve.
    """
    each = worth / KNOTS
    errors = KNOTS * np.log1p(np.maximum(costs - 1.0, 0.0) * each)
    for general, simple in _forms(hypotheses):
        errors[:, simple] = np.minimum(errors[:, simple], errors[:, general])
    sizes = np.array([len(h.refit.effects) for h in hypotheses])
    return np.column_stack([errors[:, i] - errors[:, sizes <= size].min(axis=1) for i, size in enumerate(sizes)])


def _needed(
    hypotheses: Sequence[Hypothesis], base: Array, costs: Array, misfit: Array, kept: Array, unit: float
) -> Array:
    """(d, h) how far each hypothesis explains materially more than each of fewer effects that it contains, or the base.

    An effect that explains none of what is missing is no better than something unknown, and many of these must not
    outweigh the one that does. Nor does what is far below the noise of the sensors matter, however sure it is.

    Args:
        misfit: (d,) floors beyond the noise.
        kept: (h,) share of them by which the form of each hypothesis counts.
        unit: of the costs, in floors.
    """
    needed = np.ones_like(costs)
    sets = [frozenset(h.refit.effects) for h in hypotheses]
    for i, h in enumerate(hypotheses):
        smaller = [j for j, other in enumerate(sets)
                   if len(other) < len(sets[i]) and (other < sets[i] or other in h.contains)]  # fmt: skip
        simpler = [(costs[:, j], kept[j]) for j in smaller] or [(base, 1.0)]
        # One effect matters if it is more than the sensors' noise; another one if it is more than what the best leaves.
        matters = SETTINGS.material / (unit if len(sets[i]) < 2 else min(unit, 1.0))
        for cost, share in simpler:
            more = _materially(cost - costs[:, i], misfit, share, matters)
            needed[:, i] = np.minimum(needed[:, i], np.maximum(more, _completes(costs[:, i], cost, unit)))
    return needed


def _completes(costs: Array, simpler: Array, unit: float) -> Array:
    """(d,) from 0 to 1: how far a hypothesis leaves no more than a healthy rig does and a simpler one more, clearly.

    What is between them is then not an error of the simpler one's form: that would not end at the noise.
    """
    whole, part = 1.0 - _above(costs * unit, SETTINGS.healthy), _above(simpler * unit, SETTINGS.healthy)
    return np.asarray(whole * part * _above((simpler - costs) * unit, SETTINGS.material))


def _between_forms(
    hypotheses: Sequence[Hypothesis], scores: Array, costs: Array, worst: Array, misfit: Array, kept: Array,
    worth: float, unit: float,
) -> Array:  # fmt: skip
    """Scores (d, h) of general and of simple forms of the same effects, by what they leave on the worst signal.

    Where the general one leaves no more than a healthy rig does, and the simple one more, the simple one is lowered as
    far as the noise says. Elsewhere the general one is no better than the simple one, unless it explains materially
    more; then the number of their values decides. With the values at their bounds that it has beyond the simple one, it
    is that one, and counts only for what it explains more.
    """
    capped, completes = scores.copy(), {}
    for i, j in _forms(hypotheses):
        gain = worst[:, j] - worst[:, i]
        completes[i, j] = _completes(worst[:, i], worst[:, j], unit)
        more = np.maximum(_materially(gain, misfit, kept[j]), completes[i, j])
        alike = np.minimum(scores[:, i], scores[:, j])
        capped[:, i] = np.minimum(capped[:, i], more * scores[:, i] + (1.0 - more) * alike)
        if _acts_as(hypotheses[i], hypotheses[j]):
            capped[:, i] += np.log(np.maximum(more, 1e-300))
    for (i, j), surely in completes.items():
        worse = 0.5 * worth * np.maximum(_surprise(costs[:, j]) - _surprise(costs[:, i]), 0.0)
        capped[:, j] = np.minimum(capped[:, j], surely * (scores[:, i] - worse) + (1.0 - surely) * capped[:, j])
    return capped


def _acts_as(general: Hypothesis, simple: Hypothesis) -> bool:
    """Whether as many of a general form's values lie at a bound as it has beyond those that a simple one uses."""
    return 0 < general.unused >= general.refit.free - (simple.refit.free - simple.unused)


def _free_values(hypotheses: Sequence[Hypothesis]) -> NDArray[np.int64]:
    """(h,) how many values count. Of a simple form beside a general one those at a bound do not, as they are not
    free; of the general one they do, as with a value at its bound it acts as the simple one.
    """
    general, simple = ({pair[k] for pair in _forms(hypotheses)} for k in (0, 1))
    return np.array([h.refit.free - h.unused * (i in simple - general) for i, h in enumerate(hypotheses)])


def _forms(hypotheses: Sequence[Hypothesis]) -> Iterator[tuple[int, int]]:
    """Numbers of a set of effects and of one of as many that it can imitate: a general form and a simple one."""
    sets = [frozenset(h.refit.effects) for h in hypotheses]
    for i, h in enumerate(hypotheses):
        yield from ((i, j) for j, other in enumerate(sets) if len(other) == len(sets[i]) and other in h.contains)


def _materially(gain: Array, misfit: Array, kept: float, matters: float = SETTINGS.material) -> Array:
    """(d,) from 0 to 1: how far gains (d,) are more than what matters and than what form alone may do."""
    least = np.maximum(matters, SETTINGS.share * kept * misfit)
    return _above(gain, least)


def _curve_room(base: Array | float, curve: Array | float) -> Array:
    """Floors by which a named effect may be worse than a free curve."""
    return np.maximum(SETTINGS.material, SETTINGS.curve * np.maximum(np.asarray(base) - np.asarray(curve), 0.0))


def _above(floors: Array, limit: Array | float) -> Array:
    """From 0 to 1 as floors go from below a limit to above."""
    return _soft(np.log(np.maximum(floors, 1e-12) / limit))


def _soft(log_ratio: Array) -> Array:
    """From 0 to 1 as a ratio goes from below 1 to above."""
    return 1.0 / (1.0 + np.exp(-np.clip(log_ratio / SETTINGS.width, -50.0, 50.0)))


def joint(axes: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Probabilities of what is missing on all axes together, from each axis's own.

    Args:
        axes: name of a set of effects, "none" or "unknown" -> probability, for each axis; each sums to 1.
    """
    sets: dict[frozenset[str], float] = {frozenset(): 1.0}
    unknown = 0.0
    for axis in axes:
        longer: dict[frozenset[str], float] = {}
        unknown += sum(sets.values()) * axis.get(UNKNOWN, 0.0)
        for names, p in sets.items():
            for name, q in axis.items():
                if name != UNKNOWN:
                    more = names if name == NONE else names | frozenset(name.split(" + "))
                    longer[more] = longer.get(more, 0.0) + p * q
        sets = longer
    named = {name_of(sorted(names)): p for names, p in sets.items()}
    listed = {name: p for name, p in named.items() if p >= LEAST or name == NONE}
    listed[UNKNOWN] = unknown
    total = sum(listed.values())
    return ordered({name: p / total for name, p in listed.items()})


def with_overlooked(probabilities: Mapping[str, float]) -> dict[str, float]:
    """The probabilities with a part of UNKNOWN's for what the library has and the search did not find."""
    missed = SETTINGS.overlooked * probabilities.get(UNKNOWN, 0.0)
    if missed < LEAST:
        return dict(probabilities)
    return ordered({**probabilities, UNKNOWN: probabilities[UNKNOWN] - missed, OVERLOOKED: missed})


def itself(probability: float) -> float:
    """The part of the probability of a set of effects that is for it, and not for something that behaves like it."""
    return probability * (1.0 - SETTINGS.imitated)


def with_imitated(probabilities: Mapping[str, float]) -> dict[str, float]:
    """The probabilities with a part of each set's for what behaves like it."""
    kept = {n: p if n in NAMELESS else itself(p) for n, p in probabilities.items()}
    others = sum(probabilities.values()) - sum(kept.values())
    return ordered({**kept, IMITATED: others}) if others >= LEAST else dict(probabilities)


def ordered(probabilities: Mapping[str, float]) -> dict[str, float]:
    """Most probable first."""
    return dict(sorted(probabilities.items(), key=lambda item: (-item[1], item[0])))


def smallest_set(probabilities: Mapping[str, float], coverage: float) -> tuple[str, ...]:
    """The fewest names that together have at least this probability, most probable first."""
    chosen: list[str] = []
    for name in ordered(probabilities):
        chosen.append(name)
        if sum(probabilities[n] for n in chosen) >= coverage - 1e-12:
            break
    return tuple(chosen)
