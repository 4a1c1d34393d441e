# SPDX-License-Identifier: Apache-2.0
"""The force that a model lacks over time: added in the roll-out, it closes the gap to what was measured.

Forces at nodes 20 ms apart, linear between them, solve a least-squares problem in the residuals of positions and
efforts together, linearised about the roll-out; then again about the roll-out with the force found. Its bandwidth
is the smoothness that best predicts samples that were left out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.sparse import csr_array, diags_array

from eps_tunnel_analysis.diagnose.added_force import Motion, Playing
from eps_tunnel_analysis.diagnose.axis_search import AxisPart, SearchOptions, axis_search
from eps_tunnel_analysis.diagnose.rank import worst_floors
from eps_tunnel_analysis.diagnose.settings import SETTINGS
from eps_tunnel_analysis.fit.differences import steps_within
from eps_tunnel_analysis.recorded_play import Play
from labyrinth_sim.build import own_inertia
from labyrinth_sim.model import Model
from labyrinth_sim.trials import Array

SPACING = 0.02  # s between nodes
DECAYED = 1.5  # s after which a push is forgotten, so that one roll-out answers several
PUSH = 0.2  # of the drive's torque, root mean square: to see how the motion answers
LEAST_PUSH = 1e-4  # N m
NUDGE = 0.02  # of the range of angles: to see how the motion answers to its command
LEAST_NUDGE = 1e-4  # rad
SMOOTH = np.geomspace(1e-3, 1e3, 7)  # of the curvature's weight, tried
COLUMNS_AT_ONCE = 512  # columns of an inverse
LEFT_OUT = 4  # neighbouring samples, left out together
FOLDS = 2
SWINGS = 0.95  # of a joint's inertia, the most that may swing on it
PASSES = 6  # linearisations at most, and
AS_PROMISED = 0.1  # of the residuals' change by which a roll-out may differ from what its linearisation promised
DIFFERENCE = 1e-3  # of a value's span


@dataclass(frozen=True)
class PlayAnswer:
    """One play, linearised: R residuals in units of the noise floor, n nodes.

    Attributes:
        motion: of the axis, with the missing force added.
        nodes: (n,) s.
        residuals: (R,) that the model leaves without any force.
        answer: (R, n) by the force at each node, 1/(N m); few of them, because a push decays soon.
        base: (R, k) by the values that are also refitted, each in shares of its span.
        time: (R,) s; `signal` (R,) which of the compared; `fold` (R,) stretch of time.
        scale: (R,) the noise floor in the signal's unit.
        force, band: (n,) N m missing, and its standard deviation.
    """

    motion: Motion
    nodes: Array
    residuals: Array
    answer: csr_array
    base: Array
    time: Array
    signal: NDArray[np.int64]
    fold: NDArray[np.int64]
    scale: Array
    force: Array
    band: Array

    def at_nodes(self, values: Array) -> Array:
        """(n,) of a quantity over the motion's steps (K,)."""
        return np.interp(self.nodes, self.motion.time, values)

    def about_nodes(self, values: Array) -> Array:
        """(n, c) of quantities that jump, over the motion's steps (K, c): their mean about each node."""
        after, share = _places(self.motion.time, self.nodes)
        rows = np.tile(np.arange(len(share)), 2)
        weights = csr_array((np.concatenate([1.0 - share, share]), (np.concatenate([after - 1, after]), rows)),
                            shape=(len(self.nodes), len(share)))  # fmt: skip
        return np.asarray((weights @ values) / np.maximum(weights.sum(axis=1), 1e-9)[:, None])


@dataclass(frozen=True)
class MissingForce:
    """What one axis lacks.

    Attributes:
        axis: its name; `signals` those compared.
        unit: of the force.
        plays: one for each recording.
        smoothness: weight of the curvature that predicts left-out samples best.
        floors: mean square of the residuals in units of the noise floor, without the force and, as linearised, with it.
        worst: that of the worst signal without the force: others with a wide floor would hide it.
        side: of the axis that it acts on, "motor" or "load".
        unforced: the plays linearised about the model's own motion, without the force; `plays` by default.
        inertia: kg m^2 (kg where it slides), the most that may swing on the joint instead of moving with it.
        commanded: for each play (R, n) the answer of the residuals, about the model's own motion, to an offset of the
            command at each node, 1/rad; empty unless asked for.
    """

    axis: str
    signals: tuple[str, ...]
    unit: str
    plays: tuple[PlayAnswer, ...]
    smoothness: float
    floors: tuple[float, float]
    worst: float = float("nan")
    side: str = "motor"
    unforced: tuple[PlayAnswer, ...] = field(default=(), repr=False)
    commanded: tuple[csr_array, ...] = field(default=(), repr=False)
    inertia: float = float("inf")

    def __post_init__(self) -> None:
        if not self.unforced:
            object.__setattr__(self, "unforced", self.plays)

    @property
    def size(self) -> float:
        """Root mean square of the force, in its unit."""
        return float(np.sqrt(np.mean(np.concatenate([p.force for p in self.plays]) ** 2)))


