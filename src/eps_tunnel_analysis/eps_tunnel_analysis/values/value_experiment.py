# SPDX-License-Identifier: Apache-2.0
"""The next experiment for values: what to play so that the fitted values are known best, in a given time of motion.

Fisher information of each part of the commands of a menu, at the model's values, over the noise of the signals. Each
axis takes one part after another, always the one that narrows its values most for its time (D-optimal, greedily), and
all axes move at the same time. What runs into a stop on the model would show the stop, and is left out.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import ndtri

from eps_tunnel_analysis.diagnose.evidence import play_evidence
from eps_tunnel_analysis.diagnose.experiment import RATE, STEP, STOP, menu
from eps_tunnel_analysis.diagnose.settings import SETTINGS
from eps_tunnel_analysis.fit.differences import moved
from eps_tunnel_analysis.fit.problem import by_axis, default_free, free_parameters
from eps_tunnel_analysis.outputs import plain
from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.sequence import Command, Hold, Ramp, Shape
from eps_tunnel_analysis.sequence_file import sequence_text
from eps_tunnel_analysis.simulated import rollouts
from labyrinth_sim.errors import InputError
from labyrinth_sim.model import Model
from labyrinth_sim.rig import Axis
from labyrinth_sim.simulate import simulate_batch
from labyrinth_sim.trials import Array

SECONDS = 12.0  # of motion, unless asked otherwise
BLOCK = 2.0  # s, of the parts into which a command of the menu is cut: so long, or one shape more
BACK = 0.4  # s to return to rest after a command that ends elsewhere
DIFFERENCE = 1e-3  # of the finite differences, normalised
PRIOR = 1.0  # standard deviation of a value, in shares of its span, without any recording
NOISE = 3e-4  # rad or m, of a sensor about which nothing is known


@dataclass(frozen=True)
class NarrowedValue:
    """One value: half-widths of its 95 % interval, in its unit, by the recordings at hand and with one more play of the
    experiment; of `before` NaN without recordings.
    """

    name: str
    unit: str
    value: float
    before: float
    after: float


@dataclass(frozen=True)
class ValueExperiment:
    """A play that narrows values.

    Attributes:
        command: what is played.
        values: what it narrows.
        pieces: the parts of the menu's commands that each axis goes through.
    """

    command: Command
    values: tuple[NarrowedValue, ...]
    pieces: Mapping[str, tuple[str, ...]]

    @property
    def reason(self) -> str:
        """In words."""
        each = "; ".join(f"{axis}: {', '.join(names)}" for axis, names in self.pieces.items())
        return f"Narrows {', '.join(v.name for v in self.values)}. {each}."

    def to_yaml(self, linear: Sequence[str] = (), trials: int = 5) -> str:
        """A sequence file, ready to play."""
        return sequence_text(self.command, self.reason, trials, linear)

    def to_json(self) -> dict[str, Any]:
        """Plain dicts, lists, numbers and words."""
        content = {
            "sequence": self.command.name,
            "seconds": self.command.duration,
            "pieces": {axis: list(names) for axis, names in self.pieces.items()},
            "values": [
                {"name": v.name, "unit": v.unit, "value": v.value, "before": v.before, "after": v.after}
                for v in self.values
            ],
        }
        found: dict[str, Any] = plain(content)
        return found


def value_experiment(
    model: Model,
    plays: Sequence[Play] = (),
    patterns: Sequence[str] | None = None,
    seconds: float = SECONDS,
    nthread: int = 0,
) -> ValueExperiment:
    """Designs the play that narrows a model's values most.

    Args:
        model: with its values as far as they are known.
        plays: what was recorded already; without any, nothing is known of the values.
        patterns: values to narrow, as `drive.x.*`; what is free by default.
        seconds: of motion, at most.

    Raises:
        InputError: unknown names, values of no axis, or a time in which no command of the menu ends.
    """
    free = free_parameters(model, patterns) if patterns else default_free(model)
    parts = [part for part in by_axis(model, free, plays, None) if part.axis]
    if not parts:
        raise InputError(f"None of {', '.join(free)} belongs to an axis, so no command of the menu narrows it.")
    names = tuple(n for part in parts for n in part.free)
    known = information(model, names, plays, nthread) if plays else np.zeros((len(names), len(names)))
    noise = _noise(model, plays)
    rows: dict[str, list[Shape]] = {}
    pieces: dict[str, tuple[str, ...]] = {}
    for part in parts:
        axis = model.rig.axis(part.axis)
        own = [names.index(n) for n in part.free]
        chosen, shapes = _pieces(model, axis, part.free, known[np.ix_(own, own)], seconds, noise, nthread)
        rows[axis.command], pieces[part.axis] = shapes, chosen
    lasts = max(math.fsum(s.lasts for s in row) for row in rows.values())
    channels = model.rig.command_channels
    command = Command(
        f"values_{lasts:.0f}s",
        channels,
        (0.0,) * len(channels),
        tuple(tuple(_filled(rows.get(channel, []), lasts)) for channel in channels),
    )
    more, _ = _command_information(model, names, command, noise, nthread)
    before, after = (_half_widths(i) for i in (known, known + more))
    infos = model.parameters()
    return ValueExperiment(
        command,
        tuple(
            NarrowedValue(n, (i := infos[n]).unit, i.value, i.span * (b if plays else math.nan), i.span * a)
            for n, b, a in zip(names, before.tolist(), after.tolist(), strict=True)
        ),
        pieces,
    )  # fmt: skip


def information(model: Model, names: Sequence[str], plays: Sequence[Play], nthread: int = 0) -> Array:
    """(k, k) Fisher information of recorded plays on values, each in shares of its span."""
    noise = _noise(model, plays)
    runs = rollouts(model, plays)
    points, steps, _ = _points(model, names)
    signals = tuple(noise)
    answers, _, _ = runs.simulate(model, names, points, signals, nthread)
    total = np.zeros((len(names), len(names)))
    for row, play in enumerate(runs.play):
        size = len(plays[play].trials.time)
        share = 1.0 / np.count_nonzero(runs.play == play)
        total += share * _of_answers(answers[:, row, :size], steps, signals, noise)
    return total


def _command_information(
    model: Model, names: Sequence[str], command: Command, noise: Mapping[str, float], nthread: int
) -> tuple[Array, Array]:
    """(k, k) Fisher information of a command on values, and (T, m) what the model does with it."""
    time, targets = command.sample(RATE)
    points, steps, _ = _points(model, names)
    result = simulate_batch(
        model, names, points, time, targets[None], {}, signals=tuple(noise), timestep=STEP, nthread=nthread
    )
    return _of_answers(result.values[:, 0], steps, tuple(noise), noise), np.asarray(result.values[0, 0])


def _points(model: Model, names: Sequence[str]) -> tuple[Array, Array, Array]:
    """(1 + k, k) values, the model's own first, (k,) normalised steps, (k,) spans."""
    infos = model.parameters()
    own = [infos[n] for n in names]
    low, width, span, value = np.array([(i.low, i.high - i.low, i.span, i.value) for i in own]).T
    z = np.clip((value - low) / span, 0.0, width / span)
    points, steps = moved(z, DIFFERENCE, width=width / span)
    return low + np.vstack([z, points]) * span, steps, span


