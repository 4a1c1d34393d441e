# SPDX-License-Identifier: Apache-2.0
"""What the noise of the pose in which a roll-out starts does to fitted values, to first order."""

import copy
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from eps_tunnel_analysis.fit.problem import Objective, Problem
from eps_tunnel_analysis.simulated import Play
from labyrinth_sim.trials import Array


def start_pose_deviation(
    objective: Objective, plays: Sequence[Play], problem: Problem, z: Array, residuals: Array, slopes: Array
) -> Array:
    """(k,) standard deviations, normalised, for each play and position starts by itself.

    Args:
        plays: that were fitted.
        z: (k,) the fit, normalised.
        residuals, slopes: (R,) and (R, k) there, in the fitness's scaling.
    """
    total = np.zeros(problem.size)
    if not np.isfinite(slopes).all():
        return total
    inverse = np.linalg.pinv(slopes)
    of_play = objective.blocks // len(objective.signals)
    for change in start_changes(objective, plays, problem, z, residuals):
        for number in range(len(plays)):
            total += (inverse @ np.where(of_play == number, change, 0.0)) ** 2
    return np.sqrt(total)


def start_changes(
    objective: Objective, plays: Sequence[Play], problem: Problem, z: Array, residuals: Array
) -> Iterator[Array]:
    """For each position (R,) by how much residuals change as every play starts elsewhere, by the noise of its mean."""
    values = problem.from_unit(z)[None]
    runs = objective.rollouts
    for signal, start in runs.initial.items():
        noise = np.array([_noise_of_mean(play, signal) for play in plays])
        if noise.any():
            moved = copy.copy(objective)
            moved.rollouts = replace(runs, initial={**runs.initial, signal: start + noise[runs.play]})
            yield np.nan_to_num(problem.fitness.scaled(moved(values))[0] - residuals)


def _noise_of_mean(play: Play, signal: str) -> float:
    """Standard deviation of a signal's mean over a play's trials; 0 of a single one, of which nothing is known."""
    if signal not in play.trials.signals or play.trials.count < 2:
        return 0.0
    values = play.trials.values[:, :, play.trials.index(signal)]
    seen = values[:, np.isfinite(values).all(axis=0)]
    return float(np.sqrt(np.mean(np.var(seen, axis=0, ddof=1)) / len(seen))) if seen.size else 0.0
