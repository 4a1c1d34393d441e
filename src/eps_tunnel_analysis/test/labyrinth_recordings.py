# SPDX-License-Identifier: Apache-2.0
"""Recordings of one axis of a labyrinth's model, with the noise of its sensors."""

from collections.abc import Sequence

import numpy as np

from eps_tunnel_analysis.recorded_play import Play
from labyrinth_sim.model import Model
from labyrinth_sim.simulate import simulate
from labyrinth_sim.trials import Array, Trials

STEP = 0.01  # s
BEGINS = 20  # samples at rest


def jerked(slow: float, quick: float, samples: int, size: float = 0.06, phase: float = 0.0) -> Array:
    """(samples,) rad of a command, after a rest: a sine of `slow` rad/s, and steps at the pace of `quick` rad/s."""
    time = np.arange(samples)[BEGINS:] * STEP
    waves = size * np.sin(slow * time + phase) + 0.03 * np.sign(np.sin(quick * time))
    return np.concatenate([np.zeros(BEGINS), waves])


def recorded(model: Model, signals: Sequence[str], commands: Array) -> Play:
    """Three trials of a model under commands (T, 2)."""
    time = np.arange(len(commands)) * STEP
    run = simulate(model, time, commands).select(list(signals))
    noise = 2e-4 * np.random.default_rng(4).standard_normal((3, *run.values.shape[1:]))
    return Play("jerked", Trials(time, run.signals, run.units, run.values + noise, run.command_channels,
                                 np.repeat(run.commands, 3, axis=0)))  # fmt: skip
