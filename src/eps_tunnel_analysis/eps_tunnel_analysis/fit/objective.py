# SPDX-License-Identifier: Apache-2.0
"""From a model and recorded plays to residuals: one roll-out per command, simulated minus mean measured."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from eps_tunnel_analysis.plays import Play
from eps_tunnel_analysis.tunnel import build_tunnel, smooth
from labyrinth_sim.errors import InputError, unknown_name
from labyrinth_sim.model import Model
from labyrinth_sim.simulate import simulate_batch
from labyrinth_sim.trials import Array, Trials, locked


@dataclass(frozen=True)
class Rollouts:
    """What a batch needs to simulate c plays: all on one grid, the shorter ones held to the longest.

    Attributes:
        time: (T,) s.
        commands: (c, T, u) rad.
        initial: signal -> (c,) at the first sample, NaN where unseen.
        with_ball: whether the ball is simulated.
        known: full parameter name -> (c,), what is known to differ between the plays.
    """

    time: Array
    commands: Array
    initial: dict[str, Array]
    with_ball: bool
    known: dict[str, Array] = field(default_factory=dict)


class Objective:
    """Residuals of a model on recorded plays.

    Args:
        model: its values hold where the free ones do not.
        free: k full names of free parameters.
        plays: the recorded commands with their trials.
        signals: which to compare; by default every measured position of the rig that all plays have.
        timestep: MuJoCo's step, s; None for the rig's own.
        nthread: 0 for one per CPU; the answer does not depend on it.

    Attributes:
        mean: (R,) measured means of all seen samples, play by play, signal by signal.
        lower, upper: (R,) half-widths of the smoothed tunnel there (equation 12).
        blocks: (R,) number of the play and signal.
        samples: (R,) number of the sample on the play's grid.
        weights: (R,) one over the samples of the block.
    """

    def __init__(
        self,
        model: Model,
        free: Sequence[str],
        plays: Sequence[Play],
        signals: Iterable[str] | None = None,
        timestep: float | None = None,
        nthread: int = 0,
    ) -> None:
        known = model.parameters()
        complaints = [unknown_name("parameter", name, known) for name in free if name not in known]
        if not plays:
            complaints.append("There is nothing to fit to: no recorded play.")
        if complaints:
            raise InputError(complaints)
        self.model, self.free = model, tuple(free)
        self.signals = compared_signals(model, [play.trials for play in plays], signals)
        self.timestep, self.nthread = timestep, nthread
        self.rollouts = replace(rollouts(model, [play.trials for play in plays]), known=known_values(model, plays))
        self._columns: tuple[int, ...] | None = None
        means, lowers, uppers, blocks, self._picks = [], [], [], [], []
        for number, play in enumerate(plays):
            tunnel = smooth(build_tunnel(play.trials.select(self.signals)))
            for column in range(len(self.signals)):
                seen = np.flatnonzero(~np.isnan(tunnel.mean[:, column]))
                means.append(tunnel.mean[seen, column])
                lowers.append(np.abs(tunnel.lower[seen, column]))
                uppers.append(tunnel.upper[seen, column])
                blocks.append(np.full(len(seen), number * len(self.signals) + column))
                self._picks.append((number, seen, column))
        self.mean, self.lower, self.upper = (locked(np.concatenate(part)) for part in (means, lowers, uppers))
        self.blocks = np.concatenate(blocks)
        self.samples = np.concatenate([seen for _, seen, _ in self._picks])
        counts = np.bincount(self.blocks)
        self.weights = locked(1.0 / counts[self.blocks])

    def __call__(self, values: Array) -> Array:
        """(n, k) values in their units to (n, R) residuals; a diverged roll-out is a row of NaN."""
        result = simulate_batch(
            self.model,
            self.free,
            values,
            self.rollouts.time,
            self.rollouts.commands,
            self.rollouts.initial,
            per_command=self.rollouts.known,
            with_ball=self.rollouts.with_ball,
            timestep=self.timestep,
            nthread=self.nthread,
        )
        where = [result.signals.index(name) for name in self.signals]
        parts = [result.values[:, play, seen, where[column]] for play, seen, column in self._picks]
        residuals = np.concatenate(parts, axis=1) - self.mean
        residuals[result.failed.any(axis=1)] = np.nan
        return residuals

    def __getstate__(self) -> dict[str, Any]:
        # A worker elsewhere has its own number of cores.
        return {**self.__dict__, "nthread": 0}


def known_values(model: Model, plays: Sequence[Play]) -> dict[str, Array]:
    """Full parameter name -> (c,) of what is known of some plays; the model's value for the others.

    Raises:
        InputError: a name that the model lacks.
    """
    names = list(dict.fromkeys(name for play in plays for name in play.known))
    infos = model.parameters()
    wrong = [unknown_name("parameter", name, infos) for name in names if name not in infos]
    if wrong:
        raise InputError(wrong)
    return {name: np.array([play.known.get(name, infos[name].value) for play in plays]) for name in names}


def compared_signals(model: Model, trials: Sequence[Trials], asked: Iterable[str] | None = None) -> tuple[str, ...]:
    """Signals to compare: those asked for, or every position (and the ball's) that the rig and all trials have."""
    common = [s for s in model.rig.signals if all(s in t.signals for t in trials)]
    if asked is not None:
        names = tuple(dict.fromkeys(asked))
        unknown = [unknown_name("signal", name, common) for name in names if name not in common]
        if unknown:
            raise InputError(unknown)
        return names
    positions = {m.signal for m in model.rig.measured if m.quantity == "position"} | {"ball_x", "ball_y"}
    chosen = tuple(s for s in common if s in positions)
    if not chosen:
        raise InputError(
            f"Rig '{model.rig.name}' measures {', '.join(model.rig.signals)}; the trials hold "
            f"{', '.join(trials[0].signals)}. No position is in both; is it the right rig?"
        )
    return chosen


def rollouts(model: Model, trials: Sequence[Trials]) -> Rollouts:
    """What to simulate so that it can be compared with these trials.

    A play's command is the median over its trials, which differ by a sample of jitter at most.
    """
    steps = [t.step for t in trials]
    if max(steps) - min(steps) > 1e-9:
        raise InputError(f"All plays need one sampling step; got {sorted(set(steps))} s. Resample at one rate.")
    missing = {c for c in model.rig.command_channels for t in trials if c not in t.command_channels}
    if missing:
        raise InputError([unknown_name("command channel", c, trials[0].command_channels) for c in sorted(missing)])
    longest = max(trials, key=lambda t: len(t.time))
    size = len(longest.time)
    commands = np.empty((len(trials), size, len(model.rig.command_channels)))
    for number, t in enumerate(trials):
        columns = [t.command_channels.index(c) for c in model.rig.command_channels]
        commands[number, : len(t.time)] = middle(t.commands[:, :, columns])
        commands[number, len(t.time) :] = commands[number, len(t.time) - 1]
    positions = {m.signal for m in model.rig.measured if m.quantity == "position"} | {"ball_x", "ball_y"}
    names = [s for s in model.rig.signals if s in positions and any(s in t.signals for t in trials)]
    initial = {
        s: np.array([mean_of(t.values[:, 0, t.index(s)]) if s in t.signals else np.nan for t in trials]) for s in names
    }
    ball = [s for s in ("ball_x", "ball_y") if s in initial and np.isfinite(initial[s]).any()]
    return Rollouts(longest.time - longest.time[0], commands, initial, bool(ball))


def middle(commands: Array) -> Array:
    """(p, T, u) to (T, u): the trials' median, so that one late message does not move a step; NaN where most are."""
    ordered = np.sort(commands, axis=0)  # NaN sorts last
    return np.asarray(ordered[(len(commands) - 1) // 2])


def mean_of(values: Array) -> float:
    """Mean of the seen values, NaN where there are none."""
    seen = values[~np.isnan(values)]
    return float(seen.mean()) if len(seen) else float("nan")
