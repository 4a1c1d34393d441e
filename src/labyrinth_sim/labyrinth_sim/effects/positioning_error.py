# SPDX-License-Identifier: Apache-2.0
"""Local positioning error."""

import math

import numpy as np

from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.filters import Map
from labyrinth_sim.law import law, state
from labyrinth_sim.site import Site
from labyrinth_sim.trials import Array


def command(values: Values, site: Site, step: float, start: Array) -> Map:
    size, period, phase, seen = (values[name][:, None] for name in ("amplitude", "period", "phase", "seen"))
    return Map(lambda target: target + (1.0 - seen) * size * np.sin(2 * np.pi * target / period + phase))


@law
def error(raw: int) -> None:
    s = state(raw)
    size, period, phase, seen = s.values[0], s.values[1], s.values[2], s.values[3]
    s.error[s.channel] += seen * size * math.sin(2.0 * math.pi * s.qpos[s.angle] / period + phase)


EFFECT = Effect(
    name="positioning_error",
    title="Local positioning error",
    physics="The servo settles off its target by an error that depends on the angle: its targets are uneven, or what "
    "its own angle sensor shows.",
    equation="u' = u + (1 - s) A sin(2 pi u / L + phase); e' = e + s A sin(2 pi angle / L + phase)",
    parameters=(
        Parameter("amplitude", "rad", 0.0, 0.05, 0.0, 0.01, "0 to ten ticks of a worn potentiometer"),
        Parameter("period", "rad", 0.03, 3.2, None, 0.15, "from a few ticks to half a turn"),
        Parameter("phase", "rad", -3.2, 3.2, None, 0.0, "a full period", fixed="unit"),
        Parameter("seen", "1", 0.0, 1.0, None, 0.0, "0 where targets are uneven, 1 where the sensor is", settled=True),
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
    steps_with="seen",
    command=command,
    error=error,
)
