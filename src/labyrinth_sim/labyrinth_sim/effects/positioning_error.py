# SPDX-License-Identifier: Apache-2.0
"""Local positioning error."""

import numpy as np

from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.filters import Map
from labyrinth_sim.site import Site
from labyrinth_sim.trials import Array


def command(values: Values, site: Site, step: float, start: Array) -> Map:
    size, period, phase = (values[name][:, None] for name in ("amplitude", "period", "phase"))
    return Map(lambda target: target + size * np.sin(2 * np.pi * target / period + phase))


EFFECT = Effect(
    name="positioning_error",
    title="Local positioning error",
    physics="The servo's own angle sensor is uneven, so that it settles off its target by an error that depends on "
    "the angle.",
    equation="u' = u + A sin(2 pi u / L + phase)",
    parameters=(
        Parameter("amplitude", "rad", 0.0, 0.05, 0.0, 0.01, "0 to ten ticks of a worn potentiometer"),
        Parameter("period", "rad", 0.03, 3.2, None, 0.15, "from a few ticks to half a turn"),
        Parameter("phase", "rad", -3.2, 3.2, None, 0.0, "a full period"),
    ),
    stage="command",
    mark="The axis never quite reaches some targets, always missing the same ones by the same angle from either side.",
    shows="by_angle",
    confused_with=(
        "gain_error",
        "sensor_bias",
        "coulomb_friction",
        "command_quantisation",
        "gravity_load",
    ),
    separated_by="A staircase up and down over the whole range: this error depends on the angle and not on the "
    "direction.",
    order=50,
    command=command,
)
