# SPDX-License-Identifier: Apache-2.0
"""From refits to probabilities: what each hypothesis explains against what it costs.

The residuals are taken as Gaussian of unknown size, so a hypothesis with mean square c on n independent samples has
log-likelihood -n/2 ln c. Models err together, so these are divided by a temperature found on cases of known truth. A
hypothesis pays a multiple of 1/2 ln n for each of its own values (Schwarz 1978), lest an effect be taken for one that
contains it, and ln K for each effect, K being how many were tried (as PASTIS does: Gerardos and Ronceray, 2025).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from eps_tunnel_analysis.diagnose.calibration import CALIBRATION
from eps_tunnel_analysis.diagnose.gate import complete, unexplained
from eps_tunnel_analysis.diagnose.refit import Refit

NONE, UNKNOWN = "none", "unknown"
LEAST = 1e-4  # probabilities below are not listed


@dataclass(frozen=True)
class Ranked:
    """One hypothesis on one axis.

    Attributes:
        effects: candidate names; empty for the base alone.
        probability: 0 to 1.
        cost: mean square of the residuals in units of the noise floor, fitted samples.
        held_out, overall: the same on the samples kept from the fit, and on all.
        explained: share of the base's overall cost that is gone.
        penalty: what it pays for its values and for having been chosen from many, in log-likelihood.
    """

    effects: tuple[str, ...]
    probability: float
    cost: float
    held_out: float
    overall: float
    explained: float
    penalty: float

    @property
    def name(self) -> str:
        return name_of(self.effects)


def name_of(effects: Sequence[str]) -> str:
    """How a set of effects is written: "a + b"; "none" for the empty one."""
    return " + ".join(sorted(effects)) if effects else NONE


def penalty(own_values: int, effects: int, independent: float, tried: int) -> float:
    """What a hypothesis pays, in log-likelihood."""
    return 0.5 * CALIBRATION.value * own_values * np.log(max(independent, 2.0)) + effects * np.log(max(tried, 1))


def rank(
    base: Refit,
    refits: Sequence[Refit],
    independent: float,
    tried: int,
    once: float = 0.0,
    drifts: bool = False,
    uneven: bool = False,
    floor: bool = True,
) -> tuple[list[Ranked], float]:
    """Probabilities of the base alone, of every refit, and of something unknown.

    Args:
        base: the base values alone.
        refits: sets of effects on top; nested or not, in any order.
        independent: samples that the residuals are worth.
        tried: number of candidates.
        once: overall cost before effects were added to the base in earlier steps.
        drifts: whether the rig drifts from trial to trial: something is missing, whatever else is.
        uneven: whether the trials differ by their timing: nothing is complete then, but an effect may still explain the
            rest.
        floor: whether the noise floor is known. If not, the base is one hypothesis among the others and nothing can be
            said of what none of them explains.

    Returns:
        The ranking, most probable first, the base among it; and the probability of something unknown.
    """
    found: list[tuple[Refit, float, float]] = []
    for refit in refits:
        pays = penalty(refit.free - base.free, len(refit.effects), independent, tried)
        found.append((refit, pays, _likelihood(refit, independent) - pays))
    best = min((_judged(r) for r in refits), default=np.inf)
    none = complete(_judged(base), best, once) if refits else 1.0
    scores = np.array([score for _, _, score in found])
    shares = np.exp(scores - scores.max()) if len(scores) else scores
    shares = shares / shares.sum() if len(scores) else shares
    level = max(_judged(base), once)
    explained = [1.0 - unexplained(_judged(refit), level) for refit, _, _ in found]
    lacking = 1.0 - float(np.sum(shares * np.array(explained)))
    if not floor:
        others = np.logaddexp.reduce(scores) if len(scores) else -np.inf
        none, lacking = float(1.0 / (1.0 + np.exp(others - _likelihood(base, independent)))), 0.0
    changed = CALIBRATION.odd if drifts or uneven else 0.0
    effects = (1.0 - none) * (1.0 - lacking) * (1.0 - CALIBRATION.odd if drifts else 1.0)
    none *= 1.0 - changed
    ranked = [
        Ranked(
            refit.effects,
            float(effects * share),
            refit.cost,
            refit.held_out,
            refit.overall,
            1.0 - refit.overall / base.overall if base.overall else 0.0,
            float(pays),
        )
        for (refit, pays, _), share in zip(found, shares, strict=True)
    ]
    ranked.append(Ranked((), none, base.cost, base.held_out, base.overall, 0.0, 0.0))
    unknown = max(0.0, 1.0 - none - (effects if found else 0.0))
    return sorted(ranked, key=lambda r: (-r.probability, r.overall, r.effects)), unknown


def _likelihood(refit: Refit, independent: float) -> float:
    return float(-0.5 * independent * np.log(max(_judged(refit), 1e-12)) / CALIBRATION.temperature)


def _judged(refit: Refit) -> float:
    return refit.overall


def joint(axes: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Probabilities of what is missing on all axes together, from each axis's own.

    Args:
        axes: name of a set of effects, "none" or "unknown" -> probability, for each axis; each sums to 1.
    """
    found: dict[frozenset[str], float] = {frozenset(): 1.0}
    unknown = 0.0
    for axis in axes:
        longer: dict[frozenset[str], float] = {}
        unknown += sum(found.values()) * axis.get(UNKNOWN, 0.0)
        for names, p in found.items():
            for name, q in axis.items():
                if name != UNKNOWN:
                    more = names if name == NONE else names | frozenset(name.split(" + "))
                    longer[more] = longer.get(more, 0.0) + p * q
        found = longer
    named = {name_of(sorted(names)): p for names, p in found.items()}
    listed = {name: p for name, p in named.items() if p >= LEAST or name == NONE}
    listed[UNKNOWN] = unknown
    total = sum(listed.values())
    return {name: p / total for name, p in sorted(listed.items(), key=lambda item: (-item[1], item[0]))}


def smallest_set(probabilities: Mapping[str, float], coverage: float) -> tuple[str, ...]:
    """The fewest names that together have at least this probability, most probable first."""
    chosen: list[str] = []
    for name, _ in sorted(probabilities.items(), key=lambda item: (-item[1], item[0])):
        chosen.append(name)
        if sum(probabilities[n] for n in chosen) >= coverage - 1e-12:
            break
    return tuple(chosen)
