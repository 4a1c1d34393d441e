# SPDX-License-Identifier: Apache-2.0
"""Adding effects to a model: the refits of a diagnosis, or of one that considers nothing else."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from eps_tunnel_analysis.diagnose.axes import Diagnosis, left_out_error, with_refits
from eps_tunnel_analysis.diagnose.axis import AxisDiagnosis, hypothesis
from eps_tunnel_analysis.diagnose.ball import BALL, without_ball
from eps_tunnel_analysis.diagnose.candidates import Candidate
from eps_tunnel_analysis.diagnose.contained import MISFITTED, ROUNDS, nested_refits
from eps_tunnel_analysis.diagnose.diagnose import diagnose
from eps_tunnel_analysis.diagnose.errors import compared, errors_of, play_errors
from eps_tunnel_analysis.diagnose.falls import RecordingErrors, Three, by_recording, fall_sentences
from eps_tunnel_analysis.diagnose.named_intervals import intervals_json, named_intervals
from eps_tunnel_analysis.diagnose.progress import RolloutProgress
from eps_tunnel_analysis.diagnose.refits import Refit
from eps_tunnel_analysis.diagnose.verdict import Errors, PlayError
from eps_tunnel_analysis.fit.problem import AT_BOUND
from eps_tunnel_analysis.outputs import plain
from eps_tunnel_analysis.recorded_play import Play
from labyrinth_sim.errors import InputError, unknown_name
from labyrinth_sim.model import Model

STARTS = 6  # trial points that are descended


@dataclass(frozen=True)
class Addition:
    """A model with effects added.

    Attributes:
        effects: names, such as `backlash.x`; empty if only the values were refitted.
        model: with the effects, everything fitted.
        given, before, after: errors of the model as given, with its values refitted, and with the effects; the ball's,
            in m, if all of them act on it.
        plays: the error of each recording for the same three models, rad.
        values: what was fitted.
        intervals: their 95 % intervals, from `named_intervals`.
        doubts: values at their bounds and fits that have not converged, one sentence each.
        unit: of the errors.
        itself: alikeness, joint at k = 1, that the rig reaches against itself; NaN where unknown.
    """

    effects: tuple[str, ...]
    model: Model
    given: Errors
    before: Errors
    after: Errors
    plays: tuple[tuple[PlayError, ...], ...]
    values: Mapping[str, float]
    intervals: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    doubts: tuple[str, ...] = ()
    unit: str = "rad"
    itself: float = math.nan

    @property
    def errors(self) -> Three:
        """Of the model as given, with its values refitted, and with the effects."""
        return self.given, self.before, self.after

    @property
    def sentences(self) -> list[str]:
        """How the error changed, in the rig's unit or the ball's, and what is doubtful about the result."""
        ball = self.unit != self.model.rig.position_unit
        falls = fall_sentences(self.errors, self.plays, self.unit, self.itself, ball) if self.effects else []
        return [*falls, *self.doubts]

    @property
    def recordings(self) -> list[RecordingErrors]:
        """One entry per recording, in the rig's unit, worst change first."""
        return by_recording(self.plays, self.model.rig.position_unit)

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        names = ("as_given", "refitted", "with_effects")
        return {
            "given": asdict(self.given),
            "before": asdict(self.before),
            "after": asdict(self.after),
            "recordings": {n: [asdict(e) for e in of_one] for n, of_one in zip(names, self.plays, strict=True)},
            "rig_against_itself": plain(self.itself),
            "values": dict(self.values),
            "intervals": plain(intervals_json(self.intervals)),
            "doubts": list(self.doubts),
            "sentence": " ".join(self.sentences),
        }


def add_effects(
    model: Model,
    plays: Sequence[Play],
    names: Sequence[str],
    nthread: int = 0,
    progress: RolloutProgress | None = None,
    held: Sequence[Play] = (),
) -> Addition:
    """Adds effects by name (`backlash.x`), fitted as in a diagnosis that considers nothing else.

    Args:
        progress: called with the current step and the number of roll-outs so far.
        held: plays that are never fitted, for the held-out error.

    Raises:
        InputError: unknown names or places, effects that the model has, or an axis that was not measured or not moved.
    """
    model.registry.check(names)
    valid = [f"{effect.name}.{place}" for effect in model.registry.effects.values() for place in model.places(effect)]
    present = [f"{use.effect.name}.{use.place}" for use in model.effects]
    complaints = [unknown_name("effect and place", n, valid) for n in names if n not in valid]
    complaints += [f"{n} is in the model already; `calibrate` fits its values." for n in names if n in present]
    if complaints:
        raise InputError(complaints)
    diagnosis = diagnose(
        model, plays, only=tuple(names), nthread=nthread, progress=progress, experiments=False, held=held
    )
    return addition_of(diagnosis, names, plays, held)


