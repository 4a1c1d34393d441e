# SPDX-License-Identifier: Apache-2.0
"""What a model does with recorded commands: the one way from model and commands to simulated trials.

Commands act at their own stamps, on a grid as fine as MuJoCo's step; the answer is read on the trials' grid. Comparison
and fit both go this way, so one model has one error on one recording.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.stamped import Series, StampedTrial, setpoints
from labyrinth_sim.errors import InputError, unknown_name
from labyrinth_sim.model import Model
from labyrinth_sim.rig import BALL_SIGNALS, Axis
from labyrinth_sim.simulate import even_timestep, simulate_batch
from labyrinth_sim.trials import Array, Trials

COMMAND_JITTER = 2  # samples by which the commands of trials may be early or late and still be the same
SENT_ALIKE = 0.99  # share of the samples that must agree, and
SENT_WITHIN = 0.01  # by how much, of the command's range
AT_REST = 0.1  # s, in which an axis that rests as a play begins
RESTING = 0.003  # of its range, or a tick of its sensor, if that is more, moves less than this
HELD_WITHIN = 0.25  # of its range; a command that is further away than that moves it, however late
NEAR = 0.05  # of its range, between the command and an axis that rests though it is shaken
ROLLOUT_BYTES = 2e8  # bytes of roll-outs on the fine grid that are held at once


class Diverged(InputError):
    """The simulation of a model went out of bounds."""


@dataclass(frozen=True)
class Rollouts:
    """c roll-outs that answer the commands of some plays: all on one grid, the shorter ones held to the longest.

    Attributes:
        time: (K,) s, in steps of MuJoCo's own.
        every: steps of it in one sample of the trials; sample i is read at step i * every.
        commands: (c, K, u) rad, the setpoint during each step; NaN where the drive is off.
        initial: signal -> (c,) at time zero, NaN where unseen.
        resting: (c, u) whether each axis rests under its first command at time zero.
        with_ball: whether the ball is simulated.
        known: full parameter name -> (c,), what is known to differ between the plays.
        play: (c,) number of the play that each belongs to.
    """

    time: Array
    every: int
    commands: Array
    initial: dict[str, Array]
    resting: NDArray[np.bool_]
    with_ball: bool
    known: dict[str, Array]
    play: NDArray[np.int64]

    def simulate(
        self, model: Model, names: Sequence[str], values: Array, signals: Sequence[str] | None = None, nthread: int = 0
    ) -> tuple[Array, tuple[str, ...], str]:
        """Rolls out n parameter sets times c roll-outs.

        Args:
            names, values: k full parameter names and (n, k) of their values.
            signals: which to read; None for all that the simulation has.

        Returns:
            (n, c, T, m) on the trials' grid, NaN where a roll-out diverged; the m signals; why one diverged, or "".
        """
        parts, why, chosen = [], "", tuple[str, ...]()
        size = len(signals) if signals is not None else len(model.rig.signals)
        rows = max(1, int(ROLLOUT_BYTES / (8 * self.commands.shape[0] * len(self.time) * max(size, 1))))
        for low in range(0, len(values), rows):
            result = simulate_batch(
                model, names, values[low : low + rows], self.time, self.commands, self.initial,
                per_command=self.known, resting=self.resting, signals=signals, with_ball=self.with_ball,
                timestep=self.time[1] if len(self.time) > 1 else None, nthread=nthread, parts=1,
                as_run=True,
            )  # fmt: skip
            read = np.array(result.values[:, :, :: self.every])
            read[result.failed] = np.nan
            parts.append(read)
            chosen, why = result.signals, why or next(iter(result.messages.values()), "")
        return np.concatenate(parts), chosen, why


def rollouts(model: Model, plays: Sequence[Play], timestep: float | None = None) -> Rollouts:
    """What to simulate so that it can be compared with these plays' trials.

    One roll-out for each play, by the mean of its trials' commands; where these differ by more than jitter, one for
    each trial. Each starts where its trials were first seen.

    Args:
        timestep: s, MuJoCo's own step at most; None for the rig's.

    Raises:
        InputError: the plays have other sampling steps, or lack commands of the rig.
    """
    trials = [play.trials for play in plays]
    steps = [t.step for t in trials]
    if max(steps) - min(steps) > 1e-9:
        raise InputError(f"All plays need one sampling step; got {sorted(set(steps))} s. Resample at one rate.")
    _refuse_missing_commands(model, trials)
    runs = [(number, group) for number, play in enumerate(plays) for group in _answered_together(model, play)]
    first = [first_pose(model, group) for _, group in runs]
    initial = {s: np.array([pose.get(s, np.nan) for pose in first]) for s in dict.fromkeys(n for f in first for n in f)}
    with_ball = any(name in initial for name in BALL_SIGNALS)
    step = even_timestep(steps[0], timestep, model, with_ball) if steps[0] > 0.0 else 0.0
    every = round(steps[0] / step) if step else 1
    longest = max(len(t.time) for t in trials)
    size = (longest - 1) * every + 1
    commands = np.empty((len(runs), size, len(model.rig.command_channels)))
    for row, (number, group) in enumerate(runs):
        own = (len(trials[number].time) - 1) * every + 1
        for column, channel in enumerate(model.rig.command_channels):
            commands[row, :own, column] = setpoints(group, channel, step, own)
        commands[row, own:] = commands[row, own - 1]
    owner = np.array([number for number, _ in runs])
    resting = np.array([axes_at_rest(model, group) for _, group in runs])
    known = {name: given[owner] for name, given in known_values(model, plays).items()}
    time = np.asarray(step * np.arange(size), dtype=float)
    return Rollouts(time, every, commands, initial, resting, with_ball, known, owner)


def roll_out(model: Model, play: Play, timestep: float | None = None) -> Trials:
    """The model's answer to the commands of a play, on its trials' grid: one trial, or one for each; see `rollouts`.

    Raises:
        Diverged: the simulation went out of bounds.
        InputError: the trials lack commands of the rig.
    """
    runs = rollouts(model, [play], timestep)
    values, signals, why = runs.simulate(model, (), np.empty((1, 0)))
    if why:
        raise Diverged(f"The simulation of '{model.name}' {why}. Try a smaller timestep or gains.")
    units = dict(zip(model.rig.signals, model.rig.units, strict=True))
    return Trials(
        time=play.trials.time,
        signals=signals,
        units=tuple(units[s] for s in signals),
        values=values[0],
        command_channels=model.rig.command_channels,
        commands=runs.commands[:, :: runs.every],
    )


def first_pose(model: Model, trials: Sequence[StampedTrial]) -> dict[str, float]:
    """Position of each joint, and of a ball, where it was first seen: the mean over the trials that saw it."""
    pose = {}
    for name in model.rig.positions + (BALL_SIGNALS if model.rig.ball else ()):
        first = [t.signals[name].values[0] for t in trials if name in t.signals and len(t.signals[name].time)]
        if first:
            pose[name] = float(np.mean(first))
    return pose


def axes_at_rest(model: Model, trials: Sequence[StampedTrial]) -> NDArray[np.bool_]:
    """(u,) which axes rest under their first command as these trials begin.

    Such a drive carries its load already. One that began from its pose as its goal would let the load sag at first,
    and with stiction keep it there.
    """
    return np.array([_rests(model, axis, trials) for axis in model.rig.axes])


def _rests(model: Model, axis: Axis, trials: Sequence[StampedTrial]) -> bool:
    """Whether an axis rests, by what its finest sensor says before its command changes, in the mean over the trials.

    One that the motion of another axis shakes at once cannot show that; it rests if it is near its command.
    """
    seen = [m for m in axis.finest_first if m.quantity == "position" and all(m.signal in t.signals for t in trials)]
    others = [channel for channel in model.rig.command_channels if channel != axis.command]
    if not seen:
        return False
    moved, allowed, away = [], [], []
    for trial in trials:
        measured, command = trial.signals[seen[0].signal], trial.commands.get(axis.command)
        if command is None or not len(command.time) or not np.isfinite(command.values[0]):
            return False
        span = float(np.ptp(measured.values)) if len(measured.values) else 0.0
        if span <= 0.0:
            return False
        away.append(abs(command.values[0] - measured.values[0]) / span)
        early = measured.values[measured.time <= _unchanged_until(command)]
        half = len(early) // 2
        moved.append(float(np.median(early[half:]) - np.median(early[:half])) if half > 1 else 0.0)
        allowed.append(max(RESTING * span, seen[0].resolution))
    if max(away) > HELD_WITHIN:
        return False
    shaken = any(_unchanged_until(t.commands[name]) < AT_REST for t in trials for name in others if name in t.commands)
    return bool(abs(np.mean(moved)) < np.mean(allowed) or (shaken and max(away) < NEAR))


def _unchanged_until(command: Series) -> float:
    """s, when a first command gives way to another one; `AT_REST` after it came, at most."""
    if not len(command.time) or np.isnan(command.values[0]):
        return AT_REST
    return float(min([max(command.time[0], 0.0) + AT_REST, *command.time[command.values != command.values[0]][:1]]))


def _answered_together(model: Model, play: Play) -> list[tuple[StampedTrial, ...]]:
    """The play's trials, in groups that one roll-out answers."""
    columns = [play.trials.command_channels.index(c) for c in model.rig.command_channels]
    if same_commands(play.trials.commands[:, :, columns]):
        return [play.at_stamps]
    return [(trial,) for trial in play.at_stamps]