def missing_force(
    model: Model, plays: Sequence[Play], part: AxisPart, nthread: int = 0, passes: int = PASSES, at_load: bool = False,
    commanded: bool = False,
) -> MissingForce:  # fmt: skip
    """The force that one axis lacks.

    Args:
        model: refitted.
        plays: recorded.
        part: of the axis: what is compared, and the values that may also move.
        passes: linearisations at most; each is about the force of the last, or part of the way to it if a roll-out with
            that force leaves more.
        at_load: whether the force acts behind the belt, on the load's joint.
        commanded: whether to find out how the axis answers to offsets of its command, too.
    """
    search = axis_search(model, plays, part, SearchOptions((), nthread))
    folds = search.evidence.fold(SETTINGS.block)
    playing = Playing(model, plays, part.name, part.signals, part.base, at_load, nthread)
    sizes = [sum(len(n.time) for n in p.noise) for p in playing.plays]
    owner = np.repeat(np.arange(len(sizes)), sizes)
    first = np.concatenate([[0], np.cumsum(sizes)])
    forces = [np.zeros(playing.count(p)) for p in range(len(plays))]
    nodes_of = [_nodes(playing.evidence[p].times(0)) for p in range(len(plays))]
    samples_of = [owner[search.used] == p for p in range(len(plays))]
    smoothness, least, share = 1.0, np.inf, 1.0
    accepted = target = forces
    answers: list[PlayAnswer] = []
    unforced: tuple[PlayAnswer, ...] = ()
    for _ in range(passes):
        parts = [
            _linearised(
                playing, p, forces[p], nodes_of[p], search.used[own] - first[p], search.scale[own], search.spans
            )
            for p, own in enumerate(samples_of)
        ]
        rolled_out = np.concatenate([about.rolled_out for about in parts])
        cost = float(np.mean(rolled_out**2))
        if not unforced:
            smoothness = _bandwidth([(about.residuals, about.answer) for about in parts])
        elif not cost < least:  # a step too far for the linearisation that it came from
            share *= 0.5
            forces = [old + share * (new - old) for old, new in zip(accepted, target, strict=True)]
            continue
        elif _settled(answers, rolled_out):
            break
        least, share, accepted = cost, 1.0, forces
        answers, target = [], []
        for p, about in enumerate(parts):
            own = samples_of[p]
            force, band = _smoothed(about.residuals, about.answer, smoothness)
            target.append(np.interp(playing.evidence[p].times(0), about.nodes, force))
            answers.append(
                PlayAnswer(
                    about.motion, about.nodes, about.residuals, about.answer, about.base,
                    search.evidence.time[search.used][own], search.signal[own], folds[search.used][own],
                    search.scale[own], force, band,
                )
            )  # fmt: skip
        forces, unforced = target, unforced or tuple(answers)
    answers_commanded = tuple(
        _commanded(playing, p, nodes_of[p], search.used[own] - first[p], search.scale[own], unforced[p].motion)
        for p, own in enumerate(samples_of if commanded else ())
    )
    without = np.concatenate([a.residuals for a in unforced])
    remaining = np.concatenate([a.residuals + a.answer @ a.force for a in answers])
    slides, side = model.rig.axis(part.name).slides, "load" if at_load else "motor"
    floors = float(np.mean(without**2)), float(np.mean(remaining**2))
    worst = worst_floors(without, np.concatenate([a.signal for a in answers]))
    return MissingForce(
        part.name, part.signals, "N" if slides else "N m", tuple(answers), smoothness, floors, worst, side, unforced,
        answers_commanded, SWINGS * own_inertia(model, part.name),
    )  # fmt: skip


@dataclass(frozen=True)
class MissingOffset:
    """Error of a sensor over time, if it alone caused the misfit.

    Attributes:
        signal: its name; `unit` SI, of the offset.
        time, offset, band: for each play (n,) s, the offset to be added to the model's signal, its standard deviation.
        floors: mean square that the model leaves of the signal, without the offset and with it.
    """

    signal: str
    unit: str
    time: tuple[Array, ...]
    offset: tuple[Array, ...]
    band: tuple[Array, ...]
    floors: tuple[float, float]

    def to_json(self) -> dict[str, Any]:
        """Plain values, without the series."""
        size = float(np.sqrt(np.mean(np.concatenate(self.offset) ** 2)))
        return {"signal": self.signal, "unit": self.unit, "floors": list(self.floors), "root_mean_square": size}


