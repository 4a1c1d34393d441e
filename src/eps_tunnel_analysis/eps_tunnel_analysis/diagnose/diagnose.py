# SPDX-License-Identifier: Apache-2.0
"""The diagnosis: recordings and a model in, a verdict with its evidence out. docs/diagnosis.md has the same steps."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace

from eps_tunnel_analysis.diagnose.axes import (
    Diagnosis,
    axis_verdict,
    diagnosed,
    fit_names,
    left_out_error,
    together,
    with_refits,
)
from eps_tunnel_analysis.diagnose.axis import diagnose_axis, floor_known
from eps_tunnel_analysis.diagnose.axis_search import (
    SearchOptions,
    axis_parts,
    ball_part,
    joined,
    moved_parts,
)
from eps_tunnel_analysis.diagnose.ball import sees_ball, split, without_ball
from eps_tunnel_analysis.diagnose.base_values import Bases, fitted_bases, stated_bases
from eps_tunnel_analysis.diagnose.doubts import doubts, notes_of
from eps_tunnel_analysis.diagnose.errors import distances
from eps_tunnel_analysis.diagnose.experiment import next_experiment
from eps_tunnel_analysis.diagnose.progress import RolloutCount, RolloutProgress, expected_rollouts
from eps_tunnel_analysis.diagnose.rank import with_imitated
from eps_tunnel_analysis.diagnose.settings import SETTINGS
from eps_tunnel_analysis.diagnose.verdict import Verdict, decide, sentence
from eps_tunnel_analysis.fit.cluster import Spread
from eps_tunnel_analysis.recorded_play import Play
from labyrinth_sim.model import Model


def diagnose(
    model: Model,
    plays: Sequence[Play],
    seed: int = 0,
    only: Sequence[str] | None = None,
    nthread: int = 0,
    progress: RolloutProgress | None = None,
    experiments: bool = True,
    levels: Mapping[str, float] | None = None,
    held: Sequence[Play] = (),
    spread: Spread | None = None,
    exhaustive: bool = False,
    fitted: bool = False,
) -> Diagnosis:
    """Names what a model lacks.

    Args:
        model: as far as it is known; its drives' values need not be right.
        plays: recorded commands with their trials.
        seed: stored with the result; no random draw depends on it.
        only: names of effects to consider; the whole library by default.
        progress: called with the current step, the roll-outs so far, and about how many there will be.
        levels: axis -> mean square in units of the noise floor before effects were added in earlier steps.
        held: plays that are never fitted, for the held-out error; without them stretches of time are left out in turn.
        experiments: look for an experiment that decides, if the recordings do not.
        spread: runs roll-outs elsewhere, such as from `fit.cluster.cluster`; the answer does not depend on it.
        exhaustive: without shortcuts: every effect is descended, and none given up before its descent has ended.
        fitted: the model's values were fitted to these plays before; the search starts there.

    Raises:
        InputError: no axis with a measured position and a command that moves it, unknown effect names.
    """
    started = time.monotonic()
    on_axes, on_ball = split(only, model.registry.effects)
    rolls = bool(on_ball) and sees_ball(model, plays)
    alone = [without_ball(p) for p in plays]
    parts = axis_parts(model, alone)
    moved = moved_parts(model, parts, alone)
    effects = len(on_axes) if only is not None else len(model.registry.effects)
    count = RolloutCount(progress, expected_rollouts([(len(p.base), effects) for p in moved])) if progress else None
    run = SearchOptions(tuple(on_axes) if only is not None else None, nthread, count, spread, exhaustive,
                        fitted and not exhaustive)  # fmt: skip

    # Each axis by itself, two coupled ones together.
    groups = joined(model, moved, run.only)
    bases = Bases()
    if run.fitted:
        bases = stated_bases(model, alone, moved)
    elif len(parts) > 1:
        bases = fitted_bases(model, alone, moved, run, roughly=True)
    axes = diagnosed(model, alone, groups, run, levels, bases)
    judged = len(axes)
    if rolls:
        # It rolls as the axes tilt, so it is judged with the axes' missing effects already added.
        tilted = with_refits(model, axes, set(decide(together(axes), SETTINGS.coverage)[1]))
        own = replace(run, only=tuple(on_ball))
        axes.append(diagnose_axis(tilted, plays, ball_part(), own, ball_part().level(levels)))

    # What is missing in all, and the models with and without it.
    probabilities = together(axes)
    kind, named, stated = decide(probabilities, SETTINGS.coverage)
    beliefs = with_imitated(probabilities)
    missing = {c.name: axis.base.cost for axis in axes for c in axis.search.library.candidates}
    named = tuple(sorted(named, key=lambda name: -missing[name]))
    # Where something unknown is missing, the lowest valley would only imitate it best.
    # The values of a model that was fitted before, and lacks nothing, come from the lowest one.
    final = with_refits(model, axes, named, final=kind == "effect" or (kind == "complete" and not run.fitted))
    base_model = with_refits(model, axes, ()) if named else final

    # How far each is from the recordings.
    shown, kept = (plays, held) if rolls else (alone, [without_ball(p) for p in held])
    left_out = (None, *(left_out_error(axes[:judged], names) for names in ((), named)))
    far = distances((model, base_model, final), shown, kept, left_out)

    # What to do next.
    doubted = [d for a in axes[:judged] if kind == "unknown" and a.best.cost > SETTINGS.healthy
               for d in doubts(*bases.among(model, alone, a.part), a, run)]  # fmt: skip
    experiment = None
    if experiments and kind == "undecided":
        experiment = next_experiment(axes[:judged], base_model, stated, floor_known(plays))
    verdicts = {name: axis_verdict(a, name, named) for a in axes for name in a.part.axes}
    verdict = Verdict(
        verdict=kind,
        effects=named,
        set=beliefs,
        stated=stated,
        coverage=SETTINGS.coverage,
        sentence=sentence(kind, named, stated, beliefs, verdicts, model.registry, floor_known(plays)),
        where=far.where,
        given=far.errors[0],
        before=far.errors[1],
        after=far.errors[2],
        ball=far.ball,
        plays=far.plays,
        rig_against_itself=far.rig_against_itself,
        axes=verdicts,
        values={n: v for n, v in final.values().items() if n in fit_names(axes, named)},
        seed=seed,
        evaluations=bases.evaluations + sum(axis.search.evaluations for axis in axes),
        seconds=time.monotonic() - started,
        next_experiment=experiment.name if experiment else None,
        notes=(*(d.sentence for d in doubted), *notes_of(model, parts, moved, plays, axes[:judged])),
    )
    first = [comparisons[0] for comparisons in far.near]
    return Diagnosis(verdict, tuple(axes), base_model, final, first[0], first[1], first[2], experiment)
