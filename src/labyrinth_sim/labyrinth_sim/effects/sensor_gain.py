# SPDX-License-Identifier: Apache-2.0
"""Sensor gain."""

from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.filters import Map
from labyrinth_sim.site import Site
from labyrinth_sim.trials import Array


def measure(values: Values, site: Site, step: float, start: Array) -> Map:
    gain = values["gain"][:, None]
    return Map(lambda angle: angle * gain)


def undo(values: Values, site: Site, seen: Array) -> Array:
    return seen / values["gain"]


EFFECT = Effect(
    name="sensor_gain",
    title="Sensor gain",
    physics="The sensor's scale is wrong.",
    equation="angle' = g angle",
    parameters=(Parameter("gain", "1", 0.7, 1.3, 1.0, 1.05, "a scale off by 30 % would be noticed by eye"),),
    stage="measurement",
    mark="One signal is too large or too small by the same share at all times; the others are not.",
    shows="scaled",
    confused_with=("gain_error", "return_spring"),
    separated_by="Compare the sensors of one axis: a wrong sensor scale is seen in one of them, a gain error in both.",
    where="signal",
    order=20,
    exact=True,
    measure=measure,
    undo=undo,
)
