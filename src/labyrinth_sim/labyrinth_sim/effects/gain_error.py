# SPDX-License-Identifier: Apache-2.0
"""Gain error of the command."""

from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.filters import Map
from labyrinth_sim.site import Site
from labyrinth_sim.trials import Array


def command(values: Values, site: Site, step: float, start: Array) -> Map:
    factor = 1.0 + values["share"][:, None]
    return Map(lambda target: target * factor)


EFFECT = Effect(
    name="gain_error",
    title="Gain error",
    physics="The drive's scale is off: it goes to a fixed multiple of the target.",
    equation="u' = (1 + g) u",
    parameters=(
        Parameter("share", "1", -0.3, 0.3, 0.0, 0.05, "a pulley or potentiometer off by 30 % would be noticed by eye"),
    ),
    stage="command",
    mark="Every angle is too large or too small by the same share, encoder and board alike, at rest too.",
    shows="scaled",
    confused_with=("sensor_gain", "return_spring", "positioning_error"),
    separated_by="Compare encoder and potentiometer: a wrong sensor scale is seen in one of them, a gain error "
    "in both.",
    order=40,
    exact=True,
    command=command,
)
