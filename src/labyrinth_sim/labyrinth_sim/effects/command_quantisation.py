# SPDX-License-Identifier: Apache-2.0
"""Command quantisation."""

from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.filters import Map, rounded
from labyrinth_sim.site import Site
from labyrinth_sim.ticks import cut
from labyrinth_sim.trials import Array

WHOLE = 1e-9  # of a tick: a target of whole ticks stays, whatever the last bits of its number


def command(values: Values, site: Site, step: float, start: Array) -> Map:
    tick = values["tick"]
    less = (values["cut"] * (1.0 - WHOLE) * tick)[:, None]
    return Map(lambda target: rounded(target - less, tick))


EFFECT = Effect(
    name="command_quantisation",
    title="Command quantisation",
    physics="The goal register has few bits, so that targets are rounded, or cut, to whole ticks.",
    equation="u' = q round(u / q - c)",
    parameters=(
        Parameter("tick", "rad", 0.0, 0.05, 0.0, 0.01, "0 to ten ticks of a 10-bit register over 300 deg (5.1 mrad)"),
        cut("targets"),
    ),
    stage="command",
    mark="The axis moves in stairs under a slow ramp and stands still under changes of the command below one tick.",
    shows="passing",
    confused_with=(
        "dead_band",
        "positioning_error",
        "coulomb_friction",
        "sensor_quantisation",
    ),
    separated_by="A slow triangle of large amplitude: the stairs of a quantised command lie at fixed angles, "
    "stick-slip "
    "does not.",
    order=20,
    exact=True,
    command=command,
)
