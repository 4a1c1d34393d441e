# SPDX-License-Identifier: Apache-2.0
"""What commands and signals go through on their way: each channel's chain of filters."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from labyrinth_sim.build import Placed, Plan, local_values
from labyrinth_sim.effect import Filter, Values
from labyrinth_sim.filters import Map
from labyrinth_sim.model import Model
from labyrinth_sim.quantities import EFFORT
from labyrinth_sim.rig import BALL_SIGNALS
from labyrinth_sim.site import Site
from labyrinth_sim.trials import Array


def command_filters(plan: Plan, values: Values, step: float, start: Array) -> list[list[Filter]]:
    """The filters of each command channel in order, the drive's own last. `start` is (nsim, u) rad."""
    chains: list[list[Filter]] = []
    acting = plan.acting(values)
    for i, (drive, prefix, site) in enumerate(plan.drives):
        made = [
            placed.effect.command(local_values(values, placed.prefix), placed.site, step, start[:, i])
            for placed in acting
            if placed.effect.command and placed.site.channel == i
        ]
        made.append(drive.target(local_values(values, prefix), site, step, start[:, i]) if drive.target else None)
        chains.append([f for f in made if f is not None])
    return chains


def measure_filters(model: Model, plan: Plan, values: Values, step: float, first: Array) -> list[list[Filter]]:
    """The filters of each signal in order; `first` is (nsim, m), the first sample."""
    names = [m.signal for m in model.rig.measured] + (list(BALL_SIGNALS) if plan.with_ball else [])
    chains: list[list[Filter]] = []
    acting = plan.acting(values)
    # An effort whose unit is open is read in that unit, as it was recorded.
    scales = {n.split(".")[1]: numbers for n, numbers in values.items() if n.startswith(f"{EFFORT}.")}
    for column, signal in enumerate(names):
        made = [
            placed.effect.measure(local_values(values, placed.prefix), site, step, first[:, column])
            for placed in acting
            if placed.effect.measure and (site := _sees(placed, signal)) is not None
        ]
        made.insert(0, _over(scales[signal]) if signal in scales else None)
        chains.append([f for f in made if f is not None])
    return chains


def _over(scale: Array) -> Map:
    return Map(lambda torque: torque / scale[:, None])


def _sees(placed: Placed, signal: str) -> Site | None:
    site, effect = placed.site, placed.effect
    if effect.where == "signal":
        return site if site.signal == signal else None
    if effect.where == "ball":
        return replace(site, signal=signal) if signal in BALL_SIGNALS else None
    own = site.axis is not None and any(m.signal == signal for m in site.axis.measured)
    return replace(site, signal=signal) if own else None


def through(chains: list[list[Filter]], block: Array) -> Array:
    """(nsim, K, channels) through each channel's filters."""
    if not any(chains):
        return block
    out = np.array(block)
    for i, chain in enumerate(chains):
        for filter_ in chain:
            out[:, :, i] = filter_(out[:, :, i], block)
    return out


def undone(plan: Plan, values: Values, given: Mapping[str, Array]) -> dict[str, Array]:
    """Signal -> (nsim,): what was there, of what was seen, by the effects that can tell."""
    found = dict(given)
    for placed in reversed(plan.acting(values)):
        for signal, seen in found.items():
            if placed.effect.undo and (site := _sees(placed, signal)) is not None:
                found[signal] = placed.effect.undo(local_values(values, placed.prefix), site, seen)
    return found
