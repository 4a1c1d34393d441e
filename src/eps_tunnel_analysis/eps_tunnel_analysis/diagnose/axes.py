# SPDX-License-Identifier: Apache-2.0
"""All axes together: the result, its probabilities, the models with what is missing, and the verdict on each."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from eps_tunnel_analysis.compare import Comparison
from eps_tunnel_analysis.diagnose.axis import AxisDiagnosis, diagnose_axis
from eps_tunnel_analysis.diagnose.axis_search import AxisPart, SearchOptions, side_by_side
from eps_tunnel_analysis.diagnose.base_values import Bases
from eps_tunnel_analysis.diagnose.experiment import Experiment
from eps_tunnel_analysis.diagnose.prescribed import coupled_with, measured_motions
from eps_tunnel_analysis.diagnose.rank import NAMELESS, itself, joint, with_overlooked
from eps_tunnel_analysis.diagnose.verdict import AxisVerdict, Verdict
from eps_tunnel_analysis.recorded_play import Play
from labyrinth_sim.model import Model
from labyrinth_sim.shown import shown


@shown
@dataclass(frozen=True)
class Diagnosis:
    """The verdict, the models and comparisons behind it, axis by axis.

    Attributes:
        base_model: the given model with its values refitted.
        model: the same with the named effects, fitted; the base model if none is named.
        experiment: what to play next if two hypotheses are left, else None.
    """

    verdict: Verdict
    axes: tuple[AxisDiagnosis, ...]
    base_model: Model
    model: Model
    given: Comparison
    before: Comparison
    after: Comparison
    experiment: Experiment | None


def diagnosed(
    model: Model, plays: Sequence[Play], parts: Sequence[AxisPart], run: SearchOptions,
    levels: Mapping[str, float] | None, bases: Bases,
) -> list[AxisDiagnosis]:  # fmt: skip
    """What each part lacks, in their order.

    Parts that move by themselves are searched side by side. Of those that are coupled with others, the one that its
    base values explain least comes first: with what it lacks in the model, its motion is known better to the rest.
    """
    coupled = [p for p in parts if set(coupled_with(model, p.axes)) & set(bases.motions)]
    free = [p for p in parts if p not in coupled]
    done = side_by_side(lambda p, run: diagnose_axis(model, plays, p, run, p.level(levels), bases), free, run)
    begun = model.with_values(bases.values, "refitted")
    for part in sorted(coupled, key=lambda p: -bases.left.get(p.name, 0.0)):
        done.append(diagnose_axis(model, plays, part, run, part.level(levels), bases))
        if done[-1].best.effects:
            effects = {name for axis in done for name in axis.best.effects}
            bases = replace(bases, motions=measured_motions(with_refits(begun, done, effects), plays))
    return [next(axis for axis in done if axis.part is part) for part in parts]


def together(axes: Sequence[AxisDiagnosis]) -> dict[str, float]:
    """Probabilities of what is missing on all axes.

    If one axis lacks an effect, uneven timing alone does not make the others unknown; a sentence reports it.
    """
    likely = [max(p, key=lambda name: p[name]) for p in (a.ranking.probabilities for a in axes)]
    named = any(name not in NAMELESS for name in likely)
    return with_overlooked(joint([(axis.even if named else axis.ranking).probabilities for axis in axes]))


def with_refits(model: Model, axes: Sequence[AxisDiagnosis], named: Collection[str], final: bool = False) -> Model:
    """A model with these effects where they act, and with each axis's values fitted together with its effects.

    Args:
        final: look for values in other valleys of the misfit as well.
    """
    for axis in axes:
        search, library, refit = axis.search, axis.search.library, axis.acting(named)
        refit = search.valleys(refit)[0] if final else search.as_run(refit)
        values = dict(zip(library.names, (float(v) for v in refit.values), strict=True))
        for name in refit.effects:
            candidate = library.find(name)
            model = model.with_effect(candidate.effect, candidate.place, candidate.given)
            model = model.with_values({p: values[p] for p in candidate.parameters}, "diagnosis")
        model = model.with_values({p: values[p] for p in library.base}, "diagnosis")
    return model


def fit_names(axes: Sequence[AxisDiagnosis], named: Collection[str]) -> set[str]:
    """Full names of the values that were fitted: of the axes' bases and of these effects."""
    names: set[str] = set()
    for axis in axes:
        names |= set(axis.search.library.base)
        for effect in axis.acting(named).effects:
            names |= set(axis.search.library.find(effect).parameters)
    return names


def left_out_error(axes: Sequence[AxisDiagnosis], named: Collection[str]) -> float:
    """rad: mean absolute error in stretches of time that were left out of the fit, over axes with these effects."""
    return float(np.mean([axis.held_out_error([c.name for c in axis.own(named)]) for axis in axes]))


def axis_verdict(axis: AxisDiagnosis, name: str, named: Collection[str]) -> AxisVerdict:
    """The verdict on one axis by itself, with these effects named.

    Args:
        name: of the axis, one of those that were judged together.
    """
    ranking, after = axis.parts.get(name, axis.ranking), axis.acting(named)
    own = {c.name for c in axis.search.library.candidates if axis.part.axes == (name,) or name in c.axes}
    here = [r for r in ranking.ranked if own & set(r.effects)]
    return AxisVerdict(
        marginals={effect: itself(p) for effect, p in ranking.marginals.items() if effect in own},
        none=sum(r.probability for r in ranking.ranked if not own & set(r.effects)),
        unknown=ranking.unknown,
        explained={r.name: (r.explained, *r.explained_interval) for r in here},
        remaining={s: left for s, left in axis.remaining(after).items() if s in axis.signals_of(name)},
        floors=(axis.floors(axis.base, name), axis.floors(after, name)),
        not_converged=tuple(" + ".join(r.effects) for r in axis.refits
                            if own & set(r.effects) and not r.converged),
        ranking=tuple(replace(r, probability=r.itself)
                      for r in ranking.ranked if r in here or not r.effects),
    )  # fmt: skip
