# SPDX-License-Identifier: Apache-2.0
"""Sensor bias."""

from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.filters import Map
from labyrinth_sim.site import Site
from labyrinth_sim.trials import Array


def measure(values: Values, site: Site, step: float, start: Array) -> Map:
    bias = values["bias"][:, None]
    return Map(lambda angle: angle + bias)


def undo(values: Values, site: Site, seen: Array) -> Array:
    return seen - values["bias"]


EFFECT = Effect(
    name="sensor_bias",
    title="Sensor bias",
    physics="The sensor's zero is not the angle's zero.",
    equation="angle' = angle + b",
    parameters=(
        Parameter(
            *("bias", "rad", -0.5, 0.5, 0.0, 0.02, "+-29 deg: a potentiometer glued on by eye, a horn some teeth off"),
            span=0.2,
        ),
    ),
    stage="measurement",
    mark="One signal is shifted by the same angle at all times; the others are not.",
    shows="offset",
    confused_with=(
        "gravity_load",
        "positioning_error",
        "direction_friction",
        "constant_torque",
        "board_not_level",
    ),
    separated_by="Compare the sensors of one axis: a bias moves one of them, a load or a wrong command moves both.",
    where="signal",
    order=30,
    exact=True,
    measure=measure,
    undo=undo,
)
