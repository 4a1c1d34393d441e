# SPDX-License-Identifier: Apache-2.0
"""Camera scale."""

from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.filters import Map
from labyrinth_sim.site import Site
from labyrinth_sim.trials import Array


def measure(values: Values, site: Site, step: float, start: Array) -> Map:
    scale = values["scale"][:, None]
    return Map(lambda place: place * scale)


EFFECT = Effect(
    name="camera_scale",
    title="Camera scale",
    physics="The camera's calibration is off, so that distances on the board come out too long or too short.",
    equation="ball' = s ball",
    parameters=(
        Parameter("scale", "1", 0.8, 1.2, 1.0, 1.05, "landmarks found wrong by a fifth would be noticed by eye"),
    ),
    stage="measurement",
    mark="The ball rests at walls and corners where there are none, by more the farther from the board's origin.",
    shows="scaled",
    confused_with=("rolling_friction", "camera_latency"),
    separated_by="Let the ball rest in several corners whose places are known.",
    where="ball",
    order=20,
    measure=measure,
)
