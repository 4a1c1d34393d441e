# SPDX-License-Identifier: Apache-2.0
"""What is played: a laboratory's steps and sines, the steps of the paper, pick and place, a person's hand."""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from scipy.ndimage import gaussian_filter1d

from drawn_rigs.physics import Array


def excite(rng: np.random.Generator, time: Array, reach: Array) -> Array:
    """Each axis alone and then all together: steps, ramps, triangles, sines, rests."""
    count = len(reach)
    out = np.zeros((len(time), count))
    spans = np.linspace(0.0, time[-1] - 0.4, count + 2 if count > 1 else 2)
    for i, (begin, end) in enumerate(pairwise(spans)):
        for axis in [i] if i < count else range(count):
            inside = (time >= begin) & (time < end)
            out[inside, axis] = reach[axis] * _pieces(rng, time[inside] - begin)
    return out


def _pieces(rng: np.random.Generator, time: Array) -> Array:
    out = np.zeros(len(time))
    at, level = 0.0, 0.0
    kinds = list(rng.permutation(["step", "ramp", "triangle", "sine", "chirp", "step", "step", "ramp"]))
    while at < time[-1] and len(time):
        kind = kinds.pop() if kinds else "step"
        lasts = float({"step": rng.uniform(0.3, 0.8), "ramp": rng.uniform(0.5, 1.2)}.get(kind, rng.uniform(0.9, 1.6)))
        part = (time >= at) & (time < at + lasts)
        t, size = time[part] - at, rng.uniform(0.2, 0.9) * rng.choice([-1, 1])
        if kind == "step":
            level = size
            out[part] = level
        elif kind == "ramp":
            out[part] = level + (size - level) * t / lasts
            level = size
        else:
            rate = rng.uniform(0.8, 2.5)
            phase = rate * t if kind != "chirp" else 0.5 * t + (rate + 1.5) * t**2 / (2 * lasts)
            swing = (
                np.sin(2 * np.pi * phase) if kind != "triangle" else 2 / np.pi * np.arcsin(np.sin(2 * np.pi * phase))
            )
            out[part] = level + min(abs(size), 1.0 - abs(level)) * (0.4 if kind == "chirp" else 0.8) * swing
        at += lasts
    return out


def paper(rng: np.random.Generator, time: Array, reach: Array) -> Array:
    """One step there and back on each axis."""
    size = reach * rng.uniform(0.3, 0.8)
    out = np.tile(size, (len(time), 1))
    spans = np.linspace(0.0, time[-1], 2 * len(reach) + 1)
    for axis in range(len(reach)):
        inside = (time >= spans[2 * axis]) & (time < spans[2 * axis + 1])
        out[inside, axis] = -size[axis]
    out[0] = size
    return out


def pick_and_place(rng: np.random.Generator, time: Array, reach: Array) -> Array:
    """From pose to pose with the least jerk, resting at each."""
    out = np.zeros((len(time), len(reach)))
    pose, at = np.zeros(len(reach)), 0.3
    while at < time[-1]:
        goal, lasts, rest = reach * rng.uniform(-1, 1, len(reach)), rng.uniform(0.4, 1.1), rng.uniform(0.1, 0.5)
        share = np.clip((time - at) / lasts, 0.0, 1.0)[:, None]
        moving = share[:, 0] > 0
        out[moving] = (pose + (goal - pose) * (10 * share**3 - 15 * share**4 + 6 * share**5))[moving]
        pose, at = goal, at + lasts + rest
    return out


def person(rng: np.random.Generator, time: Array, reach: Array) -> Array:
    """A hand: smooth, irregular, now quick, now slow, with a pause."""
    step = time[1] - time[0]
    out = np.empty((len(time), len(reach)))
    for axis, size in enumerate(reach):
        slow = gaussian_filter1d(rng.standard_normal(len(time)), 0.25 / step)
        quick = gaussian_filter1d(rng.standard_normal(len(time)), 0.09 / step)
        busy = np.clip(
            0.5 + 2 * gaussian_filter1d(rng.standard_normal(len(time)), 0.8 / step) * np.sqrt(0.8 / step), 0, 1
        )
        wave = slow / np.abs(slow).max() + 0.35 * busy * quick / np.abs(quick).max()
        rise = np.clip(time / 0.5, 0, 1) ** 2
        out[:, axis] = rng.uniform(0.5, 1.0) * size * rise * wave / np.abs(wave).max()
    return out


STYLES: dict[str, Callable[[np.random.Generator, Array, Array], Array]] = {
    "excite": excite,
    "paper": paper,
    "pick_and_place": pick_and_place,
    "person": person,
}
SHARES = {"excite": 0.5, "paper": 0.1, "pick_and_place": 0.2, "person": 0.2}
