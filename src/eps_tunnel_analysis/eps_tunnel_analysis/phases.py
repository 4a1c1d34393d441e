# SPDX-License-Identifier: Apache-2.0
"""Phases of a command: what the rig was being asked to do at each sample."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labyrinth_sim.rig import BALL_SIGNALS
from labyrinth_sim.trials import Array, Trials

SETTLE = 0.5  # s after the command stopped during which the rig is still taken to be on its way
REVERSAL = 0.25  # s after the command turned round
STEP = 0.25  # share of a motion; a start further than this from the first target was a step to it
STILL = 0.01  # share of the command's range within which two poses count as the same

MEANING = {
    "rise": f"the command moves, or moved less than {SETTLE:g} s ago",
    "reversal": f"the first {REVERSAL:g} s after the command turned round without a pause",
    "hold": "the command stands still away from where it started",
    "rest": "the command stands still where it started",
    "no command": "none was sent yet, or the drive was off",
}

MOVING = ("rise", "reversal")


@dataclass(frozen=True)
class Phases:
    """What one command channel does at each of T samples.

    Attributes:
        phase: (T,) names, keys of MEANING.
        direction: (T,) sign of the latest motion: "up", "down" or "none" before the first.
        amplitude: (T,) rad, size of the latest motion from turn to turn; 0 before the first.
    """

    phase: NDArray[np.str_]
    direction: NDArray[np.str_]
    amplitude: Array


@dataclass(frozen=True)
class _Motion:
    """One motion of the command: from sample `first` to sample `last`, by `change` rad."""

    first: int
    last: int
    change: float


def mean_command(trials: Trials) -> Array:
    """The command that the trials share, (T, u) rad: their median, so that jitter does not blunt a step."""
    seen = np.isfinite(trials.commands).any(axis=0)
    filled = np.where(seen, trials.commands, 0.0)
    return np.where(seen, np.nanmedian(filled, axis=0), np.nan)


CROSSWISE = dict(zip(BALL_SIGNALS, BALL_SIGNALS[::-1], strict=True))


def channel_of(signal: str, channels: Sequence[str]) -> str | None:
    """The command channel that moves a signal, by name: the same, its beginning, its last word, or the only one.

    A board that turns about one axis rolls the ball along the other.
    """
    signal = CROSSWISE.get(signal, signal)
    for channel in sorted(channels, key=len, reverse=True):
        if signal == channel or signal.startswith(f"{channel}_"):
            return channel
    by_axis = [c for c in channels if f"_{c.rsplit('_', 1)[-1]}_" in f"_{signal}_"]
    if len(by_axis) == 1:
        return by_axis[0]
    return channels[0] if len(channels) == 1 else None


def phases(time: Array, command: Array, before: float = np.nan) -> Phases:
    """The phases of one command channel (T,), which may be NaN where there was none.

    `before` is the target in rad that was held until time zero; where it is NaN, the first one was.
    """
    t = len(time)
    step = (time[-1] - time[0]) / (t - 1) if t > 1 else 1.0
    sent = np.isfinite(command)
    # One sample more than there are: the first stands for the time before zero.
    phase = np.full(t + 1, "no command", dtype=object)
    direction = np.full(t + 1, "none", dtype=object)
    amplitude = np.zeros(t + 1)
    if sent.any():
        held = command[np.maximum.accumulate(np.where(sent, np.arange(t), np.argmax(sent)))]
        held = np.concatenate([[before if np.isfinite(before) else held[0]], held])
        same = STILL * float(np.ptp(held))
        phase[:] = np.where(np.abs(held - held[0]) <= same, "rest", "hold")
        settle, turn = round(SETTLE / step), round(REVERSAL / step)
        last: _Motion | None = None
        for motion in _motions(held, settle, same):
            phase[motion.first : motion.last + settle + 1] = "rise"
            if last and motion.change * last.change < 0 and motion.first - last.last <= settle:
                phase[motion.first : motion.first + turn] = "reversal"
            direction[motion.first :] = "up" if motion.change > 0 else "down"
            amplitude[motion.first :] = abs(motion.change)
            last = motion
        phase[1:][~sent] = "no command"
    return Phases(phase[1:].astype(str), direction[1:].astype(str), amplitude[1:])


def target_before(time: Array, command: Array, measured: Array) -> float:
    """The target in rad until time zero, of a command (T,) that begins with a step; NaN where it does not.

    Trials begin with their first command, so that only the joint (T,) tells where it came from: it starts elsewhere,
    and goes to the target.
    """
    if not (len(time) and np.isfinite(command[0]) and np.isfinite(measured[0])):
        return np.nan
    jump = float(command[0] - measured[0])
    size = float(np.nanmax(np.abs(np.append(command, measured[0]) - command[0])))
    went = float(np.nanmax((measured[time <= time[0] + SETTLE] - measured[0]) * np.sign(jump)))
    if abs(jump) <= STEP * size or went <= STEP * abs(jump):
        return np.nan
    # A servo rests a little off its target; where the command returns to that later, its value is known.
    nearest = float(command[np.nanargmin(np.abs(command - measured[0]))])
    return nearest if abs(nearest - measured[0]) < STEP * size else float(measured[0])


def _motions(command: Array, pause: int, smallest: float) -> list[_Motion]:
    """Motions of a command (T,) without NaN: split where it turns round or rests longer than `pause` samples."""
    moving = np.flatnonzero(np.diff(command)) + 1  # samples whose command differs from the one before
    if not len(moving):
        return []
    signs = np.sign(command[moving] - command[moving - 1])
    cuts = np.flatnonzero((np.diff(moving) > pause) | (np.diff(signs) != 0)) + 1
    motions = []
    for group in np.split(moving, cuts):
        first, last = int(group[0]), int(group[-1])
        change = float(command[last] - command[first - 1])
        if abs(change) > smallest:  # less is jitter between the trials
            motions.append(_Motion(first, last, change))
    return motions
