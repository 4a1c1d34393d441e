# SPDX-License-Identifier: Apache-2.0
"""Board not level: gravity turned."""

import mujoco
import numpy as np

from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.live import Fields
from labyrinth_sim.site import Site


def fields(fields: Fields, site: Site, values: Values) -> None:
    mj = fields.model
    data = mujoco.MjData(mj)
    mujoco.mj_kinematics(mj, data)
    axis = data.xaxis[site.load_joint]
    gravity = fields["opt.gravity"]
    angle = values["angle"][:, None]
    along = axis * (gravity @ axis)[:, None]
    gravity[...] = gravity * np.cos(angle) - np.cross(axis, gravity) * np.sin(angle) + along * (1.0 - np.cos(angle))


EFFECT = Effect(
    name="board_not_level",
    title="Board not level",
    physics="The table under the rig is not level, so that zero of the axes is not level either.",
    equation="gravity' = gravity turned by -angle about the axis",
    parameters=(Parameter("angle", "rad", -0.05, 0.05, 0.0, 0.01, "+-3 deg: more is seen by eye"),),
    stage="mjcf",
    mark="The ball rolls away while all angles read zero, always to the same side.",
    shows="adrift",
    confused_with=(
        "rolling_friction",
        "sensor_bias",
        "gravity_load",
        "cross_coupling",
        "constant_torque",
    ),
    separated_by="Find the tilt at which the ball rests, from both sides: friction leaves a band about it, a "
    "tilted table "
    "shifts it.",
    needs=("ball",),
    fields=fields,
)
