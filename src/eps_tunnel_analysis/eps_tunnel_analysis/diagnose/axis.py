# SPDX-License-Identifier: Apache-2.0
"""What one axis lacks: its sets of effects, refitted and ranked."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from eps_tunnel_analysis.diagnose.axis_search import AxisPart, SearchOptions, axis_search
from eps_tunnel_analysis.diagnose.base_values import Bases, base_refit
from eps_tunnel_analysis.diagnose.candidates import Candidate
from eps_tunnel_analysis.diagnose.contained import contained
from eps_tunnel_analysis.diagnose.free_curves import free_curves, imitated
from eps_tunnel_analysis.diagnose.rank import Hypothesis, Ranking, left_out, rank, worst_floors
from eps_tunnel_analysis.diagnose.refits import Refit, lowest
from eps_tunnel_analysis.diagnose.repeats import Repeats, repeats
from eps_tunnel_analysis.diagnose.search import Search
from eps_tunnel_analysis.diagnose.sets import RUNNING, inexact_share, refitted_sets
from eps_tunnel_analysis.diagnose.settings import SETTINGS
from eps_tunnel_analysis.recorded_play import Play
from labyrinth_sim.model import Model
from labyrinth_sim.shown import shown


@shown
@dataclass(frozen=True)
class AxisDiagnosis:
    """The result for an axis, or for several coupled axes: refits, their ranking, what is left.

    Attributes:
        base: the base values alone.
        hypotheses: what was ranked, the base first.
        odd: signals whose trials differ in a way that no effect of the library explains.
        even: the ranking if uneven timing of the trials does not count against completeness.
        parts: axis -> the ranking if its own signals alone decide whether anything is left; empty for one axis.
    """

    part: AxisPart
    search: Search
    base: Refit
    refits: tuple[Refit, ...]
    hypotheses: tuple[Hypothesis, ...]
    ranking: Ranking
    even: Ranking
    odd: tuple[Repeats, ...] = ()
    parts: Mapping[str, Ranking] = field(default_factory=dict)

    @property
    def best(self) -> Refit:
        """The most probable refit, whether or not it explains everything; the base if that is more probable."""
        return self.of(self.ranking.ranked[0].effects) if self.ranking.ranked else self.base

    def of(self, effects: Sequence[str]) -> Refit:
        """The refit of a set of effects; the base if the set was not refitted."""
        return next((r for r in self.refits if set(r.effects) == set(effects)), self.base)

    def own(self, names: Collection[str]) -> list[Candidate]:
        """The given effects that act on this axis."""
        return [c for c in self.search.library.candidates if c.name in names]

    def acting(self, names: Collection[str]) -> Refit:
        """The refit of the given effects that act on this axis."""
        return self.of([c.name for c in self.own(names)])

    def held_out_error(self, effects: Sequence[str]) -> float:
        """rad (m for the ball): mean absolute error of positions in stretches of time that were left out of the fit."""
        own = next((h for h in self.hypotheses if set(h.refit.effects) == set(effects)), self.hypotheses[0])
        evidence = self.search.evidence
        units = dict(zip(evidence.model.rig.signals, evidence.model.rig.units, strict=True))
        angles = [i for i, name in enumerate(self.part.signals) if units.get(name, "m") in ("rad", "m")]
        here = np.isin(self.search.signal, angles)
        return float(np.mean(np.abs(own.left_out[here] * self.search.scale[here])))

    def signals_of(self, name: str) -> tuple[str, ...]:
        """The compared signals of one of the axes."""
        rig = self.search.library.model.rig
        own = {m.signal for axis in rig.axes if axis.name == name for m in axis.measured}
        return self.part.signals if self.part.axes == (name,) else tuple(s for s in self.part.signals if s in own)

    def floors(self, refit: Refit, name: str) -> float:
        """Floors that a refit leaves on one of the axes."""
        return float(np.mean(refit.residuals[self.samples_of(name)] ** 2))

    def worst(self, name: str) -> float:
        """Floors that the base leaves on the worst signal of one of the axes."""
        own = self.samples_of(name)
        return worst_floors(self.base.residuals[own], self.search.signal[own])

    def samples_of(self, name: str) -> NDArray[np.bool_]:
        """(R,) which of the compared samples belong to one of the axes."""
        return np.isin(self.search.signal, [self.part.signals.index(s) for s in self.signals_of(name)])

    def remaining(self, refit: Refit) -> dict[str, float]:
        """Signal -> floors that a refit leaves on it."""
        search = self.search
        return {
            name: float(np.mean(refit.residuals[search.signal == i] ** 2))
            for i, name in enumerate(self.part.signals)
            if (search.signal == i).any()
        }


def diagnose_axis(
    model: Model,
    plays: Sequence[Play],
    part: AxisPart,
    run: SearchOptions,
    level: float = 0.0,
    bases: Bases | None = None,
) -> AxisDiagnosis:
    """Names what one part lacks.

    Args:
        level: floors that the base left before effects were added in earlier steps.
        bases: base values of all axes, if there are several.
    """
    bases = bases or Bases()
    own, played = bases.among(model, plays, part)
    search = axis_search(own, played, part, run)
    base = base_refit(search, bases.known(part), fitted=run.fitted)
    floor = floor_known(plays)
    base, refits = refitted_sets(search, base, level=level, floor=floor)
    curves: list[Hypothesis] = []
    if floor and part.base and imitated(lowest([base, *refits]), search):
        over, free = free_curves(search, base, own, played, part)
        curves = [hypothesis(over, refit) for refit in free[:1]]
    return _judged(plays, part, search, base, refits, model, level, floor, curves)


def _judged(
    plays: Sequence[Play], part: AxisPart, search: Search, base: Refit, refits: Sequence[Refit], model: Model,
    level: float, floor: bool, curves: Sequence[Hypothesis] = (),
) -> AxisDiagnosis:  # fmt: skip
    hypotheses = near_hypotheses(search, base, refits)
    alone = hypothesis(search, base)
    differ = [(p, r) for p in plays for r in repeats(p.trials, _positions(model, part)) if r.sentence]
    drifts, uneven = any(r.drift for _, r in differ), any(r.jitter > p.timing for p, r in differ)
    tried = len(search.library.candidates)
    # The base's residuals on all samples show whether anything is missing; those on left-out ones, what explains it.
    whole = replace(alone, left_out=base.residuals)
    ranked = partial(rank, whole, hypotheses, search.folds, search.blocks, tried, curves, level=level,
                     drifts=drifts, floor=floor, signals=search.signal)  # fmt: skip
    even = ranked()
    diagnosis = AxisDiagnosis(
        part, search, base, tuple(refits), (alone, *hypotheses), _uneven(even) if uneven else even, even,
        tuple(r for _, r in differ),
    )  # fmt: skip
    parts = {name: ranked(asked=diagnosis.samples_of(name)) for name in part.axes} if len(part.axes) > 1 else {}
    return replace(diagnosis, parts={name: _uneven(r) if uneven else r for name, r in parts.items()})


def _uneven(ranking: Ranking) -> Ranking:
    """If trials differ in timing no model is complete, but an effect may still explain the rest."""
    ranked = tuple(replace(r, probability=r.probability * (1.0 - SETTINGS.odd)) if not r.effects else r
                   for r in ranking.ranked)  # fmt: skip
    lost = sum(a.probability - b.probability for a, b in zip(ranking.ranked, ranked, strict=True))
    return replace(ranking, ranked=ranked, unknown=ranking.unknown + lost)


def near_hypotheses(search: Search, base: Refit, refits: Sequence[Refit]) -> list[Hypothesis]:
    """The refits that are ranked: the best, those close to it, and for each of these the best one of fewer of its
    effects: without that, nothing would show whether the others are needed.
    """
    ordered = sorted(refits, key=lambda r: r.cost)
    near = [r for i, r in enumerate(ordered) if i < 4 or r.cost < RUNNING * max(ordered[0].cost, 1.0)][:10]
    kept = {r.effects: r for r in near}
    for larger in near:
        for size in range(1, len(larger.effects)):
            fewer = [r for r in ordered if len(r.effects) == size and set(r.effects) < set(larger.effects)]
            kept |= {r.effects: r for r in fewer[:1]}
    near = list(kept.values())
    return [
        replace(
            hypothesis(search, r, [o for o in near if o is not r and contained(search, r, o) is not None]),
            inexact=inexact_share(search, base, r, refits),
        )
        for r in near
    ]


def hypothesis(search: Search, refit: Refit, contains: Sequence[Refit] = ()) -> Hypothesis:
    """A refit with its predictions for stretches of time left out of the fit, and the others that it contains."""
    columns = search.fitted(refit)
    span = search.spans[columns]
    room = (refit.values - search.low)[columns] / span, (search.high - refit.values)[columns] / span
    predicted = left_out(search.jacobian(refit), refit.residuals, search.folds, room,
                         search.firmness_at(refit.values)[columns])  # fmt: skip
    kinds = math.prod(c.kinds for c in search.library.of(refit.effects))
    return Hypothesis(refit, predicted, tuple(frozenset(o.effects) for o in contains), search.strain(refit.values),
                      unused=_unused(search, refit), kinds=kinds)  # fmt: skip


def _unused(search: Search, refit: Refit) -> int:
    """How many values of a refit's effects lie at a bound, and so are no longer free: a friction that sets in at once,
    a spring that does not harden. Of each effect one value counts in any case.
    """
    total = 0
    for candidate in search.library.of(refit.effects):
        columns = search.free_columns(candidate)
        total += min(int(search.at_bound(refit.values[columns], columns).sum()), len(columns) - 1)
    return total


def floor_known(plays: Sequence[Play]) -> bool:
    """Whether every play has repeated trials, which show the noise floor."""
    return all(play.trials.count > 1 for play in plays)


def _positions(model: Model, part: AxisPart) -> list[str]:
    return [signal for signal in model.rig.positions if signal in part.signals]
