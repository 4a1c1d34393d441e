# SPDX-License-Identifier: Apache-2.0
"""A model played with the commands of real trials, from the pose in which they started."""

from dataclasses import replace

import numpy as np

from eps_tunnel_analysis.phases import mean_command
from labyrinth_sim.errors import InputError
from labyrinth_sim.model import Model
from labyrinth_sim.simulate import simulate
from labyrinth_sim.trials import Array, Trials

JITTER = 2  # samples by which the commands of trials may be early or late and still be the same
ALIKE = 0.99  # share of the samples that must agree, and
WITHIN = 0.01  # by how much, of the command's range


def roll_out(model: Model, real: Trials) -> Trials:
    """The model's answer to the commands of the real trials.

    One roll-out with the command that the trials share; where their commands differ by more than jitter, one for each
    trial. Each starts at the first pose that was seen.

    Raises:
        InputError: the trials lack commands of the rig, or the simulation diverged.
    """
    lacking = [c for c in model.rig.command_channels if c not in real.command_channels]
    if lacking:
        raise InputError(
            f"Model '{model.name}' of rig '{model.rig.name}' needs the command channels "
            f"{', '.join(model.rig.command_channels)}; "
            f"the recordings have {', '.join(real.command_channels) or 'none'}."
        )
    columns = [real.command_channels.index(c) for c in model.rig.command_channels]
    commands = real.commands[:, :, columns]
    if same_commands(commands):
        shared = replace(real, command_channels=model.rig.command_channels, commands=commands)
        return simulate(model, real.time, mean_command(shared), _first_pose(model, real, slice(None)))
    runs = [
        simulate(model, real.time, commands[i], _first_pose(model, real, slice(i, i + 1))) for i in range(real.count)
    ]
    return replace(
        runs[0],
        values=np.concatenate([run.values for run in runs]),
        commands=np.concatenate([run.commands for run in runs]),
    )


def same_commands(commands: Array) -> bool:
    """Whether the commands (p, T, u) of p trials agree but for jitter in time."""
    shared = commands[:1]
    held = np.where(np.isfinite(commands), commands, 0.0)
    margin = WITHIN * np.ptp(held[0], axis=0) + 1e-9
    padded = np.pad(held[0], ((JITTER, JITTER), (0, 0)), mode="edge")
    near = np.lib.stride_tricks.sliding_window_view(padded, 2 * JITTER + 1, axis=0)  # (T, u, window)
    low, high = near.min(axis=-1) - margin, near.max(axis=-1) + margin
    agree = (held >= low) & (held <= high)
    sent = np.isfinite(commands) == np.isfinite(shared)
    return bool(np.mean(agree & sent) >= ALIKE)


def _first_pose(model: Model, real: Trials, which: slice) -> dict[str, float]:
    """First seen value of each signal of the rig, the mean of these trials."""
    pose = {}
    for name in real.signals:
        values = real.values[which, :, real.index(name)]
        seen = np.flatnonzero(np.isfinite(values).any(axis=0))
        if name in model.rig.signals and len(seen):
            pose[name] = float(np.nanmean(values[:, seen[0]]))
    return pose
