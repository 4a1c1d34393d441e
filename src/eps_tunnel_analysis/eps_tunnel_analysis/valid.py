# SPDX-License-Identifier: Apache-2.0
"""Where a model was shown to hold: ranges of angle, speed and load, and whether a play leaves them."""

from collections.abc import Sequence

import numpy as np

from eps_tunnel_analysis.outputs import shown_value
from eps_tunnel_analysis.tunnel import build_tunnel
from labyrinth_sim.model import Model
from labyrinth_sim.trials import Array, Trials
from labyrinth_sim.validity import ShownSignal

POSITIONS = ("rad", "m")
EFFORTS = ("N m", "N")
SPEED_OVER = 0.05  # s over which a speed is taken: what ticks and noise make of shorter ones is no motion
LOAD_SHARE = 0.99  # of the time, within which an effort counts: what is beyond are single samples after steps
LEFT_BY = 0.05  # of a range, by which it may be left unnoticed


def ranges(real: Sequence[Trials], sim: Sequence[Trials]) -> dict[str, ShownSignal]:
    """Signal -> what some plays went through: positions as recorded, efforts as simulated.

    Args:
        real, sim: trials of each play; a model's efforts are there whether or not they were recorded.
    """
    shown: dict[str, ShownSignal] = {}
    for trials in real:
        for i, (name, unit) in enumerate(zip(trials.signals, trials.units, strict=True)):
            if unit in POSITIONS:
                mean = build_tunnel(trials).mean[:, i]
                shown = _wider(shown, name, unit, mean, _speed(mean, trials.step))
    for trials in sim:
        for i, (name, unit) in enumerate(zip(trials.signals, trials.units, strict=True)):
            if unit in EFFORTS:
                within = np.nanquantile(trials.values[:, :, i], [1.0 - LOAD_SHARE, LOAD_SHARE])
                shown = _wider(shown, name, unit, within, None)
    return shown


def beyond(model: Model, real: Trials, sim: Trials) -> tuple[str, ...]:
    """A sentence on each signal that goes where the model was not shown to hold; none where nothing is known of it."""
    if model.valid is None:
        return ()
    notes = []
    for name, here in ranges([real], [sim]).items():
        shown = model.valid.signals.get(name)
        if shown is None:
            continue
        room = LEFT_BY * (shown.high - shown.low)
        said = []
        if here.low < shown.low - room or here.high > shown.high + room:
            low, high, from_, to = (shown_value(v, here.unit) for v in (here.low, here.high, shown.low, shown.high))
            said.append(f"goes from {low} to {high}, validated from {from_} to {to}")
        if here.speed is not None and shown.speed is not None and here.speed > (1.0 + LEFT_BY) * shown.speed:
            fast, known = (shown_value(v, f"{here.unit}/s") for v in (here.speed, shown.speed))
            said.append(f"moves at up to {fast}, validated up to {known}")
        if said:
            notes.append(f"Outside the validated range of model '{model.name}': {name} {' and '.join(said)}.")
    return tuple(notes)


def _wider(
    shown: dict[str, ShownSignal], name: str, unit: str, values: Array, speed: float | None
) -> dict[str, ShownSignal]:
    """The ranges, so wide that they hold values (T,) and a speed, too."""
    if not np.isfinite(values).any():
        return shown
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    old = shown.get(name)
    if old is not None:
        low, high = min(low, old.low), max(high, old.high)
        speed = None if speed is None else max(speed, old.speed or 0.0)
    return {**shown, name: ShownSignal(unit, low, high, speed)}


def _speed(mean: Array, step: float) -> float:
    """Largest speed of a position (T,), over SPEED_OVER."""
    over = max(1, round(SPEED_OVER / step)) if step else 1
    moved = np.abs(mean[over:] - mean[:-over]) / (over * step) if len(mean) > over else np.zeros(1)
    return float(np.nanmax(moved)) if np.isfinite(moved).any() else 0.0
