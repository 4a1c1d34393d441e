# SPDX-License-Identifier: Apache-2.0
"""The diagnosis: recordings and a model in, a verdict with its evidence out."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from eps_tunnel_analysis.compare import Comparison, compare
from eps_tunnel_analysis.diagnose.axis_diagnosis import AxisDiagnosis, diagnose_axis, floor_known
from eps_tunnel_analysis.diagnose.axis_search import AxisPart, Progress, axis_parts, ball_part
from eps_tunnel_analysis.diagnose.ball import BALL, sees_ball, split, without_ball
from eps_tunnel_analysis.diagnose.bases import fitted_bases
from eps_tunnel_analysis.diagnose.calibration import CALIBRATION
from eps_tunnel_analysis.diagnose.doubts import doubts
from eps_tunnel_analysis.diagnose.experiment import Experiment, next_experiment
from eps_tunnel_analysis.diagnose.rank import NONE, UNKNOWN, joint
from eps_tunnel_analysis.diagnose.refit import Refit
from eps_tunnel_analysis.diagnose.samples import kept_of
from eps_tunnel_analysis.diagnose.verdict import Errors, Verdict, decide, sentence
from eps_tunnel_analysis.plays import Play
from eps_tunnel_analysis.rollout import roll_out
from labyrinth_sim.errors import InputError
from labyrinth_sim.model import Model
from labyrinth_sim.rig import BALL_SIGNALS
from labyrinth_sim.trials import Array

KS = (1.0, 2.0, 3.0, 5.0)
SHORTEST = 0.05  # s, of a span outside the tunnel that is told
WORTH_TELLING = 0.2  # of an axis's misfit
MOVES = 1e-3  # rad; a command that spans less excites nothing


@dataclass(frozen=True)
class Diagnosis:
    """The verdict, the models and comparisons behind it, axis by axis.

    Attributes:
        base_model: the given model with its values refitted.
        model: the same with the named effects, fitted; the base model where none is named.
        experiment: what to play next where two hypotheses are left, else None.
    """

    verdict: Verdict
    axes: tuple[AxisDiagnosis, ...]
    base_model: Model
    model: Model
    given: Comparison
    before: Comparison
    after: Comparison
    experiment: Experiment | None


def diagnose(
    model: Model,
    plays: Sequence[Play],
    seed: int = 0,
    only: Sequence[str] | None = None,
    nthread: int = 0,
    told: Progress | None = None,
    experiments: bool = True,
    once: Mapping[str, float] | None = None,
    held: Sequence[Play] = (),
) -> Diagnosis:
    """Names what a model lacks.

    Args:
        model: as far as it is known; its drives' values need not be right.
        plays: recorded commands with their trials.
        seed: kept with the result; nothing is drawn at random.
        only: names of effects to consider; the whole library by default.
        once: axis -> mean square in units of the noise floor before effects were added in earlier steps.
        held: plays that are never fitted, for the held-out error; without them it is that of samples kept back.
        experiments: look for the experiment that decides, where the recordings do not.

    Raises:
        InputError: no axis with a measured position and a command that moves it, unknown effect names.
    """
    started = time.monotonic()
    on_axes, on_ball = split(only)
    rolls = bool(on_ball) and sees_ball(model, plays)
    alone = [without_ball(p) for p in plays]
    parts = axis_parts(model, alone)
    moved = [p for p in parts if is_moved(model, p, alone)]
    if not moved:
        raise InputError(
            "No recorded command moves an axis whose position is measured, so no effect can be seen. "
            "Play a sequence that moves every axis, config/sequences/excite_12s.yaml for one."
        )
    left, names = once or {}, on_axes if rolls else only
    bases = fitted_bases(model, alone, moved, names, nthread, told)
    axes = tuple(diagnose_axis(model, alone, p, names, nthread, told, left.get(p.axis, 0.0), bases) for p in moved)
    if rolls:
        # It rolls as the axes tilt, so it is judged with what is missing there added already.
        found = set(decide(_together(axes), CALIBRATION.coverage)[1])
        tilted = _with(model, axes, {a.part.axis: _refit_of(a, found) for a in axes})
        axes += (diagnose_axis(tilted, plays, ball_part(), on_ball, nthread, told, left.get(BALL, 0.0)),)
    probabilities = _together(axes)
    kind, named, stated = decide(probabilities, CALIBRATION.coverage)
    missing = {c.name: axis.base.overall for axis in axes for c in axis.search.library.candidates}
    named = tuple(sorted(named, key=lambda name: -missing[name]))
    base_model = _with(model, axes, {})
    chosen = set(named)
    final = _with(model, axes, {a.part.axis: _refit_of(a, chosen) for a in axes})
    given, before, after = (compared(m, plays if rolls else alone) for m in (model, base_model, final))
    judged = [compared(m, held if rolls else [without_ball(p) for p in held]) for m in (model, base_model, final)]
    doubted = [d for a in axes[: len(moved)] if kind == "unknown" and _unexplained(a)
               for d in doubts(bases.among(model, a.part.axis), alone, a, nthread, told)]  # fmt: skip
    experiment = None
    if experiments and kind == "undecided":
        experiment = next_experiment(axes[: len(moved)], base_model, stated, floor_known(plays))
    evaluations = bases.evaluations + sum(axis.search.evaluations for axis in axes)
    verdict = Verdict(
        verdict=kind,
        effects=named,
        set=probabilities,
        stated=stated,
        coverage=CALIBRATION.coverage,
        sentence=sentence(kind, named, stated, probabilities, floor_known(plays), _partly(axes)),
        where=tuple(s for c in before for s in c.spans if s.end - s.start >= SHORTEST),
        given=errors_of(given, judged[0]),
        before=errors_of(before, judged[1]),
        after=errors_of(after, judged[2]),
        ball=tuple(errors_of(c, h, "m") for c, h in zip((given, before, after), judged, strict=True)) if rolls else (),
        floor={a.part.axis: (a.base.overall, _refit_of(a, chosen).overall) for a in axes},
        ranking={a.part.axis: a.ranking for a in axes},
        values={n: v for n, v in final.values().items() if n in _fitted(axes, chosen)},
        seed=seed,
        evaluations=evaluations,
        seconds=time.monotonic() - started,
        next_experiment=experiment.name if experiment else None,
        notes=(*(d.sentence for d in doubted), *_notes(model, parts, moved, plays, axes[: len(moved)])),
    )
    return Diagnosis(verdict, axes, base_model, final, given[0], before[0], after[0], experiment)


def _together(axes: Sequence[AxisDiagnosis]) -> dict[str, float]:
    """Probabilities of what is missing on all axes.

    Where one axis lacks an effect, uneven timing alone makes no unknown of the others; a sentence tells it.
    """
    likely = [max(axis.probabilities, key=lambda name: axis.probabilities[name]) for axis in axes]
    named = any(name not in (NONE, UNKNOWN) for name in likely)
    return joint([axis.timed if named else axis.probabilities for axis in axes])


def _unexplained(axis: AxisDiagnosis) -> bool:
    """Whether more is left on an axis than noise."""
    return axis.best.overall > CALIBRATION.gate


def _partly(axes: Sequence[AxisDiagnosis]) -> dict[str, float]:
    """For each axis that lacks something: the likeliest effects, and which share of its misfit they take away."""
    found = {}
    for axis in (a for a in axes if a.base.overall > CALIBRATION.gate):
        most = next((ranked for ranked in axis.ranking if ranked.effects), None)
        if most and most.explained >= WORTH_TELLING:
            found[most.name] = most.explained
    return found


def _refit_of(axis: AxisDiagnosis, named: set[str]) -> Refit:
    """The refit whose effects are those named on this axis; the base where none is."""
    mine = {c.name for c in axis.search.library.candidates} & named
    return next((r for r in axis.refits if set(r.effects) == mine), axis.base) if mine else axis.base


def _with(model: Model, axes: Sequence[AxisDiagnosis], refits: Mapping[str, Refit]) -> Model:
    """A model with the refits' effects and values; an axis without one gets its base's values."""
    for axis in axes:
        refit = refits.get(axis.part.axis, axis.base)
        library = axis.search.library
        values = dict(zip(library.names, (float(v) for v in refit.values), strict=True))
        for name in refit.effects:
            candidate = library.find(name)
            model = model.with_effect(candidate.effect, candidate.place)
            model = model.with_values({p: values[p] for p in candidate.parameters}, "diagnosis")
        model = model.with_values({p: values[p] for p in library.base}, "diagnosis")
    return model


def _fitted(axes: Sequence[AxisDiagnosis], named: set[str]) -> set[str]:
    names: set[str] = set()
    for axis in axes:
        names |= set(axis.search.library.base)
        for effect in _refit_of(axis, named).effects:
            names |= set(axis.search.library.find(effect).parameters)
    return names


def is_moved(model: Model, part: AxisPart, plays: Sequence[Play]) -> bool:
    """Whether a recorded command moves an axis."""
    channel = next(axis.command for axis in model.rig.axes if axis.name == part.axis)
    spans = [np.ptp(c[np.isfinite(c)]) if np.isfinite(c).any() else 0.0 for c in (_commands(p, channel) for p in plays)]
    return max(spans) > MOVES


def _commands(play: Play, channel: str) -> Array:
    return np.asarray(play.trials.commands[:, :, play.trials.command_channels.index(channel)])


def compared(model: Model, plays: Sequence[Play]) -> list[Comparison]:
    """A model against each play, positions only, the ball's where it was seen, at the rig's own step."""
    found = []
    for play in plays:
        positions = [m.signal for m in model.rig.measured if m.quantity == "position"]
        positions += BALL_SIGNALS if sees_ball(model, [play]) else ()
        names = [name for name in positions if name in play.trials.signals]
        set_so = model.with_values(dict(play.known), "known of the recording")
        found.append(compare(play.trials.select(names), roll_out(set_so, play.trials).select(names), KS))
    return found


def errors_of(comparisons: Sequence[Comparison], held: Sequence[Comparison] = (), unit: str = "rad") -> Errors:
    """Means over plays and signals in this unit; the held-out error over plays that were never fitted, if there are
    any.
    """
    errors = [e.command_error for c in comparisons for e in c.errors if e.unit == unit]
    kept = []
    for c in held or comparisons:
        off = np.abs(c.sim_tunnel.mean - c.real_tunnel.mean)
        off[:, [u != unit for u in c.real.units]] = np.nan
        kept.append(np.nanmean(off if held else off[kept_of(len(c.real.time), c.real.step)]))
    joint_share = float(np.mean([c.alikeness[0].joint for c in comparisons]))
    return Errors(float(np.nanmean(errors)), float(np.nanmean(kept)), joint_share)


def _notes(
    model: Model,
    parts: Sequence[AxisPart],
    moved: Sequence[AxisPart],
    plays: Sequence[Play],
    axes: Sequence[AxisDiagnosis],
) -> tuple[str, ...]:
    notes = []
    if any(play.trials.count == 1 for play in plays):
        notes.append(
            "One trial only: what the rig repeats is unknown, so effects are weighed against one another, one at a "
            "time, and whether something unknown is left cannot be said. Record five trials."
        )
    for part in parts:
        if part not in moved:
            notes.append(f"No command moves axis {part.axis}: none of its effects can be seen. Play excite_12s.")
    filmed = any(s in play.trials.signals for s in BALL_SIGNALS for play in plays)
    if model.rig.ball and filmed and not sees_ball(model, plays):
        notes.append("The ball was not seen where each recording begins, so its effects were not considered.")
    notes += [odd.sentence for axis in axes for odd in axis.odd]
    for axis in axes:
        torque = {m.signal for m in model.rig.measured if m.quantity == "torque"}
        if not torque & set(axis.part.signals):
            notes.append(
                f"Axis {axis.part.axis} has no recorded effort: friction under a stiff drive and dead band look alike."
            )
        measured = next(a for a in model.rig.axes if a.name == axis.part.axis).measured
        positions = [m for m in measured if m.quantity == "position"]
        seen = {m.joint for m in positions if m.signal in axis.part.signals}
        if len(seen) < len({m.joint for m in positions}):
            notes.append(f"Axis {axis.part.axis} has one position only: what lies between motor and load is guesswork.")
    return tuple(notes)
