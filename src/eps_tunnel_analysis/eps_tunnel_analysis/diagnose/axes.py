# SPDX-License-Identifier: Apache-2.0
"""What all axes lack together: its probabilities, the models that have it, and what is said of each axis."""

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from eps_tunnel_analysis.diagnose.axis import AxisDiagnosis, diagnose_axis
from eps_tunnel_analysis.diagnose.axis_search import SearchOptions
from eps_tunnel_analysis.diagnose.base_values import Bases, dynamics_couple
from eps_tunnel_analysis.diagnose.rank import NONE, UNKNOWN, joint
from eps_tunnel_analysis.diagnose.verdict import AxisVerdict
from eps_tunnel_analysis.simulated import Play
from labyrinth_sim.model import Model


def together(axes: Sequence[AxisDiagnosis]) -> dict[str, float]:
    """Probabilities of what is missing on all axes.

    Where one axis lacks an effect, uneven timing alone makes no unknown of the others; a sentence tells it.
    """
    likely = [max(p, key=lambda name: p[name]) for p in (a.ranking.probabilities for a in axes)]
    named = any(name not in (NONE, UNKNOWN) for name in likely)
    return joint([(axis.even if named else axis.ranking).probabilities for axis in axes])


def with_refits(model: Model, axes: Sequence[AxisDiagnosis], named: Collection[str]) -> Model:
    """A model with these effects where they act, and with each axis's values fitted together with its own."""
    for axis in axes:
        refit, library = axis.acting(named), axis.search.library
        values = dict(zip(library.names, (float(v) for v in refit.values), strict=True))
        for name in refit.effects:
            candidate = library.find(name)
            model = model.with_effect(candidate.effect, candidate.place, candidate.given)
            model = model.with_values({p: values[p] for p in candidate.parameters}, "diagnosis")
        model = model.with_values({p: values[p] for p in library.base}, "diagnosis")
    return model


def beside_one_another(
    model: Model,
    plays: Sequence[Play],
    axes: Sequence[AxisDiagnosis],
    run: SearchOptions,
    levels: Mapping[str, float],
    bases: Bases,
) -> list[AxisDiagnosis]:
    """The axes, each one judged again beside what the others were found to lack, where they shake one another.

    What another axis lacks moves it otherwise, and that looks as if this one lacked something, too. Those that leave
    least come first, for they are likely to be healthy. `levels` and `bases` as for one axis.
    """
    found = list(axes)
    if len(found) < 2 or not dynamics_couple(model):
        return found
    for i in sorted(range(len(found)), key=lambda i: (found[i].base.cost, i)):
        others = [axis for axis in found if axis is not found[i]]
        lacking = {name for axis in others for name in axis.best.effects}
        own = found[i].part.axis
        if lacking and found[i].search.library.candidates:
            beside = with_refits(model, others, lacking)
            known = Bases({own: bases.values[own]}) if own in bases.values else Bases()
            again = diagnose_axis(beside, plays, found[i].part, run, levels.get(own, 0.0), known)
            again.search.evaluations += found[i].search.evaluations
            found[i] = again
    return found


def fitted_names(axes: Sequence[AxisDiagnosis], named: Collection[str]) -> set[str]:
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


def axis_verdict(axis: AxisDiagnosis, named: Collection[str]) -> AxisVerdict:
    """What is said of one axis by itself, with these effects named."""
    after = axis.acting(named)
    probabilities = axis.ranking.probabilities
    return AxisVerdict(
        marginals=axis.ranking.marginals,
        none=probabilities[NONE],
        unknown=probabilities[UNKNOWN],
        explained={r.name: (r.explained, *r.explained_interval) for r in axis.ranking.ranked if r.effects},
        remaining=axis.remaining(after),
        floors=(axis.base.cost, after.cost),
        not_converged=tuple(" + ".join(r.effects) for r in axis.refits if r.effects and not r.converged),
        ranking=axis.ranking.ranked,
    )