def addition_of(
    diagnosis: Diagnosis, names: Collection[str], plays: Sequence[Play], held: Sequence[Play] = ()
) -> Addition:
    """Adds effects that a diagnosis of these plays considered, with its own refits, so that both agree.

    Args:
        names: of effects; none for the values alone.

    Raises:
        InputError: the diagnosis did not consider one of them.
    """
    considered = [c.name for axis in diagnosis.axes for c in axis.search.library.candidates]
    missing = [n for n in names if n not in considered]
    if missing:
        raise InputError([f"{n}: no recorded command moves anything that was measured there." for n in missing])
    v, chosen = diagnosis.verdict, set(names)
    axes = [_with_set(axis, chosen) for axis in diagnosis.axes]
    on_axes = [axis for axis in axes if axis.part.axes != (BALL,)]
    rolls = bool(v.ball and chosen) and not any(axis.own(chosen) for axis in on_axes)
    unit = "m" if rolls else diagnosis.model.rig.position_unit
    if chosen == set(v.effects):
        final, after, last = diagnosis.model, v.ball[2] if rolls else v.after, v.plays[2]
    else:
        final = with_refits(diagnosis.base_model, axes, chosen, final=True)
        near, far = (compared(final, p if v.ball else [without_ball(q) for q in p]) for p in (plays, held))
        after = errors_of(near, far, None if rolls else left_out_error(on_axes, chosen), unit)
        (last,) = play_errors(plays, held, [near], [far], diagnosis.model.rig.position_unit)
    given, before = v.ball[:2] if rolls else (v.given, v.before)
    values = final.values()
    fitted = [n for axis in axes for n in (*axis.part.base, *(p for c in axis.own(chosen) for p in c.parameters))]
    doubts = tuple(text for axis in axes for text in _doubts(axis, chosen, values))
    return Addition(
        tuple(names), final, given, before, after, (*v.plays[:2], last), {n: values[n] for n in fitted},
        named_intervals(axes, chosen, final), doubts, unit, v.rig_against_itself,
    )  # fmt: skip


def _with_set(axis: AxisDiagnosis, names: Collection[str]) -> AxisDiagnosis:
    """The axis with a refit of these effects, and its predictions for stretches of time that were left out."""
    own = axis.own(names)
    refit = axis.acting(names)
    if set(refit.effects) != {c.name for c in own}:
        refit = _fitted(axis, own)
        axis = replace(axis, refits=(*axis.refits, refit))
    if any(set(h.refit.effects) == set(refit.effects) for h in axis.hypotheses):
        return axis
    return replace(axis, hypotheses=(*axis.hypotheses, hypothesis(axis.search, refit)))


def _fitted(axis: AxisDiagnosis, candidates: Sequence[Candidate]) -> Refit:
    """Fits a set that the search did not try: one effect after the other, on top of the best subset that it tried."""
    search, names = axis.search, {c.name for c in candidates}
    best = min((r for r in (axis.base, *axis.refits) if set(r.effects) <= names), key=lambda r: r.cost)
    before = best
    for candidate in (c for c in candidates if c.name not in best.effects):
        search.settle_at(best)
        on = search.library.of(best.effects)
        points = search.trial_points([best], [candidate])[:STARTS]
        best = search.best_of([((*on, candidate), point.values) for point in points], ROUNDS)[0]
    if best.cost <= MISFITTED * before.cost:
        return best
    _, again = nested_refits(search, axis.base, [r for r in (before, best) if r.effects])
    return next(r for r in again if set(r.effects) == names)


def _doubts(axis: AxisDiagnosis, names: Collection[str], fitted: Mapping[str, float]) -> list[str]:
    """Doubts about the fitted values of these effects on one axis."""
    search, own = axis.search, axis.own(names)
    refit = axis.acting(names)
    columns = np.array(search.fitted(refit), dtype=int)
    values = np.array([fitted[search.library.names[i]] for i in columns])
    near = search.at_bound(values, columns)
    # A drive's value that stays as stated is not worth a message; an effect's that stays switched off is.
    kept = np.abs(values - search.start[columns]) < AT_BOUND * search.spans[columns]
    near &= ~kept | (columns >= len(search.library.base))
    sentences = [
        f"{search.library.names[i]} lies at its bound, {value:.4g}: the truth may lie beyond, or it stands "
        "in for something else."
        for i, value in zip(columns[near], values[near], strict=True)
    ]
    if own and not refit.converged:
        sentences.append(f"The fit of {' + '.join(refit.effects)} has not converged: other values may fit better.")
    return sentences
