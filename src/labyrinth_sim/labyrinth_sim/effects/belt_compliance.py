# SPDX-License-Identifier: Apache-2.0
"""Belt compliance, by the stiffness of MuJoCo's tendon."""

from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.live import Fields
from labyrinth_sim.site import Site


def fields(fields: Fields, site: Site, values: Values) -> None:
    stiffness, damping = fields["tendon_stiffness"], fields["tendon_damping"]
    softer = 1.0 + values["compliance"] * stiffness[:, site.tendon]
    stiffness[:, site.tendon] /= softer
    # A soft belt without a damper swings; one with the stiff belt's creeps.
    damping[:, site.tendon] *= values["damper"] + (1.0 - values["damper"]) / softer


EFFECT = Effect(
    name="belt_compliance",
    title="Belt compliance",
    physics="The belt stretches under load like a spring.",
    equation="belt torque = s / (1/k + c) + d (h + (1 - h) / (1 + k c)) ds/dt, s = r motor - board",
    parameters=(
        Parameter("compliance", "rad/(N m)", 0.0, 2.0, 0.0, 0.3, "0 to a rubber band: 1 deg at 9 mN m"),
        Parameter("damper", "1", 0.0, 1.0, None, 0.3, "h, share of the stiff belt's damping that the soft one keeps"),
    ),
    stage="mjcf",
    mark="The board swings after a step and lags the motor in proportion to its acceleration; no loop in slow motion.",
    shows="passing",
    confused_with=("backlash", "sensor_lag", "return_spring"),
    separated_by="Slow triangles and fast steps: backlash keeps its width in slow motion, compliance vanishes there.",
    needs=("belt",),
    fields=fields,
)
