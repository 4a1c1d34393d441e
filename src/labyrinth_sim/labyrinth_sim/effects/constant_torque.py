# SPDX-License-Identifier: Apache-2.0
"""A constant torque, by MuJoCo's applied force."""

from labyrinth_sim.effect import Effect, Values
from labyrinth_sim.friction import EITHER_WAY
from labyrinth_sim.live import Fields
from labyrinth_sim.site import Site


def fields(fields: Fields, site: Site, values: Values) -> None:
    fields.torque[:, site.dof] += values["torque"]


EFFECT = Effect(
    name="constant_torque",
    title="Constant torque",
    physics="Something pulls with the same torque at any angle and speed: a weight on a drum, the offset of an "
    "amplifier, a gas spring.",
    equation="torque = T",
    parameters=(EITHER_WAY,),
    stage="mjcf",
    mark="The axis settles to one side of every target by the same angle, whichever way it came.",
    shows="offset",
    confused_with=(
        "gravity_load",
        "direction_friction",
        "sensor_bias",
        "board_not_level",
    ),
    separated_by="Hold targets over the whole range and look at the effort: gravity's changes with the angle, this one "
    "does not, and a sensor's bias needs none.",
    exact=True,
    fields=fields,
)
