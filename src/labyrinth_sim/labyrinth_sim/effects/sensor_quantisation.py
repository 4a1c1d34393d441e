# SPDX-License-Identifier: Apache-2.0
"""Sensor quantisation."""

from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.filters import Map, dithered
from labyrinth_sim.site import Site
from labyrinth_sim.ticks import cut
from labyrinth_sim.trials import Array


def measure(values: Values, site: Site, step: float, start: Array) -> Map:
    tick, noise = values["tick"], values["noise"]
    less = (values["cut"] * tick)[:, None]
    return Map(lambda angle: dithered(angle - less, tick, noise))


EFFECT = Effect(
    name="sensor_quantisation",
    title="Sensor quantisation",
    physics="The sensor reports whole ticks only, to which it rounds or cuts the angle; in a mean of trials, noise "
    "before the rounding softens the steps.",
    equation="angle' = E[q round((angle + noise) / q - c)]",
    parameters=(
        Parameter("tick", "rad", 0.0, 0.05, 0.0, 0.01, "0 to ten ticks of a 10-bit converter over 300 deg (5.1 mrad)"),
        Parameter(
            "noise", "rad", 0.0, 0.01, None, 0.0006, "none to two ticks of such a converter; 0 is one clean trial"
        ),
        cut("angles"),
    ),
    stage="measurement",
    mark="One signal takes few values, all multiples of one angle.",
    shows="stairs",
    confused_with=("command_quantisation", "backlash"),
    separated_by="Compare the sensors of one axis under a slow ramp: a coarse sensor shows stairs that the other "
    "does not.",
    where="signal",
    order=40,
    exact=True,
    measure=measure,
)
