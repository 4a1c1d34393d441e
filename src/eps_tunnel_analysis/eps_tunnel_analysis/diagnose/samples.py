# SPDX-License-Identifier: Apache-2.0
"""Which samples a diagnosis compares, how far each can be trusted, and which are kept from the fit."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from eps_tunnel_analysis.diagnose.noise import noise_floor
from eps_tunnel_analysis.fit.objective import Objective, middle
from eps_tunnel_analysis.plays import Play
from eps_tunnel_analysis.tunnel import build_tunnel
from labyrinth_sim.trials import Array

BLOCK = 0.2  # s; every KEEP_EVERYth block of samples is kept from the fit; longer ones may hold all that shows
KEEP_EVERY = 3
TURN = 0.05  # s over which a change of the command's speed counts as one
SPEED_CHANGE = 0.1  # 1/s, relative to the command's range; less is steady
SETTLED = 0.25  # s after which a motion is steady again
EFFORT_STEP = 0.005  # of the largest effort: what a load register resolves, but no less than
LOAD_STEP = 0.001  # of the servo's full torque
EFFORT_SHARE = 0.05  # of the effort: how well a torque constant is known


def steady_efforts(
    objective: Objective, plays: Sequence[Play], channel: str, columns: Sequence[int]
) -> NDArray[np.int64]:
    """Samples of an objective that belong to efforts and to steady motion."""
    found = []
    for number, play in enumerate(plays):
        calm = steady(play, channel)
        for column in columns:
            part = np.flatnonzero(objective.blocks == number * len(objective.signals) + column)
            found.append(part[calm[objective.samples[part]]])
    return np.concatenate(found)


def begun(objective: Objective, plays: Sequence[Play]) -> NDArray[np.bool_]:
    """(n,) samples after the start: a roll-out starts where sensors say, and a sensor may be wrong."""
    found = np.zeros(len(objective.mean), dtype=bool)
    for number, play in enumerate(plays):
        late = play.trials.time - play.trials.time[0] >= SETTLED
        part = objective.blocks // len(objective.signals) == number
        found[part] = late[objective.samples[part]]
    return found


def steady(play: Play, channel: str) -> NDArray[np.bool_]:
    """(T,) where the command has kept its speed for a while: at rest, on ramps, between the turns of a triangle.

    Elsewhere a drive's effort is inertia, sampled once between the beats of a controller: not comparable.
    """
    trials = play.trials
    return is_steady(middle(trials.commands)[:, trials.command_channels.index(channel)], trials.step)


def is_steady(command: Array, step: float) -> NDArray[np.bool_]:
    """(T,) whether a command (T,) rad, NaN where the drive is off, has kept its speed for a while."""
    held = np.where(np.isfinite(command), command, 0.0)
    span = max(1, round(TURN / step))
    speed = np.gradient(held, step) if len(held) > 1 else np.zeros_like(held)
    turn = maximum_filter1d(speed, span) - minimum_filter1d(speed, span)
    busy = turn > SPEED_CHANGE * max(float(np.ptp(held)), 1e-9)
    recent = max(1, round(SETTLED / step))
    return np.asarray(np.convolve(busy, np.ones(recent))[: len(busy)] < 0.5) & np.isfinite(command)


def floors(
    objective: Objective, plays: Sequence[Play], efforts: Sequence[int] = (), channel: str = "", full: float = 0.0
) -> Array:
    """(n,) noise floor at each of an objective's samples.

    Efforts get one of their own: a servo reports them in steps of its full load and by a torque constant that is known
    to a few percent.
    """
    scale = np.empty(len(objective.mean))
    known = {m.signal: m.resolution for m in objective.model.rig.measured}
    for number, play in enumerate(plays):
        trials = play.trials.select(objective.signals)
        found = noise_floor(trials, known)
        means = build_tunnel(trials).mean
        for i in range(len(objective.signals)):
            own = 0.0
            if i in efforts:
                mean = means[:, i]
                calm = mean[steady(play, channel) & np.isfinite(mean)]
                size = float(np.sqrt(np.mean(calm**2))) if len(calm) else 0.0
                least = max(EFFORT_STEP * np.nanmax(np.abs(mean)), LOAD_STEP * full)
                own = float(np.hypot(least, EFFORT_SHARE * size))
            part = objective.blocks == number * len(objective.signals) + i
            scale[part] = np.hypot(found.local[:, i], own)[objective.samples[part]]
    return scale


def kept_samples(objective: Objective, plays: Sequence[Play]) -> NDArray[np.bool_]:
    """(R,) samples kept from the fit, of each signal of each play."""
    kept = np.zeros(len(objective.mean), dtype=bool)
    for block in np.unique(objective.blocks):
        part = np.flatnonzero(objective.blocks == block)
        kept[part] = kept_of(len(part), plays[0].trials.step)
    return kept


def kept_of(count: int, step: float) -> NDArray[np.bool_]:
    """(count,) samples, `step` s apart, kept from the fit: every third block, so that each motion is on both sides."""
    every = max(1, round(BLOCK / step)) if step else 1
    return np.asarray((np.arange(count) // every) % KEEP_EVERY == KEEP_EVERY - 1)