def _of_answers(answers: Array, steps: Array, signals: Sequence[str], noise: Mapping[str, float]) -> Array:
    """(k, k) from answers (1 + k, T, m)."""
    sigma = np.array([noise[s] for s in signals])
    slopes = np.nan_to_num((answers[1:] - answers[0]) / sigma).reshape(len(steps), -1) / steps[:, None]
    return np.asarray(slopes @ slopes.T) / SETTINGS.correlated


def _noise(model: Model, plays: Sequence[Play]) -> dict[str, float]:
    """Measured position -> standard deviation of its mean over trials; the sensor's resolution without any plays."""
    positions = [m for m in model.rig.measured if m.quantity == "position"]
    noise = {m.signal: max(m.resolution / 12**0.5, NOISE) for m in positions}
    if plays:
        seen = [m.signal for m in positions if all(m.signal in p.trials.signals for p in plays)]
        of_plays = [play_evidence(model, play, seen).noise for play in plays]
        noise = {s: float(np.mean([np.median(n[i].floor) for n in of_plays])) for i, s in enumerate(seen)}
    return noise


def _pieces(
    model: Model, axis: Axis, names: Sequence[str], known: Array, seconds: float, noise: Mapping[str, float],
    nthread: int,
) -> tuple[tuple[str, ...], list[Shape]]:  # fmt: skip
    """Parts of the menu's commands that one axis goes through, and their shapes one after another."""
    channel = model.rig.command_channels.index(axis.command)
    measured = [signal for signal in axis.positions if signal in noise]
    low, high = (STOP * limit for limit in axis.limits) if axis.limits else (-math.inf, math.inf)
    offers: list[tuple[str, list[Shape], Array]] = []
    for name, command in menu(model, axis.name).items():
        for label, shapes in _blocks(name, command.shapes[channel]):
            rows = tuple(tuple(shapes) if i == channel else () for i in range(len(command.channels)))
            alone = Command(label, command.channels, command.initial, rows)
            gained, answer = _command_information(model, names, alone, noise, nthread)
            moves = answer[:, [list(noise).index(s) for s in measured]]
            if np.isfinite(moves).all() and moves.min() > low and moves.max() < high:
                offers.append((label, shapes, gained))
    chosen: list[str] = []
    row: list[Shape] = []
    remaining = seconds
    while fitting := [o for o in offers if math.fsum(s.lasts for s in o[1]) <= remaining + 1e-9]:
        label, shapes, gained = max(fitting, key=lambda o: _gain(known, o[2]) / math.fsum(s.lasts for s in o[1]))
        known = known + gained
        chosen.append(label)
        row += shapes
        remaining -= math.fsum(s.lasts for s in shapes)
    if not chosen:
        shortest = min((math.fsum(s.lasts for s in o[1]) for o in offers), default=math.nan)
        raise InputError(
            f"No command for axis {axis.name} ends within {seconds:g} s; the shortest takes {shortest:g} s."
        )
    return tuple(chosen), row


