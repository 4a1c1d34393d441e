# SPDX-License-Identifier: Apache-2.0
"""Command quantisation."""

from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.filters import Map, rounded
from labyrinth_sim.site import Site
from labyrinth_sim.trials import Array


def command(values: Values, site: Site, step: float, start: Array) -> Map:
    tick = values["tick"]
    return Map(lambda target: rounded(target, tick))


EFFECT = Effect(
    name="command_quantisation",
    title="Command quantisation",
    physics="The goal register has few bits, so that targets are rounded to whole ticks.",
    equation="u' = q round(u / q)",
    parameters=(
        Parameter("tick", "rad", 0.0, 0.05, 0.0, 0.01, "0 to ten ticks of a 10-bit register over 300 deg (5.1 mrad)"),
    ),
    stage="command",
    mark="The axis moves in stairs under a slow ramp and stands still under changes of the command below one tick.",
    shows="passing",
    confused_with=("dead_band", "positioning_error", "coulomb_friction"),
    separated_by="A slow triangle of large amplitude: the stairs of a quantised command lie at fixed angles, "
    "stick-slip "
    "does not.",
    order=20,
    command=command,
)
