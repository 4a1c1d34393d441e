# SPDX-License-Identifier: Apache-2.0
"""Efforts between the steps of a roll-out.

A drive's effort jumps where its target does, and samples lie anywhere beside these jumps, so steps of the length of a
controller's cycle say little about them. The motion has no jumps: here it is taken between the steps, and what the
drive gives is computed for it and for the target at that very time. What effects add to that is taken between the
steps as well; and where they limit the effort, so is what they leave of it.
"""

import numba
import numpy as np

from labyrinth_sim.drive_torques import torque
from labyrinth_sim.engine import Engine
from labyrinth_sim.law import CACHED
from labyrinth_sim.trials import Array

ADDED = 0.5  # of the change of an effort from step to step: what effects give may change so much, if they add to it


def means_of(values: Array, parts: int) -> Array:
    """(n, T, u) means of (n, T * parts, u) over each `parts`, without NaN unless they are all NaN."""
    return values if parts == 1 else np.asarray(_means(values, parts))


@numba.njit(cache=CACHED, error_model="numpy")  # type: ignore[untyped-decorator]
def _means(values: Array, parts: int) -> Array:
    out = np.empty((values.shape[0], values.shape[1] // parts, values.shape[2]))
    for i in range(out.shape[0]):
        for k in range(out.shape[1]):
            for u in range(out.shape[2]):
                total, count = 0.0, 0
                for value in values[i, k * parts : (k + 1) * parts, u]:
                    if not np.isnan(value):
                        total += value
                        count += 1
                out[i, k, u] = total / count if count else np.nan
    return out


@numba.njit(cache=CACHED, error_model="numpy")  # type: ignore[untyped-decorator]
def _at_starts(targets: Array) -> Array:
    """(n, K) targets at the start of each part over which these are means, a jump being over.

    Half the change from part to part earlier than the mean, where they change on both sides; of a jump only one does.
    """
    out = targets.copy()
    for i in range(targets.shape[0]):
        for k in range(1, targets.shape[1] - 1):
            before, after = targets[i, k] - targets[i, k - 1], targets[i, k + 1] - targets[i, k]
            if before * after > 0.0:  # not so where one is NaN
                out[i, k] -= 0.5 * (before if abs(before) < abs(after) else after)
    return out


def between(values: Array, parts: int) -> Array:
    """(n, T * parts, k) what lies at the start of each of `parts` parts of the steps that begin at values (n, T, k), on
    straight lines; after the last, that one.
    """
    after = np.concatenate([values[:, 1:], values[:, -1:]], axis=1)
    share = (np.arange(parts) / parts)[:, None]
    found = (1.0 - share) * values[:, :, None] + share * after[:, :, None]
    return np.asarray(found.reshape(len(values), -1, values.shape[2]))


def missed(short: Array, long: Array) -> Array:
    """(n, 2 T, k) what steps of no length add to what was rolled out in steps (n, 2 T, k), from steps twice as long
    (n, T, k): their error is of first order (Richardson 1911).
    """
    off = short[:, ::2] - long
    after = np.concatenate([off[:, 1:], off[:, -1:]], axis=1)
    return np.asarray(np.stack([off, (off + after) / 2.0], axis=2).reshape(short.shape))


def efforts_between(
    engine: Engine, drive: int, effort: Array, moved: Array, motion: Array, own: Array, targets: Array, start: Array
) -> Array:
    """(n, T * parts) N m, the effort of a drive from the start of each part of a step on.

    Args:
        engine: rolled out.
        drive: its number.
        effort: (n, T) N m, at the beginning of each step,
        moved: (n, T, 2) rad, rad/s, and the angle and speed there as they were rolled out,
        motion: (n, T, 2) and as they are corrected.
        own: (n, T) rad, what the drive saw during each step, NaN where it was off,
        targets: (n, T * parts) rad, and what it sees during each part of one.
        start: (n,) rad, its target before.
    """
    parts = targets.shape[1] // own.shape[1]
    of_steps = engine.asked(drive, own, start)
    of_parts = engine.asked(drive, _at_starts(targets), start, engine.step / parts)
    return np.asarray(_between(engine.torques.laws[:, drive], effort, moved, motion, of_steps, of_parts, parts))


@numba.njit(cache=CACHED, error_model="numpy")  # type: ignore[untyped-decorator]
def _between(
    laws: Array, effort: Array, moved: Array, motion: Array, of_steps: Array, of_parts: Array, parts: int
) -> Array:
    """What `efforts_between` gives; controls (n, T) and (n, T * parts) are NaN where the drive is off."""
    out = np.zeros(of_parts.shape)
    for i in range(effort.shape[0]):
        law, last = laws[i], effort.shape[1] - 1
        more = np.zeros(last + 1)
        for k in range(last + 1):
            if not np.isnan(of_steps[i, k]):
                more[k] = effort[i, k] - torque(law, of_steps[i, k], moved[i, k, 0], moved[i, k, 1])
        for k in range(last + 1):
            ahead = min(k + 1, last)
            added = abs(more[ahead] - more[k]) <= ADDED * abs(effort[i, ahead] - effort[i, k])
            for part in range(parts):
                control = of_parts[i, k * parts + part]
                if not np.isnan(control):
                    share = part / parts
                    angle = (1.0 - share) * motion[i, k, 0] + share * motion[i, ahead, 0]
                    speed = (1.0 - share) * motion[i, k, 1] + share * motion[i, ahead, 1]
                    own = torque(law, control, angle, speed)
                    if added:
                        out[i, k * parts + part] = own + (1.0 - share) * more[k] + share * more[ahead]
                    else:  # a limit, in either direction, of a drive that may ask for less before its target steps
                        most = abs((1.0 - share) * effort[i, k] + share * effort[i, ahead])
                        out[i, k * parts + part] = min(max(own, -most), most)
    return out
