# SPDX-License-Identifier: Apache-2.0
"""One joint of an arm by itself: the joints that it is coupled with move as they were measured.

What acts between joints depends on how they move, and that was measured. So each joint can have a search of its own,
with its own values and effects only, and what one joint lacks does not disturb the others.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import BSpline, CubicSpline, make_smoothing_spline

from eps_tunnel_analysis.diagnose.evidence import Evidence, play_evidence
from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.stamped import Series, aligned
from labyrinth_sim.build import compiled, coupled_axes
from labyrinth_sim.model import Model
from labyrinth_sim.prescribed import command, with_prescribed
from labyrinth_sim.simulate import simulate_batch
from labyrinth_sim.trials import Array

GRID = 0.001  # s, on which a prescribed motion is told
SMOOTHING = np.geomspace(1e-9, 1e2, 12)  # penalties of a curve's bending that are tried
ENOUGH = 12  # measurements of which a smooth curve can be chosen

Motions = Mapping[str, Sequence[Series]]
"""Axis -> for each play the targets, rad, under which it moves as it was measured."""


def measured_motions(model: Model, plays: Sequence[Play]) -> Motions:
    """The motions of the joints that inertia couples, as they were measured; of those whose position was.

    See `Course`.
    """
    groups = (tuple(_positions(model, plays, group)) for group in coupled_axes(model))
    signals = {axis: signal for group in groups if len(group) > 1 for axis, signal in group}
    if not signals:
        return {}
    seen = [play_evidence(model, play, tuple(signals.values())) for play in plays]
    step = float(compiled(model, with_ball=False).mj.opt.timestep)
    evidence = Evidence(model, (), seen, tuple(signals.values()), step)
    found = measured_courses(evidence, np.empty(0), tuple(signals.values()))
    return {axis: [_told(course) for course in found[signal]] for axis, signal in signals.items()}


@dataclass(frozen=True)
class Course:
    """The motion of a joint in one play, as it was measured: what the model says of it, and a smooth curve through what
    it misses. The model knows how a joint moves between samples, and the curve follows the recording wherever the model
    errs.

    Attributes:
        time, simulated: (K,) s and what the model says.
        stamps, missing: (b,) s and what it misses.
    """

    time: Array
    simulated: Array
    stamps: Array
    missing: Array

    @cached_property
    def grid(self) -> Array:
        """(n,) s, every GRID to its end."""
        return np.arange(0.0, self.time[-1] + GRID, GRID)

    def at(self, times: Array) -> Array:
        """(3, n) position, speed and acceleration at times (n,)."""
        curves = CubicSpline(self.time, self.simulated), smooth(self.stamps, self.missing)
        inside = np.clip(times, self.time[0], self.time[-1])
        within = np.clip(times, self.stamps[0], self.stamps[-1])
        return np.array([curves[0](inside, order) + curves[1](within, order) for order in range(3)])


def measured_courses(evidence: Evidence, values: Array, signals: Collection[str]) -> dict[str, list[Course]]:
    """For each of these signals of the evidence, the course in each play, with free values (k,) of its model."""
    bare = evidence.model
    for use in bare.effects:
        bare = bare.without_effect(use.effect.name, use.place) if use.effect.only_measures else bare
    kept = [i for i, name in enumerate(evidence.free) if name in bare.values()]
    known = {name: given for name, given in evidence.known.items() if name in bare.values()}
    missed = evidence(values[None])[0]
    courses: dict[str, list[Course]] = {signal: [] for signal in signals}
    for number in range(len(evidence.plays)):
        time = evidence.times(number)
        simulated = simulate_batch(
            bare, [evidence.free[i] for i in kept], values[None, kept], time, evidence.commands[number][None],
            evidence.initial[number], per_command={name: given[[number]] for name, given in known.items()},
            resting=evidence.resting[number], signals=evidence.signals, timestep=evidence.step(number), parts=1,
        ).values[0, 0]  # fmt: skip
        for signal in signals:
            column = evidence.signals.index(signal)
            here = evidence.blocks == number * len(evidence.signals) + column
            told, missing = simulated[:, column], -missed[here]
            if not np.isfinite(missing).all():  # the model diverges
                told, missing = np.zeros(len(time)), evidence.mean[here]
            courses[signal].append(Course(time, told, evidence.time[here], missing))
    return courses


def with_prescribed_motion(
    model: Model, plays: Sequence[Play], motions: Motions, axes: Collection[str]
) -> tuple[Model, list[Play]]:
    """The model in which those of these axes that have a motion follow it, and the plays that tell them so.

    In a play the motion takes the place of the axis's command, and what is known of the axis's drive is left out.
    """
    followed = [axis for axis in model.rig.axes if axis.name in axes and axis.name in motions]
    if not followed:
        return model, list(plays)
    alone = with_prescribed(model, [axis.name for axis in followed])
    left = alone.parameters()
    told = []
    for number, play in enumerate(plays):
        targets = {axis.command: motions[axis.name][number] for axis in followed}
        stamped = tuple(replace(t, commands={**t.commands, **targets}) for t in aligned(play.at_stamps))
        known = {name: value for name, value in play.known.items() if name in left}
        told.append(replace(play, stamped=stamped, known=known))
    return alone, told


def coupled_with(model: Model, axes: Collection[str]) -> tuple[str, ...]:
    """The axes that inertia couples with any of these, without these."""
    return tuple(n for group in coupled_axes(model) if set(group) & set(axes) for n in group if n not in axes)


def _told(course: Course) -> Series:
    """The targets of a joint that moves like that."""
    return Series(course.grid, command(*course.at(course.grid + GRID / 2.0)))


def smooth(time: Array, values: Array) -> BSpline:
    """A smooth curve through values (b,) at `time`, s: of splines that bend more or less, the one that tells best every
    other value from the rest.
    """
    if len(time) < ENOUGH:
        return BSpline(np.repeat([time[0], time[-1]], 4), np.full(4, float(np.mean(values))), 3)
    halves = (slice(0, None, 2), slice(1, None, 2))
    missed = [
        sum(float(np.sum((make_smoothing_spline(time[a], values[a], lam=lam)(time[b]) - values[b]) ** 2))
            for a, b in (halves, halves[::-1]))
        for lam in SMOOTHING
    ]  # fmt: skip
    return make_smoothing_spline(time, values, lam=2.0 * SMOOTHING[int(np.argmin(missed))])


def _positions(model: Model, plays: Sequence[Play], names: Collection[str]) -> list[tuple[str, str]]:
    """Each of these axes without a belt whose position all plays have, with its finest signal."""
    found = []
    for axis in (a for a in model.rig.axes if a.name in names and a.joint == a.load):
        own = [m.signal for m in axis.finest_first if m.quantity == "position"]
        shared = [s for s in own if all(s in play.trials.signals for play in plays)]
        found += [(axis.name, shared[0])] if shared else []
    return found
