# SPDX-License-Identifier: Apache-2.0
"""One joint of an arm by itself: the joints that it is coupled with move as they were measured.

What acts between joints depends on how they move, and that was measured. So each joint can have a search of its own,
with its own values and effects only, and what one joint lacks does not disturb the others.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import BSpline, CubicSpline, make_smoothing_spline

from eps_tunnel_analysis.diagnose.evidence import Evidence, play_evidence
from eps_tunnel_analysis.simulated import Play
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

    A measured motion is what the model says of it, and a smooth curve through what it misses: the model knows how a
    joint moves between samples, and the curve follows the recording wherever the model errs.
    """
    groups = (tuple(_positions(model, plays, group)) for group in coupled_axes(model))
    signals = {axis: signal for group in groups if len(group) > 1 for axis, signal in group}
    if not signals:
        return {}
    seen = [play_evidence(model, play, tuple(signals.values())) for play in plays]
    step = float(compiled(model, with_ball=False).mj.opt.timestep)
    evidence = Evidence(model, (), seen, tuple(signals.values()), step)
    missed = evidence(np.empty((1, 0)))[0]
    bare = model
    for use in model.effects:
        bare = bare.without_effect(use.effect.name, use.place) if use.effect.only_measures else bare
    motions: dict[str, list[Series]] = {axis: [] for axis in signals}
    for number in range(len(plays)):
        time = evidence.times(number)
        simulated = simulate_batch(
            bare, (), np.empty((1, 0)), time, evidence.commands[number][None], evidence.initial[number],
            per_command={name: given[[number]] for name, given in evidence.known.items()},
            resting=evidence.resting[number], signals=evidence.signals, timestep=evidence.step(number), means=True,
        ).values[0, 0]  # fmt: skip
        at = np.arange(0.0, time[-1] + GRID, GRID)
        for column, axis in enumerate(signals):
            here = evidence.blocks == number * len(signals) + column
            told = time, simulated[:, column]
            if not np.isfinite(missed[here]).all():  # the model diverges
                told, missed[here] = (time, np.zeros(len(time))), -evidence.mean[here]
            motions[axis].append(Series(at, _targets(*told, evidence.time[here], -missed[here], at + GRID / 2.0)))
    return motions


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


def _targets(time: Array, simulated: Array, stamps: Array, missing: Array, at: Array) -> Array:
    """Targets at times (n,) of a joint that moves as simulated (K,) at `time`, and by what is missing (b,) at `stamps`
    more, smoothed.
    """
    return command(*course(time, simulated, stamps, missing, at))


def course(time: Array, simulated: Array, stamps: Array, missing: Array, at: Array) -> Array:
    """(3, n) position, speed and acceleration at times (n,) of such a joint."""
    curves = CubicSpline(time, simulated), smooth(stamps, missing)
    inside, within = np.clip(at, time[0], time[-1]), np.clip(at, stamps[0], stamps[-1])
    return np.array([curves[0](inside, order) + curves[1](within, order) for order in range(3)])


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