def _gain(known: Array, more: Array) -> float:
    """By how much a command raises the logarithm of the information's determinant."""
    prior = np.eye(len(known)) / PRIOR**2
    return float(np.linalg.slogdet(prior + known + more)[1] - np.linalg.slogdet(prior + known)[1])


def _half_widths(known: Array) -> Array:
    """(k,) of the 95 % intervals, in shares of their spans."""
    covariance = np.linalg.inv(known + np.eye(len(known)) / PRIOR**2)
    return np.asarray(ndtri(0.975) * np.sqrt(np.diag(covariance)))


def _blocks(name: str, shapes: Sequence[Shape]) -> list[tuple[str, list[Shape]]]:
    """A command's shapes in parts of some BLOCK, each from rest to rest; longer shapes are cut short."""
    blocks: list[tuple[str, list[Shape]]] = []
    block: list[Shape] = []
    base = 0.0
    moving = [replace(s, lasts=min(s.lasts, BLOCK)) for s in shapes if not isinstance(s, Hold)]
    for number, shape in enumerate(moving, start=1):
        block.append(shape)
        base = shape.end(base)
        if math.fsum(s.lasts for s in block) >= BLOCK or number == len(moving):
            label = f"{name}/{len(blocks) + 1}"
            blocks.append((label, [*block, Ramp(BACK, 0.0)] if abs(base) > 1e-9 else block))
            block, base = [], 0.0
    return blocks


def _filled(shapes: list[Shape], lasts: float) -> list[Shape]:
    """Shapes that last so long."""
    rest = lasts - math.fsum(s.lasts for s in shapes)
    return [*shapes, Hold(rest)] if rest > 1e-9 else shapes
