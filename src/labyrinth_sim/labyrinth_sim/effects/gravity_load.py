# SPDX-License-Identifier: Apache-2.0
"""Gravity load: a point mass off the axis."""

import mujoco
import numpy as np

from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.live import Fields
from labyrinth_sim.site import Site

ARM = 0.05  # m, from the axis to the point mass


def spec(spec: mujoco.MjSpec, site: Site) -> None:
    spec.joint(site.the_axis.load).parent.add_body(name=f"unbalance_{site.the_axis.name}")


def fields(fields: Fields, site: Site, values: Values) -> None:
    mj = fields.model
    data = mujoco.MjData(mj)
    mujoco.mj_kinematics(mj, data)
    sideways = np.cross(data.xaxis[site.load_joint], -mj.opt.gravity)
    length = np.linalg.norm(sideways)
    if length < 1e-9:  # gravity does not act about an upright axis
        return
    body = mj.body(f"unbalance_{site.the_axis.name}").id
    arm = ARM * data.xmat[site.load_body].reshape(3, 3).T @ (sideways / length)
    anchor = mj.jnt_pos[site.load_joint]
    fields["body_mass"][:, body] = np.abs(values["moment"]) / ARM
    fields["body_ipos"][:, body] = anchor + np.sign(values["moment"])[:, None] * arm


EFFECT = Effect(
    name="gravity_load",
    title="Gravity load (unbalanced board)",
    physics="The centre of mass of the moving part is off the axis, so that gravity pulls to one side.",
    equation="torque = M g cos(angle), M = mass times distance, at 50 mm from the axis",
    parameters=(Parameter("moment", "kg m", -0.25, 0.25, 0.0, 0.01, "a quarter of what a servo of 10 N m can hold"),),
    stage="mjcf",
    mark="The axis settles to one side of every target by nearly the same angle, and rises slower than it falls.",
    shows="offset",
    confused_with=(
        "direction_friction",
        "sensor_bias",
        "board_not_level",
        "return_spring",
        "positioning_error",
        "load_friction",
        "constant_torque",
        "cross_coupling",
    ),
    separated_by="Triangles over the whole range: its pull changes with the angle's cosine and does not depend on the "
    "direction of motion.",
    needs=("hinge",),
    spec=spec,
    fields=fields,
)