def _refuse_missing_commands(model: Model, trials: Sequence[Trials]) -> None:
    for t in trials:
        if any(c not in t.command_channels for c in model.rig.command_channels):
            raise InputError(
                f"Model '{model.name}' of rig '{model.rig.name}' needs the command channels "
                f"{', '.join(model.rig.command_channels)}; "
                f"the recordings have {', '.join(t.command_channels) or 'none'}."
            )


def same_commands(commands: Array) -> bool:
    """Whether the commands (p, T, u) of p trials agree but for jitter in time."""
    shared = commands[:1]
    held = np.where(np.isfinite(commands), commands, 0.0)
    margin = SENT_WITHIN * np.ptp(held[0], axis=0) + 1e-9
    padded = np.pad(held[0], ((COMMAND_JITTER, COMMAND_JITTER), (0, 0)), mode="edge")
    near = np.lib.stride_tricks.sliding_window_view(padded, 2 * COMMAND_JITTER + 1, axis=0)  # (T, u, window)
    low, high = near.min(axis=-1) - margin, near.max(axis=-1) + margin
    agree = (held >= low) & (held <= high)
    sent = np.isfinite(commands) == np.isfinite(shared)
    return bool(np.mean(agree & sent) >= SENT_ALIKE)


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
    positions = {*model.rig.positions, *BALL_SIGNALS}
    chosen = tuple(s for s in common if s in positions)
    if not chosen:
        raise InputError(
            f"Rig '{model.rig.name}' measures {', '.join(model.rig.signals)}; the trials hold "
            f"{', '.join(trials[0].signals)}. No position is in both; is it the right rig?"
        )
    return chosen
