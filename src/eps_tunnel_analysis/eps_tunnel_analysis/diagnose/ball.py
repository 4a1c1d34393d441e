# SPDX-License-Identifier: Apache-2.0
"""The ball: which recordings show it, which effects act on it alone, how accurately it can be predicted.

It is judged last, with a model whose axes are already fitted: a rolling ball integrates their tilt twice.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from eps_tunnel_analysis.recorded_play import Play
from labyrinth_sim.effect import Effect
from labyrinth_sim.model import Model
from labyrinth_sim.rig import BALL_SIGNALS
from labyrinth_sim.trials import Array

BALL = "ball"
PLACE = 3e-4  # m; how accurately the first sample shows where the ball lies
BALL_DIFFERENCE = 0.01  # of a value's span; finite differences wide enough to bridge the misfit's kinks at walls
TILT = 4e-4  # rad; how accurately a model tilts the board, a quarter of an encoder's tick
ROLLING = 5 / 7 * 9.81  # m/s^2, of a ball that rolls without slipping, for each radian of tilt


def part_name(axis: str) -> str:
    """What is judged, in words."""
    return "ball" if axis == BALL else f"axis {axis}"


def on_ball(effect: Effect) -> bool:
    """Whether an effect shows in how the ball rolls or is seen, and in nothing else."""
    return effect.where == "ball" or "ball" in effect.needs


def split(only: Iterable[str] | None, known: Mapping[str, Effect]) -> tuple[list[str], list[str]]:
    """Names of effects to consider, of those `known`, on the axes and on the ball."""
    names = list(known if only is None else only)
    of_ball = [n for n in names if (own := known.get(n.partition(".")[0])) and on_ball(own)]
    return [n for n in names if n not in of_ball], of_ball


def sees_ball(model: Model, plays: Sequence[Play]) -> bool:
    """Whether the rig has a ball and every play shows where it lay at the start."""
    trials = [play.trials for play in plays]
    there = model.rig.ball is not None and all(s in t.signals for s in BALL_SIGNALS for t in trials)
    return there and all(np.isfinite(t.select(BALL_SIGNALS).values[:, 0]).any(axis=0).all() for t in trials)


def without_ball(play: Play) -> Play:
    """A play for judging the axes: the ball's weight turns them by less than a tick, and simulating it costs time."""
    if not set(BALL_SIGNALS) & set(play.trials.signals):
        return play
    return replace(play, trials=play.trials.select([s for s in play.trials.signals if s not in BALL_SIGNALS]))


def values_of(model: Model) -> set[str]:
    """Full names of the model's values that belong to the ball."""
    of_ball = [use for use in model.effects if on_ball(use.effect)]
    return {f"{use.effect.name}.{use.place}.{p.name}" for use in of_ball for p in use.effect.parameters}


def inexactness(time: Array) -> Array:
    """(n,) m, how far a ball may be off at these times (n,) s since the start, even if its effects are right."""
    return np.hypot(PLACE, 0.5 * ROLLING * TILT * time**2)