def missing_offset(missing: MissingForce, number: int) -> MissingOffset:
    """The offset that would explain one sensor's misfit, with the smoothness that best predicts left-out samples.

    If the sensor is wrong, no force is missing, so it is added to what the model's own motion shows.

    Args:
        number: of the signal among those compared.
    """
    parts = []
    for play in missing.unforced:
        here = play.signal == number
        parts.append((play.residuals[here], _between(play.time[here], play.nodes, play.scale[here])))
    weight = _bandwidth(parts)
    smoothed = [_smoothed(y, answer, weight) for y, answer in parts]
    before = np.concatenate([y for y, _ in parts])
    after = np.concatenate([y + answer @ own for (y, answer), (own, _) in zip(parts, smoothed, strict=True)])
    floors = float(np.mean(before**2)), float(np.mean(after**2))
    offsets, bands = zip(*smoothed, strict=True)
    unit = "m" if missing.unit == "N" else "rad"
    return MissingOffset(
        missing.signals[number], unit, tuple(p.nodes for p in missing.unforced), offsets, bands, floors
    )


def trial_offsets(plays: Sequence[Play], signals: Sequence[str]) -> dict[str, Array]:
    """Signal -> (p, 2) number of each trial, from 1, and by how much it differs from its play's others, in SI units."""
    offsets = {}
    for name in signals:
        rows: list[tuple[int, float]] = []
        for play in plays:
            values = play.trials.values[:, :, play.trials.index(name)]
            seen = np.isfinite(values).all(axis=0)
            each = values[:, seen].mean(axis=1) if seen.any() else np.zeros(len(values))
            rows += [(len(rows) + i + 1, float(mean)) for i, mean in enumerate(each - each.mean())]
        offsets[name] = np.array(rows)
    return offsets


def _between(time: Array, nodes: Array, scale: Array) -> csr_array:
    """(R, n) answer of samples at times (R,), in units of their scale, to what is linear between nodes."""
    after, share = _places(time, nodes)
    rows = np.tile(np.arange(len(time)), 2)
    weights = np.concatenate([(1.0 - share) / scale, share / scale])
    return csr_array((weights, (rows, np.concatenate([after - 1, after]))), shape=(len(time), len(nodes)))


def _places(time: Array, nodes: Array) -> tuple[NDArray[np.int64], Array]:
    """(R,) the node after each time (R,), and how far it is from the one before it to that, as a share."""
    after = np.clip(np.searchsorted(nodes, time), 1, len(nodes) - 1)
    return after, np.clip((time - nodes[after - 1]) / (nodes[after] - nodes[after - 1]), 0.0, 1.0)


def _settled(answers: Sequence[PlayAnswer], rolled_out: Array) -> bool:
    """Whether roll-outs with the forces found leave what the last linearisation promised."""
    promised = np.concatenate([a.residuals + a.answer @ a.force for a in answers])
    return bool(np.mean((rolled_out - promised) ** 2) < AS_PROMISED * max(float(np.mean(promised**2)), 1.0))


def _nodes(times: Array) -> Array:
    """(n,) s, over the steps (K,) of a roll-out."""
    return np.linspace(0.0, times[-1], max(3, round(times[-1] / SPACING) + 1))


@dataclass(frozen=True)
class _Linearised:
    """One play about a force: as in PlayAnswer, and (R,) residuals of the roll-out with that force."""

    motion: Motion
    nodes: Array
    residuals: Array
    answer: csr_array
    base: Array
    rolled_out: Array


def _linearised(
    playing: Playing, play: int, force: Array, nodes: Array, used: NDArray[np.int64], scale: Array, span: Array
) -> _Linearised:
    motion = playing.motion(play, force)
    push = max(PUSH * float(np.sqrt(np.mean(motion.drive**2))), LEAST_PUSH)
    evidence = playing.evidence[play]
    steps_at = evidence.times(0)
    pushes = _pushes(nodes, steps_at)
    seen = playing.residuals(play, force + push * np.vstack([np.zeros(len(force)), pushes]))[:, used] / scale
    changes = np.nan_to_num(seen[1:] - seen[0]) / push
    answer = _answered(changes, nodes, evidence.time[used])
    base = np.empty((len(used), len(playing.values)))
    if len(playing.values):
        infos = playing.model.parameters()
        low, high, own = np.array([(i.low, i.high, i.span) for i in (infos[n] for n in playing.free)]).T
        steps = steps_within(playing.values, DIFFERENCE * own, low, high)
        moved = playing.values + np.diag(steps)
        shown = playing.residuals(play, np.tile(force, (len(steps), 1)), moved)[:, used] / scale
        base = (np.nan_to_num(shown - seen[0]) / (steps / span[: len(steps)])[:, None]).T
    at_nodes = np.interp(nodes, steps_at, force)
    return _Linearised(motion, nodes, seen[0] - answer @ at_nodes, answer, base, seen[0])


