# SPDX-License-Identifier: Apache-2.0
"""The commands from which the next experiment is chosen."""

import math
from collections.abc import Iterator

from eps_tunnel_analysis.sequence import Chirp, Command, Hold, Ramp, Shape, Step, Triangle
from labyrinth_sim.model import Model

SHARES = (0.25, 0.5, 0.9)  # of an axis's range
RANGE = 0.1  # rad, where a rig states no limits


def menu(model: Model, axis: str) -> dict[str, Command]:
    """Commands for one axis, the others at rest or moving along, by name; all within the rig's limits."""
    channels = model.rig.command_channels
    chosen = next(i for i, a in enumerate(model.rig.axes) if a.name == axis)
    reaches = [min(map(abs, a.limits)) if a.limits else RANGE for a in model.rig.axes]
    found = {}
    for share in SHARES:
        for name, shapes, others in _rows(share * reaches[chosen], share):
            label = f"{name}_{axis}_{round(math.degrees(share * reaches[chosen]) * 10):d}"
            lasts = math.fsum(s.lasts for s in shapes)
            rest = [[_scaled(s, reach) for s in others] if others else [Hold(lasts)] for reach in reaches]
            rows = tuple(tuple(shapes) if i == chosen else tuple(rest[i]) for i in range(len(channels)))
            if len(channels) > 1 or not others:
                found[label] = Command(label, channels, (0.0,) * len(channels), rows)
    return found


def _rows(size: float, share: float) -> Iterator[tuple[str, list[Shape], list[Shape]]]:
    """Name, shapes of the axis with angles up to `size` rad, and of the others, in shares of their range; none: at
    rest.
    """
    for name, shapes in _shapes(size).items():
        yield name, shapes, []
    # First alone, then together with the others: what the axes share shows by what changes.
    jumps = (0.25, -0.25, 1.0, -1.0)
    alone = [Hold(0.5), *[Step(0.8, s * size) for s in (*jumps, *jumps, 0.0)]]
    along = [Hold(0.5 + 4 * 0.8), *[Step(0.8, s * share) for s in (*jumps, 0.0)]]
    yield "steps_together", alone, along


def _shapes(size: float) -> dict[str, list[Shape]]:
    return {
        "slow_triangles": [Hold(0.5), Triangle(5.0, size / 4, 0.4), Triangle(6.0, size, 1 / 3), Hold(0.5)],
        "fast_triangles": [Hold(0.5), Triangle(4.0, size / 2, 1.5), Triangle(4.0, size / 4, 3.0), Hold(0.5)],
        "steps": [Hold(0.5), *[Step(1.0, s * size) for s in (0.25, -0.25, 0.5, -0.5, 1.0, -1.0, 0.1, 0.0)]],
        "quick_steps": [Hold(0.5), *[Step(0.25, s * size) for s in (1.0, -1.0, 0.5, -0.5) * 8], Step(0.5, 0.0)],
        "staircase": [Hold(0.3), *[Step(0.6, size * i / 5) for i in (1, 2, 3, 4, 5, 4, 3, 2, 1, 0, -1, -3, -5, -3, 0)]],
        "ramps": [Hold(0.3), Ramp(2.5, size), Ramp(1.5, -size), Ramp(0.8, size), Ramp(0.4, 0.0), Ramp(4.0, -size),
                  Hold(0.5)],
        "chirp": [Hold(0.3), Chirp(8.0, size / 2, 0.3, 5.0), Hold(0.5)],
    }  # fmt: skip


def _scaled(shape: Shape, reach: float) -> Shape:
    return Step(shape.lasts, shape.to * reach) if isinstance(shape, Step) else shape
