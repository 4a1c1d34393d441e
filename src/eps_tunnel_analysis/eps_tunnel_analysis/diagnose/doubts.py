# SPDX-License-Identifier: Apache-2.0
"""Stated values that a diagnosis assumes to be right: which of them, if wrong, would explain what no effect does.

A score test shows which are worth a refit: how much of the misfit vanishes along each value's slope, or at twice and
half the value, beyond what the base values explain. Also notes on what a diagnosis could not know from the recordings.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from eps_tunnel_analysis.diagnose.axis import AxisDiagnosis
from eps_tunnel_analysis.diagnose.axis_search import AxisPart, SearchOptions, axis_search
from eps_tunnel_analysis.diagnose.ball import sees_ball
from eps_tunnel_analysis.diagnose.base_values import base_from
from eps_tunnel_analysis.diagnose.contained import contained
from eps_tunnel_analysis.diagnose.rank import name_of
from eps_tunnel_analysis.diagnose.sets import explains
from eps_tunnel_analysis.diagnose.settings import SETTINGS
from eps_tunnel_analysis.diagnose.verdict import in_words
from eps_tunnel_analysis.fit.differences import directions
from eps_tunnel_analysis.fit.problem import by_axis
from eps_tunnel_analysis.outputs import shown_number, shown_times
from eps_tunnel_analysis.recorded_play import Play
from labyrinth_sim.model import Model
from labyrinth_sim.prescribed import prescribed
from labyrinth_sim.rig import BALL_SIGNALS

REFITTED = 2  # of the promising values, each alone
FARTHEST_START = 4.0  # times a stated value, at the start of its refit


@dataclass(frozen=True)
class Doubt:
    """A value that would explain more than any effect if it were different.

    Attributes:
        name, unit, source: of the parameter, as the model states it.
        given, fitted: the model's value, and the one that fits, in `unit`.
        before, after: mean square misfit in units of the noise floor, of the best effect and with this value fitted.
    """

    name: str
    unit: str
    source: str
    given: float
    fitted: float
    before: float
    after: float

    @property
    def sentence(self) -> str:
        """What to check, in words."""
        return (
            f"{self.name} is assumed to be right, {self.given:.3g} {self.unit} ({self.source}). If it were "
            f"{self.fitted:.3g}, {shown_times(self.after)} times the noise floor would be left, compared with "
            f"{shown_times(self.before)} with the best effect: check it."
        )


def doubts(model: Model, plays: Sequence[Play], axis: AxisDiagnosis, run: SearchOptions) -> list[Doubt]:
    """Values of one axis that explain what its effects do not, most likely first.

    Args:
        model: on which the axis was searched.
    """
    best, free = axis.best, len(axis.part.base) - axis.part.rough
    part = replace(axis.part, base=axis.part.base[:free], rough=0)
    known = {name for play in plays for name in play.known}
    stated = [n for n in model.parameters() if n not in part.base and n not in known]
    held = tuple(name for p in by_axis(model, stated, plays, None) if p.axis in part.axes for name in p.free)
    infos = model.parameters()
    doubted = []
    for name, value in _promising(model, plays, axis, part, held, run)[:REFITTED] if held else ():
        info = infos[name]
        search = axis_search(model, plays, _with(part, (name,)), replace(run, only=()))
        last = len(part.base)
        points = np.tile(search.start, (3, 1))
        points[:, :last] = axis.base.values[:last]
        if info.value > 0.0:
            value = min(max(value, info.value / FARTHEST_START), info.value * FARTHEST_START)
        points[:, last] = np.clip([value, 2.0 * info.value, 0.5 * info.value], info.low, info.high)
        refit = base_from(search, list(points))
        if refit.cost < SETTINGS.doubted * best.cost:
            fitted = float(refit.values[last])
            doubted.append(Doubt(name, info.unit, info.source, info.value, fitted, best.cost, refit.cost))
    return sorted(doubted, key=lambda d: d.after)


def _promising(
    model: Model, plays: Sequence[Play], axis: AxisDiagnosis, part: AxisPart, held: Sequence[str], run: SearchOptions
) -> list[tuple[str, float]]:
    """Names, each with its best value, to first order or of twice and half the given one; most promising first.

    For a limit the slope says little: where it acts, it may act all the time.
    """
    search = axis_search(model, plays, _with(part, held), replace(run, only=(), progress=None))
    size = len(part.base)
    values = search.within(search.start)  # a mass of 0 is stated as the smallest
    values[:size] = axis.base.values[:size]
    here = search.at(values, replace(axis.base, steps=None))
    steps = np.diagonal(search.moved(here) - values)
    slopes = search.changes(here)
    residuals = here.residuals
    basis = directions(slopes[:, :size])
    gains = []
    for column, (name, slope) in enumerate(zip(held, slopes[:, size:].T, strict=True), size):
        own = slope - basis @ (basis.T @ slope)
        along, towards = float(own @ own), -float(own @ residuals)
        if not np.isfinite(along) or along * towards == 0.0:
            continue
        wanted = values[column] + towards / along * steps[column]
        value = float(np.clip(wanted, search.low[column], search.high[column]))
        # The part of a parabola's fall that the bounds allow.
        went = (value - values[column]) / (wanted - values[column])
        gains.append(((2.0 - went) * went * towards**2 / along / float(residuals @ residuals), name, value))
    rest = float(np.sum((residuals - basis @ (basis.T @ residuals)) ** 2))
    for factor in (2.0, 0.5):
        for column, name in enumerate(held, size):
            point = values.copy()
            point[column] = np.clip(factor * values[column], search.low[column], search.high[column])
            answer = search.residuals(point[None])[0]
            if np.isfinite(answer).all():
                beyond = float(np.sum((answer - basis @ (basis.T @ answer)) ** 2))
                gains.append((1.0 - beyond / rest, name, float(point[column])))
    best = {name: (share, name, value) for share, name, value in sorted(gains)}
    return [(name, value) for share, name, value in sorted(best.values(), reverse=True) if share > SETTINGS.promising]


def _with(part: AxisPart, held: Sequence[str]) -> AxisPart:
    return replace(part, base=(*part.base, *held))


def notes_of(
    model: Model,
    parts: Sequence[AxisPart],
    moved: Sequence[AxisPart],
    plays: Sequence[Play],
    axes: Sequence[AxisDiagnosis],
) -> tuple[str, ...]:
    """What a diagnosis could not know from these recordings, one sentence each.

    Args:
        parts: every axis that was measured; `moved` those of them that a command moves.
        axes: what was found on these, without the ball.
    """
    notes = []
    if any(play.trials.count == 1 for play in plays):
        notes.append(
            "One trial only: how well the rig repeats is unknown, so effects are compared with one another, one at a "
            "time, and the remaining misfit only with the sensors' noise. Record five trials."
        )
    for part in parts:
        if part not in moved:
            notes.append(f"No command moves axis {part.name}: none of its effects can be seen. Play excite_12s.")
    filmed = any(s in play.trials.signals for s in BALL_SIGNALS for play in plays)
    if model.rig.ball and filmed and not sees_ball(model, plays):
        notes.append("The ball was not visible at the start of every recording, so its effects were not considered.")
    if any(prescribed(axis.search.library.model) for axis in axes):
        between = ", ".join(sorted(e.name for e in model.registry.effects.values() if e.couples and not e.nameless))
        notes.append(
            "Each joint was judged while those that it is coupled with moved as they were measured, so effects between "
            f"joints were not considered ({between}). Ask for one of them (--candidates) to judge the joints together."
        )
    notes += [odd.sentence for axis in axes for odd in axis.odd]
    for axis in axes:
        poor = [r.effects for r in axis.refits if r.effects and not r.converged and r.cost < 2.0 * axis.best.cost]
        if poor:
            names = ", ".join(" + ".join(effects) for effects in poor[:3])
            notes.append(f"{axis.part.heading}: the fit of {names} has not converged; its probability may be too low.")
        notes += _not_needed(axis)
        if axis.ranking.unknown_but:
            curve = in_words(axis.ranking.unknown_but, model.registry).replace("free curve: ", "")
            notes.append(
                f"One {curve}, as a free curve without a formula, explains more than any set of effects: they only "
                "imitate it."
            )
        for own in (model.rig.axis(name) for name in axis.part.axes):
            seen = [m for m in own.measured if m.signal in axis.part.signals]
            if all(m.quantity != "torque" for m in seen):
                notes.append(
                    f"Axis {own.name} has no recorded effort: friction under a stiff drive and dead band look alike."
                )
            joints = [{m.joint for m in some if m.quantity == "position"} for some in (seen, own.measured)]
            if len(joints[0]) < len(joints[1]):
                notes.append(f"Axis {own.name} has only one position: effects between motor and load are uncertain.")
    return tuple(notes)


def _not_needed(axis: AxisDiagnosis) -> Iterator[str]:
    """What the best set leaves and one of more effects would take away, if that is worth a look."""
    search, best = axis.search, axis.best
    larger = [r for r in axis.refits if best.effects and len(r.effects) > len(best.effects)
              and contained(search, r, best) is not None]  # fmt: skip
    more = min(larger, key=lambda r: r.cost, default=None)
    if more and explains(best, more):
        yield (
            f"{axis.part.heading}: {name_of(more.effects)} would leave {shown_number(more.cost)} of the "
            f"{shown_number(best.cost)} floors that remain with {name_of(best.effects)}. That may only make up for an "
            "error of its form, so it is not named. To add it all the same: eps-tunnel add-effect."
        )
