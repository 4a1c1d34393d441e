# SPDX-License-Identifier: Apache-2.0
"""Camera scale."""

import numpy as np

from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.filters import Map
from labyrinth_sim.site import Site
from labyrinth_sim.trials import Array


def measure(values: Values, site: Site, step: float, start: Array) -> Map:
    scale, centre = values["scale"][:, None], _centre(site)
    return Map(lambda place: np.where(scale == 1.0, place, centre + scale * (place - centre)))


def undo(values: Values, site: Site, seen: Array) -> Array:
    centre = _centre(site)
    return np.where(values["scale"] == 1.0, seen, centre + (seen - centre) / values["scale"])


def _centre(site: Site) -> float:
    assert site.signal is not None
    return site.centre[site.signal]


EFFECT = Effect(
    name="camera_scale",
    title="Camera scale",
    physics="The camera's calibration is off, so that distances on the board come out too long or too short.",
    equation="ball' = c + s (ball - c), c being the board's centre",
    parameters=(
        Parameter("scale", "1", 0.8, 1.2, 1.0, 1.05, "landmarks found wrong by a fifth would be noticed by eye"),
    ),
    stage="measurement",
    mark="The ball rests at walls and corners where there are none, the more so the farther from the board's centre.",
    shows="scaled",
    confused_with=("rolling_friction", "camera_latency"),
    separated_by="Let the ball rest in several corners whose places are known.",
    where="ball",
    order=20,
    measure=measure,
    undo=undo,
)