def _commanded(
    playing: Playing, play: int, nodes: Array, used: NDArray[np.int64], scale: Array, motion: Motion
) -> csr_array:  # fmt: skip
    """(R, n) answer of the residuals of one play to an offset of the command at each node, 1/rad."""
    evidence = playing.evidence[play]
    pushes = _pushes(nodes, evidence.times(0))
    push = max(NUDGE * float(np.ptp(motion.angle)), LEAST_NUDGE)
    table = push * np.vstack([np.zeros(pushes.shape[1]), pushes])
    seen = playing.residuals_commanded(play, table)[:, used] / scale
    return _answered(np.nan_to_num(seen[1:] - seen[0]) / push, nodes, evidence.time[used])


def _pushes(nodes: Array, steps_at: Array) -> Array:
    """(rows, K) pushes of one at every node, over the steps; those of one row are as far apart as one is forgotten."""
    apart = max(1, round(DECAYED / (nodes[1] - nodes[0])))
    number = np.arange(len(nodes)) % apart
    return np.array(
        [np.interp(steps_at, nodes, (number == row).astype(float)) for row in range(min(apart, len(nodes)))]
    )


def _answered(changes: Array, nodes: Array, time: Array) -> csr_array:
    """(R, n) answer of samples at times (R,) to a push at each node, from what each row of `_pushes` changes."""
    apart = max(1, round(DECAYED / (nodes[1] - nodes[0])))
    samples, columns, answers = [], [], []
    for row, change in enumerate(changes):
        own = np.arange(row, len(nodes), apart)
        # A sample answers the last of several pushes before it; a node acts from the previous one on.
        last = np.searchsorted(nodes[own] - (nodes[1] - nodes[0]), time, side="right") - 1
        known = np.flatnonzero(last >= 0)
        samples.append(known)
        columns.append(own[last[known]])
        answers.append(change[known])
    at = np.concatenate(samples), np.concatenate(columns)
    return csr_array((np.concatenate(answers), at), shape=(len(time), len(nodes)))


def _penalised(gram: csr_array, weight: float) -> Array:
    """(b, n) lower bands of the Cholesky factor of `gram` (n, n) with a penalty on the squared curvature, and a little
    on the force itself, where it has no visible effect.
    """
    count = gram.shape[0]
    bends = diags_array([1.0, -2.0, 1.0], offsets=(0, 1, 2), shape=(count - 2, count))
    size = max(float(gram.trace()) / count, 1e-30)
    whole = gram + weight * size * (bends.T @ bends + diags_array(np.full(count, 1e-4)))
    rows, columns = whole.nonzero()
    width = int(np.max(rows - columns))
    return np.asarray(cholesky_banded([np.pad(whole.diagonal(-k), (0, k)) for k in range(width + 1)], lower=True))


def _solved(factor: Array, right: Array) -> Array:
    return np.asarray(cho_solve_banded((factor, True), right))


def _smoothed(residuals: Array, answer: csr_array, weight: float) -> tuple[Array, Array]:
    """(n,) force and its standard deviation."""
    factor = _penalised(answer.T @ answer, weight)
    force = -_solved(factor, answer.T @ residuals)
    remaining = float(np.mean((residuals + answer @ force) ** 2))
    spread = max(remaining, 1.0) * SETTINGS.correlated / 10.0
    variance = np.empty(len(force))
    for begin in range(0, len(force), COLUMNS_AT_ONCE):
        own = np.arange(begin, min(begin + COLUMNS_AT_ONCE, len(force)))
        unit = np.zeros((len(force), len(own)))
        unit[own, np.arange(len(own))] = 1.0
        variance[own] = _solved(factor, unit)[own, np.arange(len(own))]
    return force, np.sqrt(spread * variance)


def _bandwidth(parts: Sequence[tuple[Array, csr_array]]) -> float:
    """The weight of the curvature that best predicts left-out samples."""
    costs = np.zeros(len(SMOOTH))
    for residuals, answer in parts:
        fold = (np.arange(len(residuals)) // LEFT_OUT) % FOLDS
        for f in range(FOLDS):
            out = fold == f
            kept = answer[~out]
            gram, right = kept.T @ kept, kept.T @ residuals[~out]
            for i, weight in enumerate(SMOOTH):
                force = -_solved(_penalised(gram, weight), right)
                costs[i] += float(np.sum((residuals[out] + answer[out] @ force) ** 2))
    return float(SMOOTH[int(np.argmin(costs))])
